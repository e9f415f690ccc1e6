"""Which fields does the implementation read otherwise than the profile lays them out? Found out at the start of a run.

Such a fault has many consequences: who compares creation times from the wrong end keeps the older of two variables, who
has another layout of state reports stores none of ours. The fault is named once, by the cases about data types and
formats. What follows from it in other cases is inconclusive and says so.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Final, Literal

from dcp_spec.constants import ICType

from dcp_codec.codec import Codec
from dcp_codec.values import Payload, VarCreate
from dcp_conformance.errors import UpperTesterError
from dcp_conformance.frames.received import ReceivedBeacon

from .traffic import Event

if TYPE_CHECKING:
    from .bench import Bench

Field = Literal["creationTime", "report", "VarCreate"]
"""What can be misread: the creationTime of a VarSpecT, or a whole state report or VarCreate."""

OWNERS: Final = frozenset(
    {"DATA-01", "DATA-02", "DATA-03", "DATA-05", "SRP-FMT-01", "SRP-TYP-02", "SRP-TYP-03", "VD-TYP-05"}
)
"""The requirements about layouts: a misread field never excuses their failures."""
CREATION_OWNERS: Final = frozenset({"VD-PC-07", "VD-PC-09", "VD-CMP-06"})
"""The requirements by which a VarCreate is passed on: that it is not never excuses their failures."""
_TABLE, _HAND_DOWN = "SRP-NeighbourTable", "SRP-UpdateSafetyData"
_DAY: Final = 86_400 * 10**9
#: Attempts with a state report: frames get lost.
_ATTEMPTS: Final = 2


def misread_fields(bench: Bench) -> dict[Field, str]:
    """The fields that the implementation misreads, each with what was found, in words.

    Takes about six beacon periods and leaves no variables behind. Raises ``LowerTesterError``.
    """
    found: dict[Field, str] = {}
    if not _takes_creations(bench):
        found["VarCreate"] = "it passed on no VarCreate when the run began (VD-PC-09)"
    elif text := _creation_times(bench):
        found["creationTime"] = text
    try:
        if text := _reports(bench):
            found["report"] = text
    except UpperTesterError:
        # Whoever needs the upper tester next says so.
        pass
    return found


def _takes_creations(bench: Bench) -> bool:
    """Whether VarCreates are taken (VD-PC-09): an implementation that lays a VarSpecT out otherwise takes none.

    Such an implementation asks for the variable as soon as a summary speaks of it. If it does not ask either, what it
    lacks is something else than the layout, and excuses nothing.
    """
    if not bench.has_unknown_ids():
        return True
    asked = False
    for _ in range(_ATTEMPTS):
        peer = bench.peer()
        create = peer.create(bench.var_id())
        peer.send(create)
        if bench.until_instruction(ICType.CREATE_VARIABLES, create.spec.var_id) is not None:
            peer.send(peer.delete(create.spec.var_id))
            # It is repeated once: no time need pass without one.
            bench.until_instruction(ICType.DELETE_VARIABLES, create.spec.var_id)
            return True
        peer.send(peer.summary(create.spec.var_id, 0))
        asked |= bench.until_instruction(ICType.REQUEST_VARCREATES, create.spec.var_id) is not None
    return not asked


# -- creation times ----------------------------------------------------------------------------------------------------


def _creation_times(bench: Bench) -> str:
    """Whether creation times are compared with their octets in the other order; empty if not, or if it is unknown.

    Two variables are created, and once more by another producer: one at a time that is later, and earlier with its
    octets swapped; the other one the other way round. The later creation replaces the stored one (VD-PC-01).
    """
    if "creationTime" not in bench.profile.vardis.var_spec or not bench.has_unknown_ids(2):
        return ""
    early = (bench.creation_time() >> 8 << 8) + 0x17F
    later = early + 0x82
    bench.session.creation_time = later
    one, two = bench.var_ids(2)
    first, second = bench.peer(), bench.peer()

    def passed_on(since: int, var_id: int, producer: bytes) -> bool:
        found = bench.instructions(ICType.CREATE_VARIABLES, var_id, since)
        return any(each.record.spec.prod_id == producer for each in found)

    since = bench.mark()
    first.send_all([first.create(one, creation_time=early), first.create(two, creation_time=later)])
    bench.until(lambda _: all(passed_on(since, each, first.node_id) for each in (one, two)))
    known = all(passed_on(since, each, first.node_id) for each in (one, two))
    since = bench.mark()
    second.send_all([second.create(one, creation_time=later), second.create(two, creation_time=early)])
    bench.until(lambda _: passed_on(since, one, second.node_id))
    right, wrong = (passed_on(since, each, second.node_id) for each in (one, two))
    since = bench.mark()
    # Each by the producer that the implementation may believe in.
    first.send_all([first.delete(each) for each in (one, two)])
    second.send_all([second.delete(each) for each in (one, two)])
    bench.until(lambda _: all(bench.instructions(ICType.DELETE_VARIABLES, each, since) for each in (one, two)))
    if not known or right or not wrong:
        return ""
    return "it compares creation times as if their octets were in the other order (DATA-01)"


def _swapped(value: int, width: int) -> tuple[int, int]:
    """A number with its octets in the other order: without and with a sign."""
    octets = (value % (1 << (8 * width))).to_bytes(width, "little")
    return int.from_bytes(octets, "big"), int.from_bytes(octets, "big", signed=True)


def backwards(codec: Codec, heard: Iterable[ReceivedBeacon], sut_id: bytes | None, wall: int) -> bool:
    """Whether a VarCreate of a variable of the implementation's own has a time of today only with swapped octets.

    ``wall``: ns since 1970. False where the profile's clock tells no time of day.
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
    """Whether VarCreates of one variable were sent or heard whose order is another one if octets are swapped."""
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


