"""A property that the implementation does not report is taken from the profile; a wrong assumption fails no case."""

from __future__ import annotations

import msgspec
import pytest
from dcp_conformance.definitions.pics import Pics, Testing
from dcp_conformance.definitions.results import CaseResult
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.execution.runner import Runner
from dcp_conformance.reference.inprocess import InProcess, MakeNode, plain_node, reference_config
from dcp_conformance.test_system.bench import Session
from dcp_selftest.mutants import all_mutants

from dcp_stack.config import VardisConfig

from ..rig import codec_of, known_cases

VALUE = "VARDISPAR_MAX_VALUE_LENGTH was taken to be 32, as in the profile: state its value (pixit.max_value_length)"


def judged(
    case_id: str, pixit: Testing, *, upper: bool = False, make: MakeNode = plain_node, **parameters: int
) -> CaseResult:
    """A case against a node with these parameters of VarDis, which it can be asked about by an upper tester only."""
    codec = codec_of("dcp-2.0")
    config = msgspec.structs.replace(reference_config(codec), vardis=VardisConfig(**parameters))
    sut = InProcess(config, make=make)
    session = Session(codec, sut.lower_tester(), sut.upper_tester() if upper else None, Pics(pixit=pixit))
    runner = Runner(session, sut)
    runner.prepare()
    return runner.run(known_cases()[case_id])


@pytest.mark.parametrize(
    ("case_id", "length"),
    [("TC_VD_LEN_BI_01-value-max+1", 64), ("TC_VD_LEN_BI_02-max+1", 64), ("TC_VD_LEN_BI_01-value-max", 16)],
)
def test_an_assumed_bound_decides_nothing(case_id: str, length: int):
    result = judged(case_id, Testing(), max_value_length=length)
    verdict = result.verdict
    assert verdict is Verdict.INCONCLUSIVE
    assert VALUE in result.reason
    for known in (
        judged(case_id, Testing(max_value_length=length), max_value_length=length),
        judged(case_id, Testing(), upper=True, max_value_length=length),
    ):
        verdict = known.verdict
        assert verdict is Verdict.PASS, known.reason


def test_a_stated_bound_decides():
    make = all_mutants()["M-VD-PC-04-any-value"].make
    result = judged("TC_VD_LEN_BI_01-value-max+1", Testing(max_value_length=32), make=make, max_value_length=32)
    verdict = result.verdict
    assert verdict is Verdict.FAIL


def test_values_forbidden_by_the_specification_fail_without_stated_bounds():
    """An empty value is none, whatever the maximum is."""
    verdict = judged("TC_VD_LEN_BI_01-value-0", Testing(), make=all_mutants()["M-VD-PC-04-empty-value"].make).verdict
    assert verdict is Verdict.FAIL


@pytest.mark.parametrize(
    ("case_id", "mutant"),
    [
        ("TC_VD_UPD_BO_03", "M-VD-UPD-04-ok"),
        ("TC_DCP_DATA_BV_08-least", "M-VD-PC-09-own-only"),
        ("TC_VD_CRE_BI_05-taken+value", "M-VD-CRE-13-exists-last"),
    ],
)
def test_failures_independent_of_bounds_fail_with_assumed_bounds(case_id: str, mutant: str):
    """One octet is never too long, and what is deleted or there already is so however long a value is."""
    make = all_mutants()[mutant].make
    codec = codec_of("dcp-2.0")
    sut = InProcess(reference_config(codec), make=make)
    upper = sut.upper_tester()
    upper.methods = upper.methods - {"VD-GetParameters"}
    runner = Runner(Session(codec, sut.lower_tester(), upper, Pics()), sut)
    runner.prepare()
    verdict = runner.run(known_cases()[case_id]).verdict
    assert verdict is Verdict.FAIL


def test_many_variables_that_are_not_learnt_give_a_short_reason():
    result = judged("TC_VD_PAY_BV_02-creates", Testing(), max_value_length=4)
    verdict = result.verdict
    assert verdict is Verdict.INCONCLUSIVE
    assert VALUE in result.reason
    assert len(result.reason) < 500
