"""dcp-vardis.md: Initialization, Runtime and Shutdown."""

from __future__ import annotations

from typing import Any

from dcp_spec.constants import BP_PROTID_VARDIS, ICType, SpecVersion

from dcp_conformance.bench import MS, Bench
from dcp_conformance.case import Needs, case
from dcp_conformance.scrubbing import not_by_consumers
from dcp_conformance.services import check_registered_name, listed, produced, registration, taught

_LIST = Needs(ut=("BP-ListRegisteredProtocols",))


def _registration(bench: Bench) -> dict[str, Any]:
    return registration(bench, int(BP_PROTID_VARDIS), "VarDis")


@case(
    "TC_VD_INI_BV_01",
    "VarDis is registered with BP under its name",
    requirements="VD-INI-02",
    stimulus="BP-ListRegisteredProtocols",
    expect="protocol 2, 'VarDis -- Variable Dissemination Protocol Vx.y' with a version from V1.0 to V2.0",
    needs=_LIST,
)
def name(bench: Bench) -> None:
    check_registered_name(bench, _registration(bench).get("protocolName"), "VarDis -- Variable Dissemination Protocol")


@case(
    "TC_VD_INI_BV_02",
    "VarDis is registered with the size, mode and queue of its version",
    requirements="VD-INI-02 VD-INI-07 VD-INI-08",
    stimulus="BP-ListRegisteredProtocols",
    expect="maxPayloadSize is VARDISPAR_MAX_PAYLOAD_SIZE, mode DROPHEAD (1.1 DROPTAIL, 1.0 ONCE), maxEntries positive, "
    "no multiple payloads",
    needs=_LIST,
)
def registered(bench: Bench) -> None:
    found = _registration(bench)
    expected, shown = bench.features.vardis_queueing_mode, str(found.get("queueMode"))
    bench.check(shown.replace("-", "_") == expected, f"queueMode is {expected}", shown, shown=True)
    if bench.features.allow_multiple_payloads:
        entries, several = found.get("maxEntries"), found.get("allowMultiplePayloads")
        bench.check(isinstance(entries, int) and entries > 0, "maxEntries is positive", f"{entries}", shown=True)
        bench.check(several is False, "allowMultiplePayloads is false", f"{several}", shown=True)
    size, told = bench.bound("VARDISPAR_MAX_PAYLOAD_SIZE"), found.get("maxPayloadSize")
    bench.check(told == size, f"maxPayloadSize is {size}", f"{told}", shown=True)


@case(
    "TC_VD_INI_BV_03",
    "After a reset the database and the queues are empty",
    requirements="VD-INI-04",
    stimulus="an own variable with its repetitions to come, a learnt one, and a request to come; UT-Reset",
    expect="no variable is described; after at most one beacon prepared before, no record of the two is sent; a "
    "summary of the learnt one is answered with a request",
    window=14,
    needs=Needs(ut=("UT-Reset", "RTDB-Create", "RTDB-DescribeDatabase")),
)
def after_reset(bench: Bench) -> None:
    peer = bench.peer()
    mine = produced(bench, rep_cnt=bench.bound("VARDISPAR_MAX_REPETITIONS"))
    theirs, wanted = taught(bench, peer), bench.unknown_id()
    peer.send(peer.summary(wanted, 1))
    bench.must("UT-Reset")
    mark, reset = bench.mark(), bench.now()
    known = sorted(listed(bench))
    bench.check(not known, "no variable is in the database", f"{known} are", shown=True)
    bench.wait(3)
    frames = [heard for heard in bench.heard[mark:] if heard.instructions(var_id=mine)]
    bench.check(
        len(frames) <= 1, "nothing of the old variable is sent", f"{len(frames)} beacons", frames=frames, shown=True
    )
    # What was on its way to the tester is there soon; a payload that is composed now needs a beacon of its own.
    asked = bench.instructions(ICType.REQUEST_VARCREATES, wanted, mark)
    late = [each for each in asked if each.heard.time > reset + bench.period // 2]
    bench.check(not late, "no request from before is sent", f"{len(late)} are", frames=late, shown=True)
    peer.send(peer.summary(theirs, 1))
    requested = bench.until_instruction(ICType.REQUEST_VARCREATES, theirs)
    bench.check(requested is not None, "the learnt variable is requested again", "it is not")


@case(
    "TC_VD_INI_BV_04",
    "After a restart the database is empty",
    requirements="VD-INI-04 VD-SHD-03",
    stimulus="a variable is learnt; restart; a summary of the variable",
    expect="the variable is requested as an unknown one, and nothing was said of it before",
    window=24,
    needs=Needs(restart=True),
    destructive=True,
)
def after_restart(bench: Bench) -> None:
    peer = bench.peer()
    var_id = taught(bench, peer)
    bench.restart()
    mark = bench.mark()
    bench.beacons(2, 2.5)
    frames = [heard for heard in bench.heard[mark:] if heard.instructions(var_id=var_id)]
    bench.check(not frames, "nothing of the variable is sent", f"{len(frames)} beacons", frames=frames, shown=True)
    peer.send(peer.summary(var_id, 1))
    requested = bench.until_instruction(ICType.REQUEST_VARCREATES, var_id)
    bench.check(requested is not None, "the variable is unknown and requested", "it is not requested")


@case(
    "TC_VD_INI_BV_05",
    "The scrubbing process runs without being asked",
    requirements="VD-INI-06",
    stimulus="a peer's variable with a timeout of five beacon periods is learnt, and not updated",
    expect="VarDelete records of it, the timeout and a scrubbing period later at the latest, plus tolerance; none if "
    "only producers scrub (X26)",
    window=30,
    needs=Needs(since=SpecVersion.V2_0),
)
def scrubbing(bench: Bench) -> None:
    peer = bench.peer()
    timeout = round(5 * bench.period / MS)
    var_id = taught(bench, peer, timeout=timeout)
    period = bench.parameter("VARDISPAR_SCRUBBING_PERIOD")
    latest = (timeout + period + bench.pixit.timer_tolerance_ms) * MS / bench.period + bench.reaction
    shown = bench.until_instruction(ICType.DELETE_VARIABLES, var_id, latest)
    if shown is None:
        # TC_VD_SCR_TI_02 asks the same of a variable of the implementation's own, which every reading has scrubbed.
        not_by_consumers(bench, var_id)
        return
    bench.check(True, "the variable is deleted after its timeout")
