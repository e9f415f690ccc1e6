"""dcp-srp.md: Runtime and Configurable Parameters."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

from dcp_spec.constants import BP_PROTID_SRP, SpecVersion

from dcp_conformance.definitions.case import Needs, case
from dcp_conformance.frames.builder import Block
from dcp_conformance.test_steps.services import neighbour, neighbours, parameters_set, rows, until_neighbour
from dcp_conformance.test_system.bench import MS, Bench
from dcp_conformance.test_system.sending.peers import Peer

TIMEOUT = "SRPPAR_NEIGHBOUR_TABLE_TIMEOUT"
_TABLE = Needs(ut=("SRP-NeighbourTable",), entities=("srp",))


def lifetime(
    bench: Bench,
    peers: list[Peer],
    begun: int | Mapping[bytes, int],
    timeout: int,
    meanwhile: Callable[[], object] = lambda: None,
) -> None:
    """Watch entries made at ``begun``, a time or one for each node, until they are removed; all times in ns.

    ``meanwhile`` is called twenty times per timeout.
    """
    since = dict.fromkeys((peer.node_id for peer in peers), begun) if isinstance(begun, int) else begun
    latest = timeout + timeout // 5 + round(bench.sut.pixit.timer_tolerance_ms * MS)
    step, there = max(timeout // 20, 10 * MS), {peer.node_id for peer in peers}
    _present(bench, there)
    while there:
        meanwhile()
        before = bench.now()
        table = set(neighbours(bench))
        now = bench.now()
        for node_id in sorted(there - table):
            there.discard(node_id)
            after = now - since[node_id]
            bench.some(
                after >= timeout,
                f"an entry remains for {timeout / 1e6:.0f} ms after the reception of its record",
                seen=f"{node_id.hex(':')} was removed after {after / 1e6:.0f} ms",
            )
        if late := [each for each in sorted(there) if before - since[each] > latest]:
            observed = f"{late[0].hex(':')} is still there after {(before - since[late[0]]) / 1e6:.0f} ms"
            bench.missing(
                f"an entry is removed within {latest / 1e6:.0f} ms after the reception of its record", observed
            )
        if there:
            bench.waiting.wait_ns(step)


def _present(bench: Bench, node_ids: set[bytes]) -> None:
    """Stop the case as inconclusive unless all of these nodes have an entry."""
    if missing := node_ids - set(neighbours(bench)):
        bench.inconclusive("entries of the neighbours", f"{len(missing)} missing")


@contextmanager
def brief_timeout(bench: Bench) -> Iterator[int]:
    """Set a timeout of half a second if possible; yield the timeout in use, in ms."""
    settable = bench.services.offers("SRP-SetParameter")
    length = round(500 * bench.session.timing_scale) if settable else bench.sut.bound(TIMEOUT)
    with parameters_set(bench, "SRP", **({TIMEOUT: length} if settable else {})):
        yield length


def entered(bench: Bench) -> tuple[Peer, int]:
    """Send a record of a new neighbour and wait for its entry; return the neighbour, and the time (ns) before."""
    peer, begun = bench.peer(), bench.now()
    peer.send(bench.records.report(peer.node_id, 1))
    until_neighbour(bench, peer.node_id)
    return peer, begun


def _offsets(bench: Bench) -> dict[str, int]:
    """Return special time stamps by name, in ticks of the profile's clock."""
    now = bench.records.creation_time()
    second = bench.profile.types.timestamp.per_second
    return {"now": now, "old": max(0, now - 3600 * second), "future": now + 3600 * second}


