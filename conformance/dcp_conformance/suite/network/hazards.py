"""Networks: hazards of the specification itself.

A node that follows the specification exhibits them. The cases check what the specification requires; the consequences
are reported.
"""

from __future__ import annotations

from dcp_spec.constants import ICType, SpecVersion, seqno_modulus

from dcp_conformance.definitions.case import Needs, case
from dcp_conformance.test_steps.services import create_request, produced
from dcp_conformance.test_system.bench import Bench

from .conflicts import check_deleted, held

_CREATE, _UPDATE, _DELETE = ICType.CREATE_VARIABLES, ICType.UPDATES, ICType.DELETE_VARIABLES
_ASK_CREATE = ICType.REQUEST_VARCREATES


@case(
    "TC_NET_HAZARD_BV_01",
    "Two nodes that both lack a variable request it from each other (H1, X29)",
    requirements="VD-RC-01",
    stimulus=(
        "a request for an unknown variable; the tester answers each request of the implementation with the same request"
    ),
    expect="a request for each request (1.0: none); the case reports for how long this continues",
    window=30,
)
def mutual_requests(bench: Bench) -> None:
    peer, name = bench.peer(), bench.unknown_id()
    mark = peer.stimulate(peer.request_create(name))
    if not bench.features.rerequest_unknown:
        bench.require_alive("a request for an unknown variable")
        found = bench.instructions(_ASK_CREATE, name, mark)
        if bench.none(found, "no request: 1.0 ignores requests for unknown variables"):
            bench.reading("X29", "nothing")
            bench.reading("H1", "does not arise in 1.0")
        return
    rounds = 0
    while rounds < 6 and bench.until_instruction(_ASK_CREATE, name) is not None:
        rounds += 1
        peer.send(peer.request_create(name))
    bench.required(rounds, "a request for the variable that the peer requested")
    bench.reading("X29", "requests the variable itself")
    lasting = "without end" if rounds == 6 else f"for {rounds} rounds"
    bench.reading("H1", f"two nodes request the variable from each other {lasting} (6 were tried)")


@case(
    "TC_NET_HAZARD_BO_01",
    "A producer that has lost its variable requests it without success (H2)",
    requirements="VD-PS-01 VD-PC-03",
    stimulus=(
        "a summary of an unknown variable; the request is answered with a VarCreate with the implementation as "
        "producer; three times"
    ),
    expect="a request for each summary, and no forwarded VarCreate; the case reports the consequences",
    window=30,
)
def forgotten_variable(bench: Bench) -> None:
    peer, name = bench.peer(), bench.unknown_id()
    rounds = 0
    mark = bench.mark()
    for _ in range(3):
        peer.send(peer.summary(name, 7))
        if bench.until_instruction(_ASK_CREATE, name) is None:
            break
        rounds += 1
        peer.send(peer.create(name, seqno=7, producer=bench.identifiers.sut_id))
    bench.some(rounds == 3, "a request for each summary", "VD-PS-01", seen=f"{rounds} of 3")
    bench.require_alive("a VarCreate with the implementation as producer", "VD-PC-03")
    found = bench.instructions(_CREATE, name, mark)
    bench.none(found, "no forwarded VarCreate with the implementation as producer", "VD-PC-03")
    if rounds and not found:
        again = "again with each summary" if rounds == 3 else f"{rounds} times"
        bench.reading("H2", f"a lost variable is requested {again}, and the answer is ignored")


@case(
    "TC_NET_HAZARD_BO_02",
    "A deletion by a node other than the producer separates the variable from its producer (H3)",
    requirements="VD-PD-04 VD-PU-02 VD-PS-02 VD-PC-01",
    stimulus="a peer that is not the producer deletes a variable; the producer continues to update and summarise it",
    expect="the variable is deleted and later records of the producer are ignored; the case reports how this ends",
    window=40,
)
def split(bench: Bench) -> None:
    source, other, name, count = bench.peer(), bench.peer(), bench.var_id(), bench.sut.rep_cnt(2)
    create = bench.learnt(source, name, rep_cnt=count)
    mark = other.stimulate(other.delete(name))
    bench.check_repeated(_DELETE, name, count, mark, "VD-PD-04")
    mark = source.stimulate(source.update(name, 1))
    if bench.features.removed_after_deletion:
        # The entry was removed: an update of the producer causes a request, and its VarCreate restores the variable.
        asked = bench.until_instruction(_ASK_CREATE, name)
        bench.some(asked, "a request for the variable, which is unknown again", "VD-PD-04")
        source.send(source.create(name, seqno=1, rep_cnt=count))
        healed = bench.until_instruction(_CREATE, name)
        bench.reading(
            "H3",
            "ends with the next VarCreate of the producer"
            if healed
            else "the variable of the producer is not restored",
        )
        return
    bench.require_alive("an update of a deleted variable", "VD-PU-02")
    source.send(source.summary(name, 2))
    bench.require_alive("a summary of a deleted variable", "VD-PS-02")
    trace = [each for heard in bench.heard[mark:] for each in heard.instructions(None, name)]
    bench.none(trace, "no reaction to records of the producer")
    source.send(create)
    check_deleted(bench, name, "VD-PC-01")
    source.send(source.create(name, rep_cnt=count))
    healed = bench.until_instruction(_CREATE, name)
    bench.reading("H3", "lasts until the variable is created again" if healed else "lasts even after a new creation")


