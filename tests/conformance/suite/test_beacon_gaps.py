"""Stimuli that must fall between two beacons: checked by the times of the beacons, repeated, or not judged."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from dcp_conformance.definitions.case import SANITY
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.errors import StopCase
from dcp_conformance.reference.surroundings import Upper
from dcp_conformance.test_steps.beacon_gaps import between_beacons, in_a_gap
from dcp_conformance.test_steps.bp_clients import ACTIVATE, DEACTIVATE, ONCE, BPClient
from dcp_conformance.test_system.bench import MS, Bench
from dcp_conformance.upper_tester import Answer
from dcp_selftest.mutants import all_mutants
from dcp_selftest.variants.campaign import judge
from dcp_selftest.variants.variant import Variant, setup, slow

from ..rig import known_cases
from ..slow import SlowUpper, runner_for

PERIOD = 100 * MS


def bench_of(**how: Any) -> Bench:
    return Bench(runner_for(**how).session, known_cases()["TC_BP_TX_BV_01-one-octet"])


def stalling(bench: Bench, times: int, duration: int = 2 * PERIOD) -> Callable[[], None]:
    """The tester is held up before so many of the steps."""
    left = times

    def step() -> None:
        nonlocal left
        if left:
            left -= 1
            upper = bench.services.upper
            assert isinstance(upper, SlowUpper)
            upper._node.elapse(duration)

    return step


def two_payloads(bench: Bench, client: BPClient, stall: Callable[[], None]) -> Callable[[], list[bytes]]:
    def act() -> list[bytes]:
        payloads = [client.payload(), client.payload()]
        client.transmit(payloads[0])
        stall()
        client.transmit(payloads[1])
        return payloads

    return act


@pytest.mark.parametrize("held_up", [0, 1, 3])
def test_calls_are_repeated_until_no_beacon_is_sent_between_them(held_up: int):
    bench = bench_of()
    with BPClient(bench, ONCE) as client:
        act = two_payloads(bench, client, stalling(bench, held_up))
        payloads = between_beacons(bench, "submission of two payloads", act, client.in_frame)
        start = len(bench.heard)
        bench.wait(3)
        assert client.sent(start) == payloads[1:]
    assert bench.verdicts.checks == []


def test_the_last_attempt_deactivates_bp():
    bench = bench_of()
    with BPClient(bench, ONCE) as client:
        act = two_payloads(bench, client, stalling(bench, 100))
        payloads = between_beacons(bench, "submission of two payloads", act, client.in_frame)
        bench.wait(3)
        assert client.sent()[-1:] == payloads[1:]
        assert client.sent().count(payloads[0]) == 0


def test_slow_calls_are_made_with_bp_deactivated_from_the_start():
    bench = bench_of(call_ms=300)
    with BPClient(bench, ONCE) as client:
        act = two_payloads(bench, client, lambda: None)
        # Whether the implementation keeps payloads in this time is found out once in a run.
        for _ in range(2):
            before = len(bench.traffic.events)
            between_beacons(bench, "submission of two payloads", act, client.in_frame)
        calls = [event.text for event in bench.traffic.events[before:] if event.direction == "call"]
        assert calls.count("BP-TransmitPayload") == 2
        assert calls.count(DEACTIVATE) == calls.count(ACTIVATE) == 1


def test_queues_are_not_judged_with_bp_deactivated_if_they_are_lost_then():
    """The cases about BP-MGT-04 judge that."""
    made = setup("dcp-2.0", make=all_mutants()["M-BP-MGT-05-paused-empties"].make, upper=slow(2))
    chosen = [known_cases()[name] for name in (SANITY, "TC_BP_QM_BV_12-droptail")]
    found = judge(Variant("V-X", "", "", lambda _: made), "dcp-2.0", chosen)
    assert not found.fails
    assert "the implementation loses payloads (BP-MGT-04)" in found.inconclusive[0].reason


def test_calls_that_never_fit_between_beacons_are_not_judged():
    bench = bench_of(without=(DEACTIVATE,))
    with BPClient(bench, ONCE) as client, pytest.raises(StopCase):
        between_beacons(
            bench, "submission of two payloads", two_payloads(bench, client, stalling(bench, 100)), client.in_frame
        )
    assert [check.verdict for check in bench.verdicts.checks] == [Verdict.INCONCLUSIVE]
    assert bench.verdicts.checks[0].observed == "a beacon in between in each attempt"


@pytest.mark.parametrize(("before", "good"), [(0, False), (4 * MS, False), (6 * MS, True), (50 * MS, True)])
def test_a_beacon_just_after_the_last_stimulus_counts_too(before: int, good: bool):
    """It may have been prepared before: so a twentieth of a period must be left."""
    bench = bench_of()
    bench.call("RTDB-Create", varId=1, repCnt=15, descr="x", value="01")
    bench.beacons(2)
    upper = bench.services.upper
    assert isinstance(upper, SlowUpper)
    sut = upper._node

    def act() -> None:
        due = sut.node.bp.poll_timeout()
        assert due is not None
        sut.elapse(due - sut.now - before)

    assert in_a_gap(bench, act, lambda heard: heard.has_vardis)[1] is good


@pytest.mark.parametrize("call_ms", [0, 60, 500])
@pytest.mark.parametrize("mutant", ["M-BP-TX-04-loses", "M-BP-TX-04-cuts"])
def test_payloads_that_do_not_fit_together_are_submitted_together(mutant: str, call_ms: float):
    """Calls that take longer than the beacons are apart would bring them into different beacons by themselves."""
    fault = all_mutants()[mutant]
    runner = runner_for(fault.profile, make=fault.make, call_ms=call_ms)
    cases = [each for each in known_cases().values() if each.base == "TC_BP_TX_BV_01"]
    assert Verdict.FAIL in [runner.run(each).verdict for each in cases]


@pytest.mark.parametrize("case_id", ["TC_BP_TX_BV_01-one-octet", "TC_BP_QM_BV_01", "TC_BP_QM_BV_04-droptail"])
def test_cases_that_cannot_be_in_time_are_not_judged(case_id: str):
    result = runner_for(call_ms=500, without=(DEACTIVATE,)).run(known_cases()[case_id])
    assert result.verdict is Verdict.INCONCLUSIVE
    assert "between two beacons" in result.reason


class WaitsForRoom(Upper):
    """An upper tester of an implementation that answers when its queue is empty."""

    def call(self, method: str, params: dict[str, Any]) -> Answer:
        if method == "BP-TransmitPayload":
            query = "BP-QueryNumberBufferedPayloads"
            while super().call(query, {"protId": params["protId"]}).result.get("number"):
                self._node.elapse(MS)
        return super().call(method, params)


def test_waiting_for_beacons_is_distinguished_from_slowness():
    case = known_cases()["TC_BP_QM_BV_03-droptail"]
    runner = runner_for()
    sut = runner.session.upper
    assert isinstance(sut, SlowUpper)
    runner.session.upper = WaitsForRoom(sut._node, slow(0, frozenset({DEACTIVATE})))
    for _ in range(2):
        result = runner.run(case)
    assert result.verdict is Verdict.INCONCLUSIVE
    assert "slow calls of BP-TransmitPayload end after a beacon" in result.reason
    merely_slow = runner_for(call_ms=90, without=(DEACTIVATE,)).run(case)
    assert merely_slow.verdict is Verdict.INCONCLUSIVE
    assert "calls take up to 90 ms" in merely_slow.reason
    assert "when a beacon has left" not in merely_slow.reason
