"""Slow but legal implementations: how fast they react is measured, and waited for."""

from __future__ import annotations

import pytest
from dcp_conformance.definitions.pics import Capabilities, Pics, Testing
from dcp_conformance.interconnection.findings import prepare
from dcp_conformance.interconnection.reaction import measure
from dcp_conformance.test_system.bench import Bench
from dcp_conformance.test_system.known import Reaction
from dcp_conformance.test_system.session import FLOOR

from ..rig import known_cases
from ..slow import polling, runner_for


def bench_of(**how) -> Bench:
    return Bench(runner_for(**how).session, known_cases()["TC_BP_RX_BV_01-8"])


def test_a_fast_implementation_gets_the_minimum_reaction_time():
    found = measure(bench_of())
    assert (found.periods, found.per_payload, len(found.samples)) == (FLOOR, 0, 5)
    assert 0 < max(found.samples) < 2


@pytest.mark.parametrize(("check_ms", "slowest"), [(400, 5), (2000, 21)])
def test_a_long_buffer_check_period_is_found(check_ms: int, slowest: float):
    """A question right after an answer has to wait for nearly all of it."""
    bench = bench_of(buffer_check_period_ms=check_ms)
    bench.session.parameters.clear()
    found = measure(bench)
    assert slowest - 1.5 < max(found.samples) <= slowest + 0.2
    assert found.periods >= check_ms / 100 + 2
    assert found.per_payload == 0


def test_one_payload_per_poll_is_found():
    bench = bench_of(make=polling(120))
    found = measure(bench)
    assert 1.2 <= found.per_payload <= 2.4


def test_while_payloads_wait_reactions_may_take_longer():
    bench = bench_of(make=polling(120))
    assert prepare(bench.session)
    found = bench.session.known.reaction
    assert bench.sut.one_by_one
    bench.wait(50)
    assert bench.sut.reaction == found.periods
    peer = bench.peer()
    peer.send(*(bench.builder.vardis(peer.summary(each, 1)) for each in range(8)))
    assert bench.sut.reaction == pytest.approx(found.periods + 8 * found.per_payload)
    bench.wait(8 * found.per_payload)
    assert bench.sut.reaction == pytest.approx(found.periods)


def test_the_reaction_time_is_measured_once_and_reported_if_relevant():
    runner = runner_for(buffer_check_period_ms=400)
    for case_id in ("TC_DCP_SANITY_BV_01", "TC_BP_RX_BV_01-8"):
        assert runner.run(known_cases()[case_id]).verdict == "pass"
    (note,) = runner.notes
    assert note.startswith("reactions are waited for 8.5 beacon periods")
    runner = runner_for()
    runner.run(known_cases()["TC_DCP_SANITY_BV_01"])
    assert runner.session.known.reaction.samples
    assert runner.notes == []


def test_the_pixit_overrides_the_measurement():
    bench = bench_of(pics=Pics(pixit=Testing(reaction_periods=2.5)), make=polling(120))
    prepare(bench.session)
    assert bench.sut.one_by_one
    bench.wait(50)
    assert bench.sut.reaction == 2.5


def test_the_reaction_time_is_not_measured_without_an_implementation_to_ask():
    bench = bench_of(pics=Pics(pics=Capabilities(vardis=False)))
    assert not prepare(bench.session)
    assert bench.session.known.reaction == Reaction()
    assert bench.sut.reaction == FLOOR


def test_a_silent_implementation_gets_the_minimum_and_may_be_asked_again():
    bench = bench_of(buffer_check_period_ms=65_000)
    assert not prepare(bench.session)
    assert bench.session.known.reaction == Reaction(FLOOR, 0, ())
    assert bench.sut.reaction == FLOOR


@pytest.mark.parametrize("profile", ["dcp-1.0", "dcp-2.0"])
@pytest.mark.parametrize("number", range(2, 9))
def test_blocks_that_are_taken_one_by_one_are_waited_for(profile: str, number: int):
    runner = runner_for(profile, make=polling(90))
    cases = {name: case for name, case in known_cases().items() if name == f"TC_BP_RX_BV_01-{number}"}
    for each in cases.values():
        result = runner.run(each)
        assert result.verdict in ("pass", "not-applicable"), result.reason
