"""A run without a progress bar tells every minute how far it is."""

from __future__ import annotations

import itertools
import queue

import pytest
from dcp_conformance.cli import display
from dcp_conformance.cli.display import Minutes

PATIENCE = 60


def test_the_line_has_the_time_that_is_left_and_the_last_case() -> None:
    passed = 0.0
    minutes = Minutes("cases", print, clock=lambda: passed)
    minutes.start(200)
    passed = 60.0
    assert minutes.line() == "0 of 200 cases after 60 s"
    for number in range(50):
        minutes.done(f"TC_{number}")
    assert minutes.line() == "50 of 200 cases after 60 s, about 180 s left; last completed: TC_49"


def test_the_line_tells_what_the_run_waits_for() -> None:
    minutes = Minutes("cases", print, clock=lambda: 0.0)
    minutes.start(20)
    minutes.state = lambda: "restarted 3 times, waiting for it to answer"
    assert minutes.line() == "0 of 20 cases after 0 s; restarted 3 times, waiting for it to answer"


def test_the_remaining_time_is_estimated_from_the_last_two_minutes() -> None:
    """The first cases of a run are executed side by side, and the last ones alone."""
    clock = itertools.count(0, 60)
    minutes = Minutes("cases", print, clock=lambda: next(clock))
    clock = itertools.count(0, 60)
    minutes.start(1000)
    left = []
    for cases in (600, 60, 30, 30, 0, 0):
        for _ in range(cases):
            minutes.done("TC")
        left.append(minutes.line().partition(", ")[2].removesuffix("; last completed: TC"))
    assert left == [
        *("about 40 s left", "about 62 s left", "about 413 s left", "about 560 s left", "about 1120 s left"),
        "none completed for 120 s",
    ]


def test_it_is_printed_while_nothing_is_completed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(display, "_MINUTE", 0.001)
    lines: queue.Queue[str] = queue.Queue()
    minutes = Minutes("cells", lines.put)
    minutes.start(3)
    with minutes:
        for _ in range(2):
            assert lines.get(timeout=PATIENCE).startswith("0 of 3 cells after ")
