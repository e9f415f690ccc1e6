"""The times of the tester's steps: lateness, and silence after a stimulus."""

from __future__ import annotations

from .parts import Parts


def test_time_between_steps_is_lateness_and_time_within_them_is_not():
    parts = Parts()
    link, steps = parts.link, parts.steps
    link.time = 500
    assert steps.begin() == 500
    assert steps.late_ns == 0
    link.time = 800
    steps.end(800)
    link.time = 870
    steps.begin()
    assert steps.late_ns == 70
    link.time = 880
    steps.begin()
    assert steps.late_ns == 70


def test_after_forget_the_time_before_the_next_step_does_not_count():
    parts = Parts()
    parts.steps.begin()
    parts.steps.forget()
    parts.link.time = 10**9
    parts.steps.begin()
    assert parts.steps.late_ns == 0


def test_only_a_frame_that_was_received_after_the_stimulus_is_a_reaction():
    parts = Parts()
    steps = parts.steps
    assert not steps.silent
    parts.link.time = 100
    steps.stimulated()
    steps.reacted(99)
    assert steps.silent
    steps.reacted(100)
    assert not steps.silent
