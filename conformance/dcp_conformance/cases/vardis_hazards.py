"""dcp-vardis.md: Receive Path, consequences of the rules.

What nodes do to each other when they follow the text (H1 to H6 of the catalogue). Nothing of this is a fault: it is
measured and reported, because people who fly with it should know.
"""

from __future__ import annotations

from dcp_spec.constants import ICType, SpecVersion

from dcp_conformance.bench import Bench
from dcp_conformance.case import Needs, case
from dcp_conformance.services import create_request, taught
from dcp_conformance.variables import ask, named, traces

_RC = ICType.REQUEST_VARCREATES


@case(
    "TC_VD_HAZ_BO_01",
    "How long two nodes ask each other for a variable that neither has is reported (H1, X29)",
    requirements="VD-RC-01",
    stimulus="a VarReqCreate of an unknown variable, and for every request of the implementation another, six times",
    expect="1.0: no request; since 1.1 one for each: as long as both go on, it does not end",
    window=16,
)
def endless_requests(bench: Bench) -> None:
    peer, var_id, rounds = bench.peer(), bench.unknown_id(), 0
    for _ in range(6):
        peer.send(peer.request_create(var_id))
        if bench.until_instruction(_RC, var_id) is None:
            break
        rounds += 1
    asks = rounds > 0
    if bench.features.rerequest_unknown:
        bench.check(asks, "a request for an unknown variable makes the node ask itself", "it does not", "VD-RC-01")
    bench.info("X29: what follows a request for a variable that it does not know", "its own" if asks else "nothing")
    bench.info("H1: requests for each other's requests", f"{rounds} of 6 rounds")


@case(
    "TC_VD_HAZ_BO_02",
    "What becomes of a variable that a stranger has deleted is reported (H3)",
    requirements="VD-PU-02 VD-PS-02 VD-PC-01",
    stimulus="a VarDelete by another node than the producer; then update, summary and VarCreate of the producer, who "
    "knows nothing of it",
    expect="they have no effect: the variable stays deleted until it is created anew",
    window=12,
    needs=Needs(since=SpecVersion.V2_0),
)
def deleted_by_a_stranger(bench: Bench) -> None:
    producer, stranger, var_id = bench.peer(), bench.peer(), bench.var_id()
    create = producer.create(var_id)
    bench.learn(producer, create)
    stranger.send(stranger.delete(var_id))
    if bench.until_instruction(ICType.DELETE_VARIABLES, var_id) is None:
        bench.info("H3: a VarDelete of another node than the producer", "has no effect")
        return
    since = bench.mark()
    producer.send(producer.update(var_id, 1), producer.summary(var_id, 1), create)
    bench.require_alive("update, summary and VarCreate of the producer")
    bench.beacons(1, 1.5)
    found = traces(bench, var_id, since, set(ICType) - {ICType.DELETE_VARIABLES})
    bench.check(not found, "the producer's records have no effect", f"{named(found)} came", frames=found)
    held = ask(bench, var_id)
    bench.check(held.state == "deleted", "the variable stays deleted", str(held))
    producer.send(producer.create(var_id, value=b"anew"))
    back = bench.until_instruction(ICType.CREATE_VARIABLES, var_id)
    bench.info("H3: deleted by a stranger, until it is created anew", "shown" if back else "and it does not come back")


@case(
    "TC_VD_HAZ_BO_03",
    "What a producer's clock that is ahead does to its variable is reported (H5)",
    requirements="VD-PC-01",
    stimulus="a VarCreate whose creationTime lies ten seconds ahead, then one of now, with another value",
    expect="the second one is refused",
    needs=Needs(since=SpecVersion.V2_0),
)
def clock_ahead(bench: Bench) -> None:
    peer, var_id = bench.peer(), bench.var_id()
    ahead = bench.creation_time() + 10 * bench.profile.types.timestamp.per_second
    early = peer.create(var_id, value=b"ahead", creation_time=ahead)
    bench.learn(peer, early)
    since = bench.mark()
    peer.send(peer.create(var_id, value=b"right"))
    bench.require_alive("the VarCreate")
    bench.beacons(1, 1.5)
    held = ask(bench, var_id)
    bench.check(held.record == early, "the one with the later creationTime stays stored", str(held))
    found = traces(bench, var_id, since, set(ICType) - {ICType.CREATE_VARIABLES, ICType.SUMMARIES})
    bench.check(not found, "nothing else follows", f"{named(found)} came", frames=found)
    bench.info("H5: a variable that is pinned by a clock ahead", "shown")
    # Others shall be able to use the identifier again.
    bench.session.creation_time = max(bench.session.creation_time, ahead)


