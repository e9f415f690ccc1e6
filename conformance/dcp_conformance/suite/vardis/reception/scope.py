"""dcp-vardis.md: Global vs. Local Dissemination: records that are not forwarded."""

from __future__ import annotations

from dcp_spec.constants import ICType, SpecVersion

from dcp_conformance.definitions.case import Needs, case
from dcp_conformance.test_steps.services import teach_variable
from dcp_conformance.test_steps.variable_queries import traces
from dcp_conformance.test_system.bench import Bench

_RC, _RU = ICType.REQUEST_VARCREATES, ICType.REQUEST_VARUPDATES


@case(
    "TC_VD_SCP_BO_01",
    "Summaries are not forwarded: a node summarises only its own database",
    requirements="VD-SCP-01 VD-TYP-08",
    stimulus="a newer summary of a known variable, and one of an unknown variable",
    expect="summaries with the node's own sequence number, and none of the unknown variable",
)
def summaries_stay(bench: Bench) -> None:
    peer = bench.peer()
    var_id, unknown = teach_variable(bench, peer, seqno=5), bench.unknown_id()
    since = peer.stimulate(peer.summary(var_id, 9), peer.summary(unknown, 9))
    bench.require_alive("the summaries")
    bench.beacons(3)
    wrong = [each for each in bench.instructions(ICType.SUMMARIES, var_id, since) if each.record.seqno != 5]
    bench.none(wrong, "the stored sequence number 5 in summaries", "VD-SCP-01")
    wrong = bench.instructions(ICType.SUMMARIES, unknown, since)
    bench.none(wrong, "no summary of a variable that the node does not know", "VD-TYP-08")


@case(
    "TC_VD_SCP_BO_02",
    "Requests are not forwarded",
    requirements="VD-SCP-01",
    stimulus="a VarReqCreate, and VarReqUpdates with an older, the same and a newer number, for known variables",
    expect="no request for any of these variables in the beacons of the implementation",
)
def requests_stay(bench: Bench) -> None:
    peer = bench.peer()
    ids = [teach_variable(bench, peer, seqno=5) for _ in range(4)]
    since = peer.stimulate(
        peer.request_create(ids[0]),
        *(peer.request_update(var_id, 5 + step) for var_id, step in zip(ids[1:], (-1, 0, 1), strict=True)),
    )
    bench.require_alive("the requests")
    bench.beacons(2)
    for var_id in ids:
        bench.none(traces(bench, var_id, since, (_RC, _RU)), f"no request for variable {var_id}")


@case(
    "TC_VD_SCP_BV_01",
    "A pending request is sent once, however often its cause occurs",
    requirements="VD-PS-01 VD-PS-04 VD-PU-01",
    stimulus="summaries and updates of unknown variables, and newer summaries of a known one, five of each",
    expect="one VarReqCreate for each unknown variable, one VarReqUpdate for the known one",
    window=8,
)
def requests_once(bench: Bench) -> None:
    peer, unknown, updated = bench.peer(), bench.unknown_id(), bench.unknown_id()
    known = teach_variable(bench, peer, seqno=5)
    since = bench.mark()
    # All records about one variable in one payload: otherwise some could be processed before and some after the
    # composition of a payload. No other container in it, so that an implementation that loses a second container is not
    # reported for its requests.
    peer.send(*(peer.update(updated, seqno) for seqno in range(5)))
    peer.send(*(peer.summary(unknown, seqno) for seqno in range(5)))
    peer.send(*(peer.summary(known, 6 + step) for step in range(5)))
    bench.check_repeated(_RC, unknown, 1, since, "VD-PS-01")
    bench.check_repeated(_RC, updated, 1, since, "VD-PU-01")
    bench.check_repeated(_RU, known, 1, since, "VD-PS-04")


_SINCE_1_1 = Needs(since=SpecVersion.V1_1)


@case(
    "TC_VD_SCP_BV_02",
    "A node that gets a request for an unknown variable requests the variable itself, once per payload",
    requirements="VD-RU-01 VD-RC-01",
    stimulus="both kinds of requests for unknown variables",
    expect="one VarReqCreate for each of the variables",
    needs=_SINCE_1_1,
)
def asks_too(bench: Bench) -> None:
    peer, (one, two) = bench.peer(), bench.identifiers.unknown_ids(2)
    since = peer.stimulate(peer.request_create(one), peer.request_create(one))
    peer.send(peer.request_update(two, 3))
    bench.check_repeated(_RC, one, 1, since, "VD-RC-01")
    bench.check_repeated(_RC, two, 1, since, "VD-RU-01")
    bench.none(traces(bench, two, since, [_RU]), "no VarReqUpdate for an unknown variable", "VD-RU-01")
