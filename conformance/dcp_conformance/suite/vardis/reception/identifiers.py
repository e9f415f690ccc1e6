"""dcp-vardis.md: Data Types: identifiers at their limits.

Only these identifiers reveal a node that decodes them as signed, has one table entry too few, or treats 0 as "none".
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from dcp_spec.constants import ICType

from dcp_codec.values import VardisRecord
from dcp_conformance.definitions.case import Needs, Variant, case
from dcp_conformance.test_steps.services import OK, UNKNOWN, create_request, described, listed
from dcp_conformance.test_system.bench import Bench

_CREATE, _UPDATE = ICType.CREATE_VARIABLES, ICType.UPDATES
_DELETE, _SUMMARY = ICType.DELETE_VARIABLES, ICType.SUMMARIES
_ASK_CREATE, _ASK_UPDATE = ICType.REQUEST_VARCREATES, ICType.REQUEST_VARUPDATES


def _usable(name: str) -> Callable[[Bench], str | None]:
    """Return a condition for ``Needs.when``: the identifier must be in the range that the tester may use (PIXIT)."""

    def when(bench: Bench) -> str | None:
        number, allowed = bench.session.boundaries[name], bench.sut.pixit.var_ids
        if allowed is None or allowed[0] <= number <= allowed[1]:
            return None
        return f"the tester may only use the identifiers {allowed[0]} to {allowed[1]} (pixit.var_ids)"

    return when


def _each(*methods: str) -> dict[str, Variant]:
    """Return a variant for each boundary value."""
    return {
        name: Variant(name, needs=Needs(ut=methods, when=_usable(name)))
        for name in ("lowest", "below-half", "half", "highest")
    }


@case(
    "TC_VD_ID_BV_01",
    "A variable of another node with the {variant} identifier can be learnt, updated, requested and deleted",
    requirements="VD-TYP-01 VD-PS-01 VD-PC-09 VD-PU-07 VD-PS-04 VD-RC-03 VD-PD-04",
    family="boundary values of identifiers",
    stimulus=(
        "with the {variant} identifier (of 0, 127, 128, 255 for one octet): a summary, VarCreate, VarUpdate, a "
        "newer summary, VarReqCreate, VarDelete"
    ),
    expect="VarReqCreate, VarCreate, VarUpdate, VarReqUpdate, VarCreate and VarDelete with this identifier",
    window=24,
    variants=_each(),
)
def consumer(bench: Bench, name: str) -> None:
    peer, var_id = bench.peer(), bench.identifiers.boundary_id(name)
    create = peer.create(var_id, value=b"first", rep_cnt=1)
    steps: tuple[tuple[VardisRecord, ICType, str], ...] = (
        (peer.summary(var_id, 0), _ASK_CREATE, "VD-PS-01"),
        (create, _CREATE, "VD-PC-09"),
        (peer.update(var_id, 1, b"second"), _UPDATE, "VD-PU-07"),
        (peer.summary(var_id, 2), _ASK_UPDATE, "VD-PS-04"),
        (peer.request_create(var_id), _CREATE, "VD-RC-03"),
        (peer.delete(var_id), _DELETE, "VD-PD-04"),
    )
    for record, kind, requirement in steps:
        _check_answer(bench, lambda record=record: peer.send(record), kind, var_id, requirement)  # type: ignore[misc]


@case(
    "TC_VD_ID_BV_02",
    "All services and records accept the {variant} identifier for a node's own variable",
    requirements="VD-TYP-01 VD-CRE-14 VD-CRE-12 VD-DDB-02 VD-DVA-03",
    stimulus=(
        "RTDB-Create, -Read, -Update, -Delete with the {variant} identifier (of 0, 127, 128, 255 for one octet); "
        "RTDB-DescribeDatabase and RTDB-DescribeVariable, if available"
    ),
    expect=(
        "VARDIS-STATUS-OK each time; VarCreate, summary, VarUpdate and VarDelete with this identifier, and the "
        "variable in the descriptions"
    ),
    window=24,
    variants=_each("RTDB-Create", "RTDB-Update", "RTDB-Read", "RTDB-Delete"),
)
def producer(bench: Bench, name: str) -> None:
    var_id = bench.identifiers.boundary_id(name)
    bench.expect_status(UNKNOWN, "RTDB-Read", "VD-TYP-01", varId=var_id)

    def served(method: str, **params: Any) -> None:
        bench.expect_status(OK, method, "VD-TYP-01 VD-CRE-14", varId=var_id, **params)

    request = create_request(bench, var_id, value=b"first")
    request.pop("varId")
    _check_answer(bench, lambda: served("RTDB-Create", **request), _CREATE, var_id, "VD-CRE-12")
    if bench.sut.bound("VARDISPAR_MAX_SUMMARIES"):
        told = bench.until_instruction(_SUMMARY, var_id, 2 * bench.sut.reaction)
        bench.some(told, f"a summary of variable {var_id}", "VD-CRE-12 VD-TYP-01")
    _check_answer(
        bench, lambda: served("RTDB-Update", value=bench.records.value(b"second").hex()), _UPDATE, var_id, "VD-TYP-01"
    )
    answer = bench.expect_status(OK, "RTDB-Read", "VD-TYP-01", varId=var_id)
    value = answer.result.get("value")
    bench.answered(value, bench.records.value(b"second").hex(), "the value of the update", "VD-TYP-01")
    if "RTDB-DescribeDatabase" in bench.services.upper.methods:
        bench.proved(var_id in listed(bench), f"variable {var_id} in the list", "not in the list", "VD-DDB-02")
    if "RTDB-DescribeVariable" in bench.services.upper.methods:
        shown = described(bench.must("RTDB-DescribeVariable", varId=var_id)).get("varId")
        bench.answered(shown, var_id, "varId", "VD-DVA-03")
    _check_answer(bench, lambda: served("RTDB-Delete"), _DELETE, var_id, "VD-TYP-01")


def _check_answer(bench: Bench, act: Callable[[], object], kind: ICType, var_id: int, requirement: str) -> None:
    """Check that a record of this kind about the variable follows, and wait until its repetitions end."""
    since = bench.mark()
    act()
    found = bench.until_instruction(kind, var_id)
    bench.required(found, f"a {kind.label} record of variable {var_id}", requirement, "VD-TYP-01")
    bench.until_quiet(lambda heard: heard.instructions(kind, var_id), 8, since)
