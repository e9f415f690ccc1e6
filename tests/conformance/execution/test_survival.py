"""The check after each case whether the implementation is still alive."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from dcp_conformance.definitions.case import Case, Kind
from dcp_conformance.definitions.pics import Pics, Testing
from dcp_conformance.definitions.results import CaseResult
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.execution.runner import Runner
from dcp_conformance.reference.inprocess import InProcess, reference_config
from dcp_conformance.test_system.bench import Bench, Session
from dcp_selftest.mutants import all_mutants

from ..rig import codec_of, known_cases, one_case


def case_of(body: Callable[[Bench], None]) -> Case:
    return Case("TC_DCP_X_BV_01", "", ("VD-PS-01",), Kind.VALID, "", "", 4, "", __name__, body, destructive=True)


def all_used(bench: Bench) -> None:
    """Leaves no identifier that the implementation could be asked about."""
    bench.identifiers.created.update(range(256))
    bench.passed("all identifiers were used")


def run(body: Callable[[Bench], None], *, upper: bool = True, talking: bool = True) -> CaseResult:
    sut = InProcess(reference_config(codec_of("dcp-2.0")))
    if talking:
        assert sut.upper_tester().call("RTDB-Create", {"varId": 1, "repCnt": 3, "descr": "d", "value": "01"}).ok
    session = Session(codec_of("dcp-2.0"), sut.lower_tester(), sut.upper_tester() if upper else None, Pics())
    runner = Runner(session, sut)
    runner.prepare()
    return runner.run(case_of(body))


def test_beacons_are_enough_when_no_variable_is_left_to_ask_about():
    result = run(all_used, upper=False)
    verdict, killed = result.verdict, result.killed
    assert verdict is Verdict.PASS
    assert not killed


def test_service_calls_are_enough_when_there_are_no_beacons_either():
    result = run(all_used, talking=False)
    verdict, killed = result.verdict, result.killed
    assert verdict is Verdict.PASS
    assert not killed


def test_the_identifiers_of_the_last_variables_are_found():
    def uses_all_identifiers_except_one(bench: Bench) -> None:
        bench.identifiers.created.update(set(range(256)) - {254})
        found = (bench.identifiers.has_unknown_ids(), bench.identifiers.unknown_ids(1))
        bench.identifiers.created.add(254)
        bench.answered((*found, bench.identifiers.has_unknown_ids()), (True, [254], False), "the last one", stop=True)

    verdict = run(uses_all_identifiers_except_one).verdict
    assert verdict is Verdict.PASS


def test_a_crash_violates_no_requirement_that_leaves_a_choice():
    """How an implementation reacts to an unknown type is its own choice (VD-RX-05): to survive it is what is asked."""
    result = one_case("TC_VD_ROB_BI_01-type-0", make=all_mutants()["M-VD-ROB-01-dies-of-type"].make)
    assert result.killed
    failed = {each for check in result.checks if check.verdict is Verdict.FAIL for each in check.requirements}
    assert failed == {"VD-ROB-01"}


class Slow(InProcess):
    """Takes a while to be there after a restart."""

    seconds = 3.0
    ready = 0

    def restart(self) -> None:
        super().restart()
        self.ready = self.now + round(self.seconds * 1e9)

    def deliver(self, octets: bytes) -> None:
        if self.now >= self.ready:
            super().deliver(octets)


class Gone(Slow):
    """Is never there again."""

    seconds = 1e6


NEXT = "TC_VD_STATE_BV_01-unknown.rx-summary"


def died_and_then(kind: type[InProcess], pics: Pics | None = None) -> tuple[Runner, CaseResult]:
    """The runner, and the result of a case that is run after a crash."""
    sut = kind(reference_config(codec_of("dcp-2.0")), make=all_mutants()["M-VD-ROB-01-dies-of-type"].make)
    runner = Runner(Session(codec_of("dcp-2.0"), sut.lower_tester(), None, pics or Pics()), sut)
    runner.prepare()
    killed = runner.run(known_cases()["TC_VD_ROB_BI_01-type-0"]).killed
    assert killed
    return runner, runner.run(known_cases()[NEXT])


def test_a_restarted_implementation_gets_time_to_start():
    runner, result = died_and_then(Slow)
    verdict = result.verdict
    assert verdict is Verdict.PASS, result.reason
    assert "was restarted" in runner.notes[-1]
    assert (runner.restarts, runner.restarting) == (2, False)
    # Its evidence begins with the case.
    assert len([event for event in result.evidence if event.direction == "sent"]) < 4


def test_an_implementation_restarted_before_each_case_gets_time_to_start():
    pics = Pics(pixit=Testing(reset="restart"))
    verdict = died_and_then(Slow, pics)[1].verdict
    assert verdict is Verdict.PASS


def test_an_implementation_that_does_not_come_back_fails_nothing_else():
    runner, result = died_and_then(Gone)
    verdict = result.verdict
    assert verdict is Verdict.INCONCLUSIVE
    assert runner.dead.endswith("died in TC_VD_ROB_BI_01-type-0; after a restart it does not answer within 30 s")
    assert runner.dead in runner.notes
    assert runner.restarting
    assert "TC_VD_ROB_BI_01-type-0" in result.reason


class Stillborn(InProcess):
    """Is dead after a restart."""

    def restart(self) -> None:
        super().restart()
        self.died = "a file is missing"


@pytest.mark.parametrize(
    ("kind", "why"), [(Gone, "does not answer within 30 s"), (Stillborn, "is dead again: a file is missing")]
)
def test_a_case_that_could_not_begin_does_not_fail(kind: type[InProcess], why: str):
    """An implementation that does not come back after a restart was not killed by the next case."""
    sut = kind(reference_config(codec_of("dcp-2.0")))
    pics = Pics(pixit=Testing(reset="restart"))
    runner = Runner(Session(codec_of("dcp-2.0"), sut.lower_tester(), None, pics), sut)
    runner.prepare()
    result = runner.run(known_cases()[NEXT])
    verdict = result.verdict
    assert verdict is Verdict.INCONCLUSIVE
    assert why in result.reason
    assert not result.killed


def test_a_crash_is_reported_with_the_last_sign_of_life():
    """Of many frames sent, those after the last beacon are suspects."""

    def deadly(bench: Bench) -> None:
        peer = bench.peer()
        bench.must("RTDB-Create", varId=bench.identifiers.own_var_id(), repCnt=3, descr="d", value="01")
        bench.required(bench.beacons(2, 5), "beacons")
        peer.send(bench.builder.container(peer.summary(1, 1), ic_type=0))
        peer.send(peer.summary(1, 1))

    sut = InProcess(reference_config(codec_of("dcp-2.0")), make=all_mutants()["M-VD-ROB-01-dies-of-type"].make)
    runner = Runner(Session(codec_of("dcp-2.0"), sut.lower_tester(), sut.upper_tester(), Pics()), sut)
    runner.prepare()
    result = runner.run(case_of(deadly))
    assert result.killed
    assert result.reason.endswith("; its last beacon came before frame 3 of 4")


class Winding(InProcess):
    """Stops sending and receiving in a case; its process ends 200 ms later."""

    stopped = 0

    def send(self, octets: bytes) -> None:
        if not self.stopped:
            super().send(octets)

    def deliver(self, octets: bytes) -> None:
        if not self.stopped:
            super().deliver(octets)

    def alive(self) -> bool:
        return not self.stopped or self.now < self.stopped + 200_000_000

    def restart(self) -> None:
        self.stopped = 0
        super().restart()


def test_an_implementation_that_ends_while_it_is_probed_gets_no_further_probe():
    sut = Winding(reference_config(codec_of("dcp-2.0")))

    def deadly(bench: Bench) -> None:
        sut.stopped = sut.now
        bench.passed("the case ends")

    runner = Runner(Session(codec_of("dcp-2.0"), sut.lower_tester(), sut.upper_tester(), Pics()), sut)
    runner.prepare()
    trial = runner._trial(case_of(deadly))
    assert trial.loss is not None
    assert trial.loss.died
    assert sut.now - sut.stopped <= 1e9


class Counted(InProcess):
    """Counts its restarts."""

    restarts = 0

    def restart(self) -> None:
        self.restarts += 1
        super().restart()


def test_a_known_death_right_after_a_start_needs_no_second_execution():
    """Two cases confirm how it ends; after that the first execution of a case after a start decides."""
    sut = Counted(reference_config(codec_of("dcp-2.0")), make=all_mutants()["M-VD-ROB-01-dies-of-type"].make)
    runner = Runner(Session(codec_of("dcp-2.0"), sut.lower_tester(), None, Pics()), sut)
    runner.prepare()
    counts = []
    for name in ("0", "7", "255", "0", "255"):
        before = sut.restarts
        assert runner.run(known_cases()[f"TC_VD_ROB_BI_01-type-{name}"]).killed
        counts.append(sut.restarts - before)
    # Something was executed since the last start: another case may be the cause.
    assert runner.run(known_cases()[NEXT]).verdict is Verdict.PASS
    before = sut.restarts
    assert runner.run(known_cases()["TC_VD_ROB_BI_01-type-7"]).killed
    assert [*counts, sut.restarts - before] == [2, 2, 1, 1, 1, 2]


class Hanging(Counted):
    """Neither sends nor receives any more after a case has hung it up; its process runs."""

    hung = False

    def send(self, octets: bytes) -> None:
        if not self.hung:
            super().send(octets)

    def deliver(self, octets: bytes) -> None:
        if not self.hung:
            super().deliver(octets)

    def restart(self) -> None:
        self.hung = False
        super().restart()


def test_a_known_silence_right_after_a_start_needs_no_second_execution():
    sut = Hanging(reference_config(codec_of("dcp-2.0")))

    def deadly(bench: Bench) -> None:
        sut.hung = True
        bench.passed("the case ends")

    runner = Runner(Session(codec_of("dcp-2.0"), sut.lower_tester(), None, Pics()), sut)
    runner.prepare()
    assert runner.run(known_cases()[NEXT]).verdict is Verdict.PASS
    counts = []
    for _ in range(4):
        before = sut.restarts
        assert runner.run(case_of(deadly)).killed
        counts.append(sut.restarts - before)
    assert counts == [2, 2, 1, 1]


class Renamed(InProcess):
    """Draws a new identifier with each start, as a node does that was not given one."""

    def restart(self) -> None:
        node_id = (int.from_bytes(self.config.node_id) + 1).to_bytes(6)
        self.config = reference_config(self.config.codec, node_id=node_id)
        super().restart()


def test_a_new_node_identifier_after_a_restart_within_a_case_is_recognised():
    def verdicts(pics: Pics) -> list[Verdict]:
        sut = Renamed(reference_config(codec_of("dcp-2.0")))
        runner = Runner(Session(codec_of("dcp-2.0"), sut.lower_tester(), sut.upper_tester(), pics), sut)
        runner.prepare()
        return [runner.run(known_cases()[name]).verdict for name in ("TC_VD_INI_BV_04", "TC_DCP_SANITY_BV_01")]

    assert verdicts(Pics()) == [Verdict.PASS, Verdict.PASS]
    # A node identifier stated in the PIXIT is checked.
    told = Pics(pixit=Testing(node_id="02:00:00:00:00:01"))
    assert verdicts(told) == [Verdict.INCONCLUSIVE, Verdict.FAIL]
