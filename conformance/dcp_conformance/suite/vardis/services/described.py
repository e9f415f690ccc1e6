"""dcp-vardis.md: Services `RTDB-DescribeDatabase` and `RTDB-DescribeVariable`, field by field."""

from __future__ import annotations

from typing import Any

from dcp_spec.constants import ICType, SpecVersion

from dcp_codec.values import VarCreate, VarSpec
from dcp_conformance.definitions.case import Needs, case
from dcp_conformance.test_steps.services import create_request, described, listed, settled
from dcp_conformance.test_system.bench import Bench

_OWN, _FOREIGN = "own", "received"


def _made(bench: Bench, kind: str) -> VarCreate:
    """Create a variable with an unusual value in every field; return its VarCreate as the implementation sends it."""
    count, timeout = bench.sut.rep_cnt(2), min(60_000, bench.sut.longest_timeout) if bench.features.creation_time else 0
    if kind == _FOREIGN:
        peer = bench.peer()
        record = peer.create(bench.var_id(), value=b"\x01\x02", seqno=7, rep_cnt=count, descr=b"field", timeout=timeout)
        bench.learn(peer, record)
        return record
    var_id = bench.identifiers.own_var_id()
    request = create_request(bench, var_id, rep_cnt=count, descr="field", value=b"\x01\x02", timeout=timeout)
    since = bench.mark()
    bench.must("RTDB-Create", **request)
    found = bench.until_instruction(ICType.CREATE_VARIABLES, var_id)
    if not isinstance(found, VarCreate):
        bench.inconclusive("a VarCreate of the node's own variable, which this case needs", "none in time")
    settled(bench, var_id, since)
    return found


def _expected(spec: VarSpec) -> dict[str, Any]:
    """Return the members of a VarSpecT as the upper tester returns them."""
    fields: dict[str, Any] = {
        "varId": spec.var_id,
        "prodId": spec.prod_id.hex(":"),
        "repCnt": spec.rep_cnt,
        "descr": spec.descr.removesuffix(b"\0").decode(),
    }
    if spec.creation_time is not None:
        fields |= {"creationTime": spec.creation_time, "timeout": spec.timeout}
    return fields


def _compare(bench: Bench, found: dict[str, Any], expected: dict[str, Any], *requirements: str) -> None:
    for name, value in expected.items():
        observed = found.get(name)
        if name == "prodId":
            observed, value = str(observed).replace(":", "").lower(), str(value).replace(":", "")
        bench.answered(observed, value, name, *requirements, field="creationTime" if name == "creationTime" else None)


@case(
    "TC_VD_DDB_BV_03",
    "RTDB-DescribeDatabase returns every field of the specification of a variable ({variant})",
    requirements="VD-DDB-02",
    stimulus="a variable with an unusual value in every field ({variant}); RTDB-DescribeDatabase",
    expect="varId, prodId, repCnt and descr, and from 2.0 on creationTime and timeout, as in its VarCreate",
    needs=Needs(ut=("RTDB-DescribeDatabase", "RTDB-Create")),
    variants={_OWN: _OWN, _FOREIGN: _FOREIGN},
)
def rows(bench: Bench, kind: str) -> None:
    record = _made(bench, kind)
    row = bench.present(listed(bench).get(record.spec.var_id), "the variable in the list")
    _compare(bench, row, _expected(record.spec))


@case(
    "TC_VD_DVA_BV_02",
    "RTDB-DescribeVariable returns every field of the entry of a variable ({variant})",
    requirements="VD-DVA-03",
    stimulus=(
        "a variable with an unusual value in every field ({variant}); after its repetitions RTDB-DescribeVariable "
        "and RTDB-Read"
    ),
    expect="the fields as in its VarCreate, counters 0, isDeleted false, and the same tStamp as RTDB-Read",
    needs=Needs(ut=("RTDB-DescribeVariable", "RTDB-Create", "RTDB-Read")),
    variants={_OWN: _OWN, _FOREIGN: _FOREIGN},
)
def entry(bench: Bench, kind: str) -> None:
    record = _made(bench, kind)
    found = described(bench.must("RTDB-DescribeVariable", varId=record.spec.var_id))
    counters = dict.fromkeys(("countCreate", "countUpdate", "countDelete"), 0)
    rest = {"value": record.upd.value.hex(), "seqno": record.upd.seqno, "isDeleted": False, **counters}
    _compare(bench, found, _expected(record.spec) | rest)
    read = bench.must("RTDB-Read", varId=record.spec.var_id).result.get("tStamp")
    bench.answered(found.get("tStamp"), read, "tStamp, as in RTDB-Read")


@case(
    "TC_VD_SRV_BV_02",
    ("Confirms of RTDB-Update, RTDB-Delete and RTDB-Read have the required fields, and follow the change they confirm"),
    requirements="VD-SRV-03",
    stimulus=(
        "RTDB-Create; RTDB-Update and immediately RTDB-Read; RTDB-Delete and immediately RTDB-Read; RTDB-Read for "
        "an unknown variable"
    ),
    expect="the updated value, then a rejection; value and tStamp only together with VARDIS-STATUS-OK",
    needs=Needs(since=SpecVersion.V1_0, ut=("RTDB-Create", "RTDB-Update", "RTDB-Delete", "RTDB-Read")),
)
def confirms(bench: Bench) -> None:
    var_id = bench.identifiers.own_var_id()
    bench.must("RTDB-Create", **create_request(bench, var_id))
    settled(bench, var_id)
    value = bench.records.value(b"\x01\x02").hex()
    answers = [bench.must("RTDB-Update", varId=var_id, value=value)]
    read = bench.must("RTDB-Read", varId=var_id)
    bench.answered(read.result.get("value"), value, "the value of the preceding RTDB-Update in RTDB-Read")
    answers += [bench.must("RTDB-Delete", varId=var_id), bench.call("RTDB-Read", varId=var_id)]
    bench.proved(not answers[-1].ok, "a rejection of RTDB-Read after RTDB-Delete", f"{answers[-1]}")
    answers.append(bench.call("RTDB-Read", varId=bench.unknown_id()))
    for answer in answers:
        extra = sorted(set(answer.result) & {"value", "tStamp"})
        what = f"for {answer} a status, and neither value nor tStamp"
        bench.proved(not any(answer.result.get(each) is not None for each in extra), what, f"{extra}")