@case(
    "TC_NET_HAZARD_BO_03",
    "A VarCreate of another node takes over a node's own variable (H4)",
    requirements="VD-PC-01 VD-UPD-03",
    stimulus=(
        "the application creates a variable; a VarCreate of another producer with a later creationTime arrives; "
        "then RTDB-Update and RTDB-Create of the application"
    ),
    expect=(
        "the foreign variable replaces the node's own: VARDIS-STATUS-NOT-PRODUCER; the case reports the answer to "
        "RTDB-Create"
    ),
    window=20,
    needs=Needs(since=SpecVersion.V2_0, ut=("RTDB-Create", "RTDB-Update")),
)
def taken_over(bench: Bench) -> None:
    peer, name = bench.peer(), produced(bench)
    bench.until_instruction(_CREATE, name)
    mine = bench.needed(bench.instructions(_CREATE, name), "a VarCreate of the node's own variable")
    stamp, made = bench.profile.types.timestamp, mine[0].record.spec.creation_time
    if stamp.epoch_ns is not None and made - bench.records.creation_time() > 86_400 * stamp.per_second:
        # Otherwise every further VarCreate of this run would need a still later creationTime.
        bench.inconclusive("a creationTime within a day of now, which this case needs", f"{made:#x}")
    later = max(bench.records.creation_time(), made + 1)
    bench.session.creation_time = later
    create = peer.create(name, value=b"foreign", creation_time=later)
    mark = peer.stimulate(create)
    bench.until(lambda heard: heard.about(_CREATE, name) == create, 8)
    bench.required(
        any(each.record == create for each in bench.instructions(_CREATE, name, mark)),
        "the later VarCreate is forwarded and replaces the node's own variable",
        "VD-PC-01",
    )
    update = bench.expect_status("VARDIS-STATUS-NOT-PRODUCER", "RTDB-Update", "VD-UPD-03", varId=name, value="01")
    again = bench.call("RTDB-Create", **create_request(bench, name))
    bench.reading("H4", f"the application's next update is answered with {update}, creating it again with {again}")


@case(
    "TC_NET_HAZARD_BO_04",
    "A creationTime in the future prevents later creations (H5)",
    requirements="VD-PC-01",
    stimulus="a VarCreate with a creationTime one hour ahead; then one of another producer with the correct time",
    expect="the second VarCreate is ignored",
    window=24,
    needs=Needs(since=SpecVersion.V2_0),
)
def clock_ahead(bench: Bench) -> None:
    # The variable identifier cannot be used for an hour, so it must be one that no other case uses.
    wrong, right, name = bench.peer(), bench.peer(), bench.unknown_id()
    ticks = bench.profile.types.timestamp.per_second
    ahead = bench.learnt(wrong, name, value=b"ahead", creation_time=bench.records.creation_time() + 3600 * ticks)
    right.send(right.create(name, value=b"right"))
    bench.require_alive("a VarCreate with an older creationTime")
    record = held(bench, name)
    bench.equal(record, ahead, "the variable with the creationTime in the future")
    if record == ahead:
        bench.reading("H5", "later creations with the correct time are ignored")
    wrong.send(wrong.delete(name))


@case(
    "TC_NET_HAZARD_BO_05",
    "Before 2.0, the values of a restarted producer count as outdated (H6)",
    requirements="VD-PU-06 VD-SCP-03",
    stimulus="a variable is known with sequence number 50; its producer restarts with VarCreate 0 and VarUpdate 1",
    expect="the VarCreate is ignored; the stored value with sequence number 50 is sent in response to the updates",
    window=24,
    needs=Needs(until=SpecVersion.V1_3),
)
def starts_again(bench: Bench) -> None:
    source, name, count = bench.peer(), bench.var_id(), bench.sut.rep_cnt(2)
    bench.learn(source, source.create(name, value=b"fifty", seqno=50, rep_cnt=count))
    mark = source.stimulate(source.create(name, value=b"again", seqno=0, rep_cnt=count))
    bench.require_alive("a second VarCreate", "VD-SCP-03")
    found = bench.instructions(_CREATE, name, mark)
    bench.none(found, "no VarCreate of the known variable", "VD-SCP-03")
    mark = source.stimulate(source.update(name, 1, b"again"))
    found = bench.check_repeated(_UPDATE, name, count, mark, "VD-PU-06")
    numbers = {each.record.seqno for each in found}
    bench.only(numbers, {50}, "the stored value with sequence number 50", "VD-PU-06", frames=found)
    if bench.verdicts.all_hold():
        bench.reading("H6", "the producer's values are ignored until its number passes 50")