# -- state reports -----------------------------------------------------------------------------------------------------


def stores_reports(bench: Bench) -> bool:
    """Send a state report; whether its node is in the neighbour table two beacon periods later.

    Raises ``LowerTesterError`` and ``UpperTesterError``.
    """
    peer = bench.peer()
    peer.send(bench.report(peer.node_id, 1))
    bench.wait(2)
    told = bench.call(_TABLE).result.get("neighbours")
    listed = [str(each.get("nodeId", "")) for each in told if isinstance(each, dict)] if isinstance(told, list) else []
    return peer.node_id.hex() in [each.replace(":", "").lower() for each in listed]


def _reports(bench: Bench) -> str:
    """What is wrong with its own state reports if it stores none of ours; empty if it does, or if it is unknown."""
    upper = bench.session.upper
    layout = bench.profile.srp.safety_data
    if upper is None or not {_TABLE, _HAND_DOWN} <= upper.methods or bench.pics.srp is False:
        return ""
    if not bench.profile.srp.is_report or any(each.type == "opaque" for each in layout):
        return ""
    if any(stores_reports(bench) for _ in range(_ATTEMPTS)):
        return ""
    if not bench.call(_HAND_DOWN, sData={each.name: 1 for each in layout}).ok:
        return ""
    bad = bench.until(lambda heard: heard.report_problems)
    return f"its own state reports are laid out otherwise: {bad[0]}" if bad else ""


def sent_report(codec: Codec, events: Iterable[Event]) -> bool:
    """Whether a state report is among what the tester has sent."""
    return any(payload.srp is not None for payload in _sent(codec, events))


def sent_creation(codec: Codec, events: Iterable[Event]) -> bool:
    """Whether a VarCreate is among what the tester has sent."""
    containers = (container for payload in _sent(codec, events) for container in payload.vardis or ())
    return any(isinstance(each, VarCreate) for container in containers for each in container.records)


def _sent(codec: Codec, events: Iterable[Event]) -> Iterator[Payload]:
    sent = (codec.salvage(each.frame[each.start :]).beacon for each in events if each.direction == "sent")
    return (payload for each in sent if each is not None for payload in each.payloads)
