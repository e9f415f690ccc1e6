"""A failure that lateness may explain counts only if it recurs."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from dcp_conformance.definitions.pics import Pics, Testing
from dcp_conformance.definitions.results import CaseResult
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.execution.runner import CONFIRMATIONS
from dcp_conformance.test_system.bench import Bench

from .test_repeated_execution import Rig


def silent(bench: Bench) -> None:
    """Let the node send nothing for five periods between two beacons."""
    bench.probes.probe()
    bench.wait(5)
    bench.probes.probe()


def held(bench: Bench) -> None:
    """Let the tester notice the end of a wait half a period late."""
    bench.steps.held(bench.period // 2)


def run(late: Callable[[Bench], None], *fails: bool, shown: bool = False) -> CaseResult:
    """Run a case that fails in some executions; the node or the tester is late in all of them."""

    def body(bench: Bench, number: int) -> None:
        late(bench)
        bench.verdicts.check(not fails[min(number, len(fails)) - 1], "a reaction", "none", shown=shown)

    return Rig().run(body)


@pytest.mark.parametrize("late", [silent, held])
def test_a_failure_that_does_not_recur_is_inconclusive(late: Callable[[Bench], None]):
    result = run(late, True, False)
    assert (result.verdict, result.executions) == (Verdict.INCONCLUSIVE, 2)
    assert "it did not fail in a further execution, and" in result.reason


@pytest.mark.parametrize("late", [silent, held])
def test_a_failure_that_recurs_each_time_counts(late: Callable[[Bench], None]):
    result = run(late, True)
    assert (result.verdict, result.executions) == (Verdict.FAIL, 1 + CONFIRMATIONS)


def test_two_of_three_are_not_enough():
    assert run(silent, True, True, False).verdict is Verdict.INCONCLUSIVE


def test_a_failure_in_time_needs_no_other_execution():
    result = run(lambda _: None, True)
    assert (result.verdict, result.executions) == (Verdict.FAIL, 1)


def test_wrong_octets_need_no_other_execution():
    result = run(silent, True, shown=True)
    assert (result.verdict, result.executions) == (Verdict.FAIL, 1)


def test_a_pass_needs_no_other_execution():
    assert run(silent, False).executions == 1


def test_another_failure_does_not_confirm_the_first():
    def body(bench: Bench, number: int) -> None:
        silent(bench)
        bench.verdicts.check(False, "a reaction", "none", "BP-RX-07" if number == 1 else "BP-RX-08")

    assert Rig().run(body).verdict is Verdict.INCONCLUSIVE


def test_wrong_octets_before_a_frame_that_was_overtaken_must_recur():
    """The frame was received after the check; with it, the check might have held."""

    def body(bench: Bench, number: int) -> None:
        bench.verdicts.check(number > 1, "octets 01", "02", shown=True)
        bench.steps.waited(bench.now() + bench.period)
        bench.probes.probe()

    assert Rig().run(body).verdict is Verdict.INCONCLUSIVE


def test_an_execution_that_is_undecided_shows_nothing():
    """The tester was late in the second execution, so the failure is neither confirmed nor refuted by it."""
    rig = Rig()

    def body(bench: Bench, number: int) -> None:
        silent(bench)
        if number == 2:
            rig.be_late(bench)
        bench.verdicts.check(False, "a reaction", "none")

    result = rig.run(body)
    assert (result.verdict, result.executions) == (Verdict.FAIL, 2 + CONFIRMATIONS)


@pytest.mark.parametrize(
    ("stimuli", "verdict"), [(1, Verdict.FAIL), (15, Verdict.FAIL), (60, Verdict.INCONCLUSIVE)], ids=str
)
def test_a_declared_loss_may_explain_a_failure_after_many_stimuli(stimuli: int, verdict: Verdict):
    """With a loss of 2 %, most executions lose one of 60 frames; eleven in a row rarely lose one of 15 each."""

    def body(bench: Bench, _: int) -> None:
        peer = bench.peer()
        for _ in range(stimuli):
            peer.send(peer.summary(bench.unknown_id(), 1))
        bench.verdicts.check(False, "reactions to all of them", "some are missing")

    result = Rig(Pics(pixit=Testing(loss=0.02))).run(body)
    assert result.verdict is verdict
    assert ("which may explain it" in result.reason) is (verdict is Verdict.INCONCLUSIVE)
    assert result.executions == {1: 5, 15: 11, 60: 1 + CONFIRMATIONS}[stimuli]


def test_a_declared_loss_does_not_explain_wrong_octets():
    def body(bench: Bench, _: int) -> None:
        peer = bench.peer()
        for _ in range(60):
            peer.send(peer.summary(bench.unknown_id(), 1))
        bench.verdicts.check(False, "a value", "another one", shown=True)

    result = Rig(Pics(pixit=Testing(loss=0.02))).run(body)
    assert (result.verdict, result.executions) == (Verdict.FAIL, 1)
