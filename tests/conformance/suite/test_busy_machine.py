"""Lateness fails no conforming node: a busy machine in virtual time, where tester, node and frames are held up."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest
from dcp_conformance.definitions.pics import Pics
from dcp_conformance.definitions.results import CaseResult
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.execution.runner import Runner
from dcp_conformance.reference.inprocess import (
    InProcess,
    MakeNode,
    VirtualUpperTester,
    plain_node,
    reference_config,
)
from dcp_conformance.test_system.bench import MS, Session
from dcp_conformance.upper_tester import Answer
from dcp_selftest.mutants import all_mutants
from dcp_selftest.variants import all_variants
from dcp_selftest.variants.busy import LOADS, Busy, Load, busy

from ...parts import also
from ..rig import codec_of, every_case, known_cases

PROFILE = "dcp-2.0"
#: With one case in this many, a run takes about a second.
SHARE = 6


def runner_for(load: Load, seed: int, *, upper: bool = True, make: MakeNode = plain_node) -> Runner:
    setup = busy(PROFILE, load, seed, make=make)
    sut = Busy(setup, load, seed=seed)
    connection = sut.connection(setup.upper) if upper else None
    runner = Runner(Session(setup.config.codec, sut.lower_tester(), connection, setup.pics), sut)
    runner.prepare()
    return runner


def results(load: Load, seed: int, *ids: str, upper: bool = True) -> list[CaseResult]:
    """Run cases, or a share of the suite that differs from seed to seed."""
    known = [each for each in every_case() if not each.long]
    chosen = [each for each in known if each.id in ids] if ids else known[seed % SHARE :: SHARE]
    runner = runner_for(load, seed, upper=upper)
    return [runner.run(each) for each in chosen]


def wrong(found: Sequence[CaseResult]) -> list[tuple[str, str]]:
    return [(each.id, each.reason) for each in found if each.verdict in (Verdict.FAIL, Verdict.ERROR)]


@pytest.mark.parametrize("upper", [True, *also("suite", False)])
@pytest.mark.parametrize("load", LOADS)
def test_no_case_fails_for_lateness(load: str, upper: bool):
    found = results(LOADS[load], 1 + list(LOADS).index(load), upper=upper)
    assert wrong(found) == []
    undecided = [(each.id, each.reason) for each in found if each.verdict is Verdict.INCONCLUSIVE]
    assert len(undecided) <= (0 if load == "mild" else len(found) // 30), undecided


class BeaconsInBetween(VirtualUpperTester):
    """An upper tester with which a beacon is sent after the first submission of safety data, and before each reset."""

    _submitted = False

    def call(self, method: str, params: dict[str, Any]) -> Answer:
        if method == "UT-Reset":
            self._sut.elapse(120 * MS)
        answer = super().call(method, params)
        if method == "SRP-UpdateSafetyData" and not self._submitted:
            self._submitted = True
            self._sut.elapse(120 * MS)
        return answer


def test_a_report_from_before_a_reset_is_not_the_first_one_after_it():
    """On a busy machine, the beacon with the second report was sent between the last look and the reset."""
    codec = codec_of(PROFILE)
    sut = InProcess(reference_config(codec))
    runner = Runner(Session(codec, sut.lower_tester(), BeaconsInBetween(sut), Pics()), sut)
    runner.prepare()
    result = runner.run(known_cases()["TC_SRP_INI_BV_04"])
    assert result.verdict is Verdict.PASS, result.reason
    assert result.executions == 1


@pytest.mark.parametrize(
    ("mutant", "load"),
    [
        ("M-SRP-INI-05-number-survives", "mild"),
        ("M-SRP-INI-05-number-survives", "busy"),
        ("M-VD-UPD-07-wraps-early", "mild"),
        ("M-VD-UPD-07-wraps-early", "busy"),
        ("M-BP-QM-01-drops-head", "mild"),
        ("M-VD-PU-07-ignored", "mild"),
    ],
)
def test_faults_are_found_on_a_busy_machine(mutant: str, load: str):
    fault = all_mutants()[mutant]
    runner = runner_for(LOADS[load], 1, make=fault.make)
    cases = [each for each in every_case() if set(each.requirements) & set(fault.requirements)]
    found = (runner.run(each) for each in cases if not each.long)
    assert any(each.verdict is Verdict.FAIL and set(each.requirements) & set(fault.requirements) for each in found)


def test_the_campaign_has_each_load():
    names = [each for each in all_variants() if each.startswith("V-BUSY-")]
    assert {each.removeprefix("V-BUSY-").rpartition("-")[0] for each in names} == set(LOADS)
