"""Networks: nodes that join late, and nodes that supply them with variables.

Peers behave like nodes: they request variables that they do not know, and answer requests.
"""

from __future__ import annotations

import msgspec
from dcp_spec.constants import ICType

from dcp_codec.values import VarCreate, VarUpdate
from dcp_conformance.definitions.case import Needs, case
from dcp_conformance.frames.received import ReceivedBeacon
from dcp_conformance.frames.sampling import plain
from dcp_conformance.suite.vardis.composition.summaries import summarises
from dcp_conformance.test_steps.services import produced, settled
from dcp_conformance.test_system.bench import Bench
from dcp_conformance.test_system.sending.peers import Peer

_CREATE, _UPDATE, _SUMMARY = ICType.CREATE_VARIABLES, ICType.UPDATES, ICType.SUMMARIES
_ASK_UPDATE, _ASK_CREATE = ICType.REQUEST_VARUPDATES, ICType.REQUEST_VARCREATES
_SUMMARIES = Needs(when=summarises)


@case(
    "TC_NET_JOIN_BV_01",
    "A late joiner learns of a variable from a {variant}, requests it, and knows it after the answer",
    requirements="VD-PS-01 VD-PU-01 VD-CMP-12 VD-PC-07 VD-PC-09",
    stimulus="a {variant} about an unknown variable; the tester answers the request with its VarCreate",
    expect="one request; then the VarCreate in exactly repCnt beacons, and summaries with its sequence number",
    window=16,
    variants={"summary": _SUMMARY, "update": _UPDATE},
)
def learns(bench: Bench, by: ICType) -> None:
    peer, name, count = bench.peer(), bench.unknown_id(), bench.sut.rep_cnt(2)
    mark = peer.stimulate(peer.summary(name, 6) if by is _SUMMARY else peer.update(name, 6))
    asked = bench.until_instruction(_ASK_CREATE, name)
    bench.required(asked, "a request for the unknown variable", "VD-PS-01" if by is _SUMMARY else "VD-PU-01")
    create = peer.create(name, seqno=6, value=b"six", rep_cnt=count)
    peer.send(create)
    found = bench.check_repeated(_CREATE, name, count, mark, "VD-PC-09")
    _check_content(bench, [each.record for each in found], create)
    bench.check_repeated(_ASK_CREATE, name, 1, mark, "VD-CMP-12")
    _check_summarised(bench, name, 6)


def _check_content(bench: Bench, records: list[VarCreate], create: VarCreate) -> None:
    other = next((each for each in records if each != create), None)
    bench.none(other, f"the unchanged VarCreate {create}", "VD-PC-07")


def _check_summarised(bench: Bench, name: int, number: int) -> None:
    if summarises(bench):
        return
    found = bench.until_instruction(_SUMMARY, name, 12)
    bench.some(found, f"summaries of variable {name}", "VD-PC-09", seen="none in 12 periods")
    if found is not None:
        bench.answered(found.seqno, number, "sequence number in the summary", "VD-PC-07")


@case(
    "TC_NET_JOIN_BV_02",
    "A node that missed updates learns of them from a summary, requests them, and gets the current value",
    requirements="VD-PS-04 VD-CMP-11 VD-PU-07",
    stimulus=(
        "a variable is known with sequence number 2; a summary has 7; the tester answers the request with VarUpdate 7"
    ),
    expect="one request with sequence number 2, then VarUpdate 7 in exactly repCnt beacons",
    window=16,
)
def catches_up(bench: Bench) -> None:
    peer, name, count = bench.peer(), bench.var_id(), bench.sut.rep_cnt(2)
    bench.learn(peer, peer.create(name, seqno=2, rep_cnt=count))
    mark = peer.stimulate(peer.summary(name, 7))
    asked = bench.required(bench.until_instruction(_ASK_UPDATE, name), "a request for the newer value", "VD-PS-04")
    bench.answered(asked.seqno, 2, "its own sequence number in the request", "VD-CMP-11")
    peer.send(peer.update(name, 7, b"seven"))
    bench.every(
        bench.check_repeated(_UPDATE, name, count, mark, "VD-PU-07"),
        bench.records.update(name, 7, b"seven"),
        "the VarUpdate unchanged",
        "VD-PU-07",
    )
    bench.check_repeated(_ASK_UPDATE, name, 1, mark, "VD-CMP-11")