@case(
    "TC_SRP_NT_TI_01",
    "An entry is removed after the timeout since its reception, whatever its tStamp",
    requirements="SRP-RUN-01 SRP-RUN-02 SRP-PAR-01",
    stimulus=(
        "records of three neighbours, with a tStamp of now, one hour ago, and in one hour; half a timeout later, of "
        "three others; then none"
    ),
    expect=(
        "all entries remain for SRPPAR_NEIGHBOUR_TABLE_TIMEOUT, and are removed within another fifth of it, plus "
        "tolerance"
    ),
    window=60,
    needs=_TABLE,
)
def timeout(bench: Bench) -> None:
    length, since = bench.sut.bound(TIMEOUT) * MS, dict[bytes, int]()
    peers, begun = [bench.peer() for _ in range(6)], bench.now()
    for half in (peers[:3], peers[3:]):
        if since:
            # If the table is traversed too rarely, either half is removed too late, whenever the traversals are.
            bench.waiting.wait_ns(length // 2)
            gone = [node_id.hex(":") for node_id in set(since) - set(neighbours(bench))]
            if bench.now() - begun < length:
                bench.none(gone, "removal of an entry before its timeout", seen=f"removed early: {', '.join(gone)}")
        begun = bench.now()
        for peer, stamp in zip(half, _offsets(bench).values(), strict=True):
            since[peer.node_id] = begun
            peer.send(bench.records.report(peer.node_id, 1, t_stamp=stamp))
        for peer in half:
            until_neighbour(bench, peer.node_id)
        _present(bench, {peer.node_id for peer in half})
    lifetime(bench, peers, since, length)


@case(
    "TC_SRP_NT_TI_02",
    "A new timeout applies to later entries, from the reception of their own record, and look-ups no longer find them",
    requirements="SRP-RUN-01 SRP-RUN-02 SRP-PAR-01 SRP-NT-01",
    stimulus=(
        "SRPPAR_NEIGHBOUR_TABLE_TIMEOUT = 500 ms; records of four neighbours, a seventh of it apart; look-ups of the "
        "last one before and after its removal"
    ),
    expect="each entry remains for 500 ms and is removed within another 100 ms, plus tolerance; then none is found",
    window=16,
    needs=Needs(ut=("SRP-NeighbourTable", "SRP-SetParameter"), entities=("srp",)),
)
def short_timeout(bench: Bench) -> None:
    short = round(500 * bench.session.timing_scale)
    with parameters_set(bench, "SRP", **{TIMEOUT: short}):
        peers, begun = [bench.peer() for _ in range(4)], dict[bytes, int]()
        for peer in peers:
            if begun:
                # Between two traversals of the table.
                bench.waiting.wait_ns(short * MS // 7)
            begun[peer.node_id] = bench.now()
            peer.send(bench.records.report(peer.node_id, 1))
        until_neighbour(bench, peer.node_id)
        _looked_up(bench, peer)
        lifetime(bench, peers, begun, short * MS)
        bench.none(_looked_up(bench, peer), "no entry in a look-up of a node that is not in the list", "SRP-NT-01")


def _looked_up(bench: Bench, peer: Peer) -> list[dict[str, object]]:
    return rows(bench.must("SRP-NeighbourTable", nodeId=peer.node_id.hex(":")), "neighbours")


@case(
    "TC_SRP_NT_TI_03",
    "Each further record restarts the timeout of an entry",
    requirements="SRP-RX-03 SRP-RUN-02",
    alone="it shortens the timeout of neighbours",
    stimulus="a record every half timeout, for one and a half timeouts; then none",
    expect="the entry remains all the time, and is removed in time afterwards",
    window=80,
    needs=_TABLE,
)
def refreshed(bench: Bench) -> None:
    with brief_timeout(bench) as length:
        peer = bench.peer()
        for number in range(3):
            begun = bench.now()
            peer.send(bench.records.report(peer.node_id, number))
            bench.waiting.wait_ns(length * MS // 2)
            there = neighbour(bench, peer.node_id) is not None
            if not there and bench.now() - begun < length * MS:
                bench.missing("the entry remains while records arrive", f"removed after record {number + 1}")
        peer.send(bench.records.report(peer.node_id, 5))
        lifetime(bench, [peer], bench.now(), length * MS)


@case(
    "TC_SRP_NT_TI_04",
    "An entry is removed although another neighbour keeps reporting",
    requirements="SRP-RUN-01 SRP-RUN-02",
    alone="it shortens the timeout of neighbours",
    stimulus="one record of one neighbour; many of another, twenty per timeout",
    expect="the entry of the silent neighbour is removed in time",
    window=45,
    needs=_TABLE,
)
def silent_among_others(bench: Bench) -> None:
    with brief_timeout(bench) as length:
        silent, other = bench.peer(), bench.peer()
        numbers = itertools.count()

        def report() -> None:
            other.send(bench.records.report(other.node_id, next(numbers)))

        report()
        begun = bench.now()
        silent.send(bench.records.report(silent.node_id, 1))
        until_neighbour(bench, silent.node_id)
        lifetime(bench, [silent], begun, length * MS, report)


@case(
    "TC_SRP_NT_TI_05",
    "An entry is removed even while BP and VarDis are inactive",
    requirements="SRP-RUN-01 SRP-RUN-02",
    stimulus="a record of a neighbour; VD-MGMT-Deactivate, BP-MGMT-Deactivate",
    expect="the entry is removed in time",
    window=45,
    needs=Needs(
        since=SpecVersion.V1_2,
        ut=("SRP-NeighbourTable", "BP-MGMT-Activate", "BP-MGMT-Deactivate", "VD-MGMT-Activate", "VD-MGMT-Deactivate"),
        entities=("srp", "vardis"),
    ),
)
def while_others_rest(bench: Bench) -> None:
    with brief_timeout(bench) as length:
        peer, begun = entered(bench)
        with bench.services.deactivated("VD"), bench.services.deactivated("BP"):
            lifetime(bench, [peer], begun, length * MS)


@case(
    "TC_SRP_NT_TI_09",
    "When entries expire, the others keep their identifiers and data",
    requirements="SRP-RUN-02 SRP-NT-01 SRP-NT-02",
    alone="it shortens the timeout of neighbours",
    stimulus="records of five neighbours; then only the second and the fourth continue, for one and a half timeouts",
    expect="entries of these two with their own sequence numbers, and none of the three others",
    window=60,
    needs=_TABLE,
)
def others_stay(bench: Bench) -> None:
    with brief_timeout(bench) as length:
        peers = [bench.peer() for _ in range(5)]
        for number, peer in enumerate(peers):
            peer.send(bench.records.report(peer.node_id, 100 * number))
        begun = bench.now()
        latest = length * MS * 3 // 2 + round(bench.sut.pixit.timer_tolerance_ms * MS)
        last: dict[bytes, int] = {}
        rounds = itertools.count(1)
        while bench.now() - begun < latest:
            step = next(rounds)
            for number in (1, 3):
                last[peers[number].node_id] = 100 * number + step
                peers[number].send(bench.records.report(peers[number].node_id, 100 * number + step))
            bench.waiting.wait_ns(length * MS // 8)
        sent = bench.now()
        table = neighbours(bench)
        slow = bench.now() - sent > length * MS // 2
        gone = [each.node_id.hex(":") for each in peers if each.node_id not in last and each.node_id in table]
        if gone:
            bench.missing(f"the removal of entries within {latest / MS:.0f} ms", f"still there: {', '.join(gone)}")
        if slow:
            bench.verdicts.not_applicable("the calls of this case take longer than half of the neighbour table timeout")
        for node_id, seqno in last.items():
            entry = table[node_id][0] if node_id in table else {}
            # The last record may be lost.
            near = entry.get("seqno") in range(seqno - 2, seqno + 1)
            what = f"an entry of {node_id.hex(':')} with its newest sequence number, {seqno}"
            bench.proved(near, what, f"seqno {entry['seqno']}") if entry else bench.missing(what, "no entry")


@case(
    "TC_SRP_NT_TI_10",
    "A record that is discarded does not prolong an entry ({variant})",
    requirements="SRP-RX-01 SRP-RUN-02",
    alone="it shortens the timeout of neighbours",
    stimulus="a record of a neighbour; then invalid ones with the same nodeId ({variant}), twenty per timeout",
    expect="the entry is removed in time",
    window=45,
    needs=_TABLE,
    variants={name: name for name in ("one-long", "one-short", "twice")},
)
def not_prolonged(bench: Bench, name: str) -> None:
    with brief_timeout(bench) as length:
        peer, begun = entered(bench)
        if bench.now() - begun > length * MS // 2:
            bench.verdicts.not_applicable("the calls of this case take longer than half of the neighbour table timeout")
        octets = bench.builder.srp(bench.records.report(peer.node_id, 2)).octets
        invalid = {"one-long": octets + b"\0", "one-short": octets[:-1], "twice": octets * 2}[name]
        lifetime(bench, [peer], begun, length * MS, lambda: peer.send(Block(BP_PROTID_SRP, invalid)))


@case(
    "TC_SRP_NT_TI_11",
    "Setting the timeout does not prolong the entries that exist",
    requirements="SRP-RUN-02 SRP-PAR-01",
    alone="it shortens the timeout of neighbours",
    stimulus="a record of a neighbour; then SRP-SetParameter with the same timeout, eighteen times before its end",
    expect="the entry is removed in time",
    window=45,
    needs=Needs(ut=("SRP-NeighbourTable", "SRP-SetParameter"), entities=("srp",)),
)
def set_again(bench: Bench) -> None:
    # Almost twice this time is later than any tolerance allows.
    length = round(max(1000 * bench.session.timing_scale, 2 * bench.sut.pixit.timer_tolerance_ms))
    with parameters_set(bench, "SRP", **{TIMEOUT: length}):
        peer, begun = entered(bench)
        # The interval at which the table is traversed may restart, and is a fifth of the timeout.
        end = begun + length * MS * 9 // 10

        def again() -> None:
            if bench.now() < end:
                bench.must("SRP-SetParameter", name=TIMEOUT, value=length)

        lifetime(bench, [peer], begun, length * MS, again)


@case(
    "TC_SRP_NT_BV_06",
    "The neighbour table can be queried whatever its contents",
    requirements="SRP-NT-02",
    alone="it needs an empty neighbour table",
    stimulus="SRP-NeighbourTable before and after each of three records of a neighbour, the last record sent twice",
    expect="SRP-STATUS-OK each time",
    needs=_TABLE,
)
def answers(bench: Bench) -> None:
    peer = bench.peer()
    bench.expect_status("SRP-STATUS-OK", "SRP-NeighbourTable", "SRP-NT-02")
    for number in (1, 2, 3, 3):
        peer.send(bench.records.report(peer.node_id, number))
        bench.wait(1)
        bench.expect_status("SRP-STATUS-OK", "SRP-NeighbourTable", "SRP-NT-02")


@case(
    "TC_SRP_PAR_BV_01",
    "The neighbour table timeout is 3000 ms by default",
    requirements="SRP-PAR-01 SRP-PAR-03",
    stimulus="SRP-GetParameters",
    expect="SRPPAR_NEIGHBOUR_TABLE_TIMEOUT = 3000; another value may have been configured and is reported",
    needs=Needs(ut=("SRP-GetParameters",), entities=("srp",)),
)
def default_timeout(bench: Bench) -> None:
    answer = bench.call("SRP-GetParameters")
    bench.services.require_asked(answer, "an answer to SRP-GetParameters")
    bench.required(answer.ok, "a positive answer to SRP-GetParameters", seen=answer)
    value = answer.result.get("parameters", {}).get(TIMEOUT)
    bench.proved(value is not None, f"{TIMEOUT} in ms, in the answer", "no such parameter", "SRP-PAR-01")
    if value == 3000:
        bench.passed(f"{TIMEOUT} is 3000 ms", "SRP-PAR-03")
    elif value is not None:
        bench.info(f"Is the default {TIMEOUT} 3000 ms?", f"unknown: it is {value} ms", "SRP-PAR-03")


@case(
    "TC_SRP_PAR_BI_01",
    "A rejected neighbour table timeout is not used",
    requirements="SRP-PAR-01",
    stimulus="SRP-SetParameter with SRPPAR_NEIGHBOUR_TABLE_TIMEOUT = -1, then with 0",
    expect="after a rejection, SRP-GetParameters returns the previous timeout",
    needs=Needs(ut=("SRP-GetParameters", "SRP-SetParameter"), entities=("srp",)),
)
def refused_timeout(bench: Bench) -> None:
    before = configured = bench.must("SRP-GetParameters").result.get("parameters", {}).get(TIMEOUT)
    if configured is None:
        bench.inconclusive(f"{TIMEOUT} in the answer to SRP-GetParameters, which this case needs", "no such parameter")
    try:
        for value in (-1, 0):
            answer = bench.call("SRP-SetParameter", name=TIMEOUT, value=value)
            if not answer.asked:
                bench.info(f"Can {TIMEOUT} be {value} ms?", f"unknown: the upper tester could not ask: {answer}")
                continue
            if answer.ok:
                bench.info(f"Can {TIMEOUT} be {value} ms?", "yes")
                before = value
                continue
            after = bench.must("SRP-GetParameters").result.get("parameters", {}).get(TIMEOUT)
            bench.answered(after, before, f"{TIMEOUT}, as before")
    finally:
        bench.call("SRP-SetParameter", name=TIMEOUT, value=configured)
