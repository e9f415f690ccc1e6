"""Verdicts on a bad link: what it explains is inconclusive and executed again, faults are found all the same."""

from __future__ import annotations

from collections.abc import Callable
from itertools import count

import pytest
from dcp_conformance.cli import main
from dcp_conformance.definitions.case import Case, Kind
from dcp_conformance.definitions.pics import Pics
from dcp_conformance.definitions.results import CaseResult
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.execution.run import ConformanceRun
from dcp_conformance.execution.runner import Runner
from dcp_conformance.execution.selection import Selection
from dcp_conformance.execution.target import TargetOptions
from dcp_conformance.impaired_link import MOST_EXECUTIONS, impaired, parse_directions
from dcp_conformance.lower_tester import Impairs, Incident, LinkHealth
from dcp_conformance.reference.inprocess import InProcess, VirtualLowerTester, reference_config
from dcp_conformance.test_system.bench import Bench, Session
from dcp_selftest import runner as selftest

from ..rig import codec_of, sampled_cases

LOST_STIMULUS = Incident(True, "lost", b"")
LOST_BEACON = Incident(False, "lost", b"")
LATE_BEACON = Incident(False, "late", b"")


class Scripted(VirtualLowerTester):
    """A link that tells incidents as a test wants them."""

    incidents: tuple[Incident, ...] = ()

    def health(self) -> LinkHealth:
        found, self.incidents = self.incidents, ()
        return LinkHealth(incidents=found)


def executed(body: Callable[[Bench, int, Scripted], None]) -> CaseResult:
    """The result of a case; the body gets the number of the execution, from 1 on."""
    codec, numbers = codec_of("dcp-2.0"), count(1)
    sut = InProcess(reference_config(codec))
    lower = Scripted(sut)
    runner = Runner(Session(codec, lower, sut.upper_tester(), Pics()), sut)
    runner.prepare()
    case = Case(
        *("TC_BP_X_BV_01", "", ("BP-RX-07",), Kind.VALID, "", "", 4, "", ""),
        lambda bench: body(bench, next(numbers), lower),
    )
    return runner.run(case)


@pytest.mark.parametrize(
    ("incident", "how", "excused"),
    [
        (LOST_STIMULUS, {}, True),
        (LOST_BEACON, {}, True),
        (LATE_BEACON, {}, True),
        (LOST_STIMULUS, {"shown": True}, True),
        (LATE_BEACON, {"shown": True}, True),
        (LOST_BEACON, {"shown": True}, False),
        (LOST_BEACON, {"numbers": True}, True),
        (LOST_STIMULUS, {"numbers": True}, False),
    ],
)
def test_an_incident_excuses_only_failures_that_it_explains(
    incident: Incident, how: dict[str, bool], excused: bool
) -> None:
    def body(bench: Bench, number: int, lower: Scripted) -> None:
        if number == 1:
            lower.incidents = (incident,)
        bench.verdicts.check(number > 1, "a beacon", "none", **how)

    result = executed(body)
    assert result.verdict is (Verdict.PASS if excused else Verdict.FAIL)
    assert result.executions == (2 if excused else 1)


def test_a_fault_is_a_fail_in_the_first_execution_in_which_the_link_did_nothing() -> None:
    def body(bench: Bench, number: int, lower: Scripted) -> None:
        lower.incidents = (LOST_STIMULUS,) if number < 3 else ()
        bench.verdicts.check(False, "a beacon", "none")

    result = executed(body)
    assert (result.verdict, result.executions) == (Verdict.FAIL, 3)


def test_the_reason_names_the_frame_that_was_lost() -> None:
    def body(bench: Bench, number: int, lower: Scripted) -> None:
        bench.wait(1)
        lower.incidents = ()
        peer = bench.peer()
        sent = VirtualLowerTester.send

        def send(octets: bytes, source: bytes) -> bytes:
            lower.incidents = (LOST_STIMULUS,)
            return sent(lower, octets, source)

        lower.send = send  # type: ignore[method-assign]
        peer.send(peer.create(bench.var_id()))
        del lower.send
        bench.verdicts.check(False, "an answer", "none")

    result = executed(body)
    assert result.verdict is Verdict.INCONCLUSIVE
    number = next(each.frame for each in result.evidence if each.direction == "sent")
    assert f"but the tester has lost something: lost on the impaired link: frame {number} to" in result.reason
    assert any(each.text.startswith(f"lost on the impaired link: frame {number}") for each in result.evidence)


# -- our node on bad links ---------------------------------------------------------------------------------------------


def run_of(*impair: str, seed: int = 1, profile: str = "dcp-2.0", cases: tuple[str, ...] = ()) -> ConformanceRun:
    options = TargetOptions(in_process=True, impair=impair, seed=seed, profile=profile)
    run = ConformanceRun(options, Selection(patterns=cases))
    run.execute()
    assert run.trouble == ""
    return run


