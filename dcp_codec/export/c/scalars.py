"""C expressions that read and write one scalar, and the helper functions that they need."""

from __future__ import annotations

from dcp_codec.export.shape import Shape
from dcp_codec.export.wording import bits_of
from dcp_codec.plan.measures import largest
from dcp_codec.plan.tree import Scalar

from .names import integer_type


def raw_type(size: int) -> str:
    """Return the narrowest unsigned type of C that holds ``size`` octets."""
    return f"uint{bits_of(size)}_t"


class Functions:
    """Collects the functions of a shape, line by line.

    ``scalars`` collects the helpers that they call, ``shared`` those of the functions that are in the header.
    """

    def __init__(self, shape: Shape, scalars: Scalars, shared: Scalars) -> None:
        self.shape = shape
        self.scalars = scalars
        self.shared = shared
        self.lines: list[str] = []

    def add(self, *lines: str) -> None:
        self.lines += lines


class Scalars:
    """Makes expressions, and remembers which helper functions they call."""

    def __init__(self) -> None:
        self._helpers: dict[str, str] = {}

    def helpers(self, known: Scalars | None = None) -> str:
        """Return the definitions of the helpers that are needed, without those that ``known`` defines."""
        there = known._helpers if known is not None else {}
        return "\n".join(self._helpers[name] for name in sorted(self._helpers) if name not in there)

    def read(self, scalar: Scalar, place: int) -> str:
        """Return the value of a scalar ``place`` octets after the pointer ``p``."""
        if scalar.kind == "bytes":
            return pointer(place)
        raw = self._load(scalar, place)
        if scalar.kind == "float":
            return f"{self._real(scalar.size)}({raw})"
        if scalar.signed:
            self._helpers.setdefault("dcp_signed", _AS_SIGNED)
            return f"({integer_type(scalar)})dcp_signed({raw}, {8 * scalar.size}u)"
        return raw

    def _load(self, scalar: Scalar, place: int) -> str:
        size, little = scalar.size, scalar.order == "little"
        if size == 1:
            return f"p[{place}]"
        name, raw = f"dcp_{'le' if little else 'be'}{size}", raw_type(size)
        wide = "uint64_t" if size > 4 else "uint32_t"
        terms = []
        for index in range(size):
            shift = 8 * (index if little else size - 1 - index)
            terms.append(f"({wide})p[{index}]" + (f" << {shift}" if shift else ""))
        pairs = [" | ".join(terms[index : index + 2]) for index in range(0, size, 2)]
        value = "\n           | ".join(pairs)
        cast = f"({raw})({value})" if size <= 2 else value
        self._helpers[name] = _function(f"static inline {raw} {name}(const uint8_t *p)", f"return {cast};")
        return f"{name}({pointer(place)})"

    def _real(self, size: int) -> str:
        name, raw, real = f"dcp_real{size}", raw_type(size), "float" if size == 4 else "double"
        self._helpers[name] = (
            f"/* The octets of an IEEE 754 number as {real}. */\n"
            f"static inline {real} {name}({raw} bits)\n{{\n    union {{\n        {raw} bits;\n        {real} value;\n"
            f"    }} both;\n    both.bits = bits;\n    return both.value;\n}}\n"
        )
        return name

    def write(self, scalar: Scalar, value: str, place: int) -> str:
        """Return the statement that stores a number ``place`` octets after the pointer ``p``."""
        size = scalar.size
        if scalar.kind == "float":
            name, raw, real = f"dcp_bits{size}", raw_type(size), "float" if size == 4 else "double"
            self._helpers[name] = (
                f"static inline {raw} {name}({real} value)\n{{\n"
                f"    union {{\n        {raw} bits;\n        {real} value;\n"
                f"    }} both;\n    both.value = value;\n    return both.bits;\n}}\n"
            )
            value = f"{name}({value})"
        if size == 1:
            return f"p[{place}] = {value};"
        return f"{self.store(scalar)}({pointer(place)}, {value});"

    def store(self, scalar: Scalar) -> str:
        """Return the name of the function that stores a number of a scalar's size and order."""
        size, little = scalar.size, scalar.order == "little" and scalar.size > 1
        name, raw = f"dcp_put_{'le' if little else 'be'}{size}", raw_type(size)
        lines = []
        for index in range(size):
            shift = 8 * (index if little else size - 1 - index)
            octet = f"value >> {shift}" if shift else "value"
            lines.append(
                f"p[{index}] = (uint8_t)({octet});"
                if shift
                else f"p[{index}] = {'' if size == 1 else '(uint8_t)'}value;"
            )
        self._helpers[name] = _function(f"static inline void {name}(uint8_t *p, {raw} value)", *lines)
        return name

    @staticmethod
    def range_check(scalar: Scalar, value: str) -> str:
        """Return the condition that a number does not fit its field; empty if the type has no other values."""
        if scalar.kind != "int" or scalar.size in (1, 2, 4, 8):
            return ""
        top, wide = largest(scalar), scalar.size > 4
        if scalar.signed:
            most = f"INT64_C({top})" if wide else str(top)
            return f"{value} < -{most} - 1 || {value} > {most}"
        return f"{value} > UINT64_C({top})" if wide else f"{value} > {top}u"


def pointer(place: int) -> str:
    """Return the pointer ``place`` octets after ``p``."""
    return f"p + {place}" if place else "p"


def _function(signature: str, *body: str) -> str:
    return "\n".join([signature, "{", *(f"    {line}" for line in body), "}", ""])


_AS_SIGNED = """/* The number whose two's complement of this many bits is value. */
static inline int64_t dcp_signed(uint64_t value, unsigned bits)
{
    const uint64_t half = (uint64_t)1 << (bits - 1u);
    return value < half ? (int64_t)value : -(int64_t)(half - 1u + half - value) - 1;
}
"""
