"""Networks: many neighbours, many simultaneous requests, duplicated and reordered beacons."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from dcp_spec.constants import ICType

from dcp_codec.values import VardisRecord
from dcp_conformance.definitions.case import FILLS, Needs, case
from dcp_conformance.frames.received import Instruction
from dcp_conformance.suite.vardis.composition.summaries import summarises
from dcp_conformance.test_steps.pacing import FEW, paced
from dcp_conformance.test_system.bench import Bench
from dcp_conformance.test_system.sending.peers import Peer
from dcp_conformance.test_system.session import FLOOR

from .conflicts import held

_CREATE, _UPDATE, _DELETE, _SUMMARY = (
    ICType.CREATE_VARIABLES,
    ICType.UPDATES,
    ICType.DELETE_VARIABLES,
    ICType.SUMMARIES,
)


@case(
    "TC_NET_CROWD_BV_01",
    "Ninety variables of thirty neighbours are all forwarded and summarised",
    requirements="VD-PC-09 VD-CMP-03 VD-SCP-02",
    alone=FILLS,
    stimulus="30 peers create three variables each, and summarise them, within one beacon period",
    expect="each of the 90 VarCreates in exactly one beacon; each variable in the summaries eventually",
    window=30,
    needs=Needs(when=lambda bench: bench.sut.lacks("variables", 90) or None),
)
def many_variables(bench: Bench) -> None:
    peers = [bench.peer() for _ in range(30)]
    names = {peer: bench.identifiers.var_ids(3) for peer in peers}
    everything = {each for mine in names.values() for each in mine}
    mark = bench.mark()

    def create(peer: Peer) -> list[VardisRecord]:
        mine = names[peer]
        creates: list[VardisRecord] = [peer.create(each, value=b"%d" % each, descr=b"crowd") for each in mine]
        return [*creates, *(peer.summary(each, 0) for each in mine)]

    def found() -> list[Instruction]:
        return [each for each in bench.instructions(_CREATE, since=mark) if each.var_id in everything]

    def missing() -> list[int]:
        return sorted(everything.difference(each.var_id for each in found()))

    for peer in peers:
        peer.send(*create(peer))
    bench.until_quiet(lambda heard: heard.instructions(_CREATE), since=mark)
    lost = missing()
    if lost:
        _slowly(bench, [peer for peer in peers if set(lost) & set(names[peer])], create)
        bench.until_quiet(lambda heard: heard.instructions(_CREATE), since=mark)
        _tell_overload(bench, len(lost) - len(missing()), "VarCreates", "VD-PC-09")
    left = missing()
    bench.complete(left, f"VarCreates of all {len(everything)} variables", "VD-PC-09")
    passed = [each.var_id for each in found()]
    twice = sorted({each for each in passed if passed.count(each) > 1})
    # A variable that is created again is forwarded again.
    bench.none(twice, "each VarCreate in exactly one beacon", "VD-SCP-02", given=not lost)
    bench.every(
        found(),
        lambda each: each.record.upd.value == bench.records.value(b"%d" % each.var_id),
        "each variable with its own value",
        "VD-PC-09",
    )
    if summarises(bench):
        return
    start = bench.mark()
    most = bench.sut.bound("VARDISPAR_MAX_SUMMARIES")

    def complete(_: object) -> bool:
        return {each.var_id for each in bench.instructions(_SUMMARY, since=start)} >= everything

    bench.until(complete, 4 + 2 * len(everything) / most)
    left = sorted(everything.difference(each.var_id for each in bench.instructions(_SUMMARY, since=start)))
    bench.complete(left, f"summaries of all {len(everything)} variables", "VD-CMP-03")


@case(
    "TC_NET_CROWD_BV_02",
    "The updates of thirty neighbours in every beacon period are forwarded",
    requirements="VD-PU-07 VD-SCP-02",
    alone=FILLS,
    stimulus="30 peers send a VarUpdate of one variable each in each of five beacon periods",
    expect="the last VarUpdate of each variable is forwarded; sequence numbers do not decrease",
    window=40,
)
def many_updates(bench: Bench) -> None:
    peers = {peer: bench.var_id() for peer in [bench.peer() for _ in range(30)]}
    _known(bench, peers)
    mark = bench.mark()

    def numbers_of(name: int) -> list[int]:
        return [each.record.seqno for each in bench.instructions(_UPDATE, name, mark)]

    def missing() -> list[Peer]:
        return [peer for peer, name in peers.items() if numbers_of(name)[-1:] != [5]]

    for number in range(1, 6):
        for peer, name in peers.items():
            peer.send(peer.update(name, number, b"%d" % number))
        bench.wait(1)
    bench.until_quiet(lambda heard: heard.instructions(_UPDATE), since=mark)
    if lost := missing():
        _slowly(bench, lost, lambda peer: [peer.update(peers[peer], 5, b"5")])
        bench.until_quiet(lambda heard: heard.instructions(_UPDATE), since=mark)
        _tell_overload(bench, len(lost) - len(missing()), "VarUpdates", "VD-PU-07")
    behind = [peers[peer] for peer in missing()]
    back, twice = [], []
    for name in peers.values():
        numbers = numbers_of(name)
        if numbers != sorted(numbers):
            back.append(name)
        if len(numbers) != len(set(numbers)):
            twice.append(name)
    bench.complete(behind, "the last VarUpdate of each variable", "VD-PU-07")
    bench.none(back, "sequence numbers that do not decrease", "VD-PU-07")
    bench.none(twice, "each VarUpdate in one beacon (repCnt 1)", "VD-SCP-02")


def _known(bench: Bench, peers: Mapping[Peer, int]) -> None:
    """Let each peer create its variable, again if a frame was lost; inconclusive if that fails."""
    left, attempts = list(peers), 2
    while left and attempts:
        mark = bench.mark()
        _slowly(bench, left, lambda peer: [peer.create(peers[peer], value=b"v")])
        bench.until_quiet(lambda heard: heard.instructions(_CREATE), since=mark)
        left, attempts = [peer for peer in left if not bench.instructions(_CREATE, peers[peer])], attempts - 1
    if left:
        bench.teaching.not_learnt({peers[peer] for peer in left})


def _slowly(bench: Bench, peers: Sequence[Peer], records: Callable[[Peer], Sequence[VardisRecord]]) -> None:
    """Send a beacon of each peer, a few in each beacon period; fewer if processing was measured to take longer."""
    for peer in paced(bench, peers):
        peer.send(*records(peer))


def _tell_overload(bench: Bench, count: int, what: str, requirement: str) -> None:
    """Report records that were lost in a burst but processed when sent slowly: no rule says how many a node must
    buffer.
    """
    if count > 0:
        bench.info(
            "Is a beacon of each of thirty neighbours processed if all arrive at once?",
            f"{count} {what} were lost; they were processed at a rate of {FEW} beacons per period",
            requirement,
        )


@case(
    "TC_NET_STORM_BV_01",
    "The same record from ten neighbours is answered repCnt times, not ten times as often ({variant})",
    requirements="VD-RC-03 VD-RU-04 VD-PS-03 VD-PU-06",
    stimulus="ten peers send the same record within one beacon period ({variant})",
    expect="the answer in exactly repCnt beacons, or in one more if a payload was composed before the last of the ten",
    window=24,
    variants={
        "request-for-create": (lambda peer, name: peer.request_create(name), _CREATE, "VD-RC-03"),
        "request-for-update": (lambda peer, name: peer.request_update(name, 4), _UPDATE, "VD-RU-04"),
        "old-summary": (lambda peer, name: peer.summary(name, 4), _UPDATE, "VD-PS-03"),
        "old-update": (lambda peer, name: peer.update(name, 4, b"old"), _UPDATE, "VD-PU-06"),
    },
)
def storm(bench: Bench, variant: tuple[Callable[[Peer, int], VardisRecord], ICType, str]) -> None:
    make, kind, rule = variant
    count = bench.sut.rep_cnt(3)

    def prepare() -> tuple[VardisRecord, int]:
        source, name = bench.peer(), bench.var_id()
        bench.learn(source, source.create(name, seqno=5, rep_cnt=count))
        return make(source, name), name

    found = _answers(bench, prepare, kind, count + 1)
    bench.repeated(found, count, "answers", rule, most=count + 1)
    bench.one_each(found, "each answer in a different beacon", rule)


def _answers(
    bench: Bench, prepare: Callable[[], tuple[VardisRecord, int]], kind: ICType, most: int
) -> list[Instruction]:
    """Send the same record from ten peers at once; return the answers of the last of up to three attempts.

    An attempt in which the implementation sent more than one beacon before the last of the ten is not judged: the peers
    were too slow. An implementation on a busy machine may process some of the records after a beacon, so more than
    ``most`` answers count only if they occur in every attempt. ``prepare`` returns a record and its variable, a new one
    for each attempt.
    """
    judged: list[Instruction] | None = None
    for _ in range(3):
        record, name = prepare()
        bench.beacons(1, 1.5)
        mark, begun = bench.mark(), bench.now()
        _send_ten(bench, record)
        end = bench.now()
        found = bench.waiting.repeated(kind, name, mark)
        if sum(begun <= heard.time <= end for heard in bench.heard[mark:]) <= 1:
            judged = found
            if len(found) <= most:
                break
    if judged is None:
        bench.inconclusive(
            "ten beacons within one beacon period", "two beacons of the implementation in between, in each attempt"
        )
    return judged


def _send_ten(bench: Bench, record: VardisRecord) -> None:
    if bench.sut.one_by_one:
        # The implementation may answer each payload before it processes the next: send all records in one payload.
        bench.peer().send(*[record] * 10)
        return
    peers = [bench.peer() for _ in range(10)]
    for peer in peers:
        peer.send(record)


@case(
    "TC_NET_STORM_BV_02",
    "The same stimulus from ten neighbours causes one request ({variant})",
    requirements="VD-PS-01 VD-PS-04 VD-PU-01 VD-RC-01",
    stimulus="ten peers send the same record within one beacon period ({variant})",
    expect="one request, or two if a payload was composed before the last of the ten",
    window=12,
    variants={
        "summarise-an-unknown-variable": ("summary", ICType.REQUEST_VARCREATES, "VD-PS-01"),
        "update-an-unknown-variable": ("update", ICType.REQUEST_VARCREATES, "VD-PU-01"),
        "summarise-a-newer-value": ("newer", ICType.REQUEST_VARUPDATES, "VD-PS-04"),
        "request-an-unknown-variable": ("request", ICType.REQUEST_VARCREATES, "VD-RC-01"),
    },
)
def one_request(bench: Bench, variant: tuple[str, ICType, str]) -> None:
    what, kind, rule = variant

    def prepare() -> tuple[VardisRecord, int]:
        peer = bench.peer()
        name = bench.var_id() if what == "newer" else bench.unknown_id()
        if what == "newer":
            bench.learn(peer, peer.create(name))
        records: dict[str, VardisRecord] = {"update": peer.update(name, 3), "request": peer.request_create(name)}
        return records.get(what, peer.summary(name, 3)), name

    if what == "request" and not bench.features.rerequest_unknown:
        record, name = prepare()
        mark = bench.mark()
        _send_ten(bench, record)
        bench.require_alive("requests for an unknown variable", rule)
        bench.none(bench.instructions(kind, name, mark), "no request: 1.0 ignores requests for unknown variables", rule)
        return
    bench.repeated(_answers(bench, prepare, kind, 2), 1, "requests", rule, most=2)


@case(
    "TC_NET_STORM_BV_03",
    "Answers continue while requests arrive in every period, and end after them",
    requirements="VD-RC-03",
    stimulus="peers request a VarCreate in each of six beacon periods, and then no more",
    expect="at most repCnt more answers than beacons sent in this time, and then none",
    window=40,
)
def lasting_storm(bench: Bench) -> None:
    source, name, count = bench.peer(), bench.var_id(), bench.sut.rep_cnt(3)
    bench.learn(source, source.create(name, rep_cnt=count))
    mark = bench.mark()
    asking = bench.peer()
    for _ in range(6):
        asking.send(asking.request_create(name))
        bench.wait(1)
    # A slow implementation processes the last request later.
    taken = bench.now() + round((bench.sut.reaction - min(bench.sut.reaction, FLOOR)) * bench.period)
    found = bench.waiting.repeated(_CREATE, name, mark)
    passed = sum(heard.time <= taken for heard in bench.heard[mark:])
    # Two for payloads that were composed before the last request but not yet sent.
    bench.repeated(found, count, "answers", most=passed + count + 2)


@case(
    "TC_NET_DUP_BV_01",
    "Duplicated beacons have the effect of one",
    requirements="VD-SCP-03 VD-SCP-02",
    stimulus="the beacons that create, update and delete a variable are each sent three times, with identical octets",
    expect="each record in exactly repCnt beacons",
    window=40,
)
def duplicates(bench: Bench) -> None:
    peer, name, count = bench.peer(), bench.var_id(), bench.sut.rep_cnt(3)
    for kind, record in (
        (_CREATE, peer.create(name, rep_cnt=count)),
        (_UPDATE, peer.update(name, 1)),
        (_DELETE, peer.delete(name)),
    ):
        octets, mark = peer.beacon(record), bench.mark()
        for _ in range(3):
            peer.send_octets(octets)
        bench.check_repeated(kind, name, count, mark)


@case(
    "TC_NET_ORDER_BV_01",
    "With reordered beacons, the newest value is stored ({variant})",
    requirements="VD-PU-06 VD-PU-07 VD-PU-01",
    stimulus="a creation and VarUpdates 1 and 2 in three beacons that arrive in the order {variant}",
    expect="sequence number 2 and its value in the end",
    window=30,
    variants={"create-2-1": (0, 2, 1), "1-create-2": (1, 0, 2), "create-1-2-1": (0, 1, 2, 1)},
)
def out_of_order(bench: Bench, order: tuple[int, ...]) -> None:
    peer = bench.peer()
    name = bench.unknown_id() if order[0] else bench.var_id()
    records: list[VardisRecord] = [peer.create(name), peer.update(name, 1, b"1"), peer.update(name, 2, b"2")]
    beacons = [peer.beacon(each) for each in records]
    mark = bench.mark()
    for place in order:
        peer.send_octets(beacons[place])
    bench.until_instruction(_UPDATE, name)
    numbers = [each.record.seqno for each in bench.waiting.repeated(_UPDATE, name, mark)]
    bench.some(numbers == sorted(numbers), "sequence numbers that do not decrease", "VD-PU-06", seen=numbers)
    record = held(bench, name)
    if record is None and order[0]:
        bench.missing(
            "the variable is known, although an update arrived first", "no answer to a request for it", "VD-PU-01"
        )
    state = None if record is None else (record.upd.seqno, record.upd.value)
    bench.some(state == (2, b"2"), "sequence number 2 with its value", "VD-PU-07", seen=state)
