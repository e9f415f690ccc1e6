"""dcp-vardis.md: Other Management Services."""

from __future__ import annotations

from typing import Any

from dcp_spec.constants import ICType, SpecVersion

from dcp_conformance.definitions.case import Needs, case
from dcp_conformance.test_steps.services import (
    INACTIVE,
    OK,
    UNKNOWN,
    create_request,
    max_repetitions,
    produced,
    settled,
    teach_variable,
)
from dcp_conformance.test_system.bench import Bench

_ON, _OFF = "VD-MGMT-Activate", "VD-MGMT-Deactivate"


def _needs(*methods: str) -> Needs:
    return Needs(since=SpecVersion.V1_2, ut=(_ON, _OFF, *methods))


@case(
    "TC_VD_MGT_BV_01",
    "VarDis can be deactivated and activated, even repeatedly",
    requirements="VD-MGT-01 VD-MGT-05",
    stimulus="VD-MGMT-Deactivate twice, VD-MGMT-Activate twice",
    expect="VARDIS-STATUS-OK each time; VarDis answers afterwards",
    needs=_needs(),
)
def on_and_off(bench: Bench) -> None:
    try:
        for _ in range(2):
            bench.expect_status(OK, _OFF, "VD-MGT-01")
    finally:
        for _ in range(2):
            bench.expect_status(OK, _ON, "VD-MGT-05")
    bench.require_alive("a time of inactivity", "VD-MGT-05")


@case(
    "TC_VD_MGT_BO_01",
    "Inactive VarDis generates no payloads",
    requirements="VD-MGT-02 VD-MGT-05",
    stimulus=(
        "RTDB-Create with the maximum repCnt; VD-MGMT-Deactivate after the first VarCreate; VD-MGMT-Activate after "
        "six periods"
    ),
    expect=(
        "no VarDis block after at most one beacon, whose payload BP had already buffered; blocks again after activation"
    ),
    window=20,
    needs=_needs("RTDB-Create"),
)
def no_payloads(bench: Bench) -> None:
    var_id = produced(bench, rep_cnt=max_repetitions(bench))
    bench.needed(bench.until_instruction(ICType.CREATE_VARIABLES, var_id), "beacons with VarDis payloads")
    with bench.services.deactivated("VD"):
        mark = bench.mark()
        bench.wait(6)
        frames = [heard for heard in bench.heard[mark:] if heard.has_vardis]
        bench.proved(
            len(frames) <= 1,
            "no VarDis payload, except one that BP had already buffered",
            f"{len(frames)} beacons with VarDis blocks",
            "VD-MGT-02",
            frames=frames,
        )
    again = bench.until(lambda heard: heard.has_vardis and heard)
    # The repetitions may be over, and summaries may be switched off.
    if not again and not bench.sut.bound("VARDISPAR_MAX_SUMMARIES"):
        bench.require_alive("a time of inactivity", "VD-MGT-05")
    else:
        bench.some(bool(again), "VarDis payloads after activation", "VD-MGT-05")


@case(
    "TC_VD_MGT_BO_02",
    "Payloads received while VarDis is inactive are never processed",
    requirements="VD-MGT-03",
    stimulus=(
        "while VarDis is inactive, a VarCreate, an update of a known variable and a summary of an unknown one; "
        "then VD-MGMT-Activate"
    ),
    expect="the new variable is unknown, the known one unchanged, and the summary causes no request",
    window=16,
    needs=_needs("RTDB-Read"),
)
def discards(bench: Bench) -> None:
    peer = bench.peer()
    known = teach_variable(bench, peer, value=b"before")
    created, summarized = bench.identifiers.unknown_ids(2)
    with bench.services.deactivated("VD"):
        mark = peer.stimulate(peer.create(created), peer.update(known, 1, b"while"), peer.summary(summarized, 1))
        bench.wait(max(2, bench.session.known.processing))
    bench.require_alive("a time of inactivity")
    bench.expect_status(UNKNOWN, "RTDB-Read", varId=created)
    value = bench.call("RTDB-Read", varId=known).result.get("value")
    bench.answered(value, bench.records.value(b"before").hex(), "the known variable unchanged")
    for kind, var_id in (
        (ICType.CREATE_VARIABLES, created),
        (ICType.UPDATES, known),
        (ICType.REQUEST_VARCREATES, summarized),
    ):
        bench.none(bench.receiver.frames_with(kind, var_id, mark), f"no {kind.label} record as a reaction")


