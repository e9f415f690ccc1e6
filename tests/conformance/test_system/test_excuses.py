"""Excuses of failed checks: losses and lateness of the tester excuse missing data, never received data."""

from __future__ import annotations

import socket
import time as real_time
from collections.abc import Callable
from typing import Any

import pytest
from dcp_conformance.definitions.case import Case, Kind
from dcp_conformance.definitions.pics import Pics
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.errors import LowerTesterError, StopCase
from dcp_conformance.lower_tester import Arrival, LinkHealth
from dcp_conformance.lower_tester import sockets as lower_sockets
from dcp_conformance.lower_tester.sockets import SocketLowerTester
from dcp_conformance.reference.inprocess import InProcess, VirtualLowerTester, reference_config
from dcp_conformance.test_system.bench import MS, Bench, Session

from ..rig import codec_of

PERIOD = 100 * MS


class Losing(VirtualLowerTester):
    """The link in process, whose losses a test sets."""

    def __init__(self, sut: InProcess) -> None:
        super().__init__(sut)
        self.sut = sut
        self.dropped = 0
        self.on_send: Callable[[], None] = lambda: None

    def health(self) -> LinkHealth:
        dropped, self.dropped = self.dropped, 0
        return LinkHealth(dropped)

    def send(self, octets: bytes, source: bytes) -> bytes:
        self.on_send()
        return super().send(octets, source)


def rig() -> tuple[Bench, Losing, InProcess]:
    codec = codec_of("dcp-2.0")
    sut = InProcess(reference_config(codec))
    lower = Losing(sut)
    made_up = Case("TC_BP_X_BV_01", "", ("BP-RX-07",), Kind.VALID, "", "", 4, "", "", lambda _: None)
    return Bench(Session(codec, lower, sut.upper_tester(), Pics()), made_up), lower, sut


def verdict_of(bench: Bench, **how: Any) -> Verdict:
    bench.verdicts.check(False, "something", "something else", **how)
    return bench.verdicts.checks[-1].verdict


def test_without_losses_both_kinds_count():
    bench, _, _ = rig()
    assert verdict_of(bench) is Verdict.FAIL
    assert verdict_of(bench, shown=True) is Verdict.FAIL


def test_a_drop_excuses_missing_data_but_not_received_data():
    bench, lower, _ = rig()
    lower.dropped = 2
    assert verdict_of(bench, shown=["a record"]) is Verdict.FAIL
    with pytest.raises(StopCase):
        bench.wrong("something", "something else")
    assert bench.verdicts.checks[-1].verdict is Verdict.FAIL
    assert verdict_of(bench, shown=[]) is Verdict.INCONCLUSIVE
    assert "the kernel dropped 2 frames" in bench.verdicts.checks[-1].observed
    with pytest.raises(StopCase):
        bench.missing("something")
    assert bench.verdicts.checks[-1].verdict is Verdict.INCONCLUSIVE


def test_failures_after_an_excused_failure_are_excused():
    """Data received after a loss may be a consequence of it."""
    bench, lower, _ = rig()
    lower.dropped = 1
    assert verdict_of(bench) is Verdict.INCONCLUSIVE
    assert verdict_of(bench, shown=True) is Verdict.INCONCLUSIVE


def test_a_gap_does_not_excuse_wrong_sequence_numbers():
    bench, lower, _ = rig()
    bench.call("RTDB-Create", varId=1, repCnt=1, descr="x", value="01")
    bench.beacons(3)
    del bench.heard[1]
    assert verdict_of(bench, numbers=True) is Verdict.FAIL
    assert verdict_of(bench, shown=True) is Verdict.FAIL
    assert verdict_of(bench) is Verdict.INCONCLUSIVE
    assert "beacons were not heard" in bench.verdicts.checks[-1].observed
    lower.dropped = 1
    assert verdict_of(bench, numbers=True) is Verdict.INCONCLUSIVE


def test_an_assumption_excuses_both_kinds():
    bench, _, sut = rig()
    bench.session.upper = None
    bench.sut.bound("VARDISPAR_MAX_VALUE_LENGTH")
    assert verdict_of(bench) is Verdict.INCONCLUSIVE
    assert verdict_of(bench, shown=True) is Verdict.INCONCLUSIVE
    assert sut.alive()


# -- lateness ----------------------------------------------------------------------------------------------------------


def idle(sut: InProcess, duration: int) -> None:
    """Let time pass while the tester is held up; the node continues."""
    sut.elapse(duration)


def test_waits_and_calls_are_not_lateness():
    bench, _, sut = rig()
    upper = bench.services.upper
    plain = upper.call

    def slow(method: str, params: dict[str, Any]) -> Any:
        idle(sut, 5 * PERIOD)
        return plain(method, params)

    upper.call = slow  # type: ignore[method-assign]
    peer = bench.peer()
    for _ in range(3):
        bench.call("UT-Hello")
        peer.send(peer.summary(bench.unknown_id(), 1))
        bench.wait(7)
        bench.mark()
    assert bench.steps.late_ns == 0


