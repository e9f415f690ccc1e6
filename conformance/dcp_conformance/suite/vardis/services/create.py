"""dcp-vardis.md: Service RTDB-Create."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from dcp_spec.constants import ICType, SpecVersion

from dcp_conformance.definitions.case import Needs, case
from dcp_conformance.test_steps.repetitions import check_one_in_each
from dcp_conformance.test_steps.services import (
    DESCRIPTION_TOO_LONG,
    EXISTS,
    ILLEGAL_REPCOUNT,
    NOT_EXPRESSIBLE,
    OK,
    UNKNOWN,
    VALUE_TOO_LONG,
    Moment,
    count_of,
    create_request,
    empty_status,
    entry_of,
    least_left,
    longest_description,
    max_repetitions,
    nanoseconds,
    produced,
    teach_variable,
    timed,
    too_long,
)
from dcp_conformance.test_steps.time_stamps import Stamps, check_apart, check_now
from dcp_conformance.test_system.bench import MS, Bench

_CREATE = Needs(ut=("RTDB-Create",))
_CREATE_READ = Needs(ut=("RTDB-Create", "RTDB-Read"))
_V = ICType.CREATE_VARIABLES


@case(
    "TC_VD_CRE_BV_01",
    "A new variable is announced with the parameters of the application, sequence number 0 and its producer",
    requirements="VD-CRE-10 VD-CRE-08 VD-CRE-12 VD-INI-05 VD-CRE-14",
    stimulus="RTDB-Create with all parameters",
    expect="VARDIS-STATUS-OK; a VarCreate with these parameters, seqno 0 and the implementation's identifier as prodId",
    needs=_CREATE,
)
def announced(bench: Bench) -> None:
    var_id = bench.identifiers.own_var_id()
    timeout = min(60_000, bench.sut.longest_timeout) if bench.features.creation_time else 0
    request = create_request(
        bench, var_id, rep_cnt=1, descr="speed of wind", value=b"\x00\x01\xfe\xff", timeout=timeout
    )
    bench.expect_status(OK, "RTDB-Create", "VD-CRE-14", **request)
    record = bench.required(bench.until_instruction(_V, var_id), "a VarCreate of the variable", "VD-CRE-12")
    bench.passed("a VarCreate of the variable", "VD-CRE-12")
    frames = bench.instructions(_V, var_id)
    spec, upd = record.spec, record.upd
    for name, expected, observed, requirement in (
        ("seqno", 0, upd.seqno, "VD-CRE-10"),
        ("value", bench.records.value(b"\x00\x01\xfe\xff"), upd.value, "VD-CRE-10"),
        ("repCnt", 1, spec.rep_cnt, "VD-CRE-10"),
        ("descr", bench.records.descr(b"speed of wind"), spec.descr.removesuffix(b"\0"), "VD-CRE-10"),
        ("varId of the update", var_id, upd.var_id, "VD-CRE-10"),
    ):
        bench.answered(observed, expected, name, requirement, frames=frames[:1])
    if spec.timeout is not None:
        bench.answered(spec.timeout, timeout, "timeout", "VD-CRE-10", frames=frames[:1])
    own = record_sender(bench)
    named = ("VD-CRE-08", "VD-INI-05") if bench.features.producer_set_by_vardis else ("VD-INI-05",)
    bench.answered(spec.prod_id, own, "prodId", *named, frames=frames[:1])


def record_sender(bench: Bench) -> bytes:
    """Return the senderId in the beacons of the implementation."""
    return (bench.heard[-1].sender if bench.heard else None) or bench.identifiers.sut_id


@case(
    "TC_VD_CRE_BV_02",
    "The creationTime of a variable is the time of its creation",
    requirements="VD-CRE-09",
    stimulus="RTDB-Create, twice, three beacon periods apart",
    expect=(
        "creationTimes close to these times, within the precision of the clocks, and the same difference between them"
    ),
    window=12,
    needs=Needs(since=SpecVersion.V2_0, ut=("RTDB-Create",)),
)
def creation_time(bench: Bench) -> None:
    bench.excuses.relies_on("creationTime")

    def created() -> tuple[int, Moment]:
        var_id = bench.identifiers.own_var_id()
        request = timed(bench, "RTDB-Create", **create_request(bench, var_id))
        record = bench.required(bench.until_instruction(_V, var_id), "a VarCreate of the variable", "VD-CRE-09")
        bench.wait(3)
        return nanoseconds(bench, record.spec.creation_time), request

    def measure() -> Stamps:
        (first, earlier), (second, later) = created(), created()
        return Stamps(first, second, (earlier, later))

    found = check_apart(bench, "creationTime", measure)
    if bench.profile.types.timestamp.epoch == "unix":
        check_now(bench, "creationTime", found.first, found.requests[0])


@case(
    "TC_VD_CRE_BV_03",
    "A VarCreate is sent in exactly repCnt beacons ({variant})",
    requirements="VD-CRE-12 VD-CRE-10",
    stimulus="RTDB-Create with repCnt {variant}",
    expect="one VarCreate of the variable in each of exactly repCnt beacons",
    window=30,
    needs=_CREATE,
    variants={"1": "1", "2": "2", "most": "most"},
)
def repetitions(bench: Bench, name: str) -> None:
    count = count_of(bench, name)
    var_id = produced(bench, rep_cnt=count)
    frames = bench.until_quiet(lambda heard: heard.instructions(_V, var_id))
    bench.repeated(frames, count, "beacons with the VarCreate")
    check_one_in_each(bench, frames, _V, var_id)


@case(
    "TC_VD_CRE_BV_04",
    "A new variable is included in the summaries",
    requirements="VD-CRE-12",
    stimulus="RTDB-Create",
    expect="a summary of the variable with seqno 0",
    needs=Needs(
        ut=("RTDB-Create",),
        when=lambda bench: (
            None
            if bench.sut.bound("VARDISPAR_MAX_SUMMARIES")
            else "the implementation sends no summaries (VARDISPAR_MAX_SUMMARIES is 0)"
        ),
    ),
)
def summarized(bench: Bench) -> None:
    var_id = produced(bench)
    record = bench.required(
        bench.until_instruction(ICType.SUMMARIES, var_id, 2 * bench.sut.reaction), "a summary of the variable"
    )
    bench.answered(record.seqno, 0, "seqno in the summary")


@case(
    "TC_VD_CRE_BV_05",
    "The database entry of a new variable has the contents that the specification requires",
    requirements="VD-CRE-10 VD-CRE-14",
    stimulus="RTDB-Create with the maximum repCnt, then immediately RTDB-DescribeVariable",
    expect=(
        "seqno 0, countCreate at most two less than repCnt, other counters 0, isDeleted false, current time as tStamp"
    ),
    needs=Needs(ut=("RTDB-Create", "RTDB-DescribeVariable")),
)
def entry(bench: Bench) -> None:
    count, before, start = max_repetitions(bench), bench.lower.wall(), bench.mark()
    var_id = produced(bench, rep_cnt=count)
    what = "a database entry when the request is confirmed"
    found = bench.present(entry_of(bench, var_id), what, "VD-CRE-14")
    bench.passed(what, "VD-CRE-14")
    least = least_left(bench, count, start)
    for name, values in (
        ("seqno", (0,)),
        ("countCreate", tuple(range(least, count + 1))),
        ("countUpdate", (0,)),
        ("countDelete", (0,)),
        ("isDeleted", (False,)),
    ):
        if name in found:
            observed = found[name]
            expected = f"{values[0]} to {values[-1]}" if len(values) > 1 else f"{values[0]}"
            bench.proved(observed in values, f"{name} {expected}", observed, "VD-CRE-10")
    stamp, slack = found.get("tStamp"), bench.sut.pixit.clock_tolerance_ms * MS
    near = stamp is None or before - slack <= stamp <= bench.lower.wall() + slack
    bench.proved(near, f"tStamp within {slack / 1e6:.0f} ms of the tester's clock", stamp, "VD-CRE-10")


@case(
    "TC_VD_CRE_BV_06",
    "VarDis sets the producer itself",
    requirements="VD-CRE-08",
    stimulus="RTDB-Create with the identifier of another node as prodId",
    expect="VARDIS-STATUS-OK, and a VarCreate with the implementation's identifier as prodId",
    needs=Needs(since=SpecVersion.V1_2, ut=("RTDB-Create",)),
)
def producer(bench: Bench) -> None:
    var_id, other = bench.identifiers.own_var_id(), bench.identifiers.node_id()
    answer = bench.call("RTDB-Create", **create_request(bench, var_id), prodId=other.hex(":"))
    if answer.code is not None:
        bench.info("Does RTDB-Create accept prodId as a parameter?", f"no: {answer}")
        return
    bench.services.check_status(answer, (OK,), "RTDB-Create")
    record = bench.required(bench.until_instruction(_V, var_id), "a VarCreate of the variable")
    shown, own = record.spec.prod_id, record_sender(bench)
    bench.answered(shown, own, "prodId", frames=bench.instructions(_V, var_id)[:1])


# -- limits ------------------------------------------------------------------------------------------------------------


def refused(bench: Bench, status: str, requirement: str, **request: Any) -> None:
    """Check that RTDB-Create is answered with a status and does not create a variable."""
    var_id = bench.unknown_id()
    request = {"descr": "d", "value": b"v"} | request
    answer = bench.call("RTDB-Create", **create_request(bench, var_id, exact=True, **request))
    if answer.code == NOT_EXPRESSIBLE:
        # VarDis cannot be asked for a value that its field cannot hold.
        bench.info(f"Can the profile express a request that leads to {status}?", str(answer), requirement)
    else:
        bench.services.check_status(answer, (status,), "RTDB-Create", requirement)
    bench.expect_status(UNKNOWN, "RTDB-Read", requirement, varId=var_id)


def accepted(bench: Bench, requirement: str, **request: Any) -> None:
    """Check that RTDB-Create succeeds and the variable is announced."""
    var_id = bench.identifiers.own_var_id()
    request = {"descr": "d", "value": b"v"} | request
    bench.expect_status(OK, "RTDB-Create", requirement, **create_request(bench, var_id, exact=True, **request))
    bench.some(bench.until_instruction(_V, var_id) is not None, "a VarCreate of the variable", requirement)


@case(
    "TC_VD_CRE_BI_01",
    "A description of maximum length is accepted, one that is an octet longer is rejected",
    requirements="VD-CRE-04",
    stimulus=(
        "RTDB-Create with a description of the maximum length, of one octet more, and of too many octets but fewer "
        "characters"
    ),
    expect="VARDIS-STATUS-OK, then twice VARIABLE-DESCRIPTION-TOO-LONG without a variable",
    needs=_CREATE_READ,
)
def description(bench: Bench) -> None:
    longest = longest_description(bench)
    accepted(bench, "VD-CRE-04", descr="d" * longest)
    refused(bench, DESCRIPTION_TOO_LONG, "VD-CRE-04", descr="d" * (longest + 1))
    # The limit counts octets; each of these characters has two.
    refused(bench, DESCRIPTION_TOO_LONG, "VD-CRE-04", descr="\u00e4" * (longest // 2 + 1))


@case(
    "TC_VD_CRE_BI_02",
    "A value of maximum length is accepted, one that is an octet longer is rejected",
    requirements="VD-CRE-05",
    stimulus="RTDB-Create with a value of the maximum length, then one octet more",
    expect="VARDIS-STATUS-OK, then VALUE-TOO-LONG without a variable",
    needs=_CREATE_READ,
)
def value(bench: Bench) -> None:
    longest = bench.sut.bound("VARDISPAR_MAX_VALUE_LENGTH")
    accepted(bench, "VD-CRE-05", value=b"v" * longest)
    refused(bench, VALUE_TOO_LONG, "VD-CRE-05", value=b"v" * (longest + 1))


@case(
    "TC_VD_CRE_BI_03",
    "An empty value is rejected",
    requirements="VD-CRE-06",
    stimulus="RTDB-Create with an empty value, then with one octet",
    expect="EMPTY-VALUE (1.0: INVALID-VALUE) without a variable, then VARDIS-STATUS-OK",
    needs=_CREATE_READ,
)
def empty_value(bench: Bench) -> None:
    refused(bench, empty_status(bench), "VD-CRE-06", value=b"")
    accepted(bench, "VD-CRE-06", value=b"\0")


@case(
    "TC_VD_CRE_BI_04",
    "Repetition counts from 1 to the maximum are accepted, others are rejected",
    requirements="VD-CRE-07",
    stimulus="RTDB-Create with repCnt 0, 1, VARDISPAR_MAX_REPETITIONS, one more, and 255",
    expect="ILLEGAL-REPCOUNT, OK, OK, ILLEGAL-REPCOUNT, ILLEGAL-REPCOUNT",
    needs=_CREATE_READ,
)
def repetition_count(bench: Bench) -> None:
    most = bench.sut.bound("VARDISPAR_MAX_REPETITIONS")
    refused(bench, ILLEGAL_REPCOUNT, "VD-CRE-07", rep_cnt=0)
    accepted(bench, "VD-CRE-07", rep_cnt=1)
    accepted(bench, "VD-CRE-07", rep_cnt=most)
    for count in {most + 1, max(255, most + 1)}:
        refused(bench, ILLEGAL_REPCOUNT, "VD-CRE-07", rep_cnt=count)


def _double(bench: Bench, taken: bool = False, **request: Any) -> dict[str, Any]:
    """Return a request with two mistakes, the first of which may be an existing identifier."""
    var_id = teach_variable(bench, bench.peer()) if taken else bench.unknown_id()
    request = {"descr": "d", "value": b"v"} | request
    return create_request(bench, var_id, exact=True, **request)


_ORDER: dict[str, Callable[[Bench], tuple[str, dict[str, Any]]]] = {
    "taken+descr": lambda b: (EXISTS, _double(b, True, descr=_long_descr(b))),
    "taken+value": lambda b: (EXISTS, _double(b, True, value=too_long(b))),
    "taken+empty": lambda b: (EXISTS, _double(b, True, value=b"")),
    "taken+repcnt": lambda b: (EXISTS, _double(b, True, rep_cnt=0)),
    "descr+value": lambda b: (DESCRIPTION_TOO_LONG, _double(b, descr=_long_descr(b), value=too_long(b))),
    "descr+empty": lambda b: (DESCRIPTION_TOO_LONG, _double(b, descr=_long_descr(b), value=b"")),
    "descr+repcnt": lambda b: (DESCRIPTION_TOO_LONG, _double(b, descr=_long_descr(b), rep_cnt=0)),
    "value+repcnt": lambda b: (VALUE_TOO_LONG, _double(b, value=too_long(b), rep_cnt=0)),
    "empty+repcnt": lambda b: (empty_status(b), _double(b, value=b"", rep_cnt=0)),
}


def _long_descr(bench: Bench) -> str:
    return "d" * (longest_description(bench) + 1)


@case(
    "TC_VD_CRE_BI_05",
    "The first failing check of RTDB-Create determines the status ({variant})",
    requirements="VD-CRE-13",
    stimulus="RTDB-Create with two mistakes ({variant})",
    expect="the status of the first failing check",
    needs=_CREATE,
    variants=_ORDER,
)
def order(bench: Bench, mistakes: Callable[[Bench], tuple[str, dict[str, Any]]]) -> None:
    status, request = mistakes(bench)
    if status == EXISTS:
        # The status does not depend on assumed maxima.
        bench.assumptions.discard()
    answer = bench.call("RTDB-Create", **request)
    if answer.code == NOT_EXPRESSIBLE:
        bench.info("Can the profile express the request?", str(answer))
        return
    bench.services.check_status(answer, (status,), "RTDB-Create")


@case(
    "TC_VD_CRE_BV_07",
    "The implementation accepts or rejects an empty description, and continues in either case",
    requirements="VD-CRE-15",
    stimulus="RTDB-Create with an empty description",
    expect="VARDIS-STATUS-OK or a rejection (X21); VarDis still answers",
    needs=_CREATE,
)
def empty_description(bench: Bench) -> None:
    var_id = bench.identifiers.own_var_id()
    answer = bench.call("RTDB-Create", **create_request(bench, var_id, descr=""))
    bench.services.require_asked(answer, "an answer to RTDB-Create")
    bench.reading("X21", "accept-locally" if answer.ok else "refuse-locally")
    bench.require_alive("a variable without a description")
    claimed = bench.sut.pics.empty_description
    if claimed is not None:
        bench.answered(answer.ok, claimed, "an empty description is accepted, as empty_description in the PICS claims")
    if answer.ok and bench.services.offers("RTDB-Delete"):
        # Delete it: neighbours that reject the empty description would request the variable forever.
        bench.call("RTDB-Delete", varId=var_id)
