"""The loop around a node, on a link that is no more than a list."""

from __future__ import annotations

import os
import random
import threading
import time

import pytest
from dcp_spec.constants import ICType

from dcp_codec.capture import open_capture
from dcp_codec.codec import get_codec
from dcp_codec.values import Beacon, BPHeader, Container, ExtendedSafetyData, Payload, VarReqCreate, VarSumm
from dcp_stack.config import BPConfig, NodeConfig
from dcp_stack.links.base import LinkCounters, Reception
from dcp_stack.links.recording import Recorder
from dcp_stack.links.rotation import RotatingRecorder
from dcp_stack.node import Node
from dcp_stack.runtime.driver import FLOOD, Driver

CODEC = get_codec("dcp-2.0")
SUMMARIES = CODEC.profile.vardis.container_types.by_name()[ICType.SUMMARIES.label]


class ListedLink:
    """Has what is in ``waiting`` when it is asked, and keeps what is sent."""

    name = "list"
    max_packet_size = 1000
    source = b""

    def __init__(self, waiting: list[Reception]) -> None:
        self.waiting = waiting
        self.sent: list[bytes] = []
        self.counters = LinkCounters()
        self.driver: Driver | None = None

    up = True

    def fileno(self) -> int:
        return -1

    def receive(self) -> list[Reception]:
        found, self.waiting = self.waiting, []
        return found

    def send(self, octets: bytes) -> bool:
        self.sent.append(octets)
        assert self.driver is not None
        self.driver.stop()
        return True

    def close(self) -> None:
        pass


@pytest.mark.parametrize("late", [0.0, 0.3])
def test_held_frames_are_processed_before_the_beacon(late):
    """The reaction of the node is sent in that beacon, as if the node had been woken for the frame."""
    summary = (Container(SUMMARIES, (VarSumm(9, 0),)),)
    header = BPHeader(bytes.fromhex("020000000002"), 0, CODEC.profile.bp.network_id)
    octets = CODEC.encode(Beacon(header, (Payload(2, summary),)))
    now, wall = time.monotonic_ns(), time.time_ns()
    link = ListedLink([Reception(octets, wall)])
    config = NodeConfig(node_id=bytes.fromhex("020000000001"), codec=CODEC)
    node = Node(config, rng=random.Random(1), now=now, wall=wall)
    vardis = node.vardis
    assert vardis is not None
    driver = link.driver = Driver(node, link)

    def ready() -> None:
        vardis.create(1, None, 1, b"own", b"v", 0, now=now, wall=wall)
        # However late it is woken for the beacon.
        time.sleep(late)

    driver.run(ready)
    first = CODEC.decode(link.sent[0])
    records = [record for payload in first.payloads for each in payload.vardis or () for record in each.records]
    assert VarReqCreate(9) in records


class Flood(ListedLink):
    """Always has more than can be processed in a beacon period; is asked for it again and again."""

    def __init__(self, frame: Reception, beacons: int) -> None:
        super().__init__([])
        self.frame = frame
        self.beacons = beacons

    def poll_timeout(self) -> int:
        return 0

    def receive(self) -> list[Reception]:
        return [self.frame] * 5000

    def send(self, octets: bytes) -> bool:
        self.sent.append(octets)
        assert self.driver is not None
        if len(self.sent) >= self.beacons:
            self.driver.stop()
        return True


class Counting(Node):
    """Counts the frames that it gets in a row while a beacon is due."""

    overdue = most = 0

    def handle_frame(self, octets, *, now, wall):
        due = self.bp.poll_timeout()
        self.overdue += due is not None and time.monotonic_ns() >= due
        self.most = max(self.most, self.overdue)
        super().handle_frame(octets, now=now, wall=wall)

    def handle_timeout(self, now, wall):
        self.overdue = 0
        super().handle_timeout(now, wall)


def test_a_flood_does_not_hold_up_beacons():
    """Counted and not timed: a machine that is busy may make a beacon late, the frames that wait may not."""
    now, wall = time.monotonic_ns(), time.time_ns()
    link = Flood(Reception(b"no beacon", wall), beacons=20)
    config = NodeConfig(node_id=bytes.fromhex("020000000001"), codec=CODEC, bp=BPConfig(beacon_period_ms=10))
    node = Counting(config, rng=random.Random(1), now=now, wall=wall)
    driver = link.driver = Driver(node, link)
    vardis = node.vardis
    assert vardis is not None
    driver.run(lambda: vardis.create(1, None, 1, b"own", b"v", 0, now=now, wall=wall))
    assert len(link.sent) >= 20
    # Besides those that waited for the first beacon, one may have been begun when the time had not come.
    assert node.most <= FLOOD + 1


