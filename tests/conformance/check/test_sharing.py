"""Processes that apply parts of the rules change no result."""

from __future__ import annotations

import os
from pathlib import Path

import msgspec
import pytest
from dcp_conformance.check.base import MOST_VARIABLES, Context, Seen
from dcp_conformance.check.judge import Judge
from dcp_conformance.check.numbers import Numbers
from dcp_conformance.check.recording import judge_versions
from dcp_conformance.check.topology import told
from dcp_conformance.definitions.pics import Pics
from dcp_conformance.definitions.results import RunResult
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.errors import UsageError
from dcp_conformance.frames.received import ReceivedBeacon

from dcp_codec.capture import CaptureError, create_capture, open_capture
from dcp_codec.codec import Codec
from dcp_codec.framing.locate import Framing, locate

from .test_versions import CAPTURES, frames_of, moved, recorded


def results(path: Path, jobs: int, links: str = "") -> list[RunResult]:
    """Judge a recording; without the times of judging."""
    runs = judge_versions(path, None, Pics(), jobs=jobs, topology=told([links]) if links else None)
    return [msgspec.structs.replace(run, started="", duration=0.0) for run, _ in runs]


@pytest.mark.parametrize("jobs", [2, 3])
@pytest.mark.parametrize(("name", "links"), [("b_crud", ""), ("c_latejoin", "00:01-00:02-00:03")])
def test_several_processes_have_the_same_results_as_one(name: str, links: str, jobs: int):
    path = CAPTURES / f"{name}.mcap"
    (one,), (several,) = results(path, 1, links), results(path, jobs, links)
    assert one == several
    # The shares have findings, with the frames that they cite.
    found = {case.id: case for case in several.cases if case.verdict is Verdict.FAIL}
    assert found["CK_DATA_ORDER"].evidence
    assert any("TAKES" in each or "ANSWER" in each for each in found)


@pytest.mark.parametrize("jobs", [2, 3])
def test_several_processes_judge_two_versions(tmp_path: Path, jobs: int):
    new, old = frames_of("a_bus3", 60), frames_of("a_bus3_v1.3.6", 60)
    step = new[0].time_ns - old[0].time_ns
    both = [*new, *(moved(frame, frame.time_ns + step) for frame in old)]
    path = recorded(tmp_path / "both.pcap", sorted(both, key=lambda frame: frame.time_ns))
    one, several = results(path, 1), results(path, jobs)
    assert len(one) == 2
    assert one == several


def test_a_process_that_is_killed_is_reported(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(Judge, "share", lambda _self: os._exit(9))
    with pytest.raises(UsageError, match="was it killed"):
        results(CAPTURES / "b_crud.mcap", 2)


def test_damage_is_reported_once(tmp_path: Path):
    path = tmp_path / "cut.pcap"
    with create_capture(path) as writer:
        for frame in frames_of("b_crud", 80):
            writer.write(frame)
    path.write_bytes(path.read_bytes()[:-7])
    with open_capture(path) as reader:
        list(reader)
        (damage,) = [problem.message for problem in reader.problems]
    for jobs in (1, 2, 3):
        (run,) = results(path, jobs)
        assert run.notes.count(damage) == 1
    path.write_bytes(b"\xa1\xb2\xc3\xd4")
    for jobs in (1, 2, 3):
        with pytest.raises((UsageError, CaptureError)):
            results(path, jobs)


@pytest.mark.parametrize("name", ["b_crud", "c_latejoin"])
def test_without_a_ledger_the_news_are_the_same(name: str):
    """Every eleventh beacon is missing, so that earlier numbers do not count."""
    codec = Codec("cpp-2.0")
    with_ledger, without = Context(codec, Pics()), Context(codec, Pics())
    without.keeper = Numbers(MOST_VARIABLES)
    repeated = 0
    for frame in (each for each in frames_of(name, 400) if each.number % 11):
        of = []
        for context in (with_ledger, without):
            framing = locate(frame.data, codec.profile.link)
            assert isinstance(framing, Framing)
            octets = frame.data[framing.start :]
            heard = ReceivedBeacon(codec, frame.number, frame.time_ns, frame.time_ns, octets, framing.src or b"")
            seen = Seen(codec, heard, frame.data, framing.start, framing.dst)
            context.feed(seen)
            of.append(([each for each, _, _ in seen.news], seen.again))
        assert of[0] == of[1]
        repeated += seen.again
    assert repeated > 100