@case(
    "TC_NET_JOIN_BV_03",
    "A consumer also answers a late joiner's request for a VarCreate",
    requirements="VD-RC-03 VD-CMP-07",
    stimulus="a variable is learnt from its producer and updated; another peer requests its VarCreate",
    expect="the VarCreate with the current value and sequence number in exactly repCnt beacons",
    window=20,
)
def teaches_create(bench: Bench) -> None:
    producer, joiner = bench.peer(), bench.peer()
    name, count = bench.var_id(), bench.sut.rep_cnt(3)
    create = bench.learnt(producer, name, value=b"old", seqno=1, rep_cnt=count)
    mark = producer.stimulate(producer.update(name, 2, b"new"))
    updated = bench.waiting.repeated(_UPDATE, name, mark)
    mark = joiner.stimulate(joiner.request_create(name))
    found = bench.check_repeated(_CREATE, name, count, mark, "VD-RC-03")
    wanted = msgspec.structs.replace(create, upd=bench.records.update(name, 2, b"new"))
    bench.every(found, wanted, "the current VarCreate", "VD-CMP-07", given=updated)


@case(
    "TC_NET_JOIN_BV_04",
    "A consumer also answers a request for a newer value",
    requirements="VD-RU-04",
    stimulus="a variable is learnt with sequence number 5; a peer requests an update and gives 4 as its own number",
    expect="VarUpdate 5 in exactly repCnt beacons",
    window=12,
)
def teaches_update(bench: Bench) -> None:
    producer, stale = bench.peer(), bench.peer()
    name, count = bench.var_id(), bench.sut.rep_cnt(3)
    bench.learn(producer, producer.create(name, value=b"five", seqno=5, rep_cnt=count))
    mark = stale.stimulate(stale.request_update(name, 4))
    bench.every(
        bench.check_repeated(_UPDATE, name, count, mark),
        bench.records.update(name, 5, b"five"),
        "the stored value with sequence number 5",
    )


@case(
    "TC_NET_JOIN_BV_05",
    "A peer with an outdated value gets the current one after it sends a {variant}",
    requirements="VD-PS-03 VD-PU-06",
    stimulus="a variable is known with sequence number 9; another peer sends a {variant} with 8, then a summary with 9",
    expect="VarUpdate 9 in exactly repCnt beacons; none after the summary with 9",
    window=20,
    variants={"summary": _SUMMARY, "update": _UPDATE},
)
def teaches_stale(bench: Bench, by: ICType) -> None:
    requirement = "VD-PS-03" if by is _SUMMARY else "VD-PU-06"
    producer, stale = bench.peer(), bench.peer()
    name, count = bench.var_id(), bench.sut.rep_cnt(3)
    bench.learn(producer, producer.create(name, value=b"nine", seqno=9, rep_cnt=count))
    mark = stale.stimulate(stale.summary(name, 8) if by is _SUMMARY else stale.update(name, 8, b"eight"))
    bench.every(
        bench.check_repeated(_UPDATE, name, count, mark, requirement),
        bench.records.update(name, 9, b"nine"),
        "the stored value with sequence number 9",
        requirement,
    )
    mark = stale.stimulate(stale.summary(name, 9))
    bench.require_alive("a summary with the stored sequence number", requirement)
    late = bench.instructions(_UPDATE, name, mark)
    bench.none(late, "no VarUpdate after a summary with the current sequence number", requirement)


class _Joiner:
    """A node that knows no variables and requests those it hears of."""

    def __init__(self, peer: Peer, names: list[int]) -> None:
        self.peer = peer
        self.names = set(names)
        self.values: dict[int, tuple[int, bytes]] = {}

    def react(self, heard: ReceivedBeacon) -> None:
        """Store the records of a beacon, and request what is missing."""
        for each in heard.instructions(_CREATE):
            if each.var_id in self.names:
                self.values[each.var_id] = (each.record.upd.seqno, each.record.upd.value)
        for each in heard.instructions(_UPDATE):
            if each.var_id in self.values:
                self.values[each.var_id] = (each.record.seqno, each.record.value)
        summaries = [each.record for each in heard.instructions(_SUMMARY) if each.var_id in self.names]
        unknown = [each.var_id for each in summaries if each.var_id not in self.values]
        stale = [each for each in summaries if each.var_id in self.values and self.values[each.var_id][0] != each.seqno]
        asks = [self.peer.request_create(each) for each in unknown]
        updates = [self.peer.request_update(each.var_id, self.values[each.var_id][0]) for each in stale]
        if asks or updates:
            self.peer.send(*asks, *updates)


