"""Valid messages of any profile from a seeded generator, as a basis for mutations.

``dcp_lab.testing.strategies`` is for tests: it draws from a wider range and shrinks. This module is for speed:
thousands of beacons per second, with the standard library only. Boundary values are preferred; sizes range from the
smallest message to those that fill a beacon to its last octet.
"""

from __future__ import annotations

import functools
import math
import random
from collections.abc import Callable
from typing import Any, cast

from dcp_spec.constants import BP_PROTID_SRP, BP_PROTID_VARDIS, IC_MAX_RECORDS, ICType
from dcp_spec.profile.definition import OwnContainer, OwnField

from dcp_codec.codec import Codec
from dcp_codec.errors import EncodeError
from dcp_codec.plan.layout import neutral
from dcp_codec.records import RecordFactory
from dcp_codec.values import (
    Beacon,
    BPHeader,
    Container,
    ExtendedSafetyData,
    OwnRecord,
    Payload,
    VarCreate,
    VarDelete,
    VardisRecord,
    VarReqCreate,
    VarReqUpdate,
    VarSpec,
    VarSumm,
    VarUpdate,
)

from .draws import Draws

#: Probability of a boundary value for a number.
_EDGE = 0.4
_FLOATS = (0.0, -0.0, 1.5, -1e6, math.inf, -math.inf, math.nan)


