"""Networks: partitions that heal."""

from __future__ import annotations

from dcp_spec.constants import ICType, SpecVersion, seqno_modulus

from dcp_conformance.bench import Bench
from dcp_conformance.case import Needs, case

from .network_conflicts import held

_CREATE, _UPDATE, _DELETE = ICType.CREATE_VARIABLES, ICType.UPDATES, ICType.DELETE_VARIABLES
_ASK_UPDATE, _ASK_CREATE = ICType.REQUEST_VARUPDATES, ICType.REQUEST_VARCREATES


@case(
    "TC_NET_PART_BV_01",
    "When a partition heals, what was missed is fetched with one request and one answer ({variant})",
    requirements="VD-PS-04 VD-CMP-11 VD-PU-08",
    stimulus="a variable is known; updates are missed ({variant}); four peers summarise the last, one answers",
    expect="a request with the own number, then the last VarUpdate; nothing is requested once it is there",
    window=30,
    variants={"3-to-10": (2, 10), "across-the-wrap": (-6, 4)},
)
def heals(bench: Bench, numbers: tuple[int, int]) -> None:
    modulus = seqno_modulus(bench.profile.types.var_seqno.width)
    old, new = (each % modulus for each in numbers)
    source, name, count = bench.peer(), bench.var_id(), bench.rep_cnt(2)
    bench.learn(source, source.create(name, seqno=old, rep_cnt=count))
    peers = [bench.peer() for _ in range(4)]
    mark = bench.mark()
    for peer in peers:
        peer.send(peer.summary(name, new))
    asked = bench.until_instruction(_ASK_UPDATE, name)
    if asked is None:
        bench.fail("a request for what was missed", "none", "VD-PS-04")
    bench.check(asked.seqno == old, f"its own number, {old}", f"{asked.seqno}", "VD-CMP-11", shown=True)
    bench.repeated(_ASK_UPDATE, name, mark)
    mark = bench.mark()
    peers[0].send(peers[0].update(name, new, b"last"))
    # The same beacon period brings the summaries again: they are not news any more.
    for peer in peers[1:]:
        peer.send(peer.summary(name, new))
    found = bench.repeated(_UPDATE, name, mark)
    right = bool(found) and all((each.record.seqno, each.record.value) == (new, bench.value(b"last")) for each in found)
    bench.check(
        right and len(found) == count,
        f"VarUpdate {new} in {count} beacons",
        f"{len(found)}",
        "VD-PS-04",
        shown=len(found) > count or (found and not right),
    )
    late = bench.instructions(_ASK_UPDATE, name, mark)
    bench.check(
        not late, "no request once the value is there", f"{len(late)} came", "VD-PU-08", frames=late[:4], shown=found
    )


@case(
    "TC_NET_PART_BV_02",
    "Two halves that each know something newer exchange it",
    requirements="VD-PS-03 VD-PS-04 VD-PS-01 VD-PS-02",
    stimulus="three variables are known with number 5; a payload says 4, 5 and 6, and names an unknown one",
    expect="a VarUpdate of the first, nothing of the second, a request for the third and one for the unknown one",
    window=16,
)
def both_directions(bench: Bench) -> None:
    source, other = bench.peer(), bench.peer()
    (newer, same, older), unknown = bench.var_ids(3), bench.unknown_id()
    count = bench.rep_cnt(2)
    bench.learn(source, *(source.create(each, seqno=5, rep_cnt=count) for each in (newer, same, older)))
    mark = bench.mark()
    other.send(other.summary(newer, 4), other.summary(same, 5), other.summary(older, 6), other.summary(unknown, 1))
    bench.require(bench.until_instruction(_ASK_CREATE, unknown), "a request for the unknown one", "none", "VD-PS-01")
    bench.check_repeated(_UPDATE, newer, count, mark, "VD-PS-03")
    bench.check_repeated(_ASK_UPDATE, older, 1, mark, "VD-PS-04")
    for kind in (_UPDATE, _ASK_UPDATE, _CREATE):
        found = bench.instructions(kind, same, mark)
        bench.check(
            not found,
            f"no {kind.label} record of the one with equal numbers",
            f"{len(found)} came",
            "VD-PS-02",
            shown=True,
        )


@case(
    "TC_NET_PART_BV_03",
    "A re-creation in the other half is accepted, although the variable was deleted in this one",
    requirements="VD-PC-02 VD-PC-09",
    stimulus="a variable is learnt and deleted; then comes a VarCreate with a later creationTime of another producer",
    expect="the new VarCreate in exactly repCnt beacons, and the variable lives with it",
    window=40,
    needs=Needs(since=SpecVersion.V2_0),
)
def created_in_the_other_half(bench: Bench) -> None:
    source, other, name, count = bench.peer(), bench.peer(), bench.var_id(), bench.rep_cnt(2)
    bench.learn(source, source.create(name, seqno=100, rep_cnt=count))
    mark = bench.mark()
    source.send(source.delete(name))
    bench.repeated(_DELETE, name, mark)
    mark = bench.mark()
    create = other.create(name, value=b"other half", rep_cnt=count)
    other.send(create)
    bench.check_repeated(_CREATE, name, count, mark, "VD-PC-09")
    record = held(bench, name)
    bench.check(record == create, f"{create}", f"{record}", "VD-PC-02", shown=record is not None)


@case(
    "TC_NET_PART_BV_04",
    "Many variables at once: a node that was away for long catches up with all of them",
    requirements="VD-PS-01 VD-PS-04 VD-PC-09 VD-PU-07",
    stimulus="ten variables are known; a peer summarises these with newer numbers and ten unknown ones, and answers"
    " what it is asked",
    expect="the implementation asks for all twenty and passes each of them on",
    window=60,
)
def catches_up_with_all(bench: Bench) -> None:
    source, other = bench.peer(), bench.peer()
    known, unknown = bench.var_ids(10), bench.unknown_ids(10)
    bench.learn(source, *(source.create(each) for each in known))
    mark = bench.mark()
    other.send(*(other.summary(each, 3) for each in (*known, *unknown)))
    answered: set[int] = set()
    passed: set[int] = set()

    def exchange(_: object) -> bool:
        frame = bench.heard[-1]
        created = [each.var_id for each in frame.instructions(_ASK_CREATE) if each.var_id in unknown]
        updated = [each.var_id for each in frame.instructions(_ASK_UPDATE) if each.var_id in known]
        if created or updated:
            answered.update(created, updated)
            # Apart, so that who loses a second container is not blamed for updates.
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
    bench.check(asked >= set(unknown), "requests for all unknown ones", f"for {len(asked & set(unknown))}", "VD-PS-01")
    bench.check(asked >= set(known), "requests for all outdated ones", f"for {len(asked & set(known))}", "VD-PS-04")
    text = f"{len(passed & set(unknown))} of 10"
    bench.check(passed >= set(unknown), "all new variables are passed on", text, "VD-PC-09")
    text = f"{len(passed & set(known))} of 10"
    bench.check(passed >= set(known), "all updates are passed on", text, "VD-PU-07")
