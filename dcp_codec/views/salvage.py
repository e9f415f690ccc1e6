"""Read the undamaged parts of octets that break rules: the header, payloads and containers.

Strict decoding is tried first and decides what is undamaged, so an undamaged beacon costs nothing extra. Otherwise the
frame of the beacon (headers and block lengths) is read from the dissection of the envelope plan, and every client
payload is decoded on its own. A fault inside a client payload therefore never changes the content of the others.

The header states the extent of the block list twice, as ``length`` and as ``numPayloads``. Where the two disagree,
three readings are compared, in this order of preference:

``length``   the list ends where ``length`` says (X02), whatever ``numPayloads`` says;
``whole``    as ``length``, and the length of every block counts the header of the block as well; only if exactly
             ``numPayloads`` blocks then end exactly where ``length`` says;
``count``    the list has ``numPayloads`` blocks, whatever ``length`` says.

A reading loses against one in which fewer blocks are cut off, empty or undecodable, and in which the octets after the
last block are zeros, as the padding of a bearer is. Where every reading cuts a block off, ``length`` is used.

Nothing is read (``beacon`` is None) of octets that end inside the header, or in which version and magic number are both
wrong. Nothing is read after a block that is cut off, of a client payload other than VarDis in which something is wrong,
and after a bad container of a VarDis payload: the positions of what follows are not known there.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import msgspec

from dcp_codec.errors import DecodeError, Problem
from dcp_codec.plan.layout import walk
from dcp_codec.plan.tree import Fill, Group, Many, Node, Region, Rest, Scalar, Select, Text
from dcp_codec.values import Beacon, Container, ExtendedSafetyData, OwnRecord, Payload

from .dissector import Dissect, generate_dissector
from .fields import Dissection, Field

if TYPE_CHECKING:
    from dcp_codec.codec import Codec

Reading = Literal["length", "whole", "count"]
"""The reading that gave the extent of the block list: see the module docstring."""

#: Reasons after which the position of the next block is unknown.
_CUT_OFF = frozenset({"truncated", "beacon-overrun", "block-overrun", "area-overrun"})
#: Octets of another protocol break both of these rules.
_FOREIGN = frozenset({"bad-version", "bad-magic"})


class Damaged(msgspec.Struct, frozen=True, gc=False):
    """A payload of a beacon with a fault.

    ``payload`` is its index in ``Beacon.payloads``, ``octets`` its client payload as received, ``problem`` the first
    fault inside it.
    """

    payload: int
    octets: bytes
    problem: Problem


class Salvaged(msgspec.Struct, frozen=True, gc=False):
    """The readable parts of octets, and all problems.

    ``beacon`` is None if nothing could be read. ``problems`` is empty if and only if strict decoding succeeds. The
    content of a ``damaged`` payload is its octets; that of a damaged VarDis payload is the containers before the fault.
    ``clear`` is false if the blocks do not add up in any reading: then the header may be misread as well. ``end`` is
    the offset after the last block.
    """

    beacon: Beacon | None
    problems: tuple[Problem, ...] = ()
    damaged: tuple[Damaged, ...] = ()
    reading: Reading = "length"
    clear: bool = True
    end: int = 0

    def octets_of(self, payload: int) -> bytes | None:
        """Return the client payload of a damaged block as received; None if the block has no fault."""
        return next((each.octets for each in self.damaged if each.payload == payload), None)

    @property
    def faults(self) -> tuple[Problem, ...]:
        """Return ``problems`` without consequential faults, in wire order.

        Keeps one problem for each damaged payload, or the first problem if the beacon is not clear.
        """
        if self.beacon is None or not self.clear:
            return self.problems[:1]
        inside = tuple(f"payloads[{each.payload}]." for each in self.damaged)
        found = [each for each in self.problems if not each.path.startswith(inside)] if inside else self.problems
        return tuple(sorted((*found, *(each.problem for each in self.damaged)), key=lambda each: each.offset))


class _IncompleteError(Exception):
    """A record ends before its last member."""


class _Attempt(NamedTuple):
    """The block list in one reading."""

    reading: Reading
    tree: Dissection
    blocks: tuple[Payload, ...]
    """The blocks with their client payloads as octets."""
    payloads: tuple[Payload, ...]
    damaged: tuple[Damaged, ...]
    cut_off: bool

    @property
    def faults(self) -> tuple[int, ...]:
        """Return the evidence against this reading; the reading with the smallest tuple is chosen."""
        known = {each.payload for each in self.damaged}
        empty = sum(each.content == b"" and index not in known for index, each in enumerate(self.payloads))
        return (self.cut_off, not self.payloads, empty, len(self.damaged), any(self.tree.padding))


class Salvager:
    """Reads damaged beacons of one codec; see :meth:`dcp_codec.codec.Codec.salvage`, which creates it."""

    def __init__(self, codec: Codec) -> None:
        self._codec = codec
        plan = codec.envelope_plan
        assert isinstance(plan, Group)
        self._dissect = generate_dissector(plan, f"{codec.profile.name} envelope")
        counted = _counted(plan)
        self._dissect_counted: Dissect | None = (
            None if counted is None else generate_dissector(counted, f"{codec.profile.name} counted envelope")
        )
        self._dissect_counted_beacon: Dissect | None = None
        self._payload, self._content = _payload_of(plan)
        self._clients: Mapping[int, str] = {
            number: case.name
            for node in walk(codec.beacon_plan)
            if isinstance(node, Select) and node.key == "protocolId"
            for number, case in node.cases.items()
        }

    def salvage(self, octets: bytes, *, envelope: bool = False) -> Salvaged:
        """Read octets that strict decoding refuses. ``envelope``: every client payload is left as octets."""
        problems = tuple(self._codec.dissect(octets).errors)
        tree = self._dissect(octets, 0, 0)
        header = tree.root.child("bp")
        if {each.reason for each in problems} >= _FOREIGN:
            return Salvaged(None, problems, clear=False)
        try:
            bp = None if header is None else self._record(header)
        except _IncompleteError:
            return Salvaged(None, problems, clear=False)
        attempt = self._attempt("length", tree)
        disputed = attempt.cut_off or any(each.reason == "count-mismatch" for each in tree.errors)
        if header is not None and disputed:
            attempt = min([attempt, *self._others(octets)], key=lambda each: each.faults)
        if attempt.reading != "length":
            wrong = [each for each in tree.errors if each.path.startswith("bp.")] or tree.errors[:1]
            problems = (*wrong, *(each.problem for each in attempt.damaged))
        payloads = attempt.blocks if envelope else attempt.payloads
        clear = bool(payloads) and not attempt.cut_off and not (disputed and any(attempt.tree.padding))
        return Salvaged(Beacon(bp, payloads), problems, attempt.damaged, attempt.reading, clear, attempt.tree.end)

    def tree(self, octets: bytes, reading: Reading) -> Dissection:
        """Return the dissection of a whole beacon in the reading that :meth:`salvage` has chosen for these octets.

        Its layouts are nodes of ``codec.beacon_plan``. Block lengths exclude the block header, also in the reading
        ``whole``.
        """
        if reading == "whole":
            shortened = self._shortened(octets)
            return self._codec.dissect(octets if shortened is None else shortened)
        if reading == "count":
            if self._dissect_counted_beacon is None:
                plan = self._codec.beacon_plan
                assert isinstance(plan, Group)
                title = f"{self._codec.profile.name} counted beacon"
                self._dissect_counted_beacon = generate_dissector(_counted(plan) or plan, title)
            return self._dissect_counted_beacon(octets, 0, 0)
        return self._codec.dissect(octets)

    # -- readings -----------------------------------------------------------------------------------------------

    def _others(self, octets: bytes) -> Iterator[_Attempt]:
        if self._dissect_counted is None:
            return
        shortened = self._shortened(octets)
        if shortened is not None:
            yield self._attempt("whole", self._dissect(shortened, 0, 0))
        yield self._attempt("count", self._dissect_counted(octets, 0, 0))

    def _shortened(self, octets: bytes) -> bytes | None:
        """Return the octets with every block length reduced by the header size, if that makes a valid block list."""
        names = [each.name for each in self._payload.members]
        place, content = names.index(self._content.length), self._payload.members.index(self._content)
        number, tree = 0, self._dissect(octets, 0, 0)
        while number < len(blocks := _blocks(tree)):
            members = blocks[number].children
            if len(members) <= max(place, content):
                return None
            length, layout = members[place], members[place].layout
            assert isinstance(layout, Scalar)
            header = members[content].offset - blocks[number].offset
            if length.value is None or length.value < header:
                return None
            value = (length.value - header).to_bytes(layout.size, layout.order, signed=layout.signed)
            octets = octets[: length.offset] + value + octets[length.offset + layout.size :]
            number, tree = number + 1, self._dissect(octets, 0, 0)
        wrong = {each.reason for each in tree.errors} - _FOREIGN
        return octets if number and not wrong else None

    def _attempt(self, reading: Reading, tree: Dissection) -> _Attempt:
        blocks: list[Payload] = []
        payloads: list[Payload] = []
        damaged: list[Damaged] = []
        for block in _blocks(tree):
            try:
                payload = self._record(block)
            except _IncompleteError:
                break
            blocks.append(payload)
            if (name := self._clients.get(payload.protocol_id)) is not None:
                raw = payload.content
                content, problem = self._client(name, raw)
                payload = msgspec.structs.replace(payload, content=content)
                if problem is not None:
                    problem = _inside(problem, block, self._place_of_content(block), name)
                    damaged.append(Damaged(len(payloads), raw, problem))
            payloads.append(payload)
        stops = [each for each in tree.errors if each.reason in _CUT_OFF]
        if stops and payloads:
            block, last = _blocks(tree)[len(payloads) - 1], len(payloads) - 1
            if stops[-1].path.startswith(f"{block.path}."):
                # Every fault inside the last block is a consequence of this one.
                damaged = [each for each in damaged if each.payload != last]
                damaged.append(Damaged(last, self._place_of_content(block).raw, stops[-1]))
        return _Attempt(reading, tree, tuple(blocks), tuple(payloads), tuple(damaged), bool(stops))

    def _place_of_content(self, block: Field) -> Field:
        return block.children[self._payload.members.index(self._content)]

    def _client(
        self, name: str, octets: bytes
    ) -> tuple[ExtendedSafetyData | OwnRecord | tuple[Container, ...] | bytes, Problem | None]:
        try:
            return (self._codec.decode_srp if name == "srp" else self._codec.decode_containers)(octets), None
        except DecodeError as error:
            return (octets if name == "srp" else error.partial or ()), error.problem

    # -- values -------------------------------------------------------------------------------------------------

    def _record(self, field: Field) -> Any:
        """Return the value of a record of the envelope."""
        group = field.layout
        assert isinstance(group, Group)
        types = self._codec.types
        _, foreign = types.slots(group)
        values: dict[str, Any] = {}
        extra: list[Any] = []
        parts = field.children
        for place, member in enumerate(group.members):
            attribute = types.attribute(group, member)
            if attribute is None and member not in foreign:
                continue
            if attribute is None and place >= len(parts) and "content" in values:
                # The octets end before the content.
                extra.append(b"")
                continue
            if place >= len(parts):
                raise _IncompleteError
            value = self._value(parts[place])
            if attribute is None:
                extra.append(value)
            else:
                values[attribute] = value
        if len(parts) < len(group.members) and "content" not in values:
            raise _IncompleteError
        if foreign:
            values["extra"] = tuple(extra)
        return types[group.type_name](**values)

    def _value(self, field: Field) -> Any:
        match field.layout:
            case Rest() | Fill():
                return field.raw
            case Scalar() | Text() if field.value is not None:
                return field.value
            case Group():
                return self._record(field)
            case _:
                raise _IncompleteError


def _blocks(tree: Dissection) -> tuple[Field, ...]:
    payloads = tree.root.child("payloads")
    return () if payloads is None else tuple(payloads.children)


def _counted(plan: Group) -> Group | None:
    """Return an envelope plan with as many blocks as the header counts; None if the plan counts them already."""
    members: list[Node] = []
    for member in plan.members:
        if isinstance(member, Region) and isinstance(member.content, Many) and member.content.agrees is not None:
            blocks = member.content
            members.append(dataclasses.replace(blocks, count=blocks.agrees, agrees=None))
        else:
            members.append(member)
    return None if members == list(plan.members) else dataclasses.replace(plan, members=tuple(members))


def _payload_of(plan: Group) -> tuple[Group, Region]:
    """Return the record of a payload block, and the member that is its content."""
    for node in walk(plan):
        if isinstance(node, Group) and node.type_name == "Payload":
            return node, next(each for each in node.members if isinstance(each, Region))
    raise TypeError("a beacon without payload blocks")


def _inside(problem: Problem, block: Field, content: Field, name: str) -> Problem:
    """Convert a problem of a client payload into a problem of the beacon."""
    joint = "." if problem.path and not problem.path.startswith("[") else ""
    path = f"{block.path}.{name}{joint}{problem.path}"
    return msgspec.structs.replace(problem, path=path, offset=problem.offset + content.offset)
