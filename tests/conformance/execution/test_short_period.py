"""The short beacon period: which cases are executed with it; only a pass is accepted, others are repeated."""

from __future__ import annotations

import re

import pytest
from dcp_conformance.definitions.case import all_cases
from dcp_conformance.definitions.pics import Pics
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.execution.concurrent.executor import execute
from dcp_conformance.execution.concurrent.sharing import at_short_period
from dcp_conformance.execution.concurrent.short_period import PERIOD, ShortPeriod
from dcp_conformance.execution.runner import Runner
from dcp_conformance.reference.inprocess import InProcess, plain_node, reference_config
from dcp_conformance.test_system.reception.waiting import Waiting
from dcp_conformance.test_system.session import Session
from dcp_selftest.mutants import all_mutants
from dcp_selftest.runner import Suite, cases
from dcp_selftest.side_by_side import compare

from dcp_codec.codec import Codec

CODEC = Codec("dcp-2.0")
SANITY_CASE = all_cases()["TC_DCP_SANITY_BV_01"]
#: Cases that set a multiple or a fraction of the period in force, whichever it is.
RELATIVE = re.compile(r"TC_BP_(TX_TI_02|HDR_BV_10).*")


def bench_of(make=plain_node, *, beacon_period_ms: int = 100) -> tuple[Runner, InProcess]:
    sut = InProcess(reference_config(CODEC, beacon_period_ms=beacon_period_ms), make=make)
    runner = Runner(Session(CODEC, sut.lower_tester(), sut.upper_tester(), Pics()), sut)
    runner.prepare()
    runner.run(SANITY_CASE)
    return runner, sut


def begin(runner: Runner) -> tuple[ShortPeriod, bool]:
    short = ShortPeriod(runner.session, SANITY_CASE)
    return short, short.begin(lambda: runner.initial_state(SANITY_CASE, used=False))


def told(runner: Runner) -> object:
    assert runner.session.upper is not None
    return runner.session.upper.call("BP-GetParameters", {}).result["parameters"][PERIOD]


def test_the_period_stays_short_after_a_reset_and_is_restored_at_the_end() -> None:
    runner, _ = bench_of()
    before = runner.session.known.reaction
    short, begun = begin(runner)
    assert begun
    assert told(runner) == short.milliseconds == 25
    runner.initial_state(SANITY_CASE, used=False)
    assert told(runner) == 25
    result = runner.attempt(all_cases()["TC_VD_CMP_BV_01"])
    assert result is not None
    assert (result.verdict, result.short_period) == (Verdict.PASS, 25)
    short.end()
    assert told(runner) == 100
    assert runner.session.parameters[PERIOD] == 100
    assert runner.session.known.reaction is before
    assert runner.run(all_cases()["TC_VD_CMP_BV_01"]).short_period == 0


def test_a_restart_ends_the_short_period() -> None:
    runner, _ = bench_of()
    _, begun = begin(runner)
    assert begun
    assert not runner._restart_sut(SANITY_CASE)
    assert runner.session.short_period is None
    assert runner.session.parameters[PERIOD] == 100


def test_an_implementation_that_does_not_use_the_parameter_keeps_its_period() -> None:
    runner, _ = bench_of(all_mutants()["M-BP-PAR-02-ignored"].make)
    short, begun = begin(runner)
    assert not begun
    assert runner.session.short_period is None
    assert runner.session.parameters[PERIOD] == 100
    assert short.milliseconds < 100


def test_a_period_other_than_the_stated_one_is_not_changed() -> None:
    runner, _ = bench_of(beacon_period_ms=80)
    _, begun = begin(runner)
    assert not begun
    assert told(runner) == 80


def test_cases_about_the_configured_period_are_executed_with_it() -> None:
    for case in all_cases().values():
        if RELATIVE.fullmatch(case.id):
            assert at_short_period(case), case.id
        elif "BP-SetParameter" in case.needs.ut or case.needs.restart or re.match(r"TC_BP_(TX_TI|INI)", case.id):
            assert not at_short_period(case), case.id


def test_cases_that_do_not_pass_at_the_short_period_are_repeated_at_the_configured_one() -> None:
    runner, _ = bench_of()
    wrong = all_cases()["TC_BP_PAR_BV_05"]
    short, begun = begin(runner)
    assert begun
    # It compares the implementation's period with the configured one, and would fail.
    assert runner.attempt(wrong) is None
    short.end()
    passed = []
    execute(runner, SANITY_CASE, [wrong], 12, lambda case, result: passed.append((case.id, result.short_period)))
    assert passed == [(wrong.id, 0)]


@pytest.mark.part("suite")
def test_a_whole_run_is_short_and_gives_the_verdicts_of_our_node() -> None:
    suite = Suite("dcp-2.0")
    session = suite._runner.session
    begun = session.lower.now()
    results = suite.run_side_by_side([case for case in cases() if not case.long], 12)
    assert {result.verdict for result in results} <= {Verdict.PASS, Verdict.INFO, Verdict.NOT_APPLICABLE}
    # One case after the other takes 620 s.
    assert (session.lower.now() - begun) / 1e9 < 180


@pytest.mark.parametrize("pattern", ["TC_VD_DB_BV_06-", "TC_NET_RACE_BO_02-", "TC_NET_JOIN_BV_07", "TC_VD_UPD_BV_0"])
def test_no_case_waits_for_finished_repetitions(monkeypatch, pattern: str) -> None:
    vain: list[str] = []
    until_quiet = Waiting.until_quiet

    def watched(self: Waiting, present, periods: float = 60, *args, **more):
        began = self._clock.now()
        found = until_quiet(self, present, periods, *args, **more)
        if not found and self._clock.now() - began > 20 * self._sut.period:
            vain.append(str(began))
        return found

    monkeypatch.setattr(Waiting, "until_quiet", watched)
    suite = Suite("dcp-2.0")
    chosen = [case for case in cases() if case.id.startswith(pattern)]
    assert chosen
    results = list(suite.run(chosen))
    assert len(results) == len(chosen) + 1
    assert vain == []


@pytest.mark.parametrize("mutant", ["M-VD-SCR-04-counts-left", "M-VD-SCR-04-createQ", "M-VD-SCR-04-updateQ"])
def test_repetitions_outlast_a_timeout_also_if_the_beacon_period_can_be_shortened(mutant: str) -> None:
    chosen = [each for each in cases() if each.id in ("TC_VD_SCR_TI_09", "TC_VD_SCR_TI_16")]
    assert compare(all_mutants()[mutant], "dcp-2.0", chosen, companions=0).killed == (True, True)


def test_timeouts_are_measured_with_a_short_scrubbing_period_also_at_a_short_beacon_period() -> None:
    # Beside others they would have to wait for the configured one, which hides a variable that is deleted too early.
    found = compare(all_mutants()["M-VD-SCR-03-half"], "dcp-2.0", [each for each in cases() if "_SCR_TI_" in each.id])
    assert found.killed == (True, True)
    different = {each.case for each in found.differences}
    assert not different & {
        "TC_VD_SCR_TI_04",
        "TC_VD_SCR_TI_05",
        "TC_VD_SCR_TI_08",
        "TC_VD_SCR_TI_14-own",
        "TC_VD_SCR_TI_14-received",
    }
