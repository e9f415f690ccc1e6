"""Cases that are executed concurrently get the same verdicts as in succession."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import Future
from typing import Any, ClassVar

import pytest
from dcp_conformance.definitions.case import SANITY, Case, all_cases
from dcp_conformance.definitions.results import CaseResult
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.errors import LowerTesterError, NoAnswerError, UpperTesterError
from dcp_conformance.execution.concurrent import WIDTH, why_alone
from dcp_conformance.execution.concurrent.executor import SideBySide
from dcp_conformance.execution.concurrent.scheduler import Scheduler, Task
from dcp_conformance.execution.concurrent.shared import SharedLink, SharedUpper
from dcp_conformance.execution.concurrent.sharing import ALONE
from dcp_conformance.execution.run import ConformanceRun
from dcp_conformance.execution.selection import Selection
from dcp_conformance.execution.target import TargetOptions
from dcp_conformance.frames.received import ReceivedBeacon
from dcp_conformance.lower_tester import Arrival, LinkHealth
from dcp_conformance.reference.inprocess import InProcess, VirtualUpperTester, reference_config
from dcp_conformance.test_system.control import Control
from dcp_conformance.upper_tester import Answer
from dcp_conformance.upper_tester.base import NOT_REACHED
from dcp_selftest.mutants import all_mutants
from dcp_selftest.runner import Suite, cases
from dcp_selftest.side_by_side import compare

from dcp_codec.codec import Codec

from ...parts import every
from ..rig import sampled_cases

#: Mutants of each kind: wrong octets, missing reactions, too many of them, queues, time, deaths.
MUTANTS = (
    "M-BP-HDR-01-two",
    "M-VD-RU-03-equal-answered",
    "M-VD-CMP-06-one-more",
    "M-VD-SCR-03-half",
    "M-SRP-NT-02-stumbles",
    "M-VD-INI-02-mode",
    "M-BP-QM-03-drophead-repeats",
    "M-VD-PD-04-summaryQ",
    "M-BP-TX-04-hangs",
)


def run(side_by_side: int, *patterns: str, profile: str | None = None, **more) -> ConformanceRun:
    found = ConformanceRun(
        TargetOptions(in_process=True, profile=profile), Selection(patterns=patterns), side_by_side=side_by_side, **more
    )
    found.execute()
    return found


@pytest.mark.part("suite")
@pytest.mark.parametrize(
    ("profile", "chosen"), [("dcp-2.0", cases()), ("dcp-1.0", sampled_cases(0))], ids=["2.0", "1.0"]
)
def test_our_node_gets_the_same_verdicts(profile: str, chosen: Sequence[Case]) -> None:
    assert compare(None, profile, chosen).differences == ()


@pytest.mark.parametrize("mutant", every(4, MUTANTS))
def test_a_mutant_is_detected_in_a_concurrent_run(mutant: str) -> None:
    mutants = all_mutants()
    assert mutant in mutants
    assert compare(mutants[mutant], mutants[mutant].profile, cases(), companions=20).killed == (True, True)


@pytest.mark.part("suite")
def test_most_cases_pass_concurrently_and_each_has_one_result() -> None:
    found = run(WIDTH)
    assert not found.trouble
    results = Counter(result.id for result in found.results)
    assert results.pop(SANITY) == 2
    assert set(results.values()) == {1}
    assert set(results) == {case.id for case in found.selected if case.id != SANITY}
    beside = [result for result in found.results if result.side_by_side]
    assert len(beside) > 0.7 * len(found.results)
    assert all(result.verdict is Verdict.PASS for result in beside)
    assert any(f"{len(beside)} cases passed while others were executed" in note for note in found.result().notes)


def test_cases_that_do_not_pass_concurrently_are_repeated_alone() -> None:
    found = run(WIDTH, "TC_BP_REG_*", "TC_SRP_NT_BV_03")
    # It reports what it has seen, which is not a plain pass.
    assert found.repeated_alone.keys() == {"TC_SRP_NT_BV_03"}
    result = next(each for each in found.results if each.id == "TC_SRP_NT_BV_03")
    assert result.verdict is Verdict.INFO
    assert not result.side_by_side


def test_a_case_with_a_call_that_did_not_arrive_is_repeated_alone(monkeypatch) -> None:
    """The implementation may have ended, although the case passes: it only asks which values are accepted."""
    called = VirtualUpperTester.call

    def call(self: VirtualUpperTester, method: str, params: dict[str, Any]) -> Answer:
        if method == "BP-RegisterProtocol" and params["maxEntries"] > 200:
            return Answer(code=NOT_REACHED, message="cannot connect")
        return called(self, method, params)

    monkeypatch.setattr(VirtualUpperTester, "call", call)
    found = run(WIDTH, "TC_BP_REG_BV_05", "TC_VD_STATE_BV_03-*")
    assert found.repeated_alone.keys() == {"TC_BP_REG_BV_05"}


@pytest.mark.part("suite")
def test_each_case_that_depends_on_the_room_in_beacons_declares_it(monkeypatch) -> None:
    asked: set[str] = set()

    def noted(_: Control) -> None:
        running.add("")

    running: set[str] = set()
    monkeypatch.setattr(Control, "needs_whole_beacons", noted)
    for profile in ("dcp-2.0", "dcp-1.0"):
        for result in Suite(profile).run(cases()):
            if running:
                asked.add(result.id)
            running.clear()
    assert len(asked) > 20
    assert [each for each in sorted(asked) if not why_alone(all_cases()[each])] == []


def test_a_case_that_depends_on_the_room_in_beacons_does_not_pass_beside_others(monkeypatch) -> None:
    # Even if it does not declare that.
    monkeypatch.setattr("dcp_conformance.execution.concurrent.executor.why_alone", lambda _: "")
    found = run(WIDTH, "TC_BP_TX_BV_01-one-octet", "TC_VD_STATE_BV_03-*")
    assert found.repeated_alone.keys() == {"TC_BP_TX_BV_01-one-octet"}
    assert "take room in the beacons" in found.repeated_alone["TC_BP_TX_BV_01-one-octet"]


def test_cases_that_change_the_whole_node_run_alone() -> None:
    for case in all_cases().values():
        if ALONE & set(case.needs.ut) or case.needs.restart or case.needs.link:
            assert why_alone(case), case.id


@pytest.mark.parametrize("name", ["TC_BP_RXP_BV_05-VarDis", "TC_VD_SRV_BO_01"])
def test_vardis_stays_registered_while_others_are_executed(monkeypatch, name: str) -> None:
    # Even if no rule keeps the case from being executed beside others.
    monkeypatch.setattr("dcp_conformance.execution.concurrent.executor.why_alone", lambda _: "")
    found = run(WIDTH, name, "TC_VD_STATE_BV_03-*")
    assert found.repeated_alone.keys() == {name}
    assert "registrations of SRP and VarDis" in found.repeated_alone[name]
    assert {result.verdict for result in found.results} == {Verdict.PASS}


def test_a_signal_ends_the_run_with_its_results_and_deregisters_everything(monkeypatch) -> None:
    steps = Counter()
    step = Scheduler.step
    left: list[object] = []

    def interrupted(self: Scheduler, until: int) -> None:
        steps["step"] += 1
        if steps["step"] == 60:
            raise KeyboardInterrupt
        step(self, until)

    close = Scheduler.close

    def closed(self: Scheduler) -> None:
        close(self)
        assert self.upper is not None
        left.extend(self.upper.call("BP-ListRegisteredProtocols", {}).result["protocols"])

    monkeypatch.setattr(Scheduler, "step", interrupted)
    monkeypatch.setattr(Scheduler, "close", closed)
    found = run(WIDTH, "TC_BP_*")
    assert found.interrupted
    assert found.exit_status() == 130
    assert any(result.side_by_side for result in found.results)
    # VarDis and SRP themselves.
    assert {entry["protocolId"] for entry in left} <= {1, 2}


@pytest.mark.part("suite")
def test_live_cases_never_share_an_identifier(monkeypatch) -> None:
    clashes: list[set[int]] = []
    account = SideBySide._account

    def checked(self: SideBySide, arrival: Arrival) -> None:
        account(self, arrival)
        used = Counter(each for bench in self._live.values() for each in bench.identifiers.created)
        clashes.append({each for each, count in used.items() if count > 1})

    monkeypatch.setattr(SideBySide, "_account", checked)
    run(WIDTH, "TC_VD_STATE_*", "TC_VD_SEQ_*", "TC_VD_UPD_*", "TC_VD_FWD_*")
    assert len(clashes) > 50
    assert not set().union(*clashes)


def test_no_case_sends_records_of_a_variable_of_another_live_case(monkeypatch) -> None:
    """The implementation would react to it, and the other case would take that as a reaction to its own stimulus."""
    executors: list[SideBySide] = []
    begin = SideBySide._wave
    sent: list[tuple[str, str, int]] = []

    def wave(self: SideBySide, on_result) -> None:
        executors[:] = [self]
        begin(self, on_result)

    make = SharedLink.__init__

    def watched(self: SharedLink, scheduler: Scheduler, task: Task) -> None:
        make(self, scheduler, task)
        send = self.send

        def noted(octets: bytes, source: bytes) -> bytes:
            note(self, octets, source)
            return send(octets, source)

        self.send = noted

    def note(link: SharedLink, octets: bytes, source: bytes) -> None:
        live = executors[0]._live.values() if executors else ()
        for bench in (each for each in live if each.lower is link):
            owners = {
                var_id: other.case.id
                for other in live
                for var_id in other.identifiers.created | other.identifiers.called_unknown
                if other is not bench
            }
            said = ReceivedBeacon(bench.codec, 0, 0, 0, octets, source).instructions()
            sent.extend((bench.case.id, owners.get(each.var_id, ""), each.var_id) for each in said)

    monkeypatch.setattr(SideBySide, "_wave", wave)
    monkeypatch.setattr(SharedLink, "__init__", watched)
    run(WIDTH, "TC_BP_RX_BI_*", "TC_BP_CRX_BI_*", "TC_VD_ROB_*", "TC_VD_SEQ_*")
    assert len(sent) > 100
    assert [each for each in sent if each[1]] == []


class Link:
    """A link in virtual time with frames that were determined before."""

    name = "link"

    def __init__(self, *times: int) -> None:
        self.time = 0
        self.frames = [Arrival(time, time, b"octets", b"frame octets", b"source") for time in times]
        self.sent: list[tuple[int, bytes]] = []

    def now(self) -> int:
        return self.time

    wall = now

    def framed(self, octets: bytes, source: bytes) -> bytes:
        return source + octets

    def send(self, octets: bytes, source: bytes) -> bytes:
        self.sent.append((self.time, octets))
        return source + octets

    def send_frame(self, frame: bytes) -> None:
        self.sent.append((self.time, frame))

    def receive(self, until: int, also: object = ()) -> Arrival | None:
        if self.frames and self.frames[0].time < until:
            self.time = max(self.time, self.frames[0].time)
            return self.frames.pop(0)
        self.time = max(self.time, until)
        return None

    def take_in(self) -> None:
        pass

    def health(self) -> LinkHealth:
        return LinkHealth(1)

    def close(self) -> None:
        pass


def drive(scheduler: Scheduler) -> None:
    for _ in range(1000):
        if not scheduler.tasks:
            break
        scheduler.step(scheduler.lower.now() + 100)
    assert not scheduler.tasks
    scheduler.close()


def test_every_task_receives_every_frame_at_its_time_and_none_after_its_deadline() -> None:
    link = Link(10, 20, 20, 35)
    accounted: list[int] = []
    scheduler = Scheduler(link, None, lambda arrival: accounted.append(arrival.time))
    heard: dict[str, list[tuple[int, int | None]]] = {"short": [], "long": []}

    def listens(name: str, until: int) -> None:
        def body(task: Task) -> None:
            own = SharedLink(scheduler, task)
            while own.now() < until:
                found = own.receive(until)
                heard[name].append((own.now(), None if found is None else found.time))

        scheduler.start(body)

    listens("short", 20)
    listens("long", 50)
    drive(scheduler)
    assert heard["short"] == [(10, 10), (20, None)]
    assert heard["long"] == [(10, 10), (20, 20), (20, 20), (35, 35), (50, None)]
    assert accounted == [10, 20, 20, 35]


def test_kernel_losses_are_reported_to_every_task_once() -> None:
    link = Link(10)
    scheduler = Scheduler(link, None, lambda _: None)
    losses: list[list[int]] = []

    def body(task: Task) -> None:
        own = SharedLink(scheduler, task)
        own.receive(50)
        losses.append([own.health().dropped, own.health().dropped])

    scheduler.start(body)
    scheduler.start(body)
    drive(scheduler)
    assert losses == [[1, 0], [1, 0]]


class BrokenLink(Link):
    def receive(self, until: int, also: object = ()) -> Arrival | None:
        if self.frames:
            return super().receive(until, also)
        raise LowerTesterError("the interface is gone")


class GoneUpper:
    """An upper tester whose connection is closed."""

    name = "gone"
    about: ClassVar[dict] = {}
    methods = frozenset({"UT-Hello"})

    def call(self, method: str, params: dict) -> Answer:
        raise UpperTesterError("closed")

    def poll(self) -> list:
        raise UpperTesterError("closed")

    def another(self) -> None:
        return None

    def filenos(self) -> tuple:
        return ()


def test_a_lost_link_is_reported_by_the_cases() -> None:
    scheduler = Scheduler(BrokenLink(10), None, lambda _: None)
    met: list[str] = []

    def body(task: Task) -> None:
        own = SharedLink(scheduler, task)
        assert own.receive(50) is not None
        with pytest.raises(LowerTesterError, match="the interface is gone"):
            own.receive(50)
        met.append("lost")

    scheduler.start(body)
    scheduler.start(body)
    drive(scheduler)
    assert met == ["lost", "lost"]


def test_a_lost_upper_tester_is_reported_by_the_cases() -> None:
    scheduler = Scheduler(Link(10), GoneUpper(), lambda _: None)
    met: list[str] = []

    def body(task: Task) -> None:
        own, upper = SharedLink(scheduler, task), SharedUpper(scheduler, task, scheduler.upper)
        own.receive(50)
        for ask in (upper.poll, lambda: upper.call("UT-Hello", {})):
            with pytest.raises(UpperTesterError, match="closed"):
                ask()
        met.append("lost")

    scheduler.start(body)
    scheduler.start(body)
    drive(scheduler)
    assert met == ["lost", "lost"]


class RealLink(Link):
    """A link that counts as one in real time: calls of the upper tester are made by a thread."""

    def overload(self) -> str:
        return ""

    def receive(self, until: int, also=()) -> Arrival | None:
        if self.frames and self.frames[0].time < until:
            return super().receive(until)
        # All frames have been received: the call may end. The thread needs a moment to begin it, and to end it.
        if WAITING.wait(0.05):
            BLOCKED.set()
            assert RETURNED.wait(20)
        return None


WAITING, BLOCKED, RETURNED = threading.Event(), threading.Event(), threading.Event()


class SlowUpper:
    """An upper tester whose calls last until another task has received a frame."""

    name = "slow"
    about: ClassVar[dict] = {}
    methods = frozenset({"SLOW", "UT-Reset"})

    def call(self, method: str, params: dict) -> Answer:
        WAITING.set()
        assert BLOCKED.wait(20)
        WAITING.clear()
        RETURNED.set()
        return Answer("BP-STATUS-OK", {"method": method})

    def poll(self) -> list:
        return []

    def filenos(self) -> tuple:
        return ()

    def another(self) -> None:
        return None

    def close(self) -> None:
        pass


def test_other_cases_continue_during_a_call() -> None:
    WAITING.clear()
    BLOCKED.clear()
    scheduler = Scheduler(RealLink(10, 20, 30), SlowUpper(), lambda _: None)
    order: list[str] = []

    def calls(task: Task) -> None:
        upper = SharedUpper(scheduler, task, scheduler.upper)
        assert "UT-Reset" not in upper.methods
        assert upper.call("SLOW", {}).ok
        order.append("called")

    def listens(task: Task) -> None:
        own = SharedLink(scheduler, task)
        for _ in range(3):
            assert own.receive(100) is not None
            order.append("heard")

    scheduler.start(calls)
    scheduler.start(listens)
    drive(scheduler)
    assert order == ["heard", "heard", "heard", "called"]


class HangingUpper(SlowUpper):
    """An upper tester that answers nothing any more, or only UT-Hello."""

    methods = frozenset({"SLOW", "UT-Hello"})

    def __init__(self, answered: str = "") -> None:
        self.answered = answered
        self.called: list[str] = []

    def call(self, method: str, params: dict) -> Answer:
        self.called.append(method)
        if len(self.called) == 1:
            # Not before the other case waits, too.
            WAITING.set()
            assert BLOCKED.wait(20)
            WAITING.clear()
            RETURNED.set()
        if method == self.answered:
            return Answer("UT-STATUS-OK")
        raise NoAnswerError(f"{method} was not answered")


@pytest.mark.parametrize(
    ("answered", "calls"),
    [("", ["SLOW", "UT-Hello"]), ("UT-Hello", ["SLOW", "UT-Hello", "SLOW", "UT-Hello"])],
)
def test_waiting_calls_fail_together_if_nothing_is_answered_any_more(answered: str, calls: list[str]) -> None:
    for each in (WAITING, BLOCKED, RETURNED):
        each.clear()
    upper = HangingUpper(answered)
    scheduler = Scheduler(RealLink(10), upper, lambda _: None)
    failed: list[str] = []

    def body(task: Task) -> None:
        with pytest.raises(NoAnswerError) as error:
            SharedUpper(scheduler, task, scheduler.upper).call("SLOW", {})
        failed.append(str(error.value))

    scheduler.start(body)
    scheduler.start(body)
    drive(scheduler)
    assert failed == ["SLOW was not answered"] * 2
    assert upper.called == calls


def test_a_crash_is_detected_and_attributed_to_its_case() -> None:
    codec = Codec("dcp-2.0")
    sut = InProcess(reference_config(codec))
    handle = sut.deliver

    def fragile(octets: bytes) -> None:
        # A foreign protocol in a block of 600 octets or more ends it.
        if len(octets) > 900:
            sut.fail(RuntimeError("too long"))
        handle(octets)

    sut.deliver = fragile
    from dcp_conformance.definitions.pics import Pics
    from dcp_conformance.execution.runner import Runner
    from dcp_conformance.test_system.session import Session

    runner = Runner(Session(codec, sut.lower_tester(), sut.upper_tester(), Pics()), sut)
    runner.prepare()
    every = all_cases()
    runner.run(every[SANITY])
    chosen = [case for name, case in every.items() if name.startswith(("TC_BP_RXP", "TC_VD_STATE_BV_03"))]
    found: dict[str, CaseResult] = {}
    executor = SideBySide(runner, every[SANITY])
    beside = [case for case in chosen if not why_alone(case)]
    executor.run(beside, lambda case, result: found.update({case.id: result}))
    killers = [name for name, result in found.items() if result.killed]
    assert "TC_BP_RXP_BV_01-1000" in killers
    assert all(found[name].verdict is Verdict.FAIL and not found[name].side_by_side for name in killers)
    # The other cases pass beside each other, and none is left to be executed alone.
    assert len(found) == len(beside)
    assert {result.verdict for name, result in found.items() if name not in killers} <= {Verdict.PASS}
    assert any("executed side by side" in note and "executed again" in note for note in runner.notes)


def test_cases_with_malformed_containers_run_only_beside_each_other(monkeypatch) -> None:
    """Their octets may be read as records of any variable: one had a request sent for the variable of another case."""
    beside: set[str] = set()
    account = SideBySide._account

    def noted(self: SideBySide, arrival: Arrival) -> None:
        account(self, arrival)
        if any(name.startswith("TC_VD_ROB_BI_") for name in self._live):
            beside.update(self._live)

    monkeypatch.setattr(SideBySide, "_account", noted)
    found = run(WIDTH, "TC_BP_RX_BI_*", "TC_BP_CRX_BI_*", "TC_VD_ROB_*")
    assert len(beside) > 10
    assert {name.rpartition("_")[0] for name in beside} == {"TC_VD_ROB_BI"}
    assert found.result().readings["X02"] == ("length-field",)


class _FasterThread:
    """Ends each call before ``submit`` returns, as a thread does if the scheduler has to wait for a processor."""

    def submit(self, call, *arguments) -> Future[Answer]:
        future: Future[Answer] = Future()
        future.set_result(call(*arguments))
        return future

    def shutdown(self, *, wait: bool) -> None:
        pass


class _Upper:
    def call(self, method: str, params: dict) -> Answer:
        return Answer(result={"method": method})

    def poll(self) -> list:
        return []

    def filenos(self) -> tuple[int, ...]:
        return ()


def test_a_call_that_is_answered_before_the_case_waits_for_it_wakes_the_case_once() -> None:
    """A second waking ended a wait early, or met a case that had ended: a fault of the tester, under load only."""
    link = Link()
    scheduler = Scheduler(link, _Upper(), lambda _: None)
    scheduler._threads = _FasterThread()
    ends: list[int] = []

    def calls_and_waits(task: Task) -> None:
        own = SharedLink(scheduler, task)
        assert scheduler.call(task, "UT-Hello", {}).result == {"method": "UT-Hello"}
        assert own.receive(own.now() + 500) is None
        ends.append(own.now())

    def calls_and_ends(task: Task) -> None:
        scheduler.call(task, "UT-Hello", {})

    scheduler.start(calls_and_waits)
    scheduler.start(calls_and_ends)
    drive(scheduler)
    assert ends == [500]