@case(
    "TC_NET_HAZARD_BO_06",
    "A node that misses the renewed creation of a variable does not notice it (H7)",
    requirements="VD-PS-03 VD-PS-02",
    stimulus=(
        "a variable is known with sequence number 3; the implementation misses its renewed creation; a peer "
        "summarises it with 0, then with 3"
    ),
    expect="the old value in response to 0, no response to 3, and no request for a VarCreate",
    window=24,
    needs=Needs(since=SpecVersion.V2_0),
)
def missed_creation(bench: Bench) -> None:
    source, other, name, count = bench.peer(), bench.peer(), bench.var_id(), bench.sut.rep_cnt(2)
    bench.learn(source, source.create(name, value=b"first life", seqno=3, rep_cnt=count))
    mark = other.stimulate(other.summary(name, 0))
    bench.check_repeated(_UPDATE, name, count, mark, "VD-PS-03")
    quiet = other.stimulate(other.summary(name, 3))
    bench.require_alive("a summary with the stored sequence number", "VD-PS-02")
    found = bench.instructions(_UPDATE, name, quiet)
    bench.none(found, "no VarUpdate in response to the stored sequence number", "VD-PS-02")
    asked = bench.instructions(_ASK_CREATE, name, mark)
    if asked or bench.verdicts.all_hold():
        bench.reading("H7", "requests the VarCreate" if asked else "keeps the first creation without a request")


@case(
    "TC_NET_HAZARD_BO_07",
    "An update of an earlier creation is accepted as a newer value (H8)",
    requirements="VD-PC-01 VD-PU-07",
    stimulus=(
        "a variable with sequence number 9 is created again with number 0; then VarUpdate 10 of the first creation "
        "arrives"
    ),
    expect="the renewed creation is accepted, and then the VarUpdate, because its sequence number is newer",
    window=24,
    needs=Needs(since=SpecVersion.V2_0),
)
def earlier_update(bench: Bench) -> None:
    source, late, name, count = bench.peer(), bench.peer(), bench.var_id(), bench.sut.rep_cnt(2)
    bench.learn(source, source.create(name, seqno=9, rep_cnt=count))
    mark = source.stimulate(source.create(name, value=b"second life", rep_cnt=count))
    bench.check_repeated(_CREATE, name, count, mark, "VD-PC-01")
    mark = late.stimulate(late.update(name, 10, b"first life"))
    bench.check_repeated(_UPDATE, name, count, mark, "VD-PU-07")
    record = held(bench, name)
    state = "nothing" if record is None else f"{record.upd.value.decode(errors='replace')!r}"
    if bench.verdicts.all_hold():
        bench.reading("H8", f"holds {state} after an update of the first creation")


@case(
    "TC_NET_HAZARD_BO_08",
    "A node that missed more than half of the sequence numbers treats newer values as older ones (H9)",
    requirements="VD-PS-03 VD-PU-06",
    stimulus=(
        "a variable is known with sequence number 0; a summary and a VarUpdate are just over half of the number "
        "space ahead"
    ),
    expect="both count as older: the stored value is sent in response",
    window=24,
)
def many_missed_updates(bench: Bench) -> None:
    source, name, count = bench.peer(), bench.var_id(), bench.sut.rep_cnt(2)
    far = seqno_modulus(bench.profile.types.var_seqno.width) // 2 + 1
    bench.learn(source, source.create(name, value=b"stale", rep_cnt=count))
    for record, requirement in (
        (source.summary(name, far), "VD-PS-03"),
        (source.update(name, far, b"new"), "VD-PU-06"),
    ):
        mark = source.stimulate(record)
        found = bench.check_repeated(_UPDATE, name, count, mark, requirement)
        values, stored = {each.record.value for each in found}, bench.records.value(b"stale")
        bench.only(values, {stored}, "the stored value", requirement, frames=found)
    if bench.verdicts.all_hold():
        bench.reading("H9", "sends its outdated value and keeps it")