@case(
    "TC_VD_HAZ_BO_04",
    "What the application of a producer is told whose variable was taken over is reported (H4)",
    requirements="VD-PC-01 VD-UPD-03",
    stimulus="a VarCreate with a later creationTime by another node for an own variable, then RTDB-Update and "
    "RTDB-Create of the application",
    expect="the variable is the other node's: NOT-PRODUCER and VARIABLE-EXISTS",
    window=8,
    needs=Needs(since=SpecVersion.V2_0, ut=("RTDB-Create", "RTDB-Update")),
)
def taken_over(bench: Bench) -> None:
    peer, var_id = bench.peer(), bench.own_var_id()
    bench.must("RTDB-Create", **create_request(bench, var_id))
    own = bench.until_instruction(ICType.CREATE_VARIABLES, var_id)
    if own is None:
        bench.inconclusive("the implementation sends its own variable, which this case needs", "it does not")
    stamp = max(bench.creation_time(), (own.spec.creation_time or 0) + 1)
    other = peer.create(var_id, value=b"mine", creation_time=stamp)
    peer.send(other)
    came = bench.until(lambda heard: heard.about(ICType.CREATE_VARIABLES, var_id) == other)
    bench.check(came, "the other node's VarCreate is stored and repeated", "it is not", "VD-PC-01")
    bench.expect_status("VARDIS-STATUS-NOT-PRODUCER", "RTDB-Update", "VD-UPD-03", varId=var_id, value="00")
    answer = bench.call("RTDB-Create", **create_request(bench, var_id))
    bench.info("H4: a variable that was taken over", f"RTDB-Create of its first producer: {answer.status}")


@case(
    "TC_VD_HAZ_BO_05",
    "What neighbours answer to a producer that has started again is reported (H6)",
    requirements="VD-PU-06",
    stimulus="a variable with number 20; then VarCreate and VarUpdates of its producer that count from 0 again",
    expect="up to 1.3 it is outdated: the old value is sent to it until its number passes the old one",
    window=12,
    needs=Needs(until=SpecVersion.V1_3),
)
def started_again(bench: Bench) -> None:
    peer = bench.peer()
    var_id = taught(bench, peer, seqno=20, value=b"old")
    peer.send(peer.create(var_id, value=b"new", seqno=0))
    since = bench.mark()
    peer.send(peer.update(var_id, 1, b"new"))
    came = bench.until_instruction(ICType.UPDATES, var_id)
    outdated = came is not None and came.seqno == 20
    bench.check(outdated, "the producer's update counts as outdated", f"{came}", "VD-PU-06")
    found = traces(bench, var_id, since, (ICType.CREATE_VARIABLES,))
    bench.info("H6: a producer that starts again counts as outdated", "not shown" if found else "shown")


@case(
    "TC_VD_HAZ_BO_06",
    "How often summaries of its own variable make a restarted producer ask in vain is reported (H2)",
    requirements="VD-PS-01",
    stimulus="five summaries of a variable that the implementation does not know, each after its request",
    expect="a request for each",
    window=16,
)
def asks_in_vain(bench: Bench) -> None:
    peer, var_id, rounds = bench.peer(), bench.unknown_id(), 0
    for _ in range(5):
        peer.send(peer.summary(var_id, 1))
        if bench.until_instruction(_RC, var_id) is None:
            break
        rounds += 1
    bench.check(rounds == 5, "each summary of an unknown variable leads to a request", f"{rounds} of 5 did")
    bench.info("H2: requests of a producer that has forgotten its variable", f"{rounds} for 5 summaries")
