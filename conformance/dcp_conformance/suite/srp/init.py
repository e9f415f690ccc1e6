"""dcp-srp.md: Initialization, Runtime and Shutdown."""

from __future__ import annotations

from typing import Any

from dcp_spec.constants import BP_PROTID_SRP

from dcp_conformance.definitions.case import REPLACES, Needs, case
from dcp_conformance.errors import NoAnswerError
from dcp_conformance.test_steps.services import (
    NO_RESPONSE,
    check_registered_name,
    neighbours,
    registration,
    report_octets,
    safety_data,
    srp_blocks,
    until_report,
)
from dcp_conformance.test_steps.state_reports import Reporter
from dcp_conformance.test_system.bench import Bench

#: Submissions of safety data before a restart: more than an application makes from the restart to the first beacon.
_MANY = 300
_LIST = Needs(ut=("BP-ListRegisteredProtocols",), entities=("srp",))


def _registration(bench: Bench) -> dict[str, Any]:
    return registration(bench, int(BP_PROTID_SRP), "SRP", "SRP-INI-01")


@case(
    "TC_SRP_INI_BV_01",
    "SRP is registered with BP under the name of the specification",
    requirements="SRP-INI-01",
    stimulus="BP-ListRegisteredProtocols",
    expect="protocol 1 with the name 'SRP -- State Reporting Protocol Vx.y', x.y from 1.0 to 2.0",
    needs=_LIST,
)
def name(bench: Bench) -> None:
    check_registered_name(bench, _registration(bench).get("protocolName"), "SRP -- State Reporting Protocol")


@case(
    "TC_SRP_INI_BV_02",
    "SRP is registered with a sufficient maxPayloadSize",
    requirements="SRP-INI-02",
    stimulus="BP-ListRegisteredProtocols",
    expect="a maxPayloadSize of at least the size of a record",
    needs=_LIST,
)
def size(bench: Bench) -> None:
    octets, shown = report_octets(bench), _registration(bench).get("maxPayloadSize")
    bench.proved(isinstance(shown, int) and shown >= octets, f"a maxPayloadSize of at least {octets} octets", shown)


@case(
    "TC_SRP_INI_BV_03",
    "SRP is registered with the queueing mode of its version of the specification",
    requirements="SRP-INI-03 SRP-INI-08",
    stimulus="BP-ListRegisteredProtocols",
    expect="BP_QMODE_ONCE; up to 1.2 BP_QMODE_REPEAT",
    needs=_LIST,
)
def mode(bench: Bench) -> None:
    expected, shown = bench.features.srp_queueing_mode, str(_registration(bench).get("queueMode"))
    bench.answered(shown.replace("-", "_"), expected, "queueMode")


def _forgets(bench: Bench, reporter: Reporter, most: int | None = None) -> bool:
    """Create state in SRP, restart it, check that the state is gone, and return whether its first report has seqno 0.

    A wrong number is judged only if no application can have caused it. ``most``: the largest number that the first
    report may have, if not 0.
    """
    peer = bench.peer()
    peer.send(bench.records.report(peer.node_id, 1))
    for _ in (1, 2):
        reporter.submit()
    until_report(bench)
    begun = bench.now()
    if bench.case.needs.restart:
        bench.control.restart()
    else:
        bench.must("UT-Reset")
    gone = peer.node_id not in neighbours(bench)
    bench.proved(gone, "no entry of an earlier neighbour in the table", f"an entry of {peer.node_id.hex(':')}")
    # Safety data may be configured; then the first report is not the tester's.
    bench.wait(2)
    # A report that was sent before the restart can be received after it, so only number 0 makes a submission needless.
    if 0 not in _numbers(bench, begun):
        reporter.sent(what="a record is sent after the restart")
    numbers = _numbers(bench, begun)
    right = 0 in numbers or (most is not None and min(numbers) <= most)
    if not right and most is None and reporter.application():
        return False
    last = next((heard for heard in reversed(bench.heard) if heard.report is not None), None)
    bench.proved(
        right,
        f"seqno {0 if most is None else f'0 to {most}'} in the first record after the restart",
        f"seqno {', '.join(map(str, numbers[:8]))}",
        "SRP-INI-05 SRP-SEQ-01",
        frames=[last] if last is not None else (),
    )
    return True