@pytest.mark.parametrize(("periods", "verdict"), [(0.9, Verdict.FAIL), (1.1, Verdict.INCONCLUSIVE)])
def test_a_tester_that_is_held_up_before_it_sends_is_late(periods: float, verdict: Verdict):
    bench, _, sut = rig()
    peer = bench.peer()
    bench.wait(1)
    idle(sut, round(periods * PERIOD))
    peer.send(peer.summary(bench.unknown_id(), 1))
    assert bench.steps.late_ns == round(periods * PERIOD)
    assert verdict_of(bench, shown=True) is Verdict.FAIL
    assert verdict_of(bench) is verdict


@pytest.mark.parametrize(("periods", "verdict"), [(3.9, Verdict.FAIL), (4.1, Verdict.INCONCLUSIVE)])
def test_a_check_with_repeated_stimuli_tolerates_more_lateness(periods: float, verdict: Verdict):
    bench, _, sut = rig()
    peer = bench.peer()
    bench.wait(1)
    idle(sut, round(periods * PERIOD))
    peer.send(peer.summary(bench.unknown_id(), 1))
    assert verdict_of(bench, patience=4) is verdict


def test_a_tester_that_is_held_up_while_it_sends_is_late():
    bench, lower, sut = rig()
    peer = bench.peer()
    lower.on_send = lambda: idle(sut, 2 * PERIOD)
    peer.send(peer.summary(bench.unknown_id(), 1))
    assert bench.steps.late_ns == 2 * PERIOD
    assert "it acted late by 200 ms" in bench.losses.own()


def test_an_answer_to_a_frame_that_was_read_late_is_late():
    bench, _, sut = rig()
    peer, wanted = bench.peer(), bench.unknown_id()
    peer.send(peer.summary(wanted, 1))
    found = bench.until(lambda heard: heard)
    assert found is not None
    idle(sut, 3 * PERIOD)
    peer.send(peer.summary(bench.unknown_id(), 1))
    assert bench.steps.late_ns == 3 * PERIOD


def test_frames_that_arrive_during_a_call_are_read_and_not_late():
    """Frames that arrive during a call are read by the next wait, with their time of arrival."""
    bench, _, sut = rig()
    plain = bench.services.upper.call

    def slow(method: str, params: dict[str, Any]) -> Any:
        answer = plain(method, params)
        idle(sut, 3 * PERIOD)
        return answer

    bench.services.upper.call = slow  # type: ignore[method-assign]
    begun = bench.now()
    bench.call("RTDB-Create", varId=7, repCnt=1, descr="x", value="01")
    found = bench.until(lambda heard: heard.known == {7} and heard)
    assert found
    assert found.time < begun + 2 * PERIOD
    assert bench.steps.late_ns == 0


# -- reading from sockets ----------------------------------------------------------------------------------------------


class Clock:
    """A clock that stands still. When it is read for the n-th time a function is called first (``at[n]``)."""

    def __init__(self) -> None:
        self.time = 1_000 * PERIOD
        self.looks = 0
        self.at: dict[int, Callable[[], None]] = {}

    def monotonic_ns(self) -> int:
        self.looks += 1
        self.at.pop(self.looks, lambda: None)()
        return self.time

    def time_ns(self) -> int:
        return self.time


class Pair(SocketLowerTester):
    """Datagrams of a socket pair, stamped with the time at which a test wrote them."""

    def __init__(self) -> None:
        self.there, self._here = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._here.setblocking(False)
        super().__init__("pair")

    def _open(self) -> socket.socket:
        return self._here

    def _read(self, source: socket.socket) -> tuple[bytes, bytes, bytes, int] | None:
        octets = source.recv(100)
        return octets, octets, b"", int.from_bytes(octets[:8], "big")

    def _kernel_drops(self) -> int:
        return 0

    def _gone(self, error: OSError) -> LowerTesterError:
        return LowerTesterError(str(error))


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    monkeypatch.setattr(lower_sockets, "time", made)
    return made


@pytest.fixture
def pair():
    with Pair() as made:
        yield made
        made.there.close()


def test_a_frame_that_arrived_in_time_is_read_however_late(clock: Clock, pair: Pair):
    """The tester is held up after it has found nothing to read, until after the deadline."""
    deadline = clock.time + PERIOD

    def held_up() -> None:
        for late in (-1, 0, 1):
            pair.there.send((deadline + late).to_bytes(8, "big"))
        clock.time = deadline + 50 * PERIOD

    clock.at[1] = held_up
    read = pair.receive(deadline)
    assert isinstance(read, Arrival)
    assert read.time == deadline - 1
    assert pair.receive(deadline) is None
    assert [pair.receive(clock.time + 1).time - deadline for _ in range(2)] == [0, 1]  # type: ignore[union-attr]
    assert pair.health() == LinkHealth(0)


def test_buffered_frames_are_received_later_with_their_time_of_arrival(clock: Clock, pair: Pair):
    for number in range(3):
        pair.there.send((clock.time + number).to_bytes(8, "big"))
    clock.time += 10 * PERIOD
    pair.take_in()
    with pytest.raises(BlockingIOError):
        pair._here.recv(1)
    first = pair.receive(clock.time)
    assert first is not None
    assert first.time == clock.time - 10 * PERIOD
    assert pair.receive(first.time + 1) is None
    assert [pair.receive(clock.time).time - first.time for _ in range(2)] == [1, 2]  # type: ignore[union-attr]
    assert pair.receive(clock.time) is None


def test_the_clock_of_tests_is_not_the_real_one():
    assert lower_sockets.time is real_time
