"""dcp-datatypes.md: byte order and packing of records."""

from __future__ import annotations

from typing import Literal

from dcp_spec.profile.definition import own_fields

from dcp_conformance.check.base import Context, Invariant, Seen, name
from dcp_conformance.check.statements import CREATE
from dcp_conformance.definitions.results import Mark

#: A time stamp is near the time of the recording if they differ by less than this: 30 days in ns.
_NEAR = 30 * 86_400 * 1e9


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
        self._width, self._byte_order = self._stamp.width, self._stamp.byte_order
        self._other: Literal["big", "little"] = "little" if self._byte_order == "big" else "big"

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
            self._of_all += 1
            if order == "big":
                continue
            key = (seen.sender, field)
            text = f"{name(seen.sender)}: {field} is near the time of the recording only if read as little-endian"
            self.violated(text, [] if self.times(key) else [self._mark_of(seen, field)], once=key)

    def _order(self, ticks: int, wall: int) -> Literal["big", "little", ""]:
        """Return the byte order in which a time stamp is near ``wall`` (ns since 1970); empty for none or both."""
        ticks %= self._modulus
        other = int.from_bytes(ticks.to_bytes(self._width, self._byte_order), self._other)
        native = self._near(ticks, wall)
        if native == self._near(other, wall):
            return ""
        return self._byte_order if native else self._other

    def _near(self, ticks: int, wall: int) -> bool:
        """Whether a time stamp is less than 30 days from ``wall`` (ns since 1970)."""
        return abs(ticks * self._ns + self._epoch - wall) < _NEAR

    @staticmethod
    def _mark_of(seen: Seen, name_: str) -> Mark:
        """Return the place of the first field with this name; the whole frame if there is none."""
        field = next((each for each in seen.dissection.root.walk() if each.name == name_), None)
        return Mark(seen.number) if field is None else Mark(seen.number, field.offset, field.length, field.path)


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
            self._of_all += 1
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
            value = f" ({pointer:#x}, an address in memory)" if pointer is not None else ""
            found.append(what + (value if any(field.raw) else " (zero)"))
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


def _stamps(seen: Seen) -> list[tuple[str, int]]:
    """Return field name and value of the nonzero time stamps in the parts of a frame that can be decoded."""
    stamps: list[tuple[str, int]] = []
    report = seen.heard.report
    if report is not None and report.t_stamp:
        stamps.append(("tStamp", report.t_stamp))
    for kind, records, _, _, _ in seen.parts:
        if kind is CREATE:
            stamps += [("creationTime", each.spec.creation_time) for each in records if each.spec.creation_time]
    return stamps


RULES: tuple[type[Invariant], ...] = (ByteOrder, Packing)
