"""dcp-vardis.md: Application Service Interface: RTDB-Read, the describe services, several applications."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

from dcp_spec.constants import BP_PROTID_VARDIS, ICType, SpecVersion

from dcp_conformance.definitions.case import REPLACES, Needs, case
from dcp_conformance.errors import NoAnswerError
from dcp_conformance.suite.srp.init import bring_back, no_way_back
from dcp_conformance.test_steps.services import (
    INACTIVE,
    NO_RESPONSE,
    OK,
    UNKNOWN,
    create_request,
    deleted_by_peer,
    described,
    expect_any,
    listed,
    max_repetitions,
    produced,
    statuses_after_deletion,
    teach_variable,
)
from dcp_conformance.test_steps.time_stamps import check_later
from dcp_conformance.test_system.bench import MS, Bench


@case(
    "TC_VD_REA_BV_01",
    "RTDB-Read returns value and time of the last change of a node's own variable",
    requirements="VD-REA-04",
    stimulus="RTDB-Create, RTDB-Read; three beacon periods later RTDB-Update, RTDB-Read",
    expect="VARDIS-STATUS-OK with the values; tStamp is the current time, and three periods later after the update",
    window=6,
    needs=Needs(ut=("RTDB-Create", "RTDB-Update", "RTDB-Read")),
)
def own(bench: Bench) -> None:
    begun = bench.lower.wall()
    var_id = produced(bench, value=b"first")
    first = _read(bench, var_id, bench.records.value(b"first"))
    slack, stamp = bench.sut.pixit.clock_tolerance_ms * MS, first.get("tStamp")
    near = isinstance(stamp, int) and begun - slack <= stamp <= bench.lower.wall() + slack
    bench.proved(near, f"tStamp within {slack / 1e6:.0f} ms of the tester's clock", stamp)

    def update(value: bytes) -> None:
        bench.must("RTDB-Update", varId=var_id, value=value.hex())

    _check_renewed(bench, var_id, update)


def _read(bench: Bench, var_id: int, value: bytes) -> dict[str, Any]:
    answer = bench.expect_status(OK, "RTDB-Read", varId=var_id)
    bench.answered(answer.result.get("value"), value.hex(), "value")
    return answer.result


def _check_renewed(bench: Bench, var_id: int, update: Callable[[bytes], None]) -> None:
    """Check that an update renews value and time stamp of a variable whose value is ``first``."""
    values = itertools.cycle((bench.records.value(b"second"), bench.records.value(b"first")))
    held = bench.records.value(b"first")

    def measure() -> int:
        nonlocal held
        before = _read(bench, var_id, held).get("tStamp") or 0
        bench.wait(3)
        held = next(values)
        update(held)
        return int((_read(bench, var_id, held).get("tStamp") or 0) - before)

    check_later(bench, "the time of the change in tStamp", 2 * bench.period, measure)


@case(
    "TC_VD_REA_BV_02",
    "RTDB-Read returns the newest value of another node's variable, and the local time of its reception",
    requirements="VD-REA-04",
    stimulus="a peer creates a variable, RTDB-Read; three beacon periods later the peer updates it, RTDB-Read",
    expect="VARDIS-STATUS-OK with the values; tStamp three periods later",
    window=12,
    needs=Needs(ut=("RTDB-Read",)),
)
def foreign(bench: Bench) -> None:
    peer = bench.peer()
    var_id = teach_variable(bench, peer, value=b"first")
    numbers = itertools.count(1)

    def update(value: bytes) -> None:
        peer.send(peer.update(var_id, next(numbers), value))
        if bench.until_instruction(ICType.UPDATES, var_id) is None:
            bench.inconclusive("a VarUpdate of the variable", "the implementation does not forward it")

    _check_renewed(bench, var_id, update)


@case(
    "TC_VD_REA_BV_03",
    "RTDB-Read returns the local time of the reception, not the creationTime ({variant})",
    requirements="VD-REA-04 VD-PC-07",
    stimulus="RTDB-Create; a peer creates a variable with a creationTime {variant}; RTDB-Read of both",
    expect="two times tStamp that differ by less than half an hour",
    needs=Needs(since=SpecVersion.V2_0, ut=("RTDB-Create", "RTDB-Read")),
    variants={"an-hour-ago": -1, "in-an-hour": 1},
)
def time_of_reception(bench: Bench, hours: int) -> None:
    stamp = bench.records.current_time(hours)
    own = produced(bench, value=b"own")
    # The identifier may have a later creationTime than others for an hour: no other case must use it.
    peer, var_id = bench.peer(), bench.unknown_id()
    bench.learn(peer, peer.create(var_id, value=b"first", creation_time=stamp))
    here = _read(bench, own, bench.records.value(b"own")).get("tStamp")
    there = _read(bench, var_id, bench.records.value(b"first")).get("tStamp")
    if not isinstance(here, int) or not isinstance(there, int):
        bench.inconclusive("tStamp in both answers, which this case needs", f"{here}, {there}")
    apart = abs(there - here) / 1e9
    bench.proved(apart < 1800, "a tStamp near that of a variable created now", f"{apart:.0f} s apart")


@case(
    "TC_VD_REA_BI_01",
    "RTDB-Read rejects a variable that does not exist",
    requirements="VD-REA-02",
    stimulus="RTDB-Read for an identifier that is not in use",
    expect="VARIABLE-DOES-NOT-EXIST and no value",
    needs=Needs(ut=("RTDB-Read",)),
)
def unknown(bench: Bench) -> None:
    answer = bench.expect_status(UNKNOWN, "RTDB-Read", varId=bench.unknown_id())
    bench.proved("value" not in answer.result, "no value", answer.result.get("value"))


@case(
    "TC_VD_REA_BO_01",
    "RTDB-Read rejects a deleted variable",
    requirements="VD-REA-03 VD-REA-06",
    stimulus="one of the node's own variables is deleted, and one of a peer by the peer; RTDB-Read for both",
    expect="VARIABLE-IS-DELETED and no value (up to 1.3 VARIABLE-BEING-DELETED)",
    window=12,
    needs=Needs(ut=("RTDB-Create", "RTDB-Delete", "RTDB-Read")),
)
def deleted(bench: Bench) -> None:
    mine = produced(bench, rep_cnt=max_repetitions(bench))
    bench.must("RTDB-Delete", varId=mine)
    answers = [expect_any(bench, statuses_after_deletion(bench), "RTDB-Read", varId=mine)]
    theirs = deleted_by_peer(bench, max_repetitions(bench))
    answers.append(expect_any(bench, statuses_after_deletion(bench), "RTDB-Read", varId=theirs))
    bench.proved(
        not any("value" in answer.result for answer in answers), "no value in the rejections", "a value in at least one"
    )


# -- describing --------------------------------------------------------------------------------------------------------


@case(
    "TC_VD_DDB_BV_01",
    "RTDB-DescribeDatabase lists the specifications of the node's own and other nodes' variables",
    requirements="VD-DDB-02",
    stimulus="RTDB-Create of two variables; a peer creates a third; RTDB-DescribeDatabase",
    expect="VARDIS-STATUS-OK and the three variables, each with identifier, producer, repCnt and description",
    needs=Needs(ut=("RTDB-Create", "RTDB-DescribeDatabase")),
)
def database(bench: Bench) -> None:
    peer = bench.peer()
    first = produced(bench, descr="the first")
    second = produced(bench, descr="the second")
    third = teach_variable(bench, peer, descr=b"the third")
    bench.expect_status(OK, "RTDB-DescribeDatabase")
    table = listed(bench)
    own = bench.identifiers.sut_id
    for var_id, producer, descr in (
        (first, own, "the first"),
        (second, own, "the second"),
        (third, peer.node_id, "the third"),
    ):
        found = table.get(var_id)
        if found is None:
            bench.proved(False, f"variable {var_id} in the list", "not in the list")
            continue
        bench.answered(
            (str(found.get("prodId")).replace(":", ""), found.get("repCnt"), found.get("descr")),
            (producer.hex(), 1, bench.records.descr(descr.encode()).decode()),
            "prodId, repCnt and descr, as created",
        )


@case(
    "TC_VD_DDB_BV_02",
    "Reports additional fields in RTDB-DescribeDatabase",
    requirements="VD-DDB-03",
    stimulus="RTDB-Create; RTDB-DescribeDatabase",
    expect="any result: it is reported; claims of the PICS must be true",
    needs=Needs(ut=("RTDB-Create", "RTDB-DescribeDatabase")),
)
def extra_fields(bench: Bench) -> None:
    var_id = produced(bench)
    found = listed(bench).get(var_id, {})
    spec = {"varId", "prodId", "repCnt", "descr", "descrHex", "creationTime", "timeout"}
    extra, claimed = sorted(set(found) - spec), bench.sut.pics.describe_extra_fields
    bench.info(
        "Which fields does RTDB-DescribeDatabase have in addition to those of VarSpecT?", ", ".join(extra) or "none"
    )
    if claimed is not None:
        bench.answered(bool(extra), claimed, "further fields, as [pics] describe_extra_fields claims")


@case(
    "TC_VD_DDB_BO_01",
    "RTDB-DescribeDatabase also lists deleted variables",
    requirements="VD-DDB-02",
    stimulus="RTDB-Create of two variables, RTDB-Delete of one with the maximum repCnt; RTDB-DescribeDatabase",
    expect="both variables in the list; up to 1.3 the deleted one until its last VarDelete",
    window=25,
    needs=Needs(ut=("RTDB-Create", "RTDB-Delete", "RTDB-DescribeDatabase")),
)
def database_with_deleted(bench: Bench) -> None:
    count = max_repetitions(bench)
    gone, kept = produced(bench, rep_cnt=count), produced(bench)
    bench.must("RTDB-Delete", varId=gone)
    table = listed(bench)
    bench.proved(kept in table, "the existing variable in the list", "not in the list")
    if not bench.features.removed_after_deletion or count > 2:
        bench.proved(gone in table, "the deleted variable in the list", "not in the list")
    bench.until_quiet(lambda heard: heard.instructions(ICType.DELETE_VARIABLES, gone))
    later = listed(bench)
    if bench.features.removed_after_deletion:
        bench.proved(
            gone not in later, "the deleted variable not in the list after its last VarDelete", "still in the list"
        )
    else:
        bench.proved(gone in later, "the deleted variable in the list after its last VarDelete", "not in the list")
    bench.proved(kept in later, "the existing variable still in the list", "not in the list")


@case(
    "TC_VD_DVA_BI_01",
    "RTDB-DescribeVariable rejects a variable that does not exist",
    requirements="VD-DVA-02",
    stimulus="RTDB-DescribeVariable for an identifier that is not in use",
    expect="VARIABLE-DOES-NOT-EXIST and no entry",
    needs=Needs(ut=("RTDB-DescribeVariable",)),
)
def describe_unknown(bench: Bench) -> None:
    answer = bench.expect_status(UNKNOWN, "RTDB-DescribeVariable", varId=bench.unknown_id())
    bench.proved("variable" not in answer.result, "no entry", answer.result.get("variable"))


@case(
    "TC_VD_DVA_BV_01",
    "RTDB-DescribeVariable returns the database entry of an existing variable, whichever node produces it",
    requirements="VD-DVA-03",
    stimulus="RTDB-Create, and a variable of a peer with seqno 7; RTDB-DescribeVariable for both",
    expect="VARDIS-STATUS-OK; identifier, producer, repCnt, description, value and seqno as created; isDeleted false",
    needs=Needs(ut=("RTDB-Create", "RTDB-DescribeVariable")),
)
def describe(bench: Bench) -> None:
    peer = bench.peer()
    mine = produced(bench, descr="mine", value=b"own")
    theirs = teach_variable(bench, peer, descr=b"theirs", value=b"foreign", seqno=7)
    for var_id, producer, descr, value, seqno in (
        (mine, bench.identifiers.sut_id, "mine", bench.records.value(b"own"), 0),
        (theirs, peer.node_id, "theirs", bench.records.value(b"foreign"), 7),
    ):
        found = described(bench.expect_status(OK, "RTDB-DescribeVariable", varId=var_id))
        wanted = {
            "varId": var_id,
            "repCnt": 1,
            "descr": bench.records.descr(descr.encode()).decode(),
            "value": value.hex(),
            "seqno": seqno,
        }
        bench.answered({name: found.get(name) for name in wanted}, wanted, "the fields of the variable")
        bench.answered(str(found.get("prodId")).replace(":", ""), producer.hex(), "prodId")
        bench.answered(found.get("isDeleted", False), False, "isDeleted")


@case(
    "TC_VD_DVA_BO_01",
    "RTDB-DescribeVariable returns the entry of a deleted variable",
    requirements="VD-DVA-03",
    stimulus="RTDB-Create with the maximum repCnt and RTDB-Delete; immediately RTDB-DescribeVariable",
    expect=(
        "VARDIS-STATUS-OK and the entry, marked as deleted (X33); up to 1.3 it may be removed after its last VarDelete"
    ),
    needs=Needs(ut=("RTDB-Create", "RTDB-Delete", "RTDB-DescribeVariable")),
)
def describe_deleted(bench: Bench) -> None:
    count = max_repetitions(bench)
    var_id = produced(bench, rep_cnt=count)
    bench.must("RTDB-Delete", varId=var_id)
    gone = (UNKNOWN,) if bench.features.removed_after_deletion and count <= 2 else ()
    answer = expect_any(bench, (OK, *gone), "RTDB-DescribeVariable", varId=var_id)
    if answer.ok:
        bench.answered(described(answer).get("isDeleted", True), True, "isDeleted")


# -- applications ------------------------------------------------------------------------------------------------------


def _single_client(bench: Bench) -> str | None:
    upper = bench.session.upper
    second = upper.another() if upper is not None else None
    if second is None:
        return "the upper tester has no second connection"
    second.close()
    return None


@case(
    "TC_VD_SRV_BV_01",
    "Two simultaneous applications get the confirms of their own requests",
    requirements="VD-SRV-02",
    stimulus="two clients in turn create, update and read a variable each, and request one that does not exist",
    expect="each client gets the confirms of its own requests; both see the same database",
    needs=Needs(ut=("RTDB-Create", "RTDB-Update", "RTDB-Read"), when=_single_client),
)
def two_clients(bench: Bench) -> None:
    second = bench.needed(bench.services.upper.another(), "a second connection", "none available")
    try:
        clients = (bench.services.upper, second)
        mine = bench.identifiers.own_var_id(), bench.identifiers.own_var_id()
        missing = bench.unknown_id()
        for client, var_id in zip(clients, mine, strict=True):
            answer = bench.services.call_on(
                client, "RTDB-Create", **create_request(bench, var_id, value=b"%d" % var_id)
            )
            bench.services.check_status(answer, (OK,), "RTDB-Create")
        for number in range(3):
            for client, var_id in zip(clients, mine, strict=True):
                value = bench.records.value(b"%d/%d" % (var_id, number))
                answer = bench.services.call_on(client, "RTDB-Update", varId=var_id, value=value.hex())
                bench.services.check_status(answer, (OK,), "RTDB-Update")
                other = clients[1] if client is clients[0] else clients[0]
                answer = bench.services.call_on(other, "RTDB-Read", varId=missing)
                bench.services.check_status(answer, (UNKNOWN,), "RTDB-Read")
                for reader in clients:
                    answer = bench.services.call_on(reader, "RTDB-Read", varId=var_id)
                    bench.proved(
                        answer.ok and answer.result.get("value") == value.hex(),
                        f"{OK} with {value!r} in the answer to RTDB-Read",
                        f"{answer}, {answer.result.get('value')}",
                    )
    finally:
        second.close()


@case(
    "TC_VD_SRV_BO_01",
    "VarDis rejects requests while it is not registered with BP",
    requirements="VD-SRV-01",
    alone=REPLACES,
    stimulus="a variable is created; BP-DeregisterProtocol for protocol 2; then the six VarDis services",
    expect="VARDIS-STATUS-INACTIVE each time, or no response (X30, from 1.2 on), within two beacon periods",
    window=8,
    needs=Needs(
        ut=(
            "RTDB-Create",
            "RTDB-Update",
            "RTDB-Delete",
            "RTDB-Read",
            "RTDB-DescribeDatabase",
            "RTDB-DescribeVariable",
            "BP-DeregisterProtocol",
        ),
        when=no_way_back,
    ),
    destructive=True,
)
def not_registered(bench: Bench) -> None:
    var_id, unused = produced(bench), bench.identifiers.own_var_id()
    bench.must("BP-DeregisterProtocol", protId=int(BP_PROTID_VARDIS))
    try:
        # VarDis may notice the deregistration only when it next queries its buffer in BP.
        bench.wait(2)
        for method, params in (
            ("RTDB-Read", {"varId": var_id}),
            ("RTDB-DescribeVariable", {"varId": var_id}),
            ("RTDB-DescribeDatabase", {}),
            ("RTDB-Update", {"varId": var_id, "value": "00"}),
            ("RTDB-Delete", {"varId": var_id}),
            ("RTDB-Create", create_request(bench, unused)),
        ):
            if not _answers(bench, method, params):
                # Each further request would cost another time limit.
                break
    finally:
        bring_back(bench)


def _answers(bench: Bench, method: str, params: dict[str, Any]) -> bool:
    """Check that a service is not executed; return whether there was an answer."""
    # Up to 1.1 the request must be rejected.
    may_be_silent = bench.profile.spec_version >= SpecVersion.V1_2
    try:
        answer = bench.call(method, **params)
    except NoAnswerError as error:
        bench.reading("X30", "no-response")
        bench.some(may_be_silent, f"{INACTIVE} in the answer to {method}", seen=error)
        return False
    if answer.code == NO_RESPONSE:
        bench.reading("X30", "no-response")
        bench.some(may_be_silent, f"{INACTIVE} in the answer to {method}")
    else:
        inactive = bench.services.check_status(answer, (INACTIVE,), method)
        if inactive:
            bench.reading("X30", "answer-inactive")
    return True


@case(
    "TC_DCP_DATA_BI_01",
    "VarDis services confirm rejected requests with a status",
    requirements="DATA-10",
    stimulus="RTDB-Update, -Delete, -Read, -DescribeVariable, as far as available, for a variable that does not exist",
    expect="one confirm for each request, with a status other than VARDIS-STATUS-OK",
    needs=Needs(ut=("RTDB-Read",)),
)
def refusals_confirmed(bench: Bench) -> None:
    var_id = bench.unknown_id()
    requests: dict[str, dict[str, Any]] = {
        "RTDB-Update": {"varId": var_id, "value": "01"},
        "RTDB-Delete": {"varId": var_id},
        "RTDB-Read": {"varId": var_id},
        "RTDB-DescribeVariable": {"varId": var_id},
    }
    for method, params in requests.items():
        if method in bench.services.upper.methods:
            answer = bench.call(method, **params)
            bench.services.require_asked(answer, f"a confirm of {method} with a rejection")
            confirmed = answer.code is None and bool(answer.status)
            bench.proved(confirmed and not answer.ok, f"a confirm of {method} with a rejection", answer)
