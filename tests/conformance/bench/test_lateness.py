"""Delays of tester, implementation and frames that the steps of a case show."""

from __future__ import annotations

from .parts import PERIOD, Parts


def test_a_late_end_of_a_wait_is_a_delay_and_no_late_step():
    parts = Parts()
    parts.steps.begin()
    parts.link.time += 3 * PERIOD
    parts.steps.end(parts.link.time - PERIOD // 2)
    assert (parts.steps.held_ns, parts.steps.late_ns) == (PERIOD // 2, 0)
    assert parts.losses.lateness() == "tester or implementation were held up for 50 ms"
    assert parts.losses.own() == ""


def test_the_silence_before_a_frame_begins_with_the_first_stimulus():
    parts = Parts()
    parts.link.time = 10 * PERIOD
    parts.steps.stimulated()
    parts.steps.reacted(13 * PERIOD)
    parts.steps.reacted(14 * PERIOD)
    assert parts.steps.silence_ns == 3 * PERIOD
    assert parts.losses.lateness() == "the implementation sent nothing for 300 ms"


def test_a_frame_that_was_sent_before_the_end_of_an_earlier_wait_was_overtaken():
    parts = Parts()
    parts.steps.waited(5 * PERIOD)
    parts.steps.reacted(5 * PERIOD)
    assert parts.losses.misleading() == ""
    parts.steps.reacted(4 * PERIOD)
    assert parts.losses.misleading() == "a frame sent 100.0 ms before the end of a wait was received after it"
    assert parts.losses.explain_all()
    assert parts.losses.own(numbers=True) == ""
