"""dcp-datatypes.md: byte order, packing, and what leaks out of memory."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from dcp_spec.profile.definition import own_fields

from dcp_codec.values import VarCreate
from dcp_conformance.check.base import Context, Invariant, Seen, name
from dcp_conformance.model.results import Mark

DAY = 86_400


class ByteOrder(Invariant):
    """Network byte order, judged by what can be judged: times that are near the clock of the recording."""

    id = "CK_DATA_ORDER"
    section = "dcp-datatypes.md: Basic Transmissible Data Types"
    purpose = "Numbers are sent most significant octet first"
    requirements = ("DATA-01",)
    expect = "time stamps that lie near the time of the recording when read most significant octet first"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._stamp = context.profile.types.timestamp
        self._modulus = 1 << (8 * self._stamp.width)
        self._ns = 1e9 / self._stamp.per_second
        self._epoch = self._stamp.epoch_ns or 0

    def applies(self) -> str:
        """Only where time stamps say a time of day."""
        if self._stamp.epoch not in ("unix", "gps"):
            return "time stamps of this profile count from no known time"
        return ""

    def feed(self, seen: Seen) -> None:
        """Read every time stamp in both orders."""
        for field, ticks in _stamps(seen):
            order = self._order(ticks, seen.time)
            if not order:
                # Both far away, as after a wrong clock, or both near: nothing can be said.
                continue
            self.exercised()
            if order == "big":
                continue
            key = (seen.sender, field)
            text = f"{name(seen.sender)}: {field} is such a time only when read least significant octet first"
            self.violated(text, [] if self.times(key) else [self._mark_of(seen, field)], once=key)

    def _order(self, ticks: int, wall: int) -> Literal["big", "little", ""]:
        """The order of octets in which a time stamp lies near a time; empty for none, or both."""
        octets = (ticks % self._modulus).to_bytes(self._stamp.width, self._stamp.byte_order)
        big = self._near(int.from_bytes(octets, "big"), wall)
        little = self._near(int.from_bytes(octets, "little"), wall)
        return "" if big == little else "big" if big else "little"

    @staticmethod
    def _mark_of(seen: Seen, name_: str) -> Mark:
        field = next((each for each in seen.dissection.root.walk() if each.name == name_), None)
        return Mark(seen.number) if field is None else Mark(seen.number, field.offset, field.length, field.path)

    def _near(self, ticks: int, wall: int) -> bool:
        return abs(ticks * self._ns + self._epoch - wall) < 30 * DAY * 1e9


class Packing(Invariant):
    """Records without traces of the memory they were in."""

    id = "CK_DATA_PACKED"
    section = "dcp-datatypes.md: Conventions"
    purpose = "Records are packed: nothing lies between their fields"
    requirements = ("DATA-02",)
    expect = "records of nothing but the fields of the specification"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        layout = context.profile.srp
        members = [each for each in own_fields(layout.record) if each.opaque is not None and layout.is_report]
        self._opaque = {each.name: each for each in members}

    def feed(self, seen: Seen) -> None:
        """Look at the regions that the profile calls opaque."""
        if seen.heard.report is None:
            # Octets of a bad payload lie anywhere.
            return
        if not self._opaque:
            self.exercised()
            return
        found: list[str] = []
        marks: list[Mark] = []
        octets = 0
        for field in seen.dissection.root.walk():
            if field.path.endswith(".srp"):
                self.exercised()
            if field.name not in self._opaque or not field.length:
                continue
            octets += field.length
            pointer = _pointer(field.raw)
            what = self._opaque[field.name].note or "unexplained"
            found.append(f"{what} ({pointer:#x}, an address in memory)" if pointer is not None else what)
            marks.append(Mark(seen.number, field.offset, field.length, field.path))
        if found:
            text = f"{name(seen.sender)}: {octets} octets of the state report belong to no field: {', '.join(found)}"
            self.violated(text, marks, once=seen.sender)


def _pointer(octets: bytes) -> int | None:
    """The address of a user's process on a 64-bit machine, if this could be one."""
    if len(octets) != 8:
        return None
    orders: tuple[Literal["little", "big"], ...] = ("little", "big")
    for order in orders:
        number = int.from_bytes(octets, order)
        if 0x5500_0000_0000 <= number <= 0x7FFF_FFFF_FFFF:
            return number
    return None


def _stamps(seen: Seen) -> Iterator[tuple[str, int]]:
    """The time stamps of the sound parts of a frame, with the names of their fields; 0 is none."""
    report = seen.heard.report
    if report is not None and report.t_stamp:
        yield "tStamp", report.t_stamp
    for container in seen.heard.containers:
        if container.records and type(container.records[0]) is VarCreate:
            for record in container.records:
                if record.spec.creation_time:
                    yield "creationTime", record.spec.creation_time


RULES: tuple[type[Invariant], ...] = (ByteOrder, Packing)
