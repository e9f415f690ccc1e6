"""dcp-vardis.md: Construction of Payloads, records that do not fit.

VarCreates come first in every payload: if they fill it to the last octet, no other record fits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from dcp_spec.constants import ICType, SpecVersion

from dcp_codec.values import VarCreate, VardisRecord
from dcp_conformance.definitions.case import FILLS, Needs, Variant, case
from dcp_conformance.test_steps.full_payloads import PAYLOAD_SIZE, filling, longest, settable
from dcp_conformance.test_steps.timeouts import lasting, latest, learn, shorten_scrubbing
from dcp_conformance.test_steps.variable_queries import teach_variables
from dcp_conformance.test_system.bench import Bench
from dcp_conformance.test_system.sending.peers import Peer

from .exact_sizes import largest_create, until_all
from .summaries import SUMMARIES, summarises

_CREATE, _UPDATE, _DELETE = ICType.CREATE_VARIABLES, ICType.UPDATES, ICType.DELETE_VARIABLES
_SUMMARY, _ASK, _ASK_UPDATE = ICType.SUMMARIES, ICType.REQUEST_VARCREATES, ICType.REQUEST_VARUPDATES
_COUNTED = (_CREATE, _UPDATE, _DELETE)
_FULL = "a payload full of VarCreates, which this case needs"


def _fillable(bench: Bench) -> str | None:
    """Return why VarCreates cannot fill a payload to the last octet, or None; for ``Needs.when``."""
    if bench.sut.parameter(PAYLOAD_SIZE) >= 2 * largest_create(bench):
        value, description = longest(bench)
        if len(value) + len(description) > bench.builder.record_size(bench.records.sample(value=b"v", descr=b"d")):
            return None
        # With only a few different lengths, some sizes cannot be reached.
        return "values and descriptions are too short for VarCreates to fill a payload to the last octet"
    return f"{PAYLOAD_SIZE} is too small for two VarCreates of the longest value and description"


def _fillable_without_summaries(bench: Bench) -> str | None:
    """As :func:`_fillable`, for records after the summaries, which would fill the remaining room."""
    if not settable(bench):
        return f"{SUMMARIES} cannot be set (VD-SetParameter, UT-Reset)"
    return _fillable(bench)


def _fillers(bench: Bench, peer: Peer, left: int) -> list[VarCreate]:
    """Teach variables whose VarCreates leave ``left`` octets of a payload, and return the VarCreates."""
    octets = bench.sut.bound(PAYLOAD_SIZE) - bench.builder.container_header_size - left
    creates = filling(bench, peer, _CREATE, octets)
    if creates is None:
        bench.inconclusive("VarCreates that fill a payload", f"no combination has {octets} octets")
    for first in range(0, len(creates), 6):
        teach_variables(bench, peer, creates[first : first + 6])
    return creates


@dataclass
class _Pending:
    """Records that the implementation must send, and the stimuli that cause them."""

    kind: ICType
    names: list[int]
    stimuli: list[VardisRecord]
    count: int
    """Number of payloads that must contain each of the records."""
    since: int = 0
    """Mark at which the stimuli were sent."""


def _pending(bench: Bench, peer: Peer, kind: ICType, number: int) -> _Pending:
    """Prepare ``number`` variables for which the stimuli cause a record of this kind."""
    if kind is _ASK:
        names = bench.identifiers.unknown_ids(number)
        return _Pending(kind, names, [peer.summary(each, 1) for each in names], 1)
    count = bench.sut.rep_cnt(3)
    creates = [peer.create(each, seqno=5, rep_cnt=count) for each in bench.identifiers.var_ids(number)]
    bench.learn(peer, *creates)
    names = [each.spec.var_id for each in creates]
    made: dict[ICType, Sequence[VardisRecord]] = {
        _CREATE: [peer.request_create(each) for each in names],
        _UPDATE: [peer.update(each, 6) for each in names],
        _DELETE: [peer.delete(each) for each in names],
        _ASK_UPDATE: [peer.summary(each, 6) for each in names],
        _SUMMARY: [],
    }
    return _Pending(kind, names, list(made[kind]), count if kind in _COUNTED else 1)


def _overflow(bench: Bench, peer: Peer, fillers: Sequence[VarCreate], kind: ICType, number: int) -> _Pending:
    """Cause ``number`` records of a kind that do not fit in addition to the fillers; inconclusive if they do.

    Repeated if no payload had all of the fillers: an application on the node may have sent something.
    """
    for _ in range(3):
        pending = _pending(bench, peer, kind, number)
        pending.since = peer.stimulate(*(peer.request_create(each.spec.var_id) for each in fillers), *pending.stimuli)
        # A VarCreate of the case itself may be between the fillers.
        if kind is _CREATE or until_all(bench, fillers) is not None:
            break
        _await_end(bench, fillers)
    else:
        bench.inconclusive(_FULL, "none in time")
    return pending


def _await_end(bench: Bench, creates: Sequence[VarCreate]) -> None:
    """Wait until these VarCreates are no longer repeated."""
    names = {each.spec.var_id for each in creates}
    bench.until_quiet(lambda heard: any(each.var_id in names for each in heard.instructions(_CREATE)))


@case(
    "TC_VD_ROOM_BV_01",
    "A record that does not fit into a payload stays in its queue ({variant})",
    requirements="VD-CMP-13",
    alone=FILLS,
    stimulus=(
        "in one beacon, requests for VarCreates that fill a payload to the last octet, and a stimulus that causes "
        "{variant}"
    ),
    expect="a payload with VarCreates only; after it the record as often as if there had been room",
    window=20,
    needs=Needs(when=_fillable),
    variants={
        "a-VarUpdate": Variant(_UPDATE, requirements="VD-CMP-13 VD-CMP-09"),
        "a-VarDelete": Variant(_DELETE, requirements="VD-CMP-13 VD-CMP-10"),
        "a-VarReqCreate": Variant(_ASK, requirements="VD-CMP-13 VD-CMP-12"),
        "a-VarReqUpdate": Variant(_ASK_UPDATE, requirements="VD-CMP-13 VD-CMP-11"),
        "a-VarCreate": Variant(_CREATE, requirements="VD-CMP-13 VD-CMP-06"),
    },
)
def stays_queued(bench: Bench, kind: ICType) -> None:
    peer = bench.peer()
    pending = _overflow(bench, peer, _fillers(bench, peer, 0), kind, 1)
    for name in pending.names:
        bench.check_repeated(kind, name, pending.count, pending.since)


@case(
    "TC_VD_ROOM_BV_02",
    "Of two records, the one that does not fit stays in its queue ({variant})",
    requirements="VD-CMP-13",
    alone=FILLS,
    stimulus=(
        "in one beacon, requests for VarCreates that leave room for one record, and stimuli that cause two {variant}"
    ),
    expect="each of them as often as if there had been room for both",
    window=20,
    needs=Needs(when=_fillable),
    variants={
        "VarUpdates": Variant(
            _UPDATE, requirements="VD-CMP-13 VD-CMP-09", needs=Needs(when=_fillable_without_summaries)
        ),
        "VarDeletes": Variant(_DELETE, requirements="VD-CMP-13 VD-CMP-10"),
        "VarReqCreates": Variant(_ASK, requirements="VD-CMP-13 VD-CMP-12"),
        "VarReqUpdates": Variant(
            _ASK_UPDATE, requirements="VD-CMP-13 VD-CMP-11", needs=Needs(when=_fillable_without_summaries)
        ),
    },
)
def rest_stays_queued(bench: Bench, kind: ICType) -> None:
    peer, size = bench.peer(), bench.builder.record_size
    samples: dict[ICType, VardisRecord] = {
        _UPDATE: peer.update(0, 6),
        _DELETE: peer.delete(0),
        _ASK: peer.request_create(0),
        _ASK_UPDATE: peer.request_update(0, 5),
    }
    if settable(bench):
        bench.must("VD-SetParameter", name=SUMMARIES, value=0)
    fillers = _fillers(bench, peer, bench.builder.container_header_size + size(samples[kind]))
    pending = _overflow(bench, peer, fillers, kind, 2)
    for name in pending.names:
        bench.check_repeated(kind, name, pending.count, pending.since)


@case(
    "TC_VD_ROOM_BV_03",
    "A payload without room for summaries does not remove variables from the rotation of summaries",
    requirements="VD-CMP-13 VD-CMP-03",
    alone=FILLS,
    stimulus="requests for VarCreates that fill a payload to the last octet",
    expect="a payload with VarCreates only; after it summaries of all variables",
    window=20,
    needs=Needs(when=lambda bench: summarises(bench) or _fillable(bench)),
)
def summaries_stay_queued(bench: Bench) -> None:
    peer = bench.peer()
    fillers = _fillers(bench, peer, 0)
    peer.send(*(peer.request_create(each.spec.var_id) for each in fillers))
    bench.needed(until_all(bench, fillers), _FULL)
    bench.mark()
    since, wanted = len(bench.heard), {each.spec.var_id for each in fillers}
    turn = 3 + 2 * len(wanted) / bench.sut.parameter(SUMMARIES)

    def missing() -> set[int]:
        return wanted - {each.var_id for each in bench.instructions(_SUMMARY, since=since)}

    bench.until(lambda _: not missing(), bench.sut.reaction + turn)
    bench.complete(sorted(missing()), f"summaries of all {len(wanted)} variables")


@case(
    "TC_VD_SCR_TI_15",
    "A timeout cancels a request for an update that did not fit",
    requirements="VD-SCR-04",
    alone=FILLS,
    stimulus=(
        "a variable with a timeout is created, and a newer summary of it arrives; until its timeout, requests for "
        "VarCreates that fill all payloads"
    ),
    expect="no VarReqUpdate of the variable when there is room again",
    window=60,
    needs=Needs(since=SpecVersion.V2_0, when=_fillable),
)
def request_cancelled(bench: Bench) -> None:
    shorten_scrubbing(bench)
    peer = bench.peer()
    fillers = _fillers(bench, peer, 0)
    requests = [peer.request_create(each.spec.var_id) for each in fillers]
    name, timeout_ms = bench.var_id(), lasting(bench, 800, 5)
    begun = learn(bench, peer, name, timeout_ms).after
    since = peer.stimulate(*requests)
    peer.send(peer.summary(name, 1))
    until = begun + latest(bench, timeout_ms)
    while bench.now() < until:
        # After each beacon, so that a late request finds repetitions left of the one before.
        bench.beacons(1)
        peer.send(*requests)
    if not bench.instructions(_ASK_UPDATE, name, since):
        bench.until_instruction(_DELETE, name)
        bench.beacons(2)
    asked = bench.instructions(_ASK_UPDATE, name, since)
    deleted = bench.instructions(_DELETE, name, since)
    late = [each for each in asked if deleted and each.heard.time >= deleted[0].heard.time]
    if len(late) < len(asked):
        bench.inconclusive("payloads full of VarCreates, which this case needs", "room for a VarReqUpdate")
    if not deleted:
        # Only producers scrub (X26): no deletion cancelled the request.
        bench.info("Does a consumer delete a variable after its timeout?", "no VarDelete in time")
        return
    bench.none(late, "no VarReqUpdate of a variable after its timeout")
