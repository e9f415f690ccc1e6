"""The smoke plan: what was chosen, and that it takes no more than ten seconds."""

from __future__ import annotations

from pathlib import Path

import pytest
from dcp_conformance.definitions.case import all_cases
from dcp_conformance.definitions.case_times import encode, load
from dcp_conformance.definitions.pics import Pics
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.diagnosis import load as load_dictionary
from dcp_conformance.execution.runner import Runner
from dcp_conformance.execution.selection import Selection, select
from dcp_conformance.reference.inprocess import InProcess, reference_config
from dcp_conformance.test_system.session import Session
from dcp_selftest.runner import Suite, cases
from dcp_selftest.smoke_plan import choose

from dcp_codec.codec import Codec

from ..parts import also


@pytest.mark.part("suite")
def test_the_file_is_the_output_of_the_command() -> None:
    times = load()
    assert times.smoke == choose(cases(), times.seconds, load_dictionary())
    file = Path(__file__).parents[2] / "conformance/dcp_conformance/data/case-times.json"
    assert file.read_bytes() == encode(times)


def test_the_smoke_plan_detects_most_faults() -> None:
    faults = [fault for fault in load_dictionary().faults if fault.fails]
    smoke = load().smoke.keys()
    noticed = [fault for fault in faults if smoke & fault.fails]
    assert len(noticed) == sum(load().smoke.values())
    assert len(noticed) > 0.65 * len(faults)


def test_a_good_part_of_the_smoke_plan_needs_no_upper_tester() -> None:
    every = all_cases()
    assert sum(not every[name].needs.ut for name in load().smoke) >= 50


def test_greedy_choice_prefers_more_faults_per_second() -> None:
    every = [case for case in cases() if case.id in load().smoke]
    chosen = choose(every, {each.id: 1.0 for each in every}, load_dictionary())
    without = [name for name in chosen if not all_cases()[name].needs.ut]
    counts = [chosen[name] for name in without]
    assert counts[:10] == sorted(counts[:10], reverse=True)
    assert min(chosen.values()) >= 1


@pytest.mark.parametrize("upper", [True, *also("suite", False)])
def test_the_smoke_plan_takes_less_than_ten_seconds_in_concurrent_execution(upper: bool) -> None:
    suite = Suite("dcp-2.0")
    if not upper:
        codec = Codec("dcp-2.0")
        sut = InProcess(reference_config(codec))
        suite._runner = Runner(Session(codec, sut.lower_tester(), None, Pics()), sut)
        suite._runner.prepare()
    lower = suite._runner.session.lower
    begun = lower.now()
    results = suite.run_side_by_side(select(all_cases(), Selection(plan="smoke")), 16)
    assert {result.verdict for result in results} <= {Verdict.PASS, Verdict.INFO, Verdict.NOT_APPLICABLE}
    assert (lower.now() - begun) / 1e9 < 10
