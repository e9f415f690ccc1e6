"""Source of the columnar decoder, line by line: reading numbers, filling columns, numbering identifiers.

Integers are ``int64`` throughout: an unsigned number of eight octets is its bit pattern, and a length with the top bit
set is too long. Indices into arrays are unsigned, or Numba would ask of each whether it counts from the end.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from dcp_codec.plan.tree import Scalar

from .row_buffer import item
from .shape import Column

#: Why the function returned: all frames are done, a table is full, or a pool of identifiers is full.
DONE, FULL, POOL_FULL = 0, 2, 3

#: Odd, and its bits are as good as any: spreads identifiers over the slots of a pool.
_MULTIPLIER = 0x9E3779B97F4A7C1
#: Octets of an identifier that can be its own key.
SHORT = 8


class KernelLines:
    """Lines of the function, and the statements that read values and put them into columns.

    Reading fails by leaving the innermost loop: everything that may fail stands in one.
    """

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.depth = 1
        self._names = 0

    # -- source ---------------------------------------------------------------------------------------------

    def add(self, line: str) -> None:
        """Append one line at the current depth."""
        self.lines.append("    " * self.depth + line)

    def fresh(self, stem: str = "v") -> str:
        """A name that nothing else in the function has."""
        self._names += 1
        return f"{stem}{self._names}"

    @contextmanager
    def block(self, line: str) -> Iterator[None]:
        """A compound statement: ``line`` and what is added inside."""
        self.add(line)
        self.depth += 1
        before = len(self.lines)
        yield
        if len(self.lines) == before:
            self.add("pass")
        self.depth -= 1

    def fail_if(self, condition: str) -> None:
        """Leave the innermost loop with ``bad`` still set."""
        with self.block(f"if {condition}:"):
            self.add("break")

    @contextmanager
    def loop(self, line: str) -> Iterator[None]:
        """A loop whose body may fail: ``ok`` is false while an element is being read."""
        ok = self.fresh("ok")
        self.add(f"{ok} = True")
        with self.block(line):
            self.add(f"{ok} = False")
            yield
            self.add(f"{ok} = True")
        self.fail_if(f"not {ok}")

    # -- values ---------------------------------------------------------------------------------------------

    @staticmethod
    def octet(at: str, relative: int) -> str:
        """The expression of an octet."""
        return f"I64(b[U64({at} + {relative})])" if relative else f"I64(b[U64({at})])"

    def number(self, scalar: Scalar, at: str, relative: int) -> str:
        """The expression of an integer, or of the bit pattern of a float, at ``at + relative``."""
        size = scalar.size
        order = range(size) if scalar.order == "little" else range(size - 1, -1, -1)
        parts = [
            self.octet(at, relative + place) + (f" << {8 * rank}" if rank else "") for rank, place in enumerate(order)
        ]
        text = " | ".join(f"({part})" for part in parts) if size > 1 else parts[0]
        if size == 8:
            text = f"wrapped({text})"
        if scalar.signed and size < 8:
            sign = 1 << (8 * size - 1)
            text = f"((({text}) ^ {sign}) - {sign})"
        return text

    def put(self, column: Column | None, row: str, value: str) -> None:
        """Put a number into a column, if there is one."""
        if column is not None:
            self.add(f"{self.place(column, row)} = {value}")

    @staticmethod
    def place(column: Column, row: str) -> str:
        """Where the stage holds the value of a column in a row; of varying octets where they end."""
        return f"{item(column)}[U64(at{column.number} + {row})]"

    def put_octets(self, column: Column, row: str, at: str, size: int) -> None:
        """Put ``size`` octets into a column of octets."""
        place = self.fresh("q")
        self.add(f"{place} = at{column.number} + {row} * {size}")
        if size <= SHORT:
            for index in range(size):
                self.add(f"u1[U64({place} + {index})] = b[U64({at} + {index})]")
        else:
            step = self.fresh("i")
            with self.block(f"for {step} in range({size}):"):
                self.add(f"u1[U64({place} + {step})] = b[U64({at} + {step})]")

    def put_varying(self, column: Column, row: str, at: str, size: str) -> None:
        """Append ``size`` octets to a column of varying ones."""
        number, index = column.number, self.fresh("i")
        with self.block(f"for {index} in range({size}):"):
            self.add(f"d{number}[U64(m{number} + {index})] = b[U64({at} + {index})]")
        self.add(f"m{number} += {size}")
        self.put(column, row, f"m{number}")

    def intern(self, pool: str, at: str, size: int, target: str) -> None:
        """Turn ``size`` <= 8 octets into their number in a pool."""
        key, place = self.fresh("k"), self.fresh("h")
        self.add(f"{key} = {self.number(Scalar('', 'int', size, '', 'big'), at, 0)}")
        self.add(f"{place} = ((({key} ^ ({key} >> 29)) * {_MULTIPLIER}) >> 20) & {pool}_mask")
        with self.block("while True:"):
            self.add(f"{target} = I64({pool}_slots[U64({place})])")
            with self.block(f"if {target} < 0:"):
                with self.block(f"if {pool}_many >= {pool}_most:"):
                    self.add(f"bad_now = {POOL_FULL}")
                    self.add("break")
                self.add(f"{target} = {pool}_many")
                self.add(f"{pool}_slots[U64({place})] = {target}")
                self.add(f"{pool}_keys[U64({target})] = {key}")
                self.add(f"{pool}_many += 1")
                self.add("break")
            with self.block(f"if {pool}_keys[U64({target})] == {key}:"):
                self.add("break")
            self.add(f"{place} = ({place} + 1) & {pool}_mask")
        self.fail_if(f"bad_now == {POOL_FULL}")

    def intern_any(self, at: str, size: str, target: str) -> None:
        """As :meth:`intern` for node identifiers of any number of octets."""
        self.add(
            f"{target} = intern(b, {at}, {size}, n_slots, n_ends, n_arena, n_many)",
        )
        with self.block(f"if {target} < 0:"):
            self.add(f"bad_now = {POOL_FULL}")
            self.add("break")
        with self.block(f"if {target} == n_many:"):
            self.add("n_many += 1")

    def node_id(self, at: str, size: int, target: str) -> None:
        """Turn a node identifier of fixed size into its number."""
        if size <= SHORT:
            self.intern("n", at, size, target)
        else:
            self.intern_any(at, f"I64({size})", target)
