"""A recorder's clock that is set back during the recording accuses no node."""

from __future__ import annotations

import pytest
from dcp_conformance.check.judge import RecorderClock
from dcp_selftest.recordings.clean import _task
from hypothesis import given
from hypothesis import strategies as st

from ..air import SECOND, Script, findings, judged

TIMES = st.lists(st.integers(0, 2**62), min_size=1, max_size=50)


@given(TIMES)
def test_time_never_goes_back(times: list[int]) -> None:
    clock = RecorderClock()
    found = [clock.time(each) for each in times]
    assert found == sorted(found)


@given(TIMES)
def test_a_clock_that_is_not_set_back_is_unchanged(times: list[int]) -> None:
    clock = RecorderClock()
    assert [clock.time(each) for each in sorted(times)] == sorted(times)


def test_a_step_back_counts_as_the_preceding_interval() -> None:
    clock = RecorderClock()
    assert [clock.time(each) for each in (1000, 1030, 500, 540)] == [1000, 1030, 1060, 1100]


@pytest.mark.part("suite")
@pytest.mark.parametrize("number", [248, 354])
def test_a_beacon_that_was_not_recorded_stays_missing(number: int) -> None:
    """After the step, a record from before it looked later than the gap, and so as if no beacon had been missed since:
    correct forwarders and producers were accused.
    """
    _, suspicions, _, _ = _task(number)
    assert suspicions == []


def test_a_clock_that_is_set_occasionally_does_not_make_time_stamps_faulty() -> None:
    """Three steps back in a long recording were enough for an accusation."""
    _, suspicions, _, _ = _task(178)
    assert suspicions == []


@pytest.mark.parametrize(("back", "fails"), [(3, False), (30, True)])
def test_time_stamps_that_continue_from_an_earlier_time_come_from_a_clock_that_is_set(back: int, fails: bool) -> None:
    """If a recorder misses most reports, three steps are many of them; a clock is not set with every other report."""
    air, late = Script(), 0
    for number in range(60):
        if number % (60 // back) == 1:
            late += 86_400 * SECOND
        air.say(1, report=air.report(1, late=late))
    found = [each for each in findings(judged(air.frames, "dcp-2.0")) if "SRP_SEQNO" in each]
    assert bool(found) is fails, found
