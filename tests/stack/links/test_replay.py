"""Recordings as links, in virtual time."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from dcp_spec.profile.definition import Link

from dcp_codec.capture import Frame, create_capture, open_capture
from dcp_codec.codec import Codec
from dcp_codec.framing.envelope import Envelope
from dcp_stack.links.base import LinkError, TimedLink
from dcp_stack.links.replay import PORTION, ReplayLink

CAPTURES = Path(__file__).resolve().parents[3] / "captures"
FRAMING = Link(ether_type=0x4953)
START = 1_600_000_000_000_000_000
A, B = bytes.fromhex("020000000001"), bytes.fromhex("020000000002")


class Clock:
    """Time as the test has it, monotonic and on the wall."""

    def __init__(self) -> None:
        self.now = 1_000

    def monotonic(self) -> int:
        return self.now

    def wall(self) -> int:
        return 1_800_000_000_000_000_000 + self.now


def ethernet(octets: bytes, source: bytes = A, ether_type: int = 0x4953) -> bytes:
    return b"\xff" * 6 + source + ether_type.to_bytes(2, "big") + octets


def recording(path: Path, frames: list[tuple[int, bytes]], *, cut: int = 0) -> Path:
    with create_capture(path) as writer:
        for number, (offset, data) in enumerate(frames, start=1):
            writer.write(Frame(number, START + offset, data, len(data) + cut))
    return path


def replay(path: Path, clock: Clock, **options) -> ReplayLink:
    return ReplayLink(path, FRAMING, clock=clock.monotonic, wall=clock.wall, **options)


THREE = [(0, ethernet(b"one")), (100, ethernet(b"two", B)), (350, ethernet(b"three"))]


@pytest.mark.parametrize("suffix", [".pcap", ".pcapng", ".mcap"])
def test_frames_arrive_at_their_distances(tmp_path, suffix):
    clock = Clock()
    link = replay(recording(tmp_path / f"a{suffix}", THREE), clock)
    assert isinstance(link, TimedLink)
    # It starts when it is first asked, not when it is opened.
    clock.now = 5_000
    heard = []
    while (due := link.poll_timeout()) is not None:
        clock.now = due
        heard += [(due - 5_000, each.octets, each.source, each.wall - clock.wall()) for each in link.receive()]
    assert heard == [(0, b"one", A, 0), (100, b"two", B, 0), (350, b"three", A, 0)]
    assert (link.finished, link.problems, link.counters.received, link.fileno()) == (True, [], 3, -1)


@pytest.mark.parametrize(("speed", "times"), [(2, [0, 50, 175]), (0.5, [0, 200, 700]), (math.inf, [0, 0, 0])])
def test_time_is_scaled(tmp_path, speed, times):
    clock = Clock()
    link = replay(recording(tmp_path / "a.pcap", THREE), clock, speed=speed)
    found = []
    while (due := link.poll_timeout()) is not None:
        clock.now = max(clock.now, due)
        found += [due - 1_000 for _ in link.receive()]
    assert found == times or (speed == math.inf and found == [0] * 3)


def test_late_calls_do_not_lose_frames(tmp_path):
    clock = Clock()
    link = replay(recording(tmp_path / "a.pcap", THREE), clock)
    link.receive()
    clock.now += 10_000
    late = link.receive()
    assert [each.octets for each in late] == [b"two", b"three"]
    # Their times are those of arrival, not of reading.
    assert [each.wall - Clock().wall() for each in late] == [100, 350]


def test_times_of_the_recording_can_be_kept(tmp_path):
    clock = Clock()
    link = replay(recording(tmp_path / "a.pcap", THREE), clock, original_times=True)
    link.poll_timeout()
    clock.now += 350
    assert [each.wall - START for each in link.receive()] == [0, 100, 350]


def test_other_traffic_and_our_own_are_left_out(tmp_path):
    frames = [(0, ethernet(b"x", ether_type=0x0806)), (5, ethernet(b"mine", B)), (9, ethernet(b"theirs")), (9, b"bad")]
    clock = Clock()
    link = replay(recording(tmp_path / "a.pcap", frames), clock, source=B)
    # Time starts with the first frame that counts.
    assert [each.octets for each in link.receive()] == [b"theirs"]
    assert link.receive() == []
    assert (link.counters.received, link.counters.ignored, link.finished) == (1, 3, True)


def test_frames_that_the_recorder_cut_short_are_left_out(tmp_path):
    clock = Clock()
    link = replay(recording(tmp_path / "a.pcap", THREE, cut=1), clock, speed=math.inf)
    assert link.receive() == []
    assert link.counters.ignored == 3


def test_times_that_go_back_keep_the_order(tmp_path):
    clock = Clock()
    link = replay(recording(tmp_path / "a.pcap", [THREE[0], THREE[2], THREE[1]]), clock)
    link.receive()
    assert link.poll_timeout() == 1_350
    clock.now = 1_350
    assert [each.octets for each in link.receive()] == [b"three", b"two"]


def test_udp_recordings_are_replayed_too(tmp_path):
    framing = Link(transport="udp", udp_port=5950)
    data = Envelope(framing).frame(b"datagram", A)
    path = recording(tmp_path / "a.pcap", [(0, data)])
    assert [each.octets for each in ReplayLink(path, framing).receive()] == [b"datagram"]


def test_sends_are_counted_also_after_the_end(tmp_path):
    clock = Clock()
    link = replay(recording(tmp_path / "a.pcap", THREE), clock, speed=math.inf, max_packet_size=300)
    assert link.send(b"x")
    assert len(link.receive()) == 3
    assert link.receive() == []
    assert link.finished
    assert link.send(bytes(300))
    assert not link.send(bytes(301))
    link.close()
    link.close()
    assert not link.send(b"x")
    assert (link.counters.sent, link.counters.send_errors, link.receive(), link.poll_timeout()) == (2, 2, [], None)


def test_frames_are_delivered_in_portions(tmp_path):
    clock = Clock()
    path = recording(tmp_path / "a.pcap", [(0, ethernet(b"x"))] * (PORTION + 1))
    link = replay(path, clock)
    assert [len(link.receive()) for _ in range(3)] == [PORTION, 1, 0]


def test_damage_is_reported_and_the_rest_arrives(tmp_path, caplog):
    path = recording(tmp_path / "a.pcap", THREE)
    path.write_bytes(path.read_bytes()[:-2])
    clock = Clock()
    link = replay(path, clock, speed=math.inf)
    assert [each.octets for each in link.receive()] == [b"one", b"two"]
    link.receive()
    assert [problem.reason for problem in link.problems] == ["truncated-record"]
    assert "a.pcap" in caplog.text


def test_files_that_cannot_be_opened(tmp_path):
    with pytest.raises(LinkError, match="No such file"):
        ReplayLink(tmp_path / "nothing.pcap", FRAMING)
    with pytest.raises(LinkError, match="speed -1"):
        ReplayLink(recording(tmp_path / "a.pcap", THREE), FRAMING, speed=-1)


def test_a_bundled_recording_is_replayed_completely():
    path = CAPTURES / "a_bus3.mcap"
    with open_capture(path) as capture:
        expected = [frame.data[14:] for frame in capture]
    link = ReplayLink(path, Codec("cpp-2.0").profile.link, speed=math.inf)
    heard = []
    while not link.finished:
        heard += [each.octets for each in link.receive()]
    assert heard == expected
