"""dcp-vardis.md: Initialization, Runtime and Shutdown."""

from __future__ import annotations

from typing import Any

from dcp_spec.constants import BP_PROTID_VARDIS, ICType, SpecVersion

from dcp_conformance.definitions.case import Needs, case
from dcp_conformance.test_steps.services import check_registered_name, listed, produced, registration, teach_variable
from dcp_conformance.test_steps.timeouts import not_by_consumers
from dcp_conformance.test_system.bench import MS, Bench

_LIST = Needs(ut=("BP-ListRegisteredProtocols",))


def _registration(bench: Bench) -> dict[str, Any]:
    return registration(bench, int(BP_PROTID_VARDIS), "VarDis")


@case(
    "TC_VD_INI_BV_01",
    "VarDis is registered with BP under the name of the specification",
    requirements="VD-INI-02",
    stimulus="BP-ListRegisteredProtocols",
    expect="protocol 2 with the name 'VarDis -- Variable Dissemination Protocol Vx.y', x.y from 1.0 to 2.0",
    needs=_LIST,
)
def name(bench: Bench) -> None:
    check_registered_name(bench, _registration(bench).get("protocolName"), "VarDis -- Variable Dissemination Protocol")


@case(
    "TC_VD_INI_BV_02",
    "VarDis is registered with the size, mode and queue of its version of the specification",
    requirements="VD-INI-02 VD-INI-07 VD-INI-08",
    stimulus="BP-ListRegisteredProtocols",
    expect=(
        "VARDISPAR_MAX_PAYLOAD_SIZE as maxPayloadSize, mode DROPHEAD (1.1 DROPTAIL, 1.0 ONCE), positive "
        "maxEntries, allowMultiplePayloads false"
    ),
    needs=_LIST,
)
def registered(bench: Bench) -> None:
    found = _registration(bench)
    expected, shown = bench.features.vardis_queueing_mode, str(found.get("queueMode"))
    bench.answered(shown.replace("-", "_"), expected, "queueMode")
    if bench.features.allow_multiple_payloads:
        entries, several = found.get("maxEntries"), found.get("allowMultiplePayloads")
        bench.proved(isinstance(entries, int) and entries > 0, "a positive maxEntries", entries)
        bench.answered(several, False, "allowMultiplePayloads")
    size, told = bench.sut.bound("VARDISPAR_MAX_PAYLOAD_SIZE"), found.get("maxPayloadSize")
    bench.answered(told, size, "maxPayloadSize")


@case(
    "TC_VD_INI_BV_03",
    "After a reset the database and the queues are empty",
    requirements="VD-INI-04",
    stimulus=(
        "one of the node's own variables with remaining repetitions, a variable of a peer, and a pending request; "
        "UT-Reset"
    ),
    expect=(
        "an empty database; no record of either variable after at most one beacon prepared before; a request in "
        "response to a summary of the peer's variable"
    ),
    window=14,
    needs=Needs(ut=("UT-Reset", "RTDB-Create", "RTDB-DescribeDatabase")),
)
def after_reset(bench: Bench) -> None:
    peer = bench.peer()
    mine = produced(bench, rep_cnt=bench.sut.bound("VARDISPAR_MAX_REPETITIONS"))
    theirs, wanted = teach_variable(bench, peer), bench.unknown_id()
    peer.send(peer.summary(wanted, 1))
    # A frame that is processed after the reset is a stimulus after it.
    bench.waiting.wait_ns(bench.session.notifications)
    bench.must("UT-Reset")
    mark, reset = bench.mark(), bench.now()
    bench.none(sorted(listed(bench)), "no variable in the database")
    bench.wait(3)
    frames = [heard for heard in bench.heard[mark:] if heard.instructions(var_id=mine)]
    bench.proved(
        len(frames) <= 1,
        "no record of the old variable, except in one beacon",
        f"in {len(frames)} beacons",
        frames=frames,
    )
    # Beacons in transit reach the tester soon; a payload composed now is sent in a later beacon.
    asked = bench.instructions(ICType.REQUEST_VARCREATES, wanted, mark)
    late = [each for each in asked if each.heard.time > reset + bench.period // 2]
    bench.none(late, "no request from before the reset")
    peer.send(peer.summary(theirs, 1))
    bench.some(bench.until_instruction(ICType.REQUEST_VARCREATES, theirs), "a request for the peer's variable")


@case(
    "TC_VD_INI_BV_04",
    "After a restart the database is empty",
    requirements="VD-INI-04 VD-SHD-03",
    stimulus="a peer creates a variable; a restart; a summary of the variable",
    expect="a request for the variable, which is unknown, and no record of it before",
    window=24,
    needs=Needs(restart=True),
    destructive=True,
)
def after_restart(bench: Bench) -> None:
    peer = bench.peer()
    var_id = teach_variable(bench, peer)
    bench.control.restart()
    mark = bench.mark()
    bench.beacons(2, 2.5)
    frames = [heard for heard in bench.heard[mark:] if heard.instructions(var_id=var_id)]
    bench.none(frames, "no record of the variable")
    peer.send(peer.summary(var_id, 1))
    requested = bench.until_instruction(ICType.REQUEST_VARCREATES, var_id)
    bench.some(requested, "a request for the variable, which is unknown")


@case(
    "TC_VD_INI_BV_05",
    "The scrubbing process runs from the start",
    requirements="VD-INI-06",
    stimulus="a peer creates a variable with a timeout of five beacon periods and does not update it",
    expect=(
        "a VarDelete at the latest one scrubbing period after the timeout, plus tolerance; none if only producers "
        "scrub (X26)"
    ),
    window=30,
    needs=Needs(since=SpecVersion.V2_0),
)
def scrubbing(bench: Bench) -> None:
    peer = bench.peer()
    timeout = round(5 * bench.period / MS)
    var_id = teach_variable(bench, peer, timeout=timeout)
    period = bench.sut.parameter("VARDISPAR_SCRUBBING_PERIOD")
    latest = (timeout + period + bench.sut.pixit.timer_tolerance_ms) * MS / bench.period + bench.sut.reaction
    shown = bench.until_instruction(ICType.DELETE_VARIABLES, var_id, latest)
    if shown is None:
        # TC_VD_SCR_TI_02 tests the same with a variable of the implementation's own, which is scrubbed in every
        # reading.
        not_by_consumers(bench, var_id)
        return
    bench.passed("a VarDelete of the variable after its timeout")