@pytest.fixture
def strict(monkeypatch: pytest.MonkeyPatch) -> None:
    """Do not excuse received data by a lost stimulus, as on a bad link that the tester does not know about."""
    excused = ("reordered", "late")
    monkeypatch.setattr(
        Incident, "misleads", property(lambda self: self.what in excused or (self.to and self.what != "lost"))
    )


@pytest.mark.part("suite")
@pytest.mark.usefixtures("strict")
@pytest.mark.parametrize(("impair", "seed"), [("loss=0.1", 1), ("loss=0.25,burst=2", 2), ("loss=0.15", 3)])
def test_losses_fail_no_node_but_received_frames_still_prove_failures(impair: str, seed: int) -> None:
    run = run_of(impair, seed=seed, cases=tuple(each.id for each in sampled_cases(seed)))
    assert [f"{each.id}: {each.reason}" for each in run.results if each.verdict in (Verdict.FAIL, Verdict.ERROR)] == []
    assert [each.id for each in run.passive if each.verdict is Verdict.FAIL] == []
    passed = sum(each.verdict is Verdict.PASS for each in run.results)
    assert passed > 0.85 * sum(each.verdict is not Verdict.NOT_APPLICABLE for each in run.results)
    assert any(each.executions > 1 for each in run.results)
    assert max(each.executions for each in run.results) <= MOST_EXECUTIONS
    assert any("the link was impaired while cases were executed (loss=" in note for note in run.result().notes)


@pytest.mark.part("suite")
@pytest.mark.usefixtures("strict")
@pytest.mark.parametrize("profile", ["dcp-1.0", "dcp-1.3", "cpp-2.0"])
def test_queues_whose_beacons_are_lost_on_the_link_pass(profile: str) -> None:
    run = run_of("loss=0.2", profile=profile, cases=("TC_BP_QM_*", "TC_VD_PEND_*"))
    assert len(run.results) > 10
    assert [f"{each.id}: {each.reason}" for each in run.results if each.verdict in (Verdict.FAIL, Verdict.ERROR)] == []


@pytest.mark.part("suite")
@pytest.mark.parametrize(
    ("seed", "impair"),
    [
        (0, "delay=5ms,jitter=2ms"),
        (1, "duplicate=0.2,reorder=0.1"),
        (2, "corrupt=0.002"),
        (3, "loss=0.1,burst=3,delay=5ms,jitter=2ms,duplicate=0.01,reorder=0.02,corrupt=0.001,down=1s+300ms/5s"),
    ],
)
def test_no_impairment_fails_our_node(seed: int, impair: str) -> None:
    run = run_of(impair, cases=tuple(each.id for each in sampled_cases(seed)))
    assert [f"{each.id}: {each.reason}" for each in run.results if each.verdict in (Verdict.FAIL, Verdict.ERROR)] == []
    assert [each.id for each in run.passive if each.verdict is Verdict.FAIL] == []


# -- mutants on a bad link ---------------------------------------------------------------------------------------------

#: Mutants of all protocols that are noticed in spite of the losses.
MUTANTS = selftest.chosen(
    [
        "M-BP-HDR-01-two",
        "M-BP-REG-13-refused-without-id",
        "M-BP-QM-02-six-bits",
        "M-BP-RX-14-padding-refused",
        "M-BP-TXP-02-truncates",
        "M-SRP-RX-03-touches-others",
        "M-SRP-NT-02-two-listed",
        "M-VD-CRE-16-accepted",
        "M-VD-PC-03-taken",
        "M-VD-TYP-01-own-zero",
        "M-VD-PAR-04-zero",
        "M-VD-CMP-09-one-more",
        "M-VD-SCR-06-older-update-renews",
        "M-VD-RUN-02-always",
        "M-VD-REA-03-does-not-exist",
        "M-VD-PS-02-equal-requested",
        "M-VD-PC-08-updateQ",
    ]
)


@pytest.fixture
def lossy(monkeypatch: pytest.MonkeyPatch) -> None:
    """Connect every node in process by a link that loses a tenth of all frames."""
    plain = InProcess.lower_tester
    monkeypatch.setattr(
        InProcess,
        "lower_tester",
        lambda self: impaired(plain(self), parse_directions(["loss=0.1"]), seed=1, tolerance=0),
    )
    assert isinstance(InProcess(reference_config(codec_of("dcp-2.0"))).lower_tester(), Impairs)


def test_there_are_ten_mutants() -> None:
    assert len(MUTANTS) >= 10


@pytest.mark.part("suite")
@pytest.mark.usefixtures("lossy")
@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.id)
def test_mutants_still_fail_their_requirements(mutant: selftest.Mutant) -> None:
    found = selftest.trial(mutant)
    assert found.killers, found


def test_a_wrong_option_is_refused_before_anything_is_started(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["run", "--in-process", "--impair", "loss=0.1,dealy=5ms"])
    assert ended.value.code == 2
    assert "--impair loss=0.1,dealy=5ms: dealy: unknown key; the keys are loss, burst," in capsys.readouterr().err
