"""dcp-srp.md: Runtime and Configurable Parameters."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from dcp_spec.constants import SpecVersion

from dcp_conformance.bench import MS, Bench
from dcp_conformance.case import Needs, case
from dcp_conformance.peers import Peer
from dcp_conformance.services import neighbour, neighbours, parameters_set, until_neighbour

_TIMEOUT = "SRPPAR_NEIGHBOUR_TABLE_TIMEOUT"
_TABLE = Needs(ut=("SRP-NeighbourTable",), entities=("srp",))


def _lifetime(
    bench: Bench, peers: list[Peer], begun: int, timeout: int, meanwhile: Callable[[], None] = lambda: None
) -> None:
    """Watch the entries that were made at ``begun`` until they are gone; all times in ns.

    ``meanwhile`` is called twenty times in each timeout.
    """
    latest = timeout + timeout // 5 + round(bench.pixit.timer_tolerance_ms * MS)
    step, there = max(timeout // 20, 10 * MS), {peer.node_id for peer in peers}
    if missing := there - set(neighbours(bench)):
        bench.inconclusive("the neighbours are in the table", f"{len(missing)} are not")
    while there:
        meanwhile()
        before = bench.now() - begun
        table = set(neighbours(bench))
        after = bench.now() - begun
        for node_id in sorted(there - table):
            there.discard(node_id)
            bench.check(
                after >= timeout,
                f"an entry lives for {timeout / 1e6:.0f} ms after the reception of its record",
                f"that of {node_id.hex(':')} was gone after {after / 1e6:.0f} ms",
            )
        if there and before > latest:
            observed = f"that of {min(there).hex(':')} is there after {before / 1e6:.0f} ms"
            bench.fail(f"an entry is gone {latest / 1e6:.0f} ms after the reception of its record", observed)
        if there:
            bench.wait_ns(step)


@contextmanager
def _brief_timeout(bench: Bench) -> Iterator[int]:
    """Half a second as the timeout if it can be set, else the timeout as it is; ms."""
    settable = bench.session.upper is not None and "SRP-SetParameter" in bench.session.upper.methods
    length = round(500 * bench.session.timing_scale) if settable else bench.bound(_TIMEOUT)
    with parameters_set(bench, "SRP", **({_TIMEOUT: length} if settable else {})):
        yield length


def _offsets(bench: Bench) -> dict[str, int]:
    """Time stamps by what is special about them, in ticks of the profile."""
    now = bench.creation_time()
    second = bench.profile.types.timestamp.per_second
    return {"now": now, "old": max(0, now - 3600 * second), "future": now + 3600 * second}


@case(
    "TC_SRP_NT_TI_01",
    "An entry is dropped when the timeout has passed since its reception, whatever its tStamp",
    requirements="SRP-RUN-01 SRP-RUN-02 SRP-PAR-01",
    stimulus="records of three neighbours, with a tStamp of now, an hour ago, and in an hour; then nothing",
    expect="all entries are there until SRPPAR_NEIGHBOUR_TABLE_TIMEOUT, and gone a fifth of it later, plus tolerance",
    window=45,
    needs=_TABLE,
)
def timeout(bench: Bench) -> None:
    peers = [bench.peer() for _ in range(3)]
    begun = bench.now()
    for peer, stamp in zip(peers, _offsets(bench).values(), strict=True):
        peer.send(bench.report(peer.node_id, 1, t_stamp=stamp))
    for peer in peers:
        until_neighbour(bench, peer.node_id)
    _lifetime(bench, peers, begun, bench.bound(_TIMEOUT) * MS)


@case(
    "TC_SRP_NT_TI_02",
    "A timeout that is set counts for entries from then on",
    requirements="SRP-RUN-01 SRP-RUN-02 SRP-PAR-01",
    stimulus="SRPPAR_NEIGHBOUR_TABLE_TIMEOUT = 500 ms; a record, and nothing more",
    expect="the entry is there for 500 ms, and gone 100 ms later, plus tolerance",
    window=12,
    needs=Needs(ut=("SRP-NeighbourTable", "SRP-SetParameter"), entities=("srp",)),
)
def short_timeout(bench: Bench) -> None:
    short = round(500 * bench.session.timing_scale)
    with parameters_set(bench, "SRP", **{_TIMEOUT: short}):
        peer = bench.peer()
        begun = bench.now()
        peer.send(bench.report(peer.node_id, 1))
        until_neighbour(bench, peer.node_id)
        _lifetime(bench, [peer], begun, short * MS)


@case(
    "TC_SRP_NT_TI_03",
    "A further record keeps the entry alive",
    requirements="SRP-RX-03 SRP-RUN-02",
    stimulus="records every half of the timeout, for two timeouts; then none",
    expect="the entry is there all the time, and gone afterwards",
    window=100,
    needs=_TABLE,
)
def refreshed(bench: Bench) -> None:
    with _brief_timeout(bench) as length:
        peer = bench.peer()
        begun = bench.now()
        for number in range(5):
            begun = bench.now()
            peer.send(bench.report(peer.node_id, number))
            bench.wait_ns(length * MS // 2)
            there = neighbour(bench, peer.node_id) is not None
            if not there and bench.now() - begun < length * MS:
                bench.fail("the entry stays while records come", f"it was gone after record {number + 1}")
        peer.send(bench.report(peer.node_id, 5))
        begun = bench.now()
        _lifetime(bench, [peer], begun, length * MS)


@case(
    "TC_SRP_NT_TI_04",
    "An entry is dropped although another neighbour goes on reporting",
    requirements="SRP-RUN-01 SRP-RUN-02",
    stimulus="one record of a neighbour; many of another one, twenty in each timeout",
    expect="the entry of the silent neighbour is dropped in time",
    window=45,
    needs=_TABLE,
)
def silent_among_others(bench: Bench) -> None:
    with _brief_timeout(bench) as length:
        silent, other = bench.peer(), bench.peer()
        numbers = itertools.count()

        def report() -> None:
            other.send(bench.report(other.node_id, next(numbers)))

        report()
        begun = bench.now()
        silent.send(bench.report(silent.node_id, 1))
        until_neighbour(bench, silent.node_id)
        _lifetime(bench, [silent], begun, length * MS, report)


@case(
    "TC_SRP_NT_TI_05",
    "An entry is dropped also while BP and VarDis are inactive",
    requirements="SRP-RUN-01 SRP-RUN-02",
    stimulus="a record of a neighbour; VD-MGMT-Deactivate, BP-MGMT-Deactivate",
    expect="the entry is dropped in time",
    window=45,
    needs=Needs(
        since=SpecVersion.V1_2,
        ut=(
            "SRP-NeighbourTable",
            "BP-MGMT-Activate",
            "BP-MGMT-Deactivate",
            "VD-MGMT-Activate",
            "VD-MGMT-Deactivate",
        ),
        entities=("srp", "vardis"),
    ),
)
def while_others_rest(bench: Bench) -> None:
    with _brief_timeout(bench) as length:
        peer = bench.peer()
        begun = bench.now()
        peer.send(bench.report(peer.node_id, 1))
        until_neighbour(bench, peer.node_id)
        with bench.deactivated("VD"), bench.deactivated("BP"):
            _lifetime(bench, [peer], begun, length * MS)


@case(
    "TC_SRP_NT_BV_06",
    "The neighbour table can be asked for, whatever is in it",
    requirements="SRP-NT-02",
    stimulus="SRP-NeighbourTable before and after each of three records of a neighbour, the last one sent twice",
    expect="SRP-STATUS-OK each time",
    needs=_TABLE,
)
def answers(bench: Bench) -> None:
    peer = bench.peer()
    bench.expect_status("SRP-STATUS-OK", "SRP-NeighbourTable", "SRP-NT-02")
    for number in (1, 2, 3, 3):
        peer.send(bench.report(peer.node_id, number))
        bench.wait(1)
        bench.expect_status("SRP-STATUS-OK", "SRP-NeighbourTable", "SRP-NT-02")


@case(
    "TC_SRP_PAR_BV_01",
    "The neighbour table timeout is 3000 ms unless it was configured",
    requirements="SRP-PAR-01 SRP-PAR-03",
    stimulus="SRP-GetParameters",
    expect="SRPPAR_NEIGHBOUR_TABLE_TIMEOUT = 3000; another value is reported, for it may have been configured",
    needs=Needs(ut=("SRP-GetParameters",), entities=("srp",)),
)
def default_timeout(bench: Bench) -> None:
    answer = bench.call("SRP-GetParameters")
    bench.require_asked(answer, "SRP-GetParameters is answered")
    bench.require(answer.ok, "SRP-GetParameters is answered", str(answer))
    value = answer.result.get("parameters", {}).get(_TIMEOUT)
    bench.check(value is not None, f"{_TIMEOUT} is told in ms", "it is not there", "SRP-PAR-01", shown=True)
    if value == 3000:
        bench.check(True, f"{_TIMEOUT} is 3000 ms", "", "SRP-PAR-03")
    elif value is not None:
        bench.info(f"{_TIMEOUT}, by default 3000 ms", f"{value} ms", "SRP-PAR-03")


@case(
    "TC_SRP_PAR_BI_01",
    "A neighbour table timeout that is refused is not used",
    requirements="SRP-PAR-01",
    stimulus="SRP-SetParameter with SRPPAR_NEIGHBOUR_TABLE_TIMEOUT = -1, and with 0",
    expect="if it is refused, SRP-GetParameters tells the timeout from before",
    needs=Needs(ut=("SRP-GetParameters", "SRP-SetParameter"), entities=("srp",)),
)
def refused_timeout(bench: Bench) -> None:
    before = configured = bench.must("SRP-GetParameters").result.get("parameters", {}).get(_TIMEOUT)
    if configured is None:
        bench.inconclusive(f"SRP-GetParameters tells {_TIMEOUT}, which this case needs", "it does not")
    try:
        for value in (-1, 0):
            answer = bench.call("SRP-SetParameter", name=_TIMEOUT, value=value)
            if not answer.asked:
                bench.info(f"Can {_TIMEOUT} be {value} ms?", f"the upper tester could not ask: {answer}")
                continue
            if answer.ok:
                bench.info(f"Can {_TIMEOUT} be {value} ms?", "yes")
                before = value
                continue
            after = bench.must("SRP-GetParameters").result.get("parameters", {}).get(_TIMEOUT)
            bench.check(after == before, f"{_TIMEOUT} stays {before}", f"it is {after}", shown=True)
    finally:
        bench.call("SRP-SetParameter", name=_TIMEOUT, value=configured)
