"""Which case is blamed for a death, and that no result is lost by one."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import pytest
from dcp_conformance.cli.display import print_summary
from dcp_conformance.definitions.case import Case, Kind, Needs
from dcp_conformance.definitions.pics import Pics, Testing
from dcp_conformance.definitions.results import CaseResult, RunResult
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.errors import UpperTesterError
from dcp_conformance.execution.runner import Runner
from dcp_conformance.execution.survival.life import Loss
from dcp_conformance.reference.inprocess import InProcess, VirtualUpperTester, reference_config
from dcp_conformance.reporting.overview import headline, undecided_deaths
from dcp_conformance.test_steps.beacon_gaps import pausable
from dcp_conformance.test_steps.bp_clients import talking
from dcp_conformance.test_system.bench import Bench, Session
from dcp_conformance.upper_tester import Answer, Notification
from dcp_conformance.upper_tester.base import NOT_REACHED
from dcp_selftest.mutants import all_mutants
from dcp_selftest.variants.variant import node_of
from dcp_spec.constants import BP_PROTID_SRP, BP_PROTID_VARDIS

from dcp_stack.bp.entity import BeaconingProtocol

from ..rig import codec_of, one_case

_CLIENT = {"name": "c", "maxPayloadSize": 8, "queueingMode": "BP_QMODE_ONCE", "allowMultiplePayloads": False}
WORD = b"\xde\xad\xbe\xef"
#: Which beacons carry the word, in the order of their cases.
A, B = b"\x01", b"\x02"


class Frail(InProcess):
    """Dies some time after it got a beacon with the word; of the second kind only after one of the first."""

    delay_ms = 0
    needs_both = False
    times = 1_000_000
    """Deaths until it has become immune."""
    cause = "RuntimeError: a word"

    def __init__(self) -> None:
        self.at: int | None = None
        self.got: list[bytes] = []
        super().__init__(reference_config(codec_of("dcp-2.0")))

    def restart(self) -> None:
        self.at, self.got = None, []
        super().restart()

    def deliver(self, octets: bytes) -> None:
        if WORD in octets and not self.died and self.times:
            self.got.append(octets[octets.index(WORD) + len(WORD) :][:1])
            if not self.needs_both or self.got == [A, B]:
                self.times -= 1
                self.at = self.now + self.delay_ms * 1_000_000
                self._end_if_due()
        super().deliver(octets)

    def _end_if_due(self) -> None:
        if self.at is not None and self.now >= self.at:
            self.died, self.at = self.cause, None
            self.arrivals.clear()

    def advance(self, until: int) -> None:
        if self.at is not None and self.at <= until and not self.arrivals:
            super().advance(self.at)
            self._end_if_due()
            if self.arrivals:
                return
        super().advance(until)

    def alive(self) -> bool:
        self._end_if_due()
        return super().alive()


def case_of(name: str, body: Callable[[Bench], None], *requirements: str) -> Case:
    return Case(name, "", requirements or ("VD-PS-01",), Kind.VALID, "", "", 4, "", __name__, body)


def says(word: bytes, *, expect: bool = True) -> Callable[[Bench], None]:
    """Send the word; ``expect``: and something that is answered at once."""

    def body(bench: Bench) -> None:
        peer = bench.peer()
        summary = peer.summary(bench.unknown_id(), 1)
        peer.send(summary, padding=WORD + word)
        if expect:
            bench.verdicts.check(bench.beacons(1), "a beacon", "none")

    return body


def teaches(bench: Bench) -> None:
    peer = bench.peer()
    bench.learn(peer, peer.create(bench.var_id()))


def asks(bench: Bench) -> None:
    bench.verdicts.check(bench.probes.probe(), "an answer", "none")


def runner_of(sut: InProcess, *, upper: bool = False, pics: Pics | None = None, can_restart: bool = True) -> Runner:
    sut.can_restart = can_restart
    session = Session(codec_of("dcp-2.0"), sut.lower_tester(), sut.upper_tester() if upper else None, pics or Pics())
    runner = Runner(session, sut)
    runner.prepare()
    return runner


def results_of(runner: Runner, *cases: Case) -> dict[str, CaseResult]:
    """Results of cases at the end of a run."""
    found: dict[str, CaseResult] = {}
    for case in cases:
        found[case.id] = runner.run(case)
        found.update((each.id, each) for each in runner.take_revised())
    runner.finish()
    found.update((each.id, each) for each in runner.take_revised())
    return found


class EndsBySending(BeaconingProtocol):
    """Ends when it should send a payload of a client other than SRP and VarDis."""

    _submitted = False

    def transmit_payload(self, prot_id: int, *args: Any, **more: Any) -> Any:
        self._submitted = self._submitted or prot_id not in (BP_PROTID_SRP, BP_PROTID_VARDIS)
        return super().transmit_payload(prot_id, *args, **more)

    def handle_timeout(self, now: int, wall: int) -> None:
        if self._submitted:
            raise RuntimeError("a payload of a client")
        super().handle_timeout(now, wall)


def submits_and_asks(bench: Bench) -> None:
    with talking(bench, clients=1):
        bench.probes.probe()
        bench.required(bench.beacons(3), "three beacons")


@pytest.mark.parametrize("known", [True, False])
def test_a_frame_that_was_survived_before_is_not_blamed_instead_of_a_call(known: bool):
    sut = InProcess(reference_config(codec_of("dcp-2.0")), make=node_of(EndsBySending))
    runner = runner_of(sut, upper=True)
    cases = [case_of("TC_X_1", asks), case_of("TC_X_2", teaches)] if known else []
    found = results_of(runner, *cases, case_of("TC_X_3", submits_and_asks, "BP-HDR-04"))["TC_X_3"]
    assert found.verdict is Verdict.FAIL
    blamed = {each for check in found.checks if check.verdict is Verdict.FAIL for each in check.requirements}
    assert ("VD-ROB-01" in blamed) is not known
    # Its clients have a buffer.
    assert ("BP-TXP-06" in blamed) is known


FIRST, SECOND = case_of("TC_DCP_X_BV_01", says(A)), case_of("TC_DCP_X_BV_02", asks)


@pytest.mark.parametrize("delay_ms", [120, 400, 1000])
@pytest.mark.parametrize("more", [1, 3, 6])
def test_a_delayed_crash_is_attributed_to_its_cause(delay_ms: int, more: int):
    """However many cases were begun in between, and if the run has come to its end."""
    sut = Frail()
    sut.delay_ms = delay_ms
    runner = runner_of(sut)
    found = results_of(runner, FIRST, *[SECOND] * more)
    assert found[SECOND.id].verdict is Verdict.PASS
    assert not found[SECOND.id].killed
    first = found[FIRST.id]
    assert (first.verdict, first.killed) == (Verdict.FAIL, True)
    failed = [check for check in first.checks if check.verdict is Verdict.FAIL]
    assert [check.expected for check in failed] == ["the implementation survives"]
    # The VarDis payload crashed it.
    assert failed[0].requirements == ("VD-ROB-01",)
    assert "RuntimeError: a word" in failed[0].observed
    assert any("in TC_DCP_X_BV_01" in note for note in runner.notes)


def test_a_passing_case_followed_by_silence_is_examined():
    """It expects silence, and gets it from a dead implementation."""
    runner = runner_of(Frail())
    silent = case_of("TC_DCP_X_BV_03", says(A, expect=False))
    body = silent.run

    def expects_silence(bench: Bench) -> None:
        body(bench)
        bench.verdicts.check(not bench.beacons(3, 3), "no beacon", "one")

    found = results_of(runner, dataclasses.replace(silent, run=expects_silence), SECOND)
    assert found["TC_DCP_X_BV_03"].killed
    assert found[SECOND.id].verdict is Verdict.PASS


def test_two_cases_that_kill_only_together():
    sut = Frail()
    sut.needs_both = True
    second = case_of("TC_DCP_X_BV_04", says(B))
    found = results_of(runner_of(sut), FIRST, second, SECOND)
    assert found[FIRST.id].verdict is Verdict.PASS
    assert found[second.id].killed
    assert f"(only when it follows {FIRST.id})" in found[second.id].reason
    assert found[SECOND.id].verdict is Verdict.PASS


def test_a_crash_that_is_not_reproduced_is_inconclusive():
    sut = Frail()
    sut.times = 1
    runner = runner_of(sut)
    found = results_of(runner, SECOND, FIRST)
    first = found[FIRST.id]
    assert (first.verdict, first.killed) == (Verdict.INCONCLUSIVE, False)
    assert "not reproduced from a fresh start" in first.reason
    assert any("was not reproduced" in note for note in runner.notes)
    assert found[SECOND.id].verdict is Verdict.PASS


def test_checks_that_fail_because_of_a_crash_are_inconclusive():
    def body(bench: Bench) -> None:
        says(A, expect=False)(bench)
        bench.verdicts.check(bench.probes.probe(), "an answer", "none", "VD-RX-03")

    result = runner_of(Frail()).run(case_of("TC_DCP_X_BV_05", body, "VD-RX-03", "VD-RX-04"))
    failed = {each for check in result.checks if check.verdict is Verdict.FAIL for each in check.requirements}
    # VD-RX-03 is the first requirement of the case: the implementation owed the reaction.
    assert failed == {"VD-ROB-01", "VD-RX-03"}
    death, answer = (check for check in result.checks if "VD-RX-03" in check.requirements)
    assert (death.verdict, answer.verdict) == (Verdict.FAIL, Verdict.INCONCLUSIVE)


def test_similar_crashes_are_reported_as_one():
    sut = Frail()
    runner = runner_of(sut)
    cases = [case_of(f"TC_DCP_X_BV_{number}", says(A)) for number in range(10, 20)]
    for number, case in enumerate(cases):
        sut.cause = f"RuntimeError: a word at 0x{number:08x}, line {number}"
        assert runner.run(case).killed
    assert len({runner.run(case).death for case in cases}) == 1
    [note] = runner.notes
    assert note.startswith("the implementation died in 20 cases in the same way (RuntimeError: a word at #")
    assert "and 14 more" in note


@pytest.mark.parametrize("delay_ms", [0, 150])
def test_without_a_restart_a_crash_with_several_suspects_fails_no_requirement(delay_ms: int):
    sut = Frail()
    sut.delay_ms = delay_ms
    runner = runner_of(sut, can_restart=False)
    found = results_of(runner, SECOND, FIRST, dataclasses.replace(SECOND, id="TC_DCP_X_BV_06"))
    dead = [each for each in found.values() if each.killed]
    assert len(dead) == 1
    assert "not confirmed: there is no command to start it again (--start, --restart); the cause" in dead[0].reason
    assert not any(check.requirements for check in dead[0].checks if check.verdict is Verdict.FAIL)
    assert "no command to restart it" in runner.dead


def test_without_a_restart_the_only_case_is_blamed():
    result = runner_of(Frail(), can_restart=False).run(FIRST)
    assert result.killed
    assert result.checks[0].requirements == ("VD-ROB-01", "VD-PS-01")


class HungUp:
    """An upper tester that goes down with the implementation."""

    def __init__(self, sut: InProcess) -> None:
        self._sut = sut
        self._real = sut.upper_tester()
        self.name, self.methods, self.about = self._real.name, self._real.methods - {"UT-Reset"}, self._real.about

    def _check(self) -> None:
        if self._sut.died:
            raise UpperTesterError("unix:adapter: it has closed the connection")

    def call(self, method: str, params: dict[str, object]) -> Answer:
        self._check()
        return self._real.call(method, params)

    def poll(self) -> list[object]:
        self._check()
        return self._real.poll()

    def filenos(self) -> tuple[int, ...]:
        return ()

    def another(self) -> None:
        return None

    def close(self) -> None:
        self._real.close()


@pytest.mark.parametrize("delay_ms", [0, 20, 150, 400, 900])
@pytest.mark.parametrize("reset", ["auto", "restart"])
def test_results_are_kept_when_the_upper_tester_ends_with_the_implementation(delay_ms: int, reset: str):
    sut = Frail()
    sut.delay_ms = delay_ms
    session = Session(codec_of("dcp-2.0"), sut.lower_tester(), HungUp(sut), Pics(pixit=Testing(reset=reset)))  # type: ignore[arg-type]
    runner = Runner(session, sut)
    runner.prepare()
    found = results_of(runner, SECOND, FIRST, dataclasses.replace(SECOND, id="TC_DCP_X_BV_06"), SECOND)
    assert set(found) == {FIRST.id, SECOND.id, "TC_DCP_X_BV_06"}
    assert found["TC_DCP_X_BV_06"].verdict is Verdict.PASS
    assert found[SECOND.id].verdict is Verdict.PASS
    if reset == "auto":
        assert found[FIRST.id].killed


def test_an_error_of_the_tester_between_cases_is_a_result():
    runner = runner_of(Frail())
    runner.life.loss = None  # type: ignore[assignment,method-assign]
    result = runner.run(SECOND)
    assert result.verdict is Verdict.ERROR
    assert "TypeError" in result.error_detail


def test_a_failure_proved_by_a_received_frame_is_kept():
    def body(bench: Bench) -> None:
        bench.verdicts.check(False, "the right octets", "others", "VD-RX-03", shown=True)
        says(A, expect=False)(bench)

    result = runner_of(Frail()).run(case_of("TC_DCP_X_BV_05", body, "VD-RX-03"))
    failed = {each for check in result.checks if check.verdict is Verdict.FAIL for each in check.requirements}
    assert failed == {"VD-ROB-01", "VD-RX-03"}


def test_failures_of_the_case_are_kept_when_a_service_crashes_the_implementation():
    """No requirement asks for surviving a service, so only the failures of the case itself are reported."""
    sut = Frail()

    def body(bench: Bench) -> None:
        bench.call("UT-Hello")
        sut.died = "RuntimeError: a service"
        bench.verdicts.check(bench.probes.probe(), "an answer", "none", "VD-RX-03")

    runner = runner_of(sut, upper=True)
    result = runner.run(case_of("TC_DCP_X_BV_05", body, "VD-RX-03", "VD-RX-04"))
    assert result.killed
    failed = {each for check in result.checks if check.verdict is Verdict.FAIL for each in check.requirements}
    assert "VD-RX-04" not in failed


def uses_all(bench: Bench) -> None:
    for _ in range(60):
        peer = bench.peer()
        peer.send(peer.create(bench.unknown_id()))
        bench.wait(1)
    bench.verdicts.check(True, "60 variables")


@pytest.mark.parametrize(("reset", "verdict"), [("auto", Verdict.PASS), ("none", Verdict.INCONCLUSIVE)])
def test_the_implementation_is_restarted_when_identifiers_are_used_up(reset: str, verdict: Verdict):
    sut = InProcess(reference_config(codec_of("dcp-2.0")))
    runner = runner_of(sut, pics=Pics(pixit=Testing(reset=reset)))
    cases = [case_of(f"TC_DCP_X_BV_{number}", uses_all) for number in range(10, 20)]
    results = [runner.run(case) for case in cases]
    assert results[0].verdict is Verdict.PASS
    assert results[-1].verdict is verdict
    assert any("when all identifiers of variables had been used" in note for note in runner.notes) == (reset == "auto")
    if reset == "none":
        assert "provide UT-Reset" in results[-1].reason


class FailingServices(HungUp):
    """Once a service has failed, each one fails until the implementation is restarted."""

    def call(self, method: str, params: dict[str, object]) -> Answer:
        if method == "RTDB-Read":
            self._sut.refuses = True
        if self._sut.refuses and method.startswith("RTDB"):
            return Answer(code=-32603, message="trying to pop from an empty buffer")
        return super().call(method, params)


class Queue(InProcess):
    refuses = False

    def restart(self) -> None:
        self.refuses = False
        super().restart()


def test_an_internal_error_does_not_affect_later_cases():
    sut = Queue(reference_config(codec_of("dcp-2.0")))
    session = Session(codec_of("dcp-2.0"), sut.lower_tester(), FailingServices(sut), Pics())  # type: ignore[arg-type]
    runner = Runner(session, sut)
    runner.prepare()

    def reads(bench: Bench) -> None:
        bench.info("the answer to RTDB-Read", str(bench.call("RTDB-Read", varId=1)))

    def creates(bench: Bench) -> None:
        bench.must("RTDB-Create", varId=bench.identifiers.own_var_id(), repCnt=1, descr="d", value="01")
        bench.verdicts.check(True, "a variable is created")

    found = results_of(runner, case_of("TC_DCP_X_BV_10", reads), case_of("TC_DCP_X_BV_11", creates))
    assert found["TC_DCP_X_BV_11"].verdict is Verdict.PASS


def failed_in(result: CaseResult) -> set[str]:
    """The requirements that failed checks name."""
    return {each for check in result.checks if check.verdict is Verdict.FAIL for each in check.requirements}


@pytest.mark.parametrize(
    ("calls", "requirements", "violated"),
    [
        ("RTDB-DescribeDatabase", "VD-RX-03 VD-RX-04", "VD-DDB-02 VD-RX-04"),
        # VD-DDB-03 is optional: nothing violates it.
        ("RTDB-DescribeDatabase", "VD-RX-03 VD-DDB-03 VD-DDB-02", "VD-DDB-02"),
        # Silence of a dead implementation proves nothing.
        ("BP-RegisterProtocol BP-ClearBuffer", "BP-QM-05 VD-RX-03 BP-CLR-03", "BP-CLR-03"),
        ("BP-RegisterProtocol BP-ClearBuffer", "BP-QM-05", "BP-CLR-02 BP-QM-05"),
        ("BP-ClearBuffer", "BP-QM-05", "BP-CLR-03 BP-QM-05"),
        ("BP-RegisterProtocol BP-TransmitPayload", "BP-QM-05", "BP-TXP-09 BP-QM-05"),
        # The client of a case is deregistered after it.
        ("BP-TransmitPayload BP-DeregisterProtocol", "BP-QM-05", "BP-TXP-09 BP-QM-05"),
        ("BP-TransmitPayload BP-DeregisterProtocol", "BP-DRG-03", "BP-DRG-03"),
        ("RTDB-Update", "VD-RX-03", "VD-UPD-08"),
        ("BP-MGMT-Deactivate", "VD-RX-03", "BP-MGT-01"),
        ("UT-Hello", "VD-RX-03", ""),
    ],
)
def test_a_service_that_kills_fails_its_own_requirement(calls: str, requirements: str, violated: str):
    sut = Frail()

    def body(bench: Bench) -> None:
        bench.verdicts.check(True, "something else", "", "VD-RX-03", "BP-CLR-03")
        queue = {**_CLIENT, "queueingMode": "BP_QMODE_QUEUE_DROPTAIL", "maxEntries": 2}
        for method in calls.split():
            bench.call(method, protId=300, **(queue if method == "BP-RegisterProtocol" else {}))
        sut.died = "RuntimeError: a service"

    case = case_of("TC_DCP_X_BV_05", body, *requirements.split())
    result = runner_of(sut, upper=True).run(dataclasses.replace(case, needs=Needs(ut=tuple(calls.split()))))
    assert result.killed
    # Also that of the case, unless the call only prepares it, a check has shown it, or the case is about the call.
    assert failed_in(result) == set(violated.split())
    assert result.reason.startswith("the implementation survives")


class Failing(InProcess):
    """Fails at a given call, and cannot be reached afterwards, although its adapter answers."""

    fatal, answers = "BP-TransmitPayload", True

    def __init__(self) -> None:
        super().__init__(reference_config(codec_of("dcp-2.0")))

    def upper_tester(self) -> Any:
        upper = super().upper_tester()
        called, sut = upper.call, self

        def call(method: str, params: dict[str, Any]) -> Answer:
            if sut.died:
                return Answer(code=NOT_REACHED, message="cannot connect to socket bp.sock")
            if method == sut.fatal:
                answer = called(method, params)
                sut.died = "RuntimeError: a service"
                if not sut.answers:
                    raise UpperTesterError("no answer")
                return answer
            return called(method, params)

        upper.call = call  # type: ignore[method-assign]
        return upper


_PARAMETERS: dict[str, dict[str, Any]] = {
    "BP-RegisterProtocol": {"protId": 300, "maxEntries": 0, **_CLIENT},
    "BP-TransmitPayload": {"protId": 300, "payload": "01"},
    "BP-DeregisterProtocol": {"protId": 300},
    "RTDB-Create": {"varId": 9, "repCnt": 1, "descr": "d", "value": "01", "timeout": 0},
    "RTDB-Update": {"varId": 9, "value": "01"},
}


@pytest.mark.parametrize(
    ("calls", "fatal", "answers", "requirements", "violated"),
    [
        # The next call finds out that the implementation is gone: it, or the call before, may be the cause.
        ("BP-RegisterProtocol BP-TransmitPayload RTDB-Update", "BP-TransmitPayload", True, "BP-QM-05", ""),
        # Deregistration restores the initial state.
        ("BP-RegisterProtocol BP-TransmitPayload BP-DeregisterProtocol", "BP-TransmitPayload", True, "", "BP-TXP-06"),
        # Queries that were answered, also those of which the case is about.
        ("BP-MGMT-Deactivate SRP-NeighbourTable", "SRP-NeighbourTable", True, "SRP-NT-01", "BP-MGT-01"),
        # A requirement with a passed check, and a call without an answer.
        ("BP-RegisterProtocol", "BP-RegisterProtocol", False, "BP-REG-05", "BP-REG-06"),
        # A requirement that is optional.
        ("RTDB-Create", "RTDB-Create", False, "VD-CRE-15", "VD-CRE-14"),
    ],
)
def test_a_death_names_the_requirement_that_it_violates(
    calls: str, fatal: str, answers: bool, requirements: str, violated: str
):
    sut = Failing()
    sut.fatal, sut.answers = fatal, answers

    def body(bench: Bench) -> None:
        bench.verdicts.check(True, "something", "", "BP-REG-05")
        for method in calls.split():
            bench.must(method, **_PARAMETERS.get(method, {}))

    case = case_of("TC_DCP_X_BV_05", body, *requirements.split())
    result = runner_of(sut, upper=True).run(dataclasses.replace(case, needs=Needs(ut=tuple(calls.split()))))
    assert result.killed
    assert failed_in(result) == set(violated.split())


@pytest.mark.parametrize(("beacons", "violated"), [(1, {"VD-ROB-01", "VD-RX-03"}), (8, set())])
def test_a_frame_that_was_outlived_by_several_beacons_is_not_blamed(beacons: int, violated: set[str]):
    sut = Frail()

    def body(bench: Bench) -> None:
        # The variable is in each beacon.
        teaches(bench)
        peer = bench.peer()
        peer.send(peer.summary(bench.unknown_id(), 1))
        bench.wait(beacons)
        sut.died = "RuntimeError: a clock"

    result = runner_of(sut).run(case_of("TC_DCP_X_BV_05", body, "VD-RX-03"))
    assert result.killed
    assert failed_in(result) == violated


@pytest.mark.parametrize(
    ("mode", "violated"), [("BP_QMODE_ONCE", "BP-QRY-03"), ("BP_QMODE_QUEUE_DROPTAIL", "BP-QRY-02")]
)
def test_a_status_that_the_specification_lacks_violates_the_requirement_about_the_service(mode: str, violated: str):
    """Such an answer tells nothing about the subject of the case."""
    sut = InProcess(reference_config(codec_of("dcp-2.0")))
    upper = sut.upper_tester()
    called = upper.call
    upper.call = lambda method, params: (  # type: ignore[method-assign]
        Answer(status="BP-STATUS-CODE-0") if method == "BP-QueryNumberBufferedPayloads" else called(method, params)
    )
    session = Session(codec_of("dcp-2.0"), sut.lower_tester(), upper, Pics())
    bench = Bench(session, case_of("TC_DCP_X_BV_05", lambda bench: None, "BP-DRG-05"))
    registration = {
        "name": "c",
        "maxPayloadSize": 8,
        "queueingMode": mode,
        "maxEntries": 2,
        "allowMultiplePayloads": False,
    }
    bench.must("BP-RegisterProtocol", protId=300, **registration)
    bench.expect_status("BP-STATUS-OK", "BP-QueryNumberBufferedPayloads", "BP-REG-06", "BP-DRG-05", protId=300)
    (check,) = bench.verdicts.checks
    assert (check.verdict, check.requirements) == (Verdict.FAIL, (violated,))
    # A registration that was refused changes nothing.
    other = {"BP_QMODE_ONCE": "BP_QMODE_QUEUE_DROPTAIL", "BP_QMODE_QUEUE_DROPTAIL": "BP_QMODE_ONCE"}[mode]
    assert not bench.call("BP-RegisterProtocol", protId=300, **{**registration, "queueingMode": other}).ok
    bench.expect_status("BP-STATUS-OK", "BP-QueryNumberBufferedPayloads", "BP-REG-06", "BP-DRG-05", protId=300)
    assert bench.verdicts.checks[-1].requirements == (violated,)
    bench.expect_status("BP-STATUS-OK", "BP-QueryNumberBufferedPayloads", "BP-QRY-01", "BP-DRG-05", protId=300)
    assert bench.verdicts.checks[-1].requirements == ("BP-QRY-01",)


@pytest.mark.parametrize(("heard", "about"), [(False, False), (True, True)])
def test_a_frame_after_a_service_kills(heard: bool, about: bool):
    """The case only uses the service, or the implementation was heard after the call."""
    sut = Frail()

    def body(bench: Bench) -> None:
        bench.call("RTDB-Create", varId=bench.identifiers.own_var_id(), repCnt=1, descr="d", value="01")
        if heard:
            bench.beacons(1)
        says(A, expect=False)(bench)

    case = case_of("TC_DCP_X_BV_05", body, "VD-CRE-09" if about else "VD-RX-03")
    result = runner_of(sut, upper=True).run(dataclasses.replace(case, needs=Needs(ut=("RTDB-Create",))))
    assert result.killed
    assert failed_in(result) == {"VD-ROB-01", *case.requirements}


@pytest.mark.parametrize(("about", "violated"), [(False, "VD-ROB-01 VD-RX-03"), (True, "VD-DDB-01")])
def test_a_call_to_an_implementation_that_a_frame_has_crashed(about: bool, violated: str):
    """A case that only uses the service finds out by it that the implementation is dead."""
    sut = Frail()

    def body(bench: Bench) -> None:
        bench.beacons(1)
        says(A, expect=False)(bench)
        bench.call("RTDB-DescribeDatabase")

    case = case_of("TC_DCP_X_BV_05", body, "VD-DDB-01" if about else "VD-RX-03")
    result = runner_of(sut, upper=True).run(dataclasses.replace(case, needs=Needs(ut=("RTDB-DescribeDatabase",))))
    assert result.killed
    assert failed_in(result) == set(violated.split())


class Detached(Frail):
    """An implementation whose process is unknown to the tester."""

    told = False
    """Whether its adapter was seen to go."""

    def restart(self) -> None:
        self.told = False
        super().restart()

    def alive(self) -> bool:
        super().alive()
        return None  # type: ignore[return-value]


class Leaving(VirtualUpperTester):
    """An adapter that ends after the deadly frame has arrived, before the implementation crashes on it.

    The tester needs five seconds to notice that the connection is closed.
    """

    def _gone(self) -> None:
        sut = self._sut
        if isinstance(sut, Frail) and sut.got:
            sut.elapse(5_000_000_000)
            sut.alive()
            raise UpperTesterError("no listener there, after 5 s")

    def call(self, method: str, params: dict[str, Any]) -> Answer:
        self._gone()
        return super().call(method, params)

    def poll(self) -> list[Notification]:
        sut = self._sut
        if isinstance(sut, Detached) and sut.got and not sut.told:
            sut.told = True
            raise UpperTesterError("closed by the other side")
        return super().poll()


def test_an_answer_before_reconnecting_to_the_upper_tester_is_not_a_sign_of_life():
    """The adapter ends first; the implementation dies while the tester tries to reach the adapter."""
    sut = Detached()
    sut.delay_ms = 2600
    session = Session(codec_of("dcp-2.0"), sut.lower_tester(), Leaving(sut), Pics())
    runner = Runner(session, sut)
    runner.prepare()
    first = results_of(runner, SECOND, FIRST)[FIRST.id]
    assert first.killed
    assert first.reason == "the implementation survives: it does not answer any more"


def test_crashes_are_grouped_whatever_the_order_of_output_lines():
    said = ["Running BP | [fatal] no room in 0x7ffe | BP ended", "Running SRP | Running BP | [fatal] no room in 0x1"]
    losses = [Loss(True, "dead", f"it ended with signal SIGABRT; its output: {words}") for words in said]
    assert len({each.group for each in losses}) == 1
    assert losses[0].group == "died: it ended with signal SIGABRT; its output: [fatal] no room in #"


def test_no_identifier_is_used_twice_between_restarts():
    sut = InProcess(reference_config(codec_of("dcp-2.0")))
    runner = runner_of(sut)
    given: list[list[int]] = [[]]
    restart = sut.restart

    def note_restart() -> None:
        given.append([])
        restart()

    sut.restart = note_restart  # type: ignore[method-assign]

    def creates(bench: Bench) -> None:
        names = bench.identifiers.var_ids(50)
        given[-1] += names
        peer = bench.peer()
        peer.send_all(peer.create(name) for name in names)
        bench.wait(2)
        bench.verdicts.check(True, "50 variables")

    for number in range(10, 22):
        assert runner.run(case_of(f"TC_DCP_X_BV_{number}", creates)).verdict is Verdict.PASS
    assert len(given) > 3
    assert all(len(names) == len(set(names)) for names in given)


def test_a_crash_by_an_auxiliary_service_does_not_fail_the_requirements_of_the_case():
    """Deactivating BP between two beacons is a means of the tester: what it kills fails the deactivation."""
    sut = Frail()

    def body(bench: Bench) -> None:
        bench.call("BP-MGMT-Deactivate")
        sut.died = "RuntimeError: a service"
        bench.verdicts.check(bench.probes.probe(), "an answer", "none", "VD-RX-03")

    case = dataclasses.replace(case_of("TC_DCP_X_BV_05", body, "VD-RX-03"), needs=Needs(ut=("RTDB-Update",)))
    runner = runner_of(sut, upper=True)
    result = runner.run(case)
    assert result.killed
    assert failed_in(result) == {"BP-MGT-01"}
    # From now on cases do without it.
    assert not pausable(Bench(runner.session, SECOND))


def test_one_hanging_call_does_not_make_the_upper_tester_slow():
    session = runner_of(Frail(), upper=True).session
    assert (session.typical_call, session.slow_call) == (0, 0)
    session.call_times.extend([1_000_000] * 20 + [1_000_000_000])
    assert session.typical_call == session.slow_call == 1_000_000


def test_a_crash_without_a_violated_requirement_is_reported_separately(capsys: pytest.CaptureFixture[str]):
    sut = Frail()

    def body(bench: Bench) -> None:
        bench.call("UT-Hello")
        sut.died = "RuntimeError: a service"

    dead = runner_of(sut, upper=True).run(
        dataclasses.replace(case_of("TC_DCP_X_BV_05", body), needs=Needs(ut=("UT-Hello",)))
    )
    died_of_a_frame = runner_of(Frail()).run(FIRST)
    assert undecided_deaths(RunResult(cases=(died_of_a_frame,))) == ""
    run = RunResult(cases=(dead, died_of_a_frame))
    line = "the implementation did not survive 1 case, which no requirement decides: TC_DCP_X_BV_05"
    assert headline(run).endswith(line)
    print_summary(run)
    assert f"died: {line}\n" in capsys.readouterr().out


class Stalled(Frail):
    """Hears nothing for some seconds after the word."""

    seconds = 8.0
    deaf_until = 0

    def deliver(self, octets: bytes) -> None:
        if WORD in octets:
            self.deaf_until = self.now + round(self.seconds * 1e9)
        elif self.now >= self.deaf_until:
            InProcess.deliver(self, octets)


@pytest.mark.parametrize("seconds", [8.0, 100.0])
def test_without_a_restart_a_silent_implementation_is_waited_for(seconds: float):
    """A silence of seconds may be caused by the machine; the run continues afterwards."""
    sut = Stalled()
    sut.seconds = seconds
    runner = runner_of(sut, can_restart=False)

    def body(bench: Bench) -> None:
        says(A, expect=False)(bench)
        bench.verdicts.check(bench.probes.probe(), "an answer", "none", "VD-RX-03")

    first, second = case_of("TC_DCP_X_BV_05", body, "VD-RX-03"), dataclasses.replace(SECOND, id="TC_DCP_X_BV_06")
    found = results_of(runner, SECOND, first, second)
    if seconds > 50:
        assert runner.dead
        return
    assert found[first.id].verdict is Verdict.INCONCLUSIVE
    assert "it answered again after " in found[first.id].reason
    assert not failed_in(found[first.id])
    assert found[second.id].verdict is Verdict.PASS
    assert not runner.dead


def test_a_death_names_the_requirement_of_the_reaction_that_was_missing():
    """A check that passed for lack of frames does not show the requirement of the case."""
    name = "TC_BP_TX_BV_01-one-octet"
    result = one_case(name, "dcp-2.0", all_mutants()["M-BP-TX-04-dies-of-overflow"].make)
    (death, *others) = result.checks
    assert death.verdict is Verdict.FAIL
    assert "BP-TX-04" in death.requirements
    assert any(each.verdict is Verdict.PASS and each.requirements == ("BP-TX-04",) for each in others)
