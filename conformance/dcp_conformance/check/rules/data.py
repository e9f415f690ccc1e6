"""dcp-datatypes.md: byte order and packing of records."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from dcp_spec.profile.definition import own_fields

from dcp_codec.values import VarCreate
from dcp_conformance.check.base import Context, Invariant, Seen, name
from dcp_conformance.model.results import Mark

DAY = 86_400


class ByteOrder(Invariant):
    """Check the byte order of time stamps: only in one order they are near the time of the recording."""

    id = "CK_DATA_ORDER"
    section = "dcp-datatypes.md: Basic Transmissible Data Types"
    purpose = "Numbers are sent in network byte order (big-endian)"
    requirements = ("DATA-01",)
    expect = "big-endian time stamps near the time of the recording"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._stamp = context.profile.types.timestamp
        self._modulus = 1 << (8 * self._stamp.width)
        self._ns = 1e9 / self._stamp.per_second
        self._epoch = self._stamp.epoch_ns or 0

    def applies(self) -> str:
        """Exclude profiles whose time stamps have no known epoch."""
        if self._stamp.epoch not in ("unix", "gps"):
            return "time stamps of this profile have no known epoch"
        return ""

    def feed(self, seen: Seen) -> None:
        """Compare each time stamp in both byte orders with the time of the recording."""
        for field, ticks in _stamps(seen):
            order = self._order(ticks, seen.time)
            if not order:
                # Both are far away (a wrong clock) or both are near: the order cannot be determined.
                continue
            self.exercised()
            if order == "big":
                continue
            key = (seen.sender, field)
            text = f"{name(seen.sender)}: {field} is near the time of the recording only if read as little-endian"
            self.violated(text, [] if self.times(key) else [self._mark_of(seen, field)], once=key)

    def _order(self, ticks: int, wall: int) -> Literal["big", "little", ""]:
        """Return the byte order in which a time stamp is near ``wall`` (ns since 1970); empty for none or both."""
        octets = (ticks % self._modulus).to_bytes(self._stamp.width, self._stamp.byte_order)
        big = self._near(int.from_bytes(octets, "big"), wall)
        little = self._near(int.from_bytes(octets, "little"), wall)
        return "" if big == little else "big" if big else "little"

    @staticmethod
    def _mark_of(seen: Seen, name_: str) -> Mark:
        """Return the place of the first field with this name; the whole frame if there is none."""
        field = next((each for each in seen.dissection.root.walk() if each.name == name_), None)
        return Mark(seen.number) if field is None else Mark(seen.number, field.offset, field.length, field.path)

    def _near(self, ticks: int, wall: int) -> bool:
        """Whether a time stamp is less than 30 days from ``wall`` (ns since 1970)."""
        return abs(ticks * self._ns + self._epoch - wall) < 30 * DAY * 1e9


class Packing(Invariant):
    """Check that records have no padding between their fields."""

    id = "CK_DATA_PACKED"
    section = "dcp-datatypes.md: Conventions"
    purpose = "Records are packed: there is no padding between their fields"
    requirements = ("DATA-02",)
    expect = "records with only the fields of the specification"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        layout = context.profile.srp
        members = [each for each in own_fields(layout.record) if each.opaque is not None and layout.is_report]
        self._opaque = {each.name: each for each in members}

    def feed(self, seen: Seen) -> None:
        """Report the regions that the profile declares as opaque."""
        if seen.heard.report is None:
            # The fields of an invalid payload have no reliable position.
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
            text = f"{name(seen.sender)}: {octets} octets of the state report are in no field: {', '.join(found)}"
            self.violated(text, marks, once=seen.sender)


def _pointer(octets: bytes) -> int | None:
    """Return the octets as a user-space address of a 64-bit machine, in either byte order; None if implausible."""
    if len(octets) != 8:
        return None
    orders: tuple[Literal["little", "big"], ...] = ("little", "big")
    for order in orders:
        number = int.from_bytes(octets, order)
        if 0x5500_0000_0000 <= number <= 0x7FFF_FFFF_FFFF:
            return number
    return None


def _stamps(seen: Seen) -> Iterator[tuple[str, int]]:
    """Yield field name and value of the nonzero time stamps in the parts of a frame that can be decoded."""
    report = seen.heard.report
    if report is not None and report.t_stamp:
        yield "tStamp", report.t_stamp
    for container in seen.heard.containers:
        if container.records and type(container.records[0]) is VarCreate:
            for record in container.records:
                if record.spec.creation_time:
                    yield "creationTime", record.spec.creation_time


RULES: tuple[type[Invariant], ...] = (ByteOrder, Packing)
