"""dcp-vardis.md: Application Service Interface: reading, describing, several applications."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

from dcp_spec.constants import BP_PROTID_VARDIS, ICType, SpecVersion

from dcp_conformance.bench import MS, Bench
from dcp_conformance.case import Needs, case
from dcp_conformance.cases.srp_init import bring_back, no_way_back
from dcp_conformance.errors import NoAnswerError
from dcp_conformance.services import (
    INACTIVE,
    NO_RESPONSE,
    OK,
    UNKNOWN,
    create_request,
    described,
    expect_any,
    listed,
    max_repetitions,
    produced,
    statuses_after_deletion,
    taught,
    untaught,
)
from dcp_conformance.stamps import check_later


@case(
    "TC_VD_REA_BV_01",
    "A variable of the own node is read with its value and the time of its last change",
    requirements="VD-REA-04",
    stimulus="RTDB-Create, RTDB-Read; three beacon periods later RTDB-Update, RTDB-Read",
    expect="OK with the values; tStamp is now, and three periods later after the update",
    window=6,
    needs=Needs(ut=("RTDB-Create", "RTDB-Update", "RTDB-Read")),
    smoke=True,
)
def own(bench: Bench) -> None:
    begun = bench.lower.wall()
    var_id = produced(bench, value=b"first")
    first = _read(bench, var_id, bench.value(b"first"))
    slack, stamp = bench.pixit.clock_tolerance_ms * MS, first.get("tStamp")
    near = isinstance(stamp, int) and begun - slack <= stamp <= bench.lower.wall() + slack
    bench.check(near, f"tStamp is within {slack / 1e6:.0f} ms of the tester's clock", f"it is {stamp}", shown=True)

    def update(value: bytes) -> None:
        bench.must("RTDB-Update", varId=var_id, value=value.hex())

    _check_renewed(bench, var_id, update)


def _read(bench: Bench, var_id: int, value: bytes) -> dict[str, Any]:
    answer = bench.expect_status(OK, "RTDB-Read", varId=var_id)
    shown = answer.result.get("value")
    bench.check(shown == value.hex(), f"the value is {value!r}", f"it is {shown}", shown=True)
    return answer.result


def _check_renewed(bench: Bench, var_id: int, update: Callable[[bytes], None]) -> None:
    """Check that an update renews value and time stamp of a variable that has the value ``first``."""
    values = itertools.cycle((bench.value(b"second"), bench.value(b"first")))
    held = bench.value(b"first")

    def measure() -> int:
        nonlocal held
        before = _read(bench, var_id, held).get("tStamp") or 0
        bench.wait(3)
        held = next(values)
        update(held)
        return int((_read(bench, var_id, held).get("tStamp") or 0) - before)

    check_later(bench, "tStamp is that of the change", 2 * bench.period, measure)


@case(
    "TC_VD_REA_BV_02",
    "A variable of another node is read with its newest value and the local time of its reception",
    requirements="VD-REA-04",
    stimulus="a peer's variable is learnt, RTDB-Read; three beacon periods later its update, RTDB-Read",
    expect="OK with the values, tStamp three periods later",
    window=12,
    needs=Needs(ut=("RTDB-Read",)),
)
def foreign(bench: Bench) -> None:
    peer = bench.peer()
    var_id = taught(bench, peer, value=b"first")
    numbers = itertools.count(1)

    def update(value: bytes) -> None:
        peer.send(peer.update(var_id, next(numbers), value))
        if bench.until_instruction(ICType.UPDATES, var_id) is None:
            bench.inconclusive("the update is learnt", "the implementation does not repeat it")

    _check_renewed(bench, var_id, update)


@case(
    "TC_VD_REA_BI_01",
    "A variable that does not exist cannot be read",
    requirements="VD-REA-02",
    stimulus="RTDB-Read of an identifier that is not in use",
    expect="VARIABLE-DOES-NOT-EXIST and no value",
    needs=Needs(ut=("RTDB-Read",)),
)
def unknown(bench: Bench) -> None:
    answer = bench.expect_status(UNKNOWN, "RTDB-Read", varId=bench.unknown_id())
    bench.check("value" not in answer.result, "no value", f"{answer.result.get('value')}", shown=True)


@case(
    "TC_VD_REA_BO_01",
    "A deleted variable cannot be read",
    requirements="VD-REA-03 VD-REA-06",
    stimulus="an own variable is deleted, and a peer's by the peer; RTDB-Read of both",
    expect="VARIABLE-IS-DELETED and no value (up to 1.3 VARIABLE-BEING-DELETED)",
    window=12,
    needs=Needs(ut=("RTDB-Create", "RTDB-Delete", "RTDB-Read")),
)
def deleted(bench: Bench) -> None:
    mine = produced(bench, rep_cnt=max_repetitions(bench))
    bench.must("RTDB-Delete", varId=mine)
    answers = [expect_any(bench, statuses_after_deletion(bench), "RTDB-Read", varId=mine)]
    peer = bench.peer()
    theirs = taught(bench, peer, rep_cnt=max_repetitions(bench))
    untaught(bench, peer, theirs)
    answers.append(expect_any(bench, statuses_after_deletion(bench), "RTDB-Read", varId=theirs))
    bench.check(
        not any("value" in answer.result for answer in answers), "no value comes with it", "one does", shown=True
    )


# -- describing --------------------------------------------------------------------------------------------------------


@case(
    "TC_VD_DDB_BV_01",
    "The description of the database lists the specifications of own and foreign variables",
    requirements="VD-DDB-02",
    stimulus="RTDB-Create of two variables, a third learnt from a peer; RTDB-DescribeDatabase",
    expect="OK and the three, each with identifier, producer, repCnt and description",
    needs=Needs(ut=("RTDB-Create", "RTDB-DescribeDatabase")),
)
def database(bench: Bench) -> None:
    peer = bench.peer()
    first = produced(bench, descr="the first")
    second = produced(bench, descr="the second")
    third = taught(bench, peer, descr=b"the third")
    bench.expect_status(OK, "RTDB-DescribeDatabase")
    table = listed(bench)
    own = bench.sut_id
    for var_id, producer, descr in (
        (first, own, "the first"),
        (second, own, "the second"),
        (third, peer.node_id, "the third"),
    ):
        found = table.get(var_id)
        if found is None:
            bench.check(False, f"variable {var_id} is listed", "it is not", shown=True)
            continue
        shown = (str(found.get("prodId")).replace(":", ""), found.get("repCnt"), found.get("descr"))
        bench.check(
            shown == (producer.hex(), 1, bench.descr(descr.encode()).decode()),
            f"prodId, repCnt, descr of {var_id}",
            f"{shown}",
            shown=True,
        )


@case(
    "TC_VD_DDB_BV_02",
    "Which further fields the description of the database has",
    requirements="VD-DDB-03",
    stimulus="RTDB-Create; RTDB-DescribeDatabase",
    expect="nothing: it is reported; a claim of the PICS must be true",
    needs=Needs(ut=("RTDB-Create", "RTDB-DescribeDatabase")),
)
def extra_fields(bench: Bench) -> None:
    var_id = produced(bench)
    found = listed(bench).get(var_id, {})
    spec = {"varId", "prodId", "repCnt", "descr", "descrHex", "creationTime", "timeout"}
    extra, claimed = sorted(set(found) - spec), bench.pics.describe_extra_fields
    bench.info("fields of RTDB-DescribeDatabase beside the VarSpec", ", ".join(extra) or "none")
    if claimed is not None:
        bench.check(
            bool(extra) == claimed, f"[pics] describe_extra_fields = {str(claimed).lower()}", f"{extra}", shown=True
        )


@case(
    "TC_VD_DDB_BO_01",
    "The description of the database lists a deleted variable, too",
    requirements="VD-DDB-02",
    stimulus="RTDB-Create of two variables, RTDB-Delete of one with the most repetitions; RTDB-DescribeDatabase",
    expect="both are listed; up to 1.3 the deleted one until its last VarDelete",
    window=25,
    needs=Needs(ut=("RTDB-Create", "RTDB-Delete", "RTDB-DescribeDatabase")),
)
def database_with_deleted(bench: Bench) -> None:
    count = max_repetitions(bench)
    gone, kept = produced(bench, rep_cnt=count), produced(bench)
    bench.must("RTDB-Delete", varId=gone)
    table = listed(bench)
    bench.check(kept in table, "the live variable is listed", "it is not", shown=True)
    if not bench.features.removed_after_deletion or count > 2:
        bench.check(gone in table, "the deleted variable is listed", "it is not", shown=True)
    bench.until_quiet(lambda heard: heard.instructions(ICType.DELETE_VARIABLES, gone))
    later = listed(bench)
    if bench.features.removed_after_deletion:
        bench.check(gone not in later, "after its last VarDelete it is not listed", "it still is", shown=True)
    else:
        bench.check(gone in later, "after its last VarDelete it is still listed", "it is not", shown=True)
    bench.check(kept in later, "the live variable is still listed", "it is not", shown=True)


@case(
    "TC_VD_DVA_BI_01",
    "A variable that does not exist cannot be described",
    requirements="VD-DVA-02",
    stimulus="RTDB-DescribeVariable of an identifier that is not in use",
    expect="VARIABLE-DOES-NOT-EXIST and no entry",
    needs=Needs(ut=("RTDB-DescribeVariable",)),
)
def describe_unknown(bench: Bench) -> None:
    answer = bench.expect_status(UNKNOWN, "RTDB-DescribeVariable", varId=bench.unknown_id())
    bench.check("variable" not in answer.result, "no entry", f"{answer.result.get('variable')}", shown=True)


@case(
    "TC_VD_DVA_BV_01",
    "A live variable is described with its database entry, whoever produces it",
    requirements="VD-DVA-03",
    stimulus="RTDB-Create, and a variable learnt from a peer with seqno 7; RTDB-DescribeVariable of both",
    expect="OK; identifier, producer, repCnt, description, value, seqno, not deleted",
    needs=Needs(ut=("RTDB-Create", "RTDB-DescribeVariable")),
)
def describe(bench: Bench) -> None:
    peer = bench.peer()
    mine = produced(bench, descr="mine", value=b"own")
    theirs = taught(bench, peer, descr=b"theirs", value=b"foreign", seqno=7)
    for var_id, producer, descr, value, seqno in (
        (mine, bench.sut_id, "mine", bench.value(b"own"), 0),
        (theirs, peer.node_id, "theirs", bench.value(b"foreign"), 7),
    ):
        answer = bench.expect_status(OK, "RTDB-DescribeVariable", varId=var_id)
        found = described(answer)
        wanted = {
            "varId": var_id,
            "repCnt": 1,
            "descr": bench.descr(descr.encode()).decode(),
            "value": value.hex(),
            "seqno": seqno,
        }
        shown = {name: found.get(name) for name in wanted}
        bench.check(shown == wanted, f"{wanted}", f"{shown}", shown=True)
        shown_producer = str(found.get("prodId")).replace(":", "")
        bench.check(shown_producer == producer.hex(), f"prodId {producer.hex()}", shown_producer, shown=True)
        bench.check(
            found.get("isDeleted", False) is False, "isDeleted is false", f"{found.get('isDeleted')}", shown=True
        )


@case(
    "TC_VD_DVA_BO_01",
    "A deleted variable is still described",
    requirements="VD-DVA-03",
    stimulus="RTDB-Create with the most repetitions and RTDB-Delete; RTDB-DescribeVariable at once",
    expect="OK and the entry, marked as deleted (X33); up to 1.3 it may be gone after its last VarDelete",
    needs=Needs(ut=("RTDB-Create", "RTDB-Delete", "RTDB-DescribeVariable")),
)
def describe_deleted(bench: Bench) -> None:
    count = max_repetitions(bench)
    var_id = produced(bench, rep_cnt=count)
    bench.must("RTDB-Delete", varId=var_id)
    gone = (UNKNOWN,) if bench.features.removed_after_deletion and count <= 2 else ()
    answer = expect_any(bench, (OK, *gone), "RTDB-DescribeVariable", varId=var_id)
    if answer.ok:
        flag = described(answer).get("isDeleted", True)
        bench.check(flag is True, "isDeleted is true", f"it is {flag}", shown=True)


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
    "Two applications at the same time get the confirms of their own requests",
    requirements="VD-SRV-02",
    stimulus="two clients take turns: each creates, updates and reads a variable, and asks for one that is not there",
    expect="each request is confirmed to its client with its own outcome; both see the same database",
    needs=Needs(ut=("RTDB-Create", "RTDB-Update", "RTDB-Read"), when=_single_client),
)
def two_clients(bench: Bench) -> None:
    second = bench.ut.another()
    if second is None:
        bench.inconclusive("a second connection", "there is none")
    try:
        clients = (bench.ut, second)
        mine = bench.own_var_id(), bench.own_var_id()
        missing = bench.unknown_id()
        for client, var_id in zip(clients, mine, strict=True):
            answer = bench.call_on(client, "RTDB-Create", **create_request(bench, var_id, value=b"%d" % var_id))
            bench.check_status(answer, (OK,), "RTDB-Create")
        for number in range(3):
            for client, var_id in zip(clients, mine, strict=True):
                value = bench.value(b"%d/%d" % (var_id, number))
                answer = bench.call_on(client, "RTDB-Update", varId=var_id, value=value.hex())
                bench.check_status(answer, (OK,), "RTDB-Update")
                other = clients[1] if client is clients[0] else clients[0]
                answer = bench.call_on(other, "RTDB-Read", varId=missing)
                bench.check_status(answer, (UNKNOWN,), "RTDB-Read")
                for reader in clients:
                    answer = bench.call_on(reader, "RTDB-Read", varId=var_id)
                    bench.check(
                        answer.ok and answer.result.get("value") == value.hex(),
                        f"RTDB-Read answers {OK} with {value!r}",
                        f"{answer}, {answer.result.get('value')}",
                        shown=True,
                    )
    finally:
        second.close()


@case(
    "TC_VD_SRV_BO_01",
    "VarDis does not serve while it is not registered with BP",
    requirements="VD-SRV-01",
    stimulus="a variable is created; BP-DeregisterProtocol of protocol 2; then the six services",
    expect="VARDIS-STATUS-INACTIVE each time, or no response (X30, since 1.2), within two beacon periods",
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
    var_id, unused = produced(bench), bench.own_var_id()
    bench.must("BP-DeregisterProtocol", protId=int(BP_PROTID_VARDIS))
    try:
        # It may only find out when it asks BP for its buffers the next time.
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
    """Check that the service is not carried out; whether there was any answer."""
    # Up to 1.1 the request has to be rejected.
    may_be_silent = bench.profile.spec_version >= SpecVersion.V1_2
    try:
        answer = bench.call(method, **params)
    except NoAnswerError as error:
        bench.reading("X30", "no-response")
        bench.check(may_be_silent, f"{method} answers {INACTIVE}", str(error))
        return False
    if answer.code == NO_RESPONSE:
        bench.reading("X30", "no-response")
        bench.check(may_be_silent, f"{method} answers {INACTIVE}", "it is not answered")
    else:
        inactive = bench.check_status(answer, (INACTIVE,), method)
        if inactive:
            bench.reading("X30", "answer-inactive")
    return True


@case(
    "TC_DCP_DATA_BI_01",
    "A service of VarDis that refuses confirms the request with a status, too",
    requirements="DATA-10",
    stimulus="RTDB-Update, -Delete, -Read and -DescribeVariable of a variable that does not exist, as far as there are",
    expect="one confirm for each, with a status other than OK",
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
        if method in bench.ut.methods:
            answer = bench.call(method, **params)
            bench.require_asked(answer, f"{method} is confirmed with a refusal")
            confirmed = answer.code is None and bool(answer.status)
            bench.check(confirmed and not answer.ok, f"{method} is confirmed with a refusal", str(answer), shown=True)
