"""The whole suite against nodes that are slow but legal: slowness is never a failure. In virtual time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest
from dcp_conformance.definitions.pics import Pics
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.execution.runner import Runner
from dcp_conformance.reference.inprocess import InProcess, reference_config
from dcp_conformance.test_system.bench import MS, Session
from dcp_selftest.mutants import all_mutants

from ...parts import also
from ..rig import codec_of, every_case, known_cases, sampled_cases
from ..slow import LateAnswers, polling, runner_for

SLOW: Mapping[str, dict[str, Any]] = {
    "one payload per 50 ms": {"make": polling(50)},
    "one payload per 120 ms": {"make": polling(120)},
    "one payload per 25 ms, room for 10": {"make": polling(25, room=10)},
    "buffer check period of 400 ms": {"buffer_check_period_ms": 400},
    "buffer check period of 2 s": {"buffer_check_period_ms": 2000},
    "500 ms for each call": {"call_ms": 500},
}
TRIALS = [
    *((each, "dcp-2.0") for each in SLOW),
    ("one payload per 25 ms, room for 10", "cpp-1.2"),
    ("500 ms for each call", "dcp-1.1"),
]
#: Variables whose timeout is over before a slow implementation first speaks, and what slow calls come too late for.
MOST_UNDECIDED = 3
#: Up to 1.1 BP cannot be deactivated while stimuli are made that must fall between two beacons.
TOO_SLOW_FOR_A_GAP = "between two beacons: a beacon in between in each attempt; calls take up to 500 ms"


@pytest.mark.part("suite")
@pytest.mark.parametrize(("how", "profile"), TRIALS)
def test_a_slow_node_does_not_fail(how: str, profile: str):
    runner = runner_for(profile, **SLOW[how])
    cases = sampled_cases(TRIALS.index((how, profile)))
    results = [runner.run(each) for each in cases]
    wrong = [(each.id, each.reason) for each in results if each.verdict in (Verdict.FAIL, Verdict.ERROR)]
    assert wrong == []
    undecided = [(each.id, each.reason) for each in results if each.verdict is Verdict.INCONCLUSIVE]
    if profile == "dcp-1.1":
        undecided = [(case_id, reason) for case_id, reason in undecided if TOO_SLOW_FOR_A_GAP not in reason]
    assert len(undecided) <= MOST_UNDECIDED, undecided
    assert sum(each.verdict is Verdict.PASS for each in results) > 0.63 * len(results)


@pytest.mark.parametrize("profile", ["dcp-1.3", "dcp-2.0"])
@pytest.mark.parametrize(("late_ms", "verdict"), [(40, Verdict.PASS), (150, Verdict.INCONCLUSIVE)])
def test_an_imprecise_clock_offset_fails_no_node(profile: str, late_ms: int, verdict: Verdict):
    codec = codec_of(profile)
    sut = InProcess(reference_config(codec))
    runner = Runner(Session(codec, sut.lower_tester(), LateAnswers(sut, late_ms * MS), Pics()), sut)
    runner.prepare()
    result = runner.run(known_cases()["TC_BP_PTI_TI_01"])
    assert result.verdict is verdict, result.reason


@pytest.mark.parametrize("call_ms", [5, *also("suite", 0, 500)])
@pytest.mark.parametrize("case_id", ["TC_VD_SEQ_BV_04", "TC_VD_UPD_BV_02"])
def test_numbers_that_wrap_early_are_found_however_slow_the_upper_tester_is(case_id: str, call_ms: float):
    """Three hundred calls, in which beacons come that wait to be read."""
    mutant = all_mutants()["M-VD-UPD-07-wraps-early"]
    result = runner_for(make=mutant.make, call_ms=call_ms).run(known_cases()[case_id])
    assert result.verdict is Verdict.FAIL, result.reason
    failed = {each for check in result.checks if check.verdict is Verdict.FAIL for each in check.requirements}
    assert failed & set(mutant.requirements)
    good = runner_for(call_ms=call_ms).run(known_cases()[case_id])
    assert good.verdict is Verdict.PASS, good.reason


@pytest.mark.parametrize(
    "mutant",
    [
        "M-SRP-RX-06-forwarded",
        "M-BP-QM-01-drops-head",
        "M-BP-QM-02-discards-new",
        "M-BP-QM-01-one-place-more",
        "M-BP-QM-07-several",
        "M-BP-QRY-02-one-more",
        "M-BP-TX-04-loses",
        "M-VD-RC-03-not-again",
        "M-VD-PU-08-request-kept",
        "M-VD-SCR-03-half",
    ],
)
@pytest.mark.parametrize("how", ["buffer check period of 400 ms", "500 ms for each call"])
def test_faults_of_slow_nodes_are_found(mutant: str, how: str):
    """A case whose steps must fall between two beacons either manages that or is not judged."""
    fault = all_mutants()[mutant]
    runner = runner_for(fault.profile, make=fault.make, **SLOW[how])
    cases = [each for each in every_case() if set(each.requirements) & set(fault.requirements)]
    for case in cases:
        result = runner.run(case)
        failed = {each for check in result.checks if check.verdict is Verdict.FAIL for each in check.requirements}
        if failed & set(fault.requirements):
            return
    pytest.fail(f"none of {len(cases)} cases has noticed it")
