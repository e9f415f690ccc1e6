"""dcp-datatypes.md: byte order, packing, and what leaks out of memory."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from dcp_spec.profile import own_fields

from dcp_codec.dissect import Field
from dcp_codec.plan import Scalar
from dcp_conformance.results import Mark

from .base import Context, Invariant, Seen, name

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

    def applies(self) -> str:
        """Only where time stamps say a time of day."""
        if self._stamp.epoch not in ("unix", "gps"):
            return "time stamps of this profile count from no known time"
        return ""

    def feed(self, seen: Seen) -> None:
        """Read every time stamp in both orders."""
        for field in _stamps(seen):
            octets = field.raw
            big = self._near(int.from_bytes(octets, "big"), seen.time)
            little = self._near(int.from_bytes(octets, "little"), seen.time)
            if big == little:
                # Both far away, as after a wrong clock, or both near: nothing can be said.
                continue
            self.exercised()
            if little:
                mark = Mark(seen.number, field.offset, field.length, field.path)
                text = (
                    f"{name(seen.sender)}: {_last(field)} is such a time only when read least significant octet first"
                )
                self.violated(text, [mark], once=(seen.sender, _last(field)))

    def _near(self, ticks: int, wall: int) -> bool:
        seconds = ticks / self._stamp.per_second + (self._stamp.epoch_ns or 0) / 1e9
        return abs(seconds - wall / 1e9) < 30 * DAY


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


def _stamps(seen: Seen) -> Iterator[Field]:
    for field in seen.dissection.root.walk():
        layout = field.layout
        if isinstance(layout, Scalar) and layout.role == "timestamp" and field.length == layout.size and any(field.raw):
            yield field


def _last(field: Field) -> str:
    return field.path.rpartition(".")[2]


RULES: tuple[type[Invariant], ...] = (ByteOrder, Packing)
