"""Judging takes time and memory in proportion to the recording, measured in calls, which no machine changes."""

from __future__ import annotations

import importlib.util
import sys
import tracemalloc
from pathlib import Path
from types import FrameType, ModuleType
from typing import Any

import pytest
from dcp_conformance.check.judge import Judge
from dcp_conformance.check.reception import reception_of
from dcp_conformance.check.reception.observer import _EVENTS, MOST_OPEN
from dcp_conformance.definitions.pics import Pics
from dcp_conformance.definitions.verdict import Verdict

from dcp_codec import get_codec
from dcp_codec.capture import Frame

BENCHMARKS = Path(__file__).resolve().parents[3] / "benchmarks"
CHUNK = 300


@pytest.fixture(scope="module")
def flights() -> ModuleType:
    spec = importlib.util.spec_from_file_location("flights", BENCHMARKS / "flights.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def calls_of(judge: Judge, frames: list[Frame]) -> int:
    """Number of function calls for judging these frames."""
    count = 0

    def called(_frame: FrameType, event: str, _arg: Any) -> None:
        nonlocal count
        count += event == "call"

    sys.setprofile(called)
    try:
        for frame in frames:
            judge.feed(frame)
    finally:
        sys.setprofile(None)
    return count


@pytest.mark.part("tools")
@pytest.mark.parametrize("kind", ["Flight", "Attack"])
def test_later_beacons_cost_as_much_as_earlier_ones(flights, kind):
    codec = get_codec("dcp-2.0")
    frames = list(getattr(flights, kind)(codec, 8, 12).frames(6 * CHUNK))
    judge = Judge(codec, Pics(), period_known=False)
    chunks = [calls_of(judge, frames[begin : begin + CHUNK]) for begin in range(0, len(frames), CHUNK)]
    # The first seconds are creations; afterwards it is the same all the time.
    assert max(chunks[4:]) < 1.5 * max(chunks[1:3])


def test_twice_the_nodes_do_not_cost_four_times_as_much(flights):
    """A beacon of a larger bus has more to do with others, but not with each pair of them."""
    codec = get_codec("dcp-2.0")
    found = []
    for nodes in (5, 10):
        frames = list(flights.Flight(codec, nodes, 12).frames(60 * nodes))
        judge = Judge(codec, Pics(), period_known=False)
        calls_of(judge, frames[: 40 * nodes])
        found.append(calls_of(judge, frames[40 * nodes :]) / (20 * nodes))
    assert found[1] < 3 * found[0]


def test_a_synthetic_flight_violates_nothing(flights):
    """The recordings that benchmarks are made with are those of nodes that follow the specification."""
    codec = get_codec("dcp-2.0")
    judge = Judge(codec, Pics(), period_known=False)
    for frame in flights.Flight(codec, 6, 10).frames(900):
        judge.feed(frame)
    run = judge.result()
    assert [check.observed for case in run.cases for check in case.checks if check.verdict is Verdict.FAIL] == []


@pytest.mark.part("tools")
def test_memory_does_not_grow_with_the_recording(flights):
    codec = get_codec("dcp-2.0")
    judge = Judge(codec, Pics(), period_known=False)
    # All variables, and more beacons than are remembered for anything but evidence.
    flight = flights.Flight(codec, 6, 10).frames(9_000)
    for _ in range(5_000):
        judge.feed(next(flight))
    tracemalloc.start()
    for frame in flight:
        judge.feed(frame)
    kept, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    # The frames themselves, which may be shown with a finding, and little more.
    assert kept / 4_000 < 2_000


def test_a_flood_of_forged_records_does_not_exceed_the_limit_of_open_occasions(flights):
    codec = get_codec("dcp-2.0")
    judge = Judge(codec, Pics(), period_known=False)
    observer = reception_of(judge._context).observer
    most = 0
    for frame in flights.Attack(codec, 8, 12).frames(400):
        judge.feed(frame)
        most = max(most, *(len(station.open) for station in observer.stations.values()))
        assert sum(map(len, observer._log.values())) <= _EVENTS
    # More than 200 variables are forged; without a limit there would be that many.
    assert most == MOST_OPEN
