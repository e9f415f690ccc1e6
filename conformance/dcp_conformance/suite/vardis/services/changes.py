"""dcp-vardis.md: Configurable Parameters, changed while variables exist and records of them are pending."""

from __future__ import annotations

from typing import Any

from dcp_spec.constants import ICType, SpecVersion

from dcp_conformance.definitions.case import Needs, case
from dcp_conformance.suite.vardis.composition.summaries import SUMMARIES, summarises
from dcp_conformance.test_steps.full_payloads import PAYLOAD_SIZE
from dcp_conformance.test_steps.services import (
    DESCRIPTION_TOO_LONG,
    ILLEGAL_REPCOUNT,
    OK,
    VALUE_TOO_LONG,
    create_request,
    least_left,
    parameters_set,
    several_repetitions,
)
from dcp_conformance.test_steps.variable_queries import stepped, teach_variables
from dcp_conformance.test_system.bench import Bench

_CREATE, _UPDATE, _SUMMARY = ICType.CREATE_VARIABLES, ICType.UPDATES, ICType.SUMMARIES
_SET = ("RTDB-Create", "RTDB-Update", "UT-Reset", "VD-SetParameter")
_LONG, _SHORT, _COUNT = 12, 6, 3


_LOWERED = {
    "VARDISPAR_MAX_VALUE_LENGTH": _SHORT,
    "VARDISPAR_MAX_DESCRIPTION_LENGTH": _SHORT,
    "VARDISPAR_MAX_REPETITIONS": 1,
}
#: Requests that exceed one of the lowered limits, their statuses and requirements.
_EXCEEDING: tuple[tuple[dict[str, Any], str, str], ...] = (
    ({"value": b"v" * _LONG}, VALUE_TOO_LONG, "VD-CRE-05"),
    ({"descr": "d" * _LONG}, DESCRIPTION_TOO_LONG, "VD-CRE-04"),
    ({"rep_cnt": _COUNT}, ILLEGAL_REPCOUNT, "VD-CRE-07"),
)


@case(
    "TC_VD_CHG_BV_01",
    "Lowered limits do not affect existing variables: they are repeated, answered and updated",
    requirements="VD-PAR-01 VD-RC-03 VD-RU-04 VD-PS-03 VD-CMP-09",
    stimulus=(
        "a received variable and an own one, with values and descriptions of 12 octets and repCnt 3, are updated; "
        "while "
        "their VarUpdates are pending, the maximum lengths are lowered to 6 and the most repetitions to 1; then "
        "requests for them, older summaries, and further updates with short values"
    ),
    expect=(
        "each VarUpdate in three beacons; the answers in three beacons each; the updates are accepted; new variables "
        "that exceed one of the limits are rejected"
    ),
    window=40,
    needs=Needs(SpecVersion.V1_1, ut=_SET, when=several_repetitions),
)
def lowered(bench: Bench) -> None:
    count = bench.sut.rep_cnt(_COUNT)
    lengths = (bench.sut.parameter("VARDISPAR_MAX_VALUE_LENGTH"), bench.sut.longest_description)
    if min(lengths) < _LONG:
        bench.verdicts.not_applicable(f"values and descriptions have at most {lengths[0]} and {lengths[1]} octets")
    peer, name, own = bench.peer(), bench.var_id(), bench.identifiers.own_var_id()
    start = bench.mark()
    request = create_request(bench, own, rep_cnt=count, value=b"own value 12", descr="a dozen here")
    bench.must("RTDB-Create", **request)
    bench.learn(peer, peer.create(name, value=b"a value of 12", descr=b"a dozen here", rep_cnt=count))
    bench.check_repeated(_CREATE, own, count, start, "VD-CRE-12")
    start = peer.stimulate(peer.update(name, 1, b"another one"))
    # A node that has not processed the update before the limits are lowered ignores it.
    bench.until_instruction(_UPDATE, name)
    bench.must("RTDB-Update", varId=own, value=bench.records.value(b"next of 12 o").hex())
    with parameters_set(bench, "VD", **_LOWERED):
        for each in (name, own):
            bench.check_repeated(_UPDATE, each, count, start, "VD-PAR-01", "VD-CMP-09")
        # The sequence numbers of both are 1.
        for records, kind, requirement in (
            ([peer.request_create(each) for each in (name, own)], _CREATE, "VD-RC-03"),
            ([peer.request_update(each, 0) for each in (name, own)], _UPDATE, "VD-RU-04"),
            ([peer.summary(name, 0)], _UPDATE, "VD-PS-03"),
        ):
            start = peer.stimulate(*records)
            for record in records:
                bench.check_repeated(kind, record.var_id, count, start, "VD-PAR-01", requirement)
        start = peer.stimulate(peer.update(name, 2, b"few"))
        bench.expect_status(OK, "RTDB-Update", "VD-PAR-01", "VD-UPD-05", varId=own, value=b"few".hex())
        for each in (name, own):
            bench.check_repeated(_UPDATE, each, count, start, "VD-PAR-01", "VD-PU-07", "VD-UPD-08")
        for exceeding, status, requirement in _EXCEEDING:
            # The other fields have the least values.
            given: dict[str, Any] = {"rep_cnt": 1, "value": b"v", "descr": "d"} | exceeding
            new = create_request(bench, bench.identifiers.own_var_id(), exact=True, **given)
            bench.expect_status(status, "RTDB-Create", requirement, "VD-PAR-01", **new)