@case(
    "TC_NET_JOIN_BV_06",
    "A late joiner that follows the protocol gets all variables and their current values",
    requirements="VD-RC-03 VD-RU-04 VD-CMP-03 VD-CMP-04",
    stimulus=(
        "eight variables, some of them updated, are known; a peer joins and requests what the summaries contain; "
        "later some variables are updated again while it does not listen"
    ),
    expect="the joiner has all eight variables with their current values, also after the second round of updates",
    window=60,
    needs=_SUMMARIES,
)
def converges(bench: Bench) -> None:
    producer, names = bench.peer(), bench.identifiers.var_ids(8)
    bench.learn(producer, *(producer.create(each, value=b"0") for each in names))
    truth = dict.fromkeys(names, (0, b"0"))
    joiner = _Joiner(bench.peer(), names)

    def caught_up(heard: ReceivedBeacon) -> bool:
        joiner.react(heard)
        return joiner.values == truth

    for turn in (1, 2):
        mark = bench.mark()
        for name in names[turn::2]:
            truth[name] = (turn, bench.records.value(b"turn %d" % turn))
            producer.send(producer.update(name, *truth[name]))
        bench.waiting.repeated(_UPDATE, names[turn], mark)
        converged = bench.until(caught_up, 60)
        wrong = sorted(each for each in names if joiner.values.get(each) != truth[each])
        bench.required(
            converged,
            "the joiner has the current values of all variables",
            seen=f"after 60 periods, variables {wrong} missing or outdated",
        )


@case(
    "TC_NET_JOIN_BO_01",
    "An unanswered request is repeated when another summary arrives ({variant})",
    requirements="VD-PS-01 VD-PS-04 VD-CMP-11 VD-CMP-12",
    stimulus="the same summary three times, each after the request caused by the one before",
    expect="one request after each summary, and no other",
    window=20,
    variants={"unknown": _ASK_CREATE, "outdated": _ASK_UPDATE},
)
def asks_again(bench: Bench, kind: ICType) -> None:
    peer = bench.peer()
    rule, once = ("VD-PS-01", "VD-CMP-12") if kind is _ASK_CREATE else ("VD-PS-04", "VD-CMP-11")
    name = bench.unknown_id() if kind is _ASK_CREATE else bench.var_id()
    if kind is _ASK_UPDATE:
        bench.learn(peer, peer.create(name))
    for _ in range(3):
        mark = peer.stimulate(peer.summary(name, 1))
        bench.required(bench.until_instruction(kind, name), "a request", rule)
        bench.check_repeated(kind, name, 1, mark, once)


@case(
    "TC_NET_JOIN_BV_07",
    "The producer itself also answers a joiner's requests",
    requirements="VD-RC-03 VD-RU-04 VD-CMP-07",
    stimulus="the application creates and updates a variable; a peer requests its VarCreate, another an update",
    expect="VarCreate and VarUpdate with the current value and sequence number, each in exactly repCnt beacons",
    window=24,
    needs=Needs(ut=("RTDB-Create", "RTDB-Update")),
)
def taught_by_producer(bench: Bench) -> None:
    count = bench.sut.rep_cnt(3)
    name = produced(bench, rep_cnt=count)
    bench.until_instruction(_CREATE, name)
    settled(bench, name)
    mark = bench.mark()
    bench.must("RTDB-Update", varId=name, value=bench.records.value(b"\x01\x02").hex())
    bench.waiting.repeated(_UPDATE, name, mark)
    joiner, stale = bench.peer(), bench.peer()
    mark = joiner.stimulate(joiner.request_create(name))
    found = bench.check_repeated(_CREATE, name, count, mark, "VD-RC-03")
    wanted = VarUpdate(name, 1, bench.records.value(b"\x01\x02"))
    bench.every(
        found, lambda each: plain(each.record.upd) == wanted, "the current value with sequence number 1", "VD-CMP-07"
    )
    mark = stale.stimulate(stale.request_update(name, 0))
    bench.check_repeated(_UPDATE, name, count, mark, "VD-RU-04")
