"""Scapy fields for the leaves and records of a plan, which :mod:`dcp_codec.scapy.packets` assembles.

Every dissected octet is in some field, so building without a change gives the same octets, also if they are not a valid
message: a field that is cut off or has no value holds :class:`Octets`.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any

from scapy.fields import ConditionalField, Field, PacketField, PacketListField, RawVal
from scapy.volatile import RandBin, RandFloat, RandNum, VolatileValue

from dcp_codec.jsonform import node_id_octets, node_id_text
from dcp_codec.plan.tree import Fill, Node, Rest, Scalar, Text
from dcp_codec.views.encode_diagnosis import bounds
from dcp_codec.views.fields import Field as Found

#: Maximum length of strings in scapy's fuzzing; longer ones would only make frames too long for the link.
_LONGEST_RANDOM = 64

#: Exceptions for values that do not fit a field.
_MISFITS = (TypeError, ValueError, OverflowError, struct.error)


class Octets(RawVal):
    """Raw octets in place of a value: of a field that is cut off, or whose octets no value gives.

    Like NaN they are neither less nor greater than any value, so filters on a field need no exception for broken
    frames.
    """

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Octets) and bool(self.val == other.val)

    def __hash__(self) -> int:
        return hash(self.val)

    def _unordered(self, _: object) -> bool:
        return False

    __lt__ = __le__ = __gt__ = __ge__ = _unordered

    def __repr__(self) -> str:
        return f"Octets({self.val!r})"


class PlanField(Field[Any, bytes]):
    """A scapy field for one leaf of a plan."""

    __slots__ = ("node",)

    #: A ``Scalar`` in the fields of numbers, else a ``Text``, ``Rest`` or ``Fill``.
    node: Any

    def __init__(self, name: str, default: Any, node: Node, size: int = 0) -> None:
        self.node = node
        super().__init__(name, default, f"{size}s")

    def value_octets(self, value: Any) -> bytes:
        """Return the octets of a value. Raises one of ``_MISFITS`` if the value does not fit this field."""
        raise NotImplementedError

    def from_octets(self, octets: bytes) -> Any:
        """Return the internal value of octets that the dissector found."""
        return octets

    def octets(self, value: Any) -> bytes:
        """Return the octets of any value that scapy may keep in the field. Raises ``ValueError`` naming the field."""
        if isinstance(value, VolatileValue):
            value = value._fix()
        if isinstance(value, RawVal):
            return bytes(value)
        try:
            return self.value_octets(self.default if value is None else value)
        except _MISFITS as error:
            raise ValueError(
                f"{self.name}: {value!r} does not fit ({error}); RawVal(b'...') puts any octets there"
            ) from None

    def held(self, found: Found) -> Any:
        """Return the field content for a dissected part: its value if that gives the same octets again, else its
        octets.
        """
        if found.value is None:
            return Octets(found.raw)
        value = self.from_octets(found.value) if isinstance(found.value, bytes) else found.value
        try:
            return value if self.value_octets(value) == found.raw else Octets(found.raw)
        except _MISFITS:
            return Octets(found.raw)

    def addfield(self, pkt: Any, s: bytes, val: Any) -> bytes:
        if val is None and self.default is None:
            val = pkt.follow(self.name)
        return s + self.octets(val)

    def i2len(self, _pkt: Any, x: Any) -> int:
        return len(self.octets(x))

    def i2repr(self, _pkt: Any, x: Any) -> str:
        return repr(x)


class ScalarField(PlanField):
    """A number, or a fixed number of octets. Enumerated values are set and shown by name."""

    __slots__ = ("names",)

    def __init__(self, name: str, default: Any, node: Scalar, names: Mapping[int, str] | None = None) -> None:
        self.names = dict(names or {})
        super().__init__(name, default, node, node.size)

    def value_octets(self, value: Any) -> bytes:
        node: Scalar = self.node
        if node.kind == "float":
            return struct.pack((">" if node.order == "big" else "<") + node.code, value)
        if node.kind == "bytes":
            return _exactly(bytes(value), node.size)
        if not isinstance(value, int):
            raise TypeError("not an integer")
        low, high = bounds(node)
        if not low <= value <= high:
            raise ValueError(f"not in {low}..{high}")
        return value.to_bytes(node.size, node.order, signed=node.signed)

    def h2i(self, _pkt: Any, x: Any) -> Any:
        if not isinstance(x, str) or not self.names:
            return x
        for number, name in self.names.items():
            if x.upper() == name.upper():
                return number
        raise ValueError(f"{self.name}: unknown name {x!r}; expected one of {', '.join(self.names.values())}")

    def i2repr(self, _pkt: Any, x: Any) -> str:
        if not isinstance(x, int):
            return repr(x)
        if x in self.names:
            return f"{x} ({self.names[x]})"
        # Usually written in hexadecimal: the magic number, the version, the network.
        known_in_hex = self.node.role == "network-id" or (self.node.rule is not None and not self.node.derived)
        return f"0x{x:0{2 * self.node.size}x}" if known_in_hex and x >= 0 else repr(x)

    def randval(self) -> Any:
        node: Scalar = self.node
        if node.kind == "bytes":
            return RandBin(node.size)
        if node.kind == "float":
            return RandFloat(-1000, 1000)
        return RandNum(*bounds(node))


class _NodeIdentifier(PlanField):
    """A node identifier, kept as text."""

    __slots__ = ()

    representation: str

    def value_octets(self, value: Any) -> bytes:
        octets = node_id_octets(value, self.representation) if isinstance(value, str) else bytes(value)
        return super().value_octets(octets)

    def from_octets(self, octets: bytes) -> Any:
        return node_id_text(octets, self.representation)

    def h2i(self, _pkt: Any, x: Any) -> Any:
        return self.from_octets(x) if isinstance(x, bytes) else x

    def i2repr(self, _pkt: Any, x: Any) -> str:
        return x if isinstance(x, str) else repr(x)


class NodeIdField(_NodeIdentifier, ScalarField):
    """A node identifier of fixed width: ``02:00:00:00:00:01``."""

    __slots__ = ("representation",)

    def __init__(self, name: str, default: Any, node: Scalar, representation: str) -> None:
        self.representation = representation
        super().__init__(name, default, node)


class OctetsField(PlanField):
    """Octets of varying number: a string, a variable value, client data, the rest of an area."""

    __slots__ = ()

    def __init__(self, name: str, default: Any, node: Text | Rest | Fill) -> None:
        super().__init__(name, default, node)

    def value_octets(self, value: Any) -> bytes:
        # bytes() of an integer would give that many zeros.
        if isinstance(value, int):
            raise TypeError("not octets")
        terminator = b"\0" if isinstance(self.node, Text) and self.node.terminated else b""
        return bytes(value) + terminator

    def h2i(self, _pkt: Any, x: Any) -> Any:
        return x.encode() if isinstance(x, str) else x

    def randval(self) -> Any:
        return RandBin(RandNum(0, _LONGEST_RANDOM))


class NodeIdTextField(_NodeIdentifier, OctetsField):
    """A node identifier that is text on the wire."""

    __slots__ = ()

    representation = "text"


class RecordField(PacketField):
    """One record inside another."""

    __slots__ = ()

    def octets(self, value: Any) -> bytes:
        """Return the octets of a packet, of octets, or of None (none)."""
        return b"" if value is None else bytes(value)


class RecordListField(PacketListField):
    """A list of records; it may also contain ``Raw`` and plain octets."""

    __slots__ = ()

    def any2i(self, pkt: Any, x: Any) -> Any:
        return super().any2i(pkt, [] if x is None else list(x) if isinstance(x, tuple) else x)

    def octets(self, value: Any) -> bytes:
        """Return the octets of a list of packets."""
        return b"".join(bytes(element) for element in value or ())


class ChosenField(ConditionalField):
    """A content that is present if the record's choice selects it (scapy shows no others).

    It reports the class of the field that it replaces, as proxies do: scapy's ``fuzz`` finds lists of packets by class
    and would otherwise skip this one.
    """

    __slots__ = ()

    @property  # type: ignore[misc] # object's can be assigned to, this one need not
    def __class__(self) -> Any:
        return type(self.fld)

    def i2h(self, pkt: Any, val: Any) -> Any:
        if pkt and not self._evalcond(pkt):
            return [] if self.fld.islist else None
        return self.fld.i2h(pkt, val)


def _exactly(octets: bytes, size: int) -> bytes:
    if len(octets) != size:
        raise ValueError(f"{len(octets)} octets, needs {size}")
    return octets