def test_soft_state_is_as_old_as_its_frame():
    """Under overload frames wait in the kernel for seconds, while the node sends beacons."""
    neighbour, now, wall = bytes.fromhex("020000000002"), time.monotonic_ns(), time.time_ns()
    waited = 2_500_000_000
    header = BPHeader(neighbour, 0, CODEC.profile.bp.network_id)
    report = ExtendedSafetyData(CODEC.safety_data_type(1.0, 2.0, 3.0), neighbour, wall - waited, 5)
    octets = CODEC.encode(Beacon(header, (Payload(1, report),)))
    link = ListedLink([])
    config = NodeConfig(node_id=bytes.fromhex("020000000001"), codec=CODEC)
    node = Node(config, rng=random.Random(1), now=now, wall=wall)
    driver = link.driver = Driver(node, link)
    node.start(now, wall)
    # It runs since long before.
    driver._arrived -= 10 * waited
    driver._timeout(now, wall)
    link.waiting = [Reception(octets, wall - waited)]
    driver._on_link()
    entry = node.srp._table.lookup(neighbour)
    assert (time.monotonic_ns() - entry.received_at) >= waited
    assert node.srp._table.expire(time.monotonic_ns(), waited) == [neighbour]


class Refusing(ListedLink):
    """Sends the second beacon, and not the first."""

    source = bytes.fromhex("02000000000a")

    def send(self, octets: bytes) -> bool:
        self.sent.append(octets)
        if len(self.sent) < 2:
            return False
        assert self.driver is not None
        self.driver.stop()
        return True


def test_received_and_sent_frames_are_recorded(tmp_path):
    """In both directions, from the address of its sender, if it was sent; with its time."""
    wall, now = time.time_ns(), time.monotonic_ns()
    neighbour = bytes.fromhex("020000000002")
    link = Refusing([Reception(b"no beacon", wall, neighbour)])
    config = NodeConfig(node_id=bytes.fromhex("020000000001"), codec=CODEC, bp=BPConfig(beacon_period_ms=10))
    node = Node(config, rng=random.Random(1), now=now, wall=wall)
    path = tmp_path / "a.mcap"
    recorder = RotatingRecorder(lambda path: Recorder(path, CODEC), path, lambda: path)
    driver = link.driver = Driver(node, link, recorder=recorder)
    vardis = node.vardis
    assert vardis is not None
    driver.run(lambda: vardis.create(1, None, 9, b"own", b"v", 0, now=now, wall=wall))
    assert not recorder.recording
    with open_capture(path) as capture:
        frames = list(capture)
    to_all = b"\xff" * 6
    assert [each.data for each in frames] == [
        to_all + neighbour + b"\x49\x53" + b"no beacon",
        to_all + link.source + b"\x49\x53" + link.sent[1],
    ]
    assert frames[0].time_ns == wall
    assert frames[1].time_ns >= wall


class PipeLink(ListedLink):
    """Has a frame for each octet in a pipe; counts how often it is asked."""

    def __init__(self) -> None:
        super().__init__([])
        self.reader, self.writer = os.pipe()
        os.set_blocking(self.reader, False)
        self.asked = self.frames = 0

    def fileno(self) -> int:
        return self.reader

    def receive(self) -> list[Reception]:
        self.asked += 1
        try:
            count = len(os.read(self.reader, 1000))
        except BlockingIOError:
            return []
        self.frames += count
        return [Reception(b"no beacon", time.time_ns())] * count

    def close(self) -> None:
        os.close(self.reader)


@pytest.mark.parametrize("listening", [False, True])
def test_frames_wait_for_a_beacon_unless_a_client_listens(listening):
    now, wall = time.monotonic_ns(), time.time_ns()
    link = PipeLink()
    config = NodeConfig(node_id=bytes.fromhex("020000000001"), codec=CODEC)
    driver = Driver(Node(config, rng=random.Random(1), now=now, wall=wall), link)
    if listening:
        session = driver.server.open()
        session.feed(
            b'{"jsonrpc":"2.0","id":1,"method":"UT-Subscribe","params":{"neighbours":true}}\n', now=now, wall=wall
        )
        assert driver.server.listening

    def talk() -> None:
        for _ in range(50):
            os.write(link.writer, b"f")
            time.sleep(0.01)
        os.close(link.writer)
        driver.stop()

    thread = threading.Thread(target=talk)
    driver.run(thread.start)
    thread.join()
    # Half a second has five beacons; on a busy machine it lasts longer.
    periods = (time.monotonic_ns() - now) / 100_000_000
    assert link.asked >= 25 if listening else link.asked <= 2 * periods + 2
    assert link.frames >= (40 if listening else 25)