@case(
    "TC_VD_CHG_BV_02",
    "After VARDISPAR_MAX_SUMMARIES was 0 all variables are summarised again",
    requirements="VD-PAR-01 VD-CMP-03",
    stimulus="six variables; VARDISPAR_MAX_SUMMARIES = 0 for four periods; then the former value",
    expect="summaries of all six",
    window=20,
    needs=Needs(ut=("UT-Reset", "VD-SetParameter"), when=summarises),
)
def summaries_again(bench: Bench) -> None:
    peer, names = bench.peer(), bench.identifiers.var_ids(6)
    teach_variables(bench, peer, [peer.create(each, value=b"v", descr=b"d") for each in names])
    with parameters_set(bench, "VD", **{SUMMARIES: 0}):
        bench.wait(4)
    start = bench.mark()

    def left() -> list[int]:
        found = {each.var_id for each in bench.instructions(_SUMMARY, since=start)}
        return [each for each in names if each not in found]

    bench.until(lambda _: not left(), 16)
    bench.complete(left(), "summaries of all variables")


@case(
    "TC_VD_CHG_BV_03",
    "Records that do not fit into a lowered VARDISPAR_MAX_PAYLOAD_SIZE are sent when it is raised again",
    requirements="VD-CMP-13 VD-PAR-01 VD-CMP-06 VD-CMP-09",
    stimulus=(
        "a request for one known variable and one for an update of another, with up to eight repetitions; at once "
        "VARDISPAR_MAX_PAYLOAD_SIZE is lowered below their records; three periods later the former value"
    ),
    expect="payloads of at most the lowered size soon afterwards; in total each record in repCnt beacons",
    window=40,
    needs=Needs(ut=("UT-Reset", "VD-SetParameter"), when=several_repetitions),
    long=True,
)
def raised_again(bench: Bench) -> None:
    peer, count = bench.peer(), bench.sut.rep_cnt(8)
    value, descr = bench.records.value(b"v" * 24), bench.records.descr(b"description")
    asked, behind = (
        peer.create(each, value=value, descr=descr, seqno=5, rep_cnt=count) for each in bench.identifiers.var_ids(2)
    )
    bench.learn(peer, asked, behind)
    limit = bench.builder.container_header_size + bench.builder.record_size(behind.upd) - 1
    # The limits of other parameters depend on the size of a payload.
    with parameters_set(bench, "VD", **{SUMMARIES: 0, "VARDISPAR_MAX_DESCRIPTION_LENGTH": 2}):
        start = peer.stimulate(peer.request_create(asked.spec.var_id), peer.request_update(behind.spec.var_id, 4))
        with parameters_set(bench, "VD", **{PAYLOAD_SIZE: limit}):
            if not least_left(bench, count, start):
                bench.inconclusive("repetitions that are left when the size is lowered", "none may be left")
            bench.beacons(bench.sut.ahead, bench.sut.ahead + 1)
            middle = bench.mark()
            bench.wait(3)
            late = bench.instructions(_CREATE, asked.spec.var_id, middle)
            late += bench.instructions(_UPDATE, behind.spec.var_id, middle)
            bench.none(late, f"no record longer than {limit} octets", "VD-IC-05", "VD-PAR-01")
        for kind, record in ((_CREATE, asked), (_UPDATE, behind)):
            found = bench.check_repeated(kind, record.spec.var_id, count, start)
            right = record if kind is _CREATE else record.upd
            bench.every(found, lambda each, right=right: each.record == right, "the record as stored", "VD-TYP-06")


@case(
    "TC_VD_CHG_BO_01",
    "VarDis serves its applications while BP is inactive, and sends the newest afterwards",
    requirements="VD-SRV-01 VD-UPD-10 VD-CMP-06",
    stimulus=(
        "while BP is inactive: RTDB-Create of two variables, RTDB-Update, RTDB-Read, RTDB-Delete of one of them; six "
        "periods later BP-MGMT-Activate"
    ),
    expect=(
        "VARDIS-STATUS-OK each time; the VarCreate and the VarDelete in one beacon each, with the newest value last"
    ),
    window=30,
    needs=Needs(
        SpecVersion.V1_2,
        ut=("RTDB-Create", "RTDB-Update", "RTDB-Read", "RTDB-Delete", "BP-MGMT-Activate", "BP-MGMT-Deactivate"),
    ),
)
def while_bp_is_inactive(bench: Bench) -> None:
    count, value = 1, bench.records.value(b"newest").hex()
    kept, gone = bench.identifiers.own_var_id(), bench.identifiers.own_var_id()
    with bench.services.deactivated("BP"):
        bench.wait(0.2)
        start = bench.mark()
        for each in (kept, gone):
            bench.expect_status(OK, "RTDB-Create", "VD-SRV-01", **create_request(bench, each, rep_cnt=count))
        bench.expect_status(OK, "RTDB-Update", "VD-SRV-01", varId=kept, value=value)
        answer = bench.expect_status(OK, "RTDB-Read", "VD-SRV-01", varId=kept)
        bench.answered(answer.result.get("value"), value, "value", "VD-SRV-01", "VD-REA-04")
        bench.expect_status(OK, "RTDB-Delete", "VD-SRV-01", varId=gone)
        bench.wait(6)
        bench.none(bench.heard[start:], "no beacon while BP is inactive", "BP-MGT-02")
    bench.check_repeated(_CREATE, kept, count, start, "VD-CMP-06")
    bench.check_repeated(ICType.DELETE_VARIABLES, gone, count, start, "VD-CMP-10", "VD-DEL-05")
    newest = bench.waiting.repeated(_UPDATE, kept, start) + bench.instructions(_CREATE, kept, start)
    numbers = [(each.record.upd if each.kind is _CREATE else each.record).seqno for each in newest]
    bench.some(stepped(bench, 0, 1) in numbers, "a record with the newest value", "VD-UPD-10", seen=f"{numbers}")