@case(
    "TC_VD_MGT_BV_02",
    "Deactivation does not change the database",
    requirements="VD-MGT-05",
    stimulus="one of the node's own variables and one of a peer; VD-MGMT-Deactivate, VD-MGMT-Activate",
    expect="RTDB-Read returns both values; summaries of both variables continue",
    window=16,
    needs=_needs("RTDB-Create", "RTDB-Read"),
)
def database_kept(bench: Bench) -> None:
    mine = produced(bench, value=b"mine")
    theirs = teach_variable(bench, bench.peer(), value=b"theirs")
    with bench.services.deactivated("VD"):
        bench.wait(2)
    mark = bench.mark()
    for var_id, value in ((mine, b"mine"), (theirs, b"theirs")):
        answer = bench.expect_status(OK, "RTDB-Read", varId=var_id)
        bench.answered(answer.result.get("value"), bench.records.value(value).hex(), "value")
    if bench.sut.bound("VARDISPAR_MAX_SUMMARIES"):
        wanted = {mine, theirs}
        bench.until(lambda _: wanted <= {each.var_id for each in bench.instructions(ICType.SUMMARIES, since=mark)}, 12)
        seen = {each.var_id for each in bench.instructions(ICType.SUMMARIES, since=mark)}
        bench.some(wanted <= seen, "summaries of both variables", seen=f"summaries of {sorted(seen & wanted)}")


# -- services of an inactive VarDis ------------------------------------------------------------------------------------


def _inactive(bench: Bench, method: str, requirement: str, **params: Any) -> dict[str, Any]:
    """Check that a service answers INACTIVE while VarDis is inactive; return the fields of its answer."""
    with bench.services.deactivated("VD"):
        answer = bench.call(method, **params)
        bench.services.check_status(answer, (INACTIVE,), method, requirement, "VD-MGT-04")
    return answer.result


@case(
    "TC_VD_MGT_BV_03",
    "An activation of active VarDis repeats nothing that was sent",
    requirements="VD-MGT-05 VD-SCP-02",
    stimulus="RTDB-Create, and a variable of a peer; after their repetitions VD-MGMT-Activate twice",
    expect="no further VarCreate, VarUpdate or VarDelete of these variables",
    window=16,
    needs=_needs("RTDB-Create"),
)
def activated_while_active(bench: Bench) -> None:
    mine = produced(bench)
    settled(bench, mine)
    before = bench.mark()
    names = [mine, teach_variable(bench, bench.peer())]
    settled(bench, names[1], before)
    mark = bench.mark()
    for _ in range(2):
        bench.expect_status(OK, _ON, "VD-MGT-05")
    bench.require_alive("an activation")
    bench.beacons(3)
    repeated = [
        each
        for kind in (ICType.CREATE_VARIABLES, ICType.UPDATES, ICType.DELETE_VARIABLES)
        for name in names
        for each in bench.instructions(kind, name, mark)
    ]
    # The last repetition of the second variable may have been in preparation.
    bench.none(repeated[1:], "no VarCreate, VarUpdate or VarDelete of these variables", "VD-SCP-02")


@case(
    "TC_VD_MGT_BO_03",
    "Inactive VarDis creates no variable, neither immediately nor after activation",
    requirements="VD-MGT-04 VD-CRE-01 VD-CRE-13",
    stimulus="while VarDis is inactive, RTDB-Create, valid and with an empty value; then VD-MGMT-Activate",
    expect="VARDIS-STATUS-INACTIVE both times, whatever the value; no variable and no VarCreate after activation",
    needs=_needs("RTDB-Create", "RTDB-Read"),
)
def create(bench: Bench) -> None:
    good, bad = bench.identifiers.unknown_ids(2)
    mark = bench.mark()
    _inactive(bench, "RTDB-Create", "VD-CRE-01", **create_request(bench, good))
    _inactive(bench, "RTDB-Create", "VD-CRE-13", **create_request(bench, bad, value=b""))
    bench.require_alive("a time of inactivity")
    bench.expect_status(UNKNOWN, "RTDB-Read", "VD-MGT-04", varId=good)
    bench.none(bench.receiver.frames_with(ICType.CREATE_VARIABLES, good, mark), "no VarCreate", "VD-MGT-04")


