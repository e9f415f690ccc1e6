"""A weak guess of the profile is not used for judging, and each version on a bus is judged by its own profile."""

from __future__ import annotations

from pathlib import Path

from dcp_conformance.check.recording import judge_versions
from dcp_conformance.definitions.pics import Pics
from dcp_conformance.definitions.verdict import Verdict

from dcp_codec.capture import Frame, create_capture, open_capture

from ..air import case_of, findings

CAPTURES = Path(__file__).resolve().parents[3] / "captures"


def frames_of(name: str, count: int) -> list[Frame]:
    """The first frames of a recording of the repository."""
    with open_capture(CAPTURES / f"{name}.mcap") as reader:
        return [frame for _, frame in zip(range(count), reader, strict=False)]


def recorded(path: Path, frames: list[Frame]) -> Path:
    """A recording of these frames in the order of their times."""
    with create_capture(path) as writer:
        for number, frame in enumerate(frames, 1):
            writer.write(Frame(number, frame.time_ns, frame.data, len(frame.data)))
    return path


def moved(frame: Frame, time_ns: int) -> Frame:
    """A frame of other stations, at another time."""
    data = frame.data.replace(b"\x02\0\0\0\0", b"\x02\0\0\0\x13")
    return Frame(frame.number, time_ns, data, len(data))


def test_two_versions_on_one_bus_are_judged_by_their_own_profiles(tmp_path: Path):
    new, old = frames_of("a_bus3", 150), frames_of("a_bus3_v1.3.6", 150)
    step = new[0].time_ns - old[0].time_ns
    both = sorted([*new, *(moved(frame, frame.time_ns + step) for frame in old)], key=lambda frame: frame.time_ns)
    runs = judge_versions(recorded(tmp_path / "both.pcap", both), None, Pics())
    assert {codec.profile.name for _, codec in runs} == {"cpp-2.0", "cpp-1.3"}
    for run, _ in runs:
        assert case_of(run, "CK_BP_FORMAT").verdict is Verdict.PASS
        assert "150 frames of 3 senders" in run.notes
        assert not [each for each in findings(run) if "CK_VD" in each]


def test_one_version_is_judged_once():
    (single,) = judge_versions(CAPTURES / "b_crud.mcap", None, Pics())
    assert single[1].profile.name == "cpp-2.0"


def test_a_weak_guess_is_not_used_and_a_remedy_is_given(tmp_path: Path):
    frames = frames_of("a_bus3", 100)
    damaged = [
        Frame(frame.number, frame.time_ns, frame.data[:14] + b"\x09" + frame.data[15:], len(frame.data))
        if number % 5
        else frame
        for number, frame in enumerate(frames)
    ]
    path = recorded(tmp_path / "odd.pcap", damaged)
    ((run, _),) = judge_versions(path, None, Pics())
    assert run.requirements == {}
    assert {case.verdict for case in run.cases}.isdisjoint({Verdict.PASS, Verdict.FAIL})
    assert run.notes[0].startswith("no verdicts: the profile ")
    assert "--profile" in run.notes[0]
    ((told, _),) = judge_versions(path, "cpp-2.0", Pics())
    assert case_of(told, "CK_BP_FORMAT").verdict is Verdict.FAIL
