"""Networks: partitions that heal."""

from __future__ import annotations

from dcp_spec.constants import ICType, SpecVersion, seqno_modulus

from dcp_conformance.definitions.case import Needs, case
from dcp_conformance.test_system.bench import Bench

from .conflicts import held

_CREATE, _UPDATE, _DELETE = ICType.CREATE_VARIABLES, ICType.UPDATES, ICType.DELETE_VARIABLES
_ASK_UPDATE, _ASK_CREATE = ICType.REQUEST_VARUPDATES, ICType.REQUEST_VARCREATES


@case(
    "TC_NET_PART_BV_01",
    "After a partition, a missed value is fetched with one request and one answer ({variant})",
    requirements="VD-PS-04 VD-CMP-11 VD-PU-08",
    stimulus=(
        "a variable is known and updates are missed ({variant}); four peers summarise the last one; one peer "
        "answers the request"
    ),
    expect="a request with the own sequence number, then the last VarUpdate; no request after it",
    window=30,
    variants={"3-to-10": (2, 10), "across-the-wrap": (-6, 4)},
)
def heals(bench: Bench, numbers: tuple[int, int]) -> None:
    modulus = seqno_modulus(bench.profile.types.var_seqno.width)
    old, new = (each % modulus for each in numbers)
    source, name, count = bench.peer(), bench.var_id(), bench.sut.rep_cnt(2)
    bench.learn(source, source.create(name, seqno=old, rep_cnt=count))
    peers = [bench.peer() for _ in range(4)]
    mark = bench.mark()
    for peer in peers:
        peer.send(peer.summary(name, new))
    asked = bench.required(bench.until_instruction(_ASK_UPDATE, name), "a request for the missed value", "VD-PS-04")
    bench.answered(asked.seqno, old, "its own sequence number in the request", "VD-CMP-11")
    bench.waiting.repeated(_ASK_UPDATE, name, mark)
    mark = peers[0].stimulate(peers[0].update(name, new, b"last"))
    # In the same beacon period the summaries arrive again; they contain nothing new now.
    for peer in peers[1:]:
        peer.send(peer.summary(name, new))
    found = bench.waiting.repeated(_UPDATE, name, mark)
    last = (new, bench.records.value(b"last"))
    what = "the VarUpdate unchanged"
    bench.every(found, lambda each: (each.record.seqno, each.record.value) == last, what, "VD-PS-04")
    bench.repeated(found, count, f"beacons with VarUpdate {new}", "VD-PS-04")
    late = bench.instructions(_ASK_UPDATE, name, mark)
    bench.none(late, "no request after the value was received", "VD-PU-08", given=found)


@case(
    "TC_NET_PART_BV_02",
    "Two halves of a partition exchange what is newer in each of them",
    requirements="VD-PS-03 VD-PS-04 VD-PS-01 VD-PS-02",
    stimulus=(
        "three variables are known with sequence number 5; a payload has summaries with 4, 5 and 6, and one of an "
        "unknown variable"
    ),
    expect=(
        "a VarUpdate of the first, no record of the second, a request for the third and one for the unknown variable"
    ),
    window=16,
)
def both_directions(bench: Bench) -> None:
    source, other = bench.peer(), bench.peer()
    (newer, same, older), unknown = bench.identifiers.var_ids(3), bench.unknown_id()
    count = bench.sut.rep_cnt(2)
    bench.learn(source, *(source.create(each, seqno=5, rep_cnt=count) for each in (newer, same, older)))
    mark = bench.mark()
    other.send(other.summary(newer, 4), other.summary(same, 5), other.summary(older, 6), other.summary(unknown, 1))
    bench.required(bench.until_instruction(_ASK_CREATE, unknown), "a request for the unknown variable", "VD-PS-01")
    bench.check_repeated(_UPDATE, newer, count, mark, "VD-PS-03")
    bench.check_repeated(_ASK_UPDATE, older, 1, mark, "VD-PS-04")
    for kind in (_UPDATE, _ASK_UPDATE, _CREATE):
        found = bench.instructions(kind, same, mark)
        what = f"no {kind.label} record of the variable with equal sequence numbers"
        bench.none(found, what, "VD-PS-02", given=bench.verdicts.in_time)


@case(
    "TC_NET_PART_BV_03",
    "A variable deleted in one half of a partition and created again in the other is accepted",
    requirements="VD-PC-02 VD-PC-09",
    stimulus="a variable is learnt and deleted; then a VarCreate of another producer with a later creationTime arrives",
    expect="the new VarCreate in exactly repCnt beacons; the variable exists again",
    window=40,
    needs=Needs(since=SpecVersion.V2_0),
)
def created_in_the_other_half(bench: Bench) -> None:
    source, other, name, count = bench.peer(), bench.peer(), bench.var_id(), bench.sut.rep_cnt(2)
    bench.learn(source, source.create(name, seqno=100, rep_cnt=count))
    mark = source.stimulate(source.delete(name))
    bench.waiting.repeated(_DELETE, name, mark)
    create = other.create(name, value=b"other half", rep_cnt=count)
    mark = other.stimulate(create)
    bench.check_repeated(_CREATE, name, count, mark, "VD-PC-09")
    bench.equal(held(bench, name), create, "the variable in the database", "VD-PC-02")


@case(
    "TC_NET_PART_BV_04",
    "A node that was away for long catches up with all variables",
    requirements="VD-PS-01 VD-PS-04 VD-PC-09 VD-PU-07",
    stimulus=(
        "ten variables are known; a peer summarises them with newer sequence numbers along with ten unknown ones, "
        "and answers requests"
    ),
    expect="requests for all twenty, which are all forwarded",
    window=60,
)
def catches_up_with_all(bench: Bench) -> None:
    source, other = bench.peer(), bench.peer()
    known, unknown = bench.identifiers.var_ids(10), bench.identifiers.unknown_ids(10)
    bench.learn(source, *(source.create(each) for each in known))
    mark = other.stimulate(*(other.summary(each, 3) for each in (*known, *unknown)))
    answered: set[int] = set()
    passed: set[int] = set()

    def exchange(_: object) -> bool:
        frame = bench.heard[-1]
        created = [each.var_id for each in frame.instructions(_ASK_CREATE) if each.var_id in unknown]
        updated = [each.var_id for each in frame.instructions(_ASK_UPDATE) if each.var_id in known]
        if created or updated:
            answered.update(created, updated)
            # In separate payloads: otherwise the loss of a second container would look like a fault of updates.
            for answers in (
                [other.create(each, seqno=3, value=b"three") for each in created],
                [other.update(each, 3, b"three") for each in updated],
            ):
                if answers:
                    other.send(*answers)
        for kind in (_CREATE, _UPDATE):
            passed.update(each.var_id for each in frame.instructions(kind) if each.var_id in answered)
        return passed == {*known, *unknown}

    bench.until(exchange, 60)
    asked = {each.var_id for kind in (_ASK_CREATE, _ASK_UPDATE) for each in bench.instructions(kind, since=mark)}
    bench.some(
        asked >= set(unknown),
        "requests for all unknown variables",
        "VD-PS-01",
        seen=f"for {len(asked & set(unknown))} of 10",
    )
    bench.some(
        asked >= set(known),
        "requests for all outdated variables",
        "VD-PS-04",
        seen=f"for {len(asked & set(known))} of 10",
    )
    text = f"{len(passed & set(unknown))} of 10"
    bench.some(passed >= set(unknown), "all new variables are forwarded", "VD-PC-09", seen=text)
    text = f"{len(passed & set(known))} of 10"
    bench.some(passed >= set(known), "all updates are forwarded", "VD-PU-07", seen=text)
