"""Fields that the implementation reads differently from the profile, and the failures that follow from that.

One such fault has many consequences: an implementation that compares creation times in the wrong byte order keeps the
older of two variables, and one with another layout of state reports stores none of the tester's. The cases about data
types and formats fail for the fault. Its consequences in other cases are inconclusive. The fields are found at the
start of a run (:mod:`dcp_conformance.interconnection.misread_fields`).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from typing import Final, Literal

from dcp_spec.constants import ICType

from dcp_codec.codec import Codec
from dcp_codec.values import Payload, VarCreate
from dcp_conformance.frames.received import ReceivedBeacon
from dcp_conformance.test_system.traffic import Event

Field = Literal["creationTime", "report", "VarCreate"]
"""Something that can be misread: the creationTime of a VarSpecT, or a whole state report or VarCreate."""

OWNERS: Final = frozenset(
    {"DATA-01", "DATA-02", "DATA-03", "DATA-05", "SRP-FMT-01", "SRP-TYP-02", "SRP-TYP-03", "VD-TYP-05"}
)
"""The requirements about layouts: a misread field never excuses their failures."""
CREATION_OWNERS: Final = frozenset({"VD-PC-07", "VD-PC-09", "VD-CMP-06"})
"""The requirements to forward a VarCreate: a misread VarCreate never excuses their failures."""
_DAY: Final = 86_400 * 10**9


def backwards(codec: Codec, heard: Iterable[ReceivedBeacon], sut_id: bytes | None, wall: int) -> bool:
    """Return whether a VarCreate of the implementation's own variables has the current day only with swapped octets.

    ``wall``: the current time in ns since 1970. False if the clock of the profile has no epoch.
    """
    stamp = codec.profile.types.timestamp
    if stamp.epoch_ns is None:
        return False

    def today(ticks: int) -> bool:
        assert stamp.epoch_ns is not None
        return abs(stamp.epoch_ns + stamp.nanoseconds(ticks) - wall) < _DAY

    own = [each.record.spec for one in heard for each in one.instructions(ICType.CREATE_VARIABLES)]
    times = [each.creation_time for each in own if each.prod_id == sut_id and each.creation_time is not None]
    return any(not today(each) and any(map(today, _swapped(each, stamp.width))) for each in times)


def disordered(codec: Codec, events: Iterable[Event]) -> bool:
    """Return whether swapped octets change the order of two creationTimes of one variable, sent or received."""
    times: dict[int, set[int]] = {}
    for event in events:
        if event.direction not in ("sent", "heard"):
            continue
        beacon = codec.salvage(event.frame[event.start :]).beacon
        for payload in () if beacon is None else beacon.payloads:
            for container in payload.vardis or ():
                for each in container.records:
                    if isinstance(each, VarCreate) and each.spec.creation_time is not None:
                        times.setdefault(each.spec.var_id, set()).add(each.spec.creation_time)
    width = codec.profile.types.timestamp.width
    for found in times.values():
        for one, two in itertools.combinations(sorted(found), 2):
            if any(a > b for a, b in zip(_swapped(one, width), _swapped(two, width), strict=True)):
                return True
    return False


def _swapped(value: int, width: int) -> tuple[int, int]:
    """Return the number with its octets in the other order, as an unsigned and as a signed number."""
    octets = (value % (1 << (8 * width))).to_bytes(width, "little")
    return int.from_bytes(octets, "big"), int.from_bytes(octets, "big", signed=True)


def sent_report(codec: Codec, events: Iterable[Event]) -> bool:
    """Return whether the tester has sent a state report."""
    return any(payload.srp is not None for payload in _sent(codec, events))


def sent_creation(codec: Codec, events: Iterable[Event]) -> bool:
    """Return whether the tester has sent a VarCreate."""
    containers = (container for payload in _sent(codec, events) for container in payload.vardis or ())
    return any(isinstance(each, VarCreate) for container in containers for each in container.records)


def _sent(codec: Codec, events: Iterable[Event]) -> Iterator[Payload]:
    """Yield the payloads that the tester has sent."""
    sent = (codec.salvage(each.frame[each.start :]).beacon for each in events if each.direction == "sent")
    return (payload for each in sent if each is not None for payload in each.payloads)