def _numbers(bench: Bench, since: int) -> list[int]:
    """Return the sequence numbers of the reports that were sent since a time in ns."""
    return [each.report.seqno for each in bench.heard if each.report is not None and each.time >= since]


@case(
    "TC_SRP_INI_BV_04",
    "After a reset the neighbour table is empty and the sequence number is 0",
    requirements="SRP-INI-05 SRP-SEQ-01",
    stimulus="a record of a neighbour and two submissions of safety data; UT-Reset; another submission",
    expect="no entry of the neighbour; seqno 0 in the record",
    window=8,
    needs=Needs(ut=("UT-Reset", "SRP-NeighbourTable", "SRP-UpdateSafetyData"), entities=("srp",)),
)
@case(
    "TC_SRP_INI_BV_05",
    "After a restart the neighbour table is empty and the sequence number is 0",
    requirements="SRP-INI-05 SRP-SEQ-01",
    stimulus="a record of a neighbour and two submissions of safety data; a restart; another submission",
    expect="no entry of the neighbour; seqno 0 in the record",
    window=20,
    needs=Needs(ut=("SRP-NeighbourTable", "SRP-UpdateSafetyData"), entities=("srp", "vardis"), restart=True),
    destructive=True,
)
def fresh_start(bench: Bench) -> None:
    reporter = Reporter(bench)
    if not _forgets(bench, reporter) and reporter.application():
        # An application may have submitted several reports before the first beacon, but not as many as are submitted
        # now.
        reporter.fill(_MANY)
        _forgets(bench, reporter, most=_MANY - 1)


def no_way_back(bench: Bench) -> str | None:
    """Return why a deregistered protocol could not be registered again, or None; for ``Needs.when``."""
    if bench.session.can_restart or bench.services.offers("UT-Reset"):
        return None
    return "there is neither UT-Reset nor a command to restart the implementation (--restart)"


def bring_back(bench: Bench) -> None:
    """Register the protocol that the case has deregistered again, by a reset or restart."""
    if bench.services.offers("UT-Reset"):
        bench.call("UT-Reset")
    else:
        bench.control.restart()


@case(
    "TC_SRP_SRV_BO_01",
    "SRP rejects requests while it is not registered with BP",
    requirements="SRP-SRV-01",
    alone=REPLACES,
    stimulus="BP-DeregisterProtocol for protocol 1, then SRP-UpdateSafetyData",
    expect="SRP-STATUS-INACTIVE, or no response (X10); no state report in the beacons",
    window=6,
    needs=Needs(
        ut=("SRP-UpdateSafetyData", "BP-DeregisterProtocol", "BP-ListRegisteredProtocols"),
        entities=("srp",),
        when=no_way_back,
    ),
    destructive=True,
)
def not_registered(bench: Bench) -> None:
    bench.must("BP-DeregisterProtocol", protId=int(BP_PROTID_SRP))
    mark = bench.mark()
    try:
        try:
            answer = bench.call("SRP-UpdateSafetyData", sData=safety_data(bench, 1))
        except NoAnswerError:
            # The upper tester cannot do more than wait for a response.
            bench.reading("X10", "no-response")
            bench.passed("no service while SRP is not registered")
            return
        if answer.code == NO_RESPONSE:
            bench.reading("X10", "no-response")
            bench.passed("no service while SRP is not registered")
        elif bench.services.check_status(answer, ("SRP-STATUS-INACTIVE",), "SRP-UpdateSafetyData"):
            # SRP has been initialized before: a node that answers nothing before its initialization may answer now.
            bench.reading("X10", "confirm-inactive", "no-response")
        bench.beacons(3, 3)
        bench.none([heard for heard in bench.heard[mark:] if srp_blocks(heard)], "no beacon with a state report")
    finally:
        bring_back(bench)