@case(
    "TC_VD_MGT_BO_04",
    "Inactive VarDis updates no variable, neither immediately nor after activation",
    requirements="VD-MGT-04 VD-UPD-01",
    stimulus="RTDB-Update while VarDis is inactive; then VD-MGMT-Activate",
    expect="VARDIS-STATUS-INACTIVE; the old value and no VarUpdate after activation",
    needs=_needs("RTDB-Create", "RTDB-Update", "RTDB-Read"),
)
def update(bench: Bench) -> None:
    var_id = produced(bench, value=b"before")
    mark = bench.mark()
    _inactive(bench, "RTDB-Update", "VD-UPD-01", varId=var_id, value=bench.records.value(b"while").hex())
    bench.require_alive("a time of inactivity")
    value = bench.call("RTDB-Read", varId=var_id).result.get("value")
    bench.answered(value, bench.records.value(b"before").hex(), "the value unchanged", "VD-MGT-04")
    bench.none(bench.receiver.frames_with(ICType.UPDATES, var_id, mark), "no VarUpdate", "VD-MGT-04")


@case(
    "TC_VD_MGT_BO_05",
    "Inactive VarDis deletes no variable, neither immediately nor after activation",
    requirements="VD-MGT-04 VD-DEL-01",
    stimulus="RTDB-Delete while VarDis is inactive; then VD-MGMT-Activate",
    expect="VARDIS-STATUS-INACTIVE; the variable exists and no VarDelete is sent after activation",
    needs=_needs("RTDB-Create", "RTDB-Delete", "RTDB-Read"),
)
def delete(bench: Bench) -> None:
    var_id = produced(bench)
    mark = bench.mark()
    _inactive(bench, "RTDB-Delete", "VD-DEL-01", varId=var_id)
    bench.require_alive("a time of inactivity")
    bench.expect_status(OK, "RTDB-Read", "VD-MGT-04", varId=var_id)
    bench.none(bench.receiver.frames_with(ICType.DELETE_VARIABLES, var_id, mark), "no VarDelete", "VD-MGT-04")


@case(
    "TC_VD_MGT_BO_06",
    "Inactive VarDis rejects RTDB-Read",
    requirements="VD-MGT-04 VD-REA-01",
    stimulus="RTDB-Read while VarDis is inactive, for an existing variable and for an unknown one",
    expect="VARDIS-STATUS-INACTIVE and no value both times",
    needs=_needs("RTDB-Create", "RTDB-Read"),
)
def read(bench: Bench) -> None:
    for var_id in (produced(bench), bench.unknown_id()):
        result = _inactive(bench, "RTDB-Read", "VD-REA-01", varId=var_id)
        bench.proved("value" not in result, "no value", result.get("value"), "VD-REA-01")


@case(
    "TC_VD_MGT_BO_07",
    "Inactive VarDis rejects RTDB-DescribeDatabase",
    requirements="VD-MGT-04 VD-DDB-01",
    stimulus="RTDB-DescribeDatabase while VarDis is inactive",
    expect="VARDIS-STATUS-INACTIVE and no variables",
    needs=_needs("RTDB-Create", "RTDB-DescribeDatabase"),
)
def describe_database(bench: Bench) -> None:
    produced(bench)
    result = _inactive(bench, "RTDB-DescribeDatabase", "VD-DDB-01")
    bench.none(
        result.get("variables"), "no variables", "VD-DDB-01", seen=f"{len(result.get('variables', []))} variables"
    )


@case(
    "TC_VD_MGT_BO_08",
    "Inactive VarDis rejects RTDB-DescribeVariable",
    requirements="VD-MGT-04 VD-DVA-01",
    stimulus="RTDB-DescribeVariable while VarDis is inactive, for an existing variable and for an unknown one",
    expect="VARDIS-STATUS-INACTIVE and no entry both times",
    needs=_needs("RTDB-Create", "RTDB-DescribeVariable"),
)
def describe_variable(bench: Bench) -> None:
    for var_id in (produced(bench), bench.unknown_id()):
        result = _inactive(bench, "RTDB-DescribeVariable", "VD-DVA-01", varId=var_id)
        bench.proved("variable" not in result, "no entry", result.get("variable"), "VD-DVA-01")