class ValidValues:
    """Draws values that ``codec.encode`` accepts. The same seed gives the same values."""

    def __init__(self, codec: Codec, rng: random.Random) -> None:
        self.codec = codec
        self.rng = rng
        self._chance = Draws(rng)
        types = codec.profile.types
        self._types = types
        self._numbers = codec.profile.vardis.container_types.by_name()
        self._spec_fields = codec.profile.vardis.var_spec
        self.longest_value = _longest(types.value.lengths, terminated=types.value.terminated)
        self.longest_text = _longest(types.string.lengths, terminated=types.string.terminated)
        self._nodes = [types.node_id.of(bytes((0x02, 0xDC, 0x90, 0, 0, number))) for number in range(1, 6)]
        self._data = self._data_fields()
        self._made = RecordFactory(codec, lambda _record, member: self._added(member))
        self._fields: dict[str, Callable[[], int | bytes]] = {
            "varId": self.var_id,
            "prodId": self.node_id,
            "seqno": self.seqno,
            "value": self.value,
            "repCnt": lambda: self.number(types.var_rep_cnt.width, signed=types.var_rep_cnt.signed),
            "descr": lambda: self.octets(self.longest_text, nul=not types.string.terminated),
            "creationTime": lambda: self.number(types.timestamp.width, signed=types.timestamp.signed),
            "timeout": lambda: self.number(types.var_timeout.width, signed=types.var_timeout.signed),
        }
        self._containers: tuple[ICType | OwnContainer, ...] = (*ICType, *codec.profile.vardis.own_containers)
        self._records: dict[ICType, Callable[[], VardisRecord]] = {
            ICType.SUMMARIES: lambda: VarSumm(self.var_id(), self.seqno()),
            ICType.UPDATES: lambda: VarUpdate(self.var_id(), self.seqno(), self.value()),
            ICType.REQUEST_VARUPDATES: lambda: VarReqUpdate(self.var_id(), self.seqno()),
            ICType.REQUEST_VARCREATES: lambda: VarReqCreate(self.var_id()),
            ICType.CREATE_VARIABLES: self._create,
            ICType.DELETE_VARIABLES: lambda: VarDelete(self.var_id()),
        }

    def number(self, width: int, *, signed: bool = False) -> int:
        """Draw an integer of ``width`` octets; 0, 1, the highest two and, if signed, the lowest are far more
        frequent.
        """
        edges = _edges(width, signed)
        if self.rng.random() < _EDGE:
            return self._chance.one_of(edges)
        return edges[-1] + self._chance.below(1 << (8 * width))

    def octets(self, most: int, *, nul: bool = True) -> bytes:
        """Draw 0 to ``most`` octets, sometimes exactly ``most``."""
        if self.rng.random() < _EDGE:
            size = self._chance.one_of((0, 1, 4, 8, most))
        else:
            size = self._chance.below(min(most, 16) + 1)
        found = self.rng.randbytes(min(size, most))
        return found if nul else found.replace(b"\0", b"\1")

    def node_id(self) -> bytes:
        """Draw a node identifier from a small set, so that identifiers recur."""
        return self._chance.one_of(self._nodes)

    def var_id(self) -> int:
        """Draw a variable, mostly from a small set, so that variables recur."""
        if self.rng.random() < 0.7:
            return self._chance.below(8)
        return self.number(self._types.var_id.width, signed=self._types.var_id.signed)

    def var_spec(self, var_id: int) -> VarSpec:
        """Draw the static attributes of a variable."""
        names = ("prodId", "repCnt", "descr", "creationTime", "timeout")
        drawn: list[Any] = [self._fields[name]() if name in self._spec_fields else None for name in names]
        return VarSpec(var_id, *drawn)

    def seqno(self) -> int:
        """Draw a sequence number of a variable."""
        return self.number(self._types.var_seqno.width, signed=self._types.var_seqno.signed)

    def value(self) -> bytes:
        """Draw the value of a variable."""
        return self.octets(self.longest_value, nul=not self._types.value.terminated)

    def _added(self, member: OwnField) -> int | float | bytes:
        """Draw the value of a field that the profile adds; octets without a meaning are zeros."""
        if member.extra is not None:
            return self.number(member.extra.width, signed=member.extra.signed)
        if member.block is not None:
            longest = _longest(member.block.lengths, terminated=member.block.terminated)
            return self.octets(longest, nul=not member.block.terminated)
        return neutral(member) if member.real is None else self._chance.one_of(_FLOATS)

    def record(self, kind: ICType | OwnContainer) -> VardisRecord | OwnRecord:
        """Draw a record of a container type."""
        if isinstance(kind, ICType):
            return self._made.filled(self._records[kind]())
        made: Any = self.codec.types[kind.type_name]
        members = (self._fields[each]() if isinstance(each, str) else self._added(each) for each in kind.record)
        return cast(OwnRecord, made(*members))

    def _create(self) -> VarCreate:
        var_id = self.var_id()
        return VarCreate(self.var_spec(var_id), VarUpdate(var_id, self.seqno(), self.value()))

    def container(self, kind: ICType | OwnContainer | None = None, count: int | None = None) -> Container:
        """Draw a container with ``count`` records of type ``kind``."""
        kind = self._chance.one_of(self._containers) if kind is None else kind
        count = self._chance.one_of((1, 1, 2, 3)) if count is None else count
        number = self._numbers[kind.label] if isinstance(kind, ICType) else kind.number
        return Container(number, tuple([self.record(kind) for _ in range(count)]))

    def report(self) -> ExtendedSafetyData:
        """Draw a state report."""
        types = self._types
        data = self.codec.safety_data_type(**{name: draw() for name, draw in self._data})
        stamp = self.number(types.timestamp.width, signed=types.timestamp.signed)
        seqno = self.number(types.srp_seqno.width, signed=types.srp_seqno.signed)
        return self._made.filled(ExtendedSafetyData(data, self.node_id(), stamp, seqno))

    def _data_fields(self) -> list[tuple[str, Callable[[], Any]]]:
        """Return the attributes of the profile's safety data, each with a function that draws its value."""
        found: list[tuple[str, Callable[[], Any]]] = []
        for field in self.codec.profile.srp.safety_data:
            draw: Callable[[], Any]
            if field.type == "opaque":
                draw = functools.partial(self.rng.randbytes, field.octets)
            elif field.type.startswith("f"):
                draw = functools.partial(self._chance.one_of, _FLOATS)
            else:
                draw = functools.partial(self.number, field.width, signed=field.type.startswith("i"))
            found.append((field.name, draw))
        return found

    def header(self) -> BPHeader | None:
        """Draw the header of a beacon; the network is that of the profile."""
        profile = self.codec.profile
        if not profile.bp.header:
            return None
        seqno = self.number(self._types.bp_seqno.width) if profile.has_header_field("seqno") else 0
        return self._made.header(self.node_id(), seqno)

    def payload(self) -> Payload:
        """Draw a payload block: VarDis, SRP if the profile can encode it, or octets of another protocol."""
        chance = self.rng.random()
        if chance < 0.15 and self.codec.report_plan is not None:
            return Payload(BP_PROTID_SRP, self.report())
        if chance < 0.25:
            width = self._types.protocol_id.width
            other = self._chance.one_of((0, 3, (1 << (8 * width)) - 1))
            return Payload(other, self.octets(40))
        return Payload(BP_PROTID_VARDIS, tuple(self.container() for _ in range(self._chance.one_of((1, 1, 2, 3)))))

    def beacon(self) -> bytes:
        """Draw a beacon; one that exceeds the maximum size of the profile is drawn again."""
        while True:
            octets = self._encoded(tuple(self.payload() for _ in range(self._chance.one_of((1, 1, 2, 3)))))
            if octets is not None:
                return octets

    def full(self, kind: ICType) -> bytes:
        """Draw a beacon whose one container has at least three quarters of the possible number of records of type
        ``kind``.
        """
        drawn = self.container(kind, IC_MAX_RECORDS)
        count = IC_MAX_RECORDS
        while count > 1:
            container = Container(drawn.ic_type, drawn.records[:count])
            octets = self._encoded((Payload(BP_PROTID_VARDIS, (container,)),))
            if octets is not None:
                return octets
            count = count * 3 // 4
        return self.beacon()

    def _encoded(self, blocks: tuple[Payload, ...]) -> bytes | None:
        try:
            octets = self.codec.encode(Beacon(self.header(), blocks))
        except EncodeError:
            # Longer than a length field can express.
            return None
        return octets if len(octets) <= max(self.codec.profile.limits.max_beacon_size, 1500) else None


@functools.cache
def _edges(width: int, signed: bool) -> tuple[int, int, int, int, int]:
    """Return 0, 1, the highest two and the lowest integer of ``width`` octets."""
    low = -(1 << (8 * width - 1)) if signed else 0
    high = low + (1 << (8 * width)) - 1
    return 0, 1, high - 1, high, low


def _longest(lengths: tuple[Any, ...], *, terminated: bool) -> int:
    """Return the length of the longest text that a length can express, at most 255."""
    most: int = min([255, *((1 << (8 * each.width - each.signed)) - 1 for each in lengths)])
    return most - terminated


def valid_beacons(codec: Codec, rng: random.Random, count: int) -> list[bytes]:
    """Return ``count`` valid beacons of the profile, among them one with a full container of each type."""
    values = ValidValues(codec, rng)
    full = [values.full(kind) for kind in ICType]
    return [*full[:count], *(values.beacon() for _ in range(count - len(full)))]
