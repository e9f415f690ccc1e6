"""Position sources: tracks, replays, JSON lines, MAVLink, and the text that opens them."""

from __future__ import annotations

import contextlib
import json
import math
import os
import random
import select
import socket
import sys
import time
from pathlib import Path

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dcp_codec.codec import Codec, get_codec
from dcp_codec.values import ExtendedSafetyData
from dcp_stack.config import NodeConfig
from dcp_stack.node import Node
from dcp_stack.positions.base import SourceError
from dcp_stack.positions.fields import FieldError, SafetyFields
from dcp_stack.positions.jsonlines import LONGEST_LINE, JsonLines
from dcp_stack.positions.mavlink import MavlinkStream, local, port_opener
from dcp_stack.positions.opening import open_source
from dcp_stack.positions.replay import Replay
from dcp_stack.positions.tracks import Circle, Line, RandomWalk, Track, Waypoints

from ..ports import own_port
from ..waiting import PATIENCE

S = 10**9
#: Seconds that what must come may take on a busy machine.
CAPTURES = Path(__file__).parents[2] / "captures"


def opened(spec, profile="dcp-2.0", *, seed=1, stdin=None):
    return open_source(spec, get_codec(profile), rng=random.Random(seed), stdin=stdin)


def fields_of(profile="dcp-2.0"):
    return SafetyFields(get_codec(profile).profile)


def profile_with(name, *fields):
    """A profile with safety data fields (name, type, unit, role)."""
    base = get_codec("dcp-2.0").profile
    made = [{"name": n, "type": t, "unit": u, "role": r} for n, t, u, r in fields]
    srp = msgspec.convert({"safety_data": made}, type(base.srp))
    return msgspec.structs.replace(base, name=name, srp=srp)


# -- fields --------------------------------------------------------------------------------------------------------


def test_roles_and_aliases_fill_the_fields_of_each_profile():
    sample = {"x": 1.0, "position.y": 2.0, "z": 3.0, "vx": 4.0}
    assert fields_of("dcp-2.0").from_sample(sample) == {"x": 1, "y": 2, "z": 3}
    sim = fields_of("sim-2.0").from_sample(sample)
    assert sim["position_x"] == 1
    assert sim["velocity_x"] == 4
    assert sim["velocity_y"] == 0
    student = fields_of("student-2024").from_sample({"x": 1.6, "speed": 7})
    assert student["position_x"] == 2
    assert student["speed"] == 7
    assert isinstance(student["position_x"], int)


def test_units_are_converted():
    fields = SafetyFields(
        profile_with(
            "cm",
            ("px", "i32", "cm", "position.x"),
            ("py", "i32", "cm", "position.y"),
            ("vx_", "i16", "km/h", "velocity.x"),
            ("vy_", "i16", "km/h", "velocity.y"),
        )
    )
    sample = fields.from_sample({"x": 1.5, "y": -2, "vx": 10})
    assert sample == {"px": 150, "py": -200, "vx_": 36, "vy_": 0}
    data = type("Data", (), sample)
    assert fields.position(data) == (1.5, -2.0, 0.0)
    assert fields.velocity(data) == (10.0, 0.0, 0.0)
    # A field by its own name is in its own unit.
    assert fields.from_sample({"px": 150})["px"] == 150


def test_degrees_are_not_a_position():
    fields = SafetyFields(profile_with("geo", ("lat", "f64", "deg", "position.x"), ("lon", "f64", "deg", "position.y")))
    assert not fields.has_position
    assert fields.position(object()) is None


@pytest.mark.parametrize(
    ("profile", "sample", "words"),
    [
        ("dcp-2.0", {"xx": 1}, "did you mean 'x'"),
        ("dcp-2.0", {"altitude": 1}, "it has x, y, z"),
        ("dcp-2.0", {"x": "1"}, "takes a number"),
        ("dcp-2.0", {"x": True}, "takes a number"),
        ("dcp-2.0", {"x": 10**400}, "large"),
        ("student-2024", {"x": 40000}, "-32768..32767"),
        ("student-2024", {"x": math.nan}, "nan"),
        ("student-2024", {"speed": -1}, "0..255"),
    ],
)
def test_values_that_do_not_fit_are_named(profile, sample, words):
    with pytest.raises(FieldError, match=words):
        fields_of(profile).from_sample(sample)


@pytest.mark.parametrize("profile", ["dcp-2.0", "sim-2.0", "student-2024"])
@given(values=st.dictionaries(st.sampled_from(["x", "y", "z", "vx", "vz"]), st.floats() | st.integers()))
def test_converted_values_can_be_encoded(profile, values):
    codec = get_codec(profile)
    try:
        sample = SafetyFields(codec.profile).from_sample(values)
    except FieldError:
        return
    node = b"02:00:00:00:00:01" if profile.startswith("student") else b"\2" * 6
    codec.encode_report(ExtendedSafetyData(codec.safety_data_type(**sample), node, 0, 0))


# -- tracks --------------------------------------------------------------------------------------------------------

speeds = st.floats(0.1, 100)
times = st.floats(0, 1000)
PATHS = {
    "line": lambda speed: Line((1, 2, 3), course=30, speed=speed),
    "shuttle": lambda speed: Line((1, 2, 3), course=200, speed=speed, climb=1, length=50),
    "circle": lambda speed: Circle((1, 2, 3), radius=20, speed=speed),
    "anticlockwise": lambda speed: Circle((1, 2, 3), radius=20, speed=-speed, phase=45),
    "waypoints": lambda speed: Waypoints([(0, 0, 0), (10, 0, 5), (10, 10, 5)], speed=speed),
    "walk": lambda speed: RandomWalk((0, 0, 9), speed=speed, extent=200, turn=20, rng=random.Random(3)),
}


@pytest.mark.parametrize("kind", PATHS)
@given(speed=speeds, seconds=times)
def test_nothing_moves_faster_than_its_speed(kind, speed, seconds):
    path = PATHS[kind](speed)
    limit = math.hypot(speed, 1) * 1.001
    step = 0.01
    before, _ = path.at(seconds)
    after, velocity = path.at(seconds + step)
    assert math.dist(before, after) <= limit * step + 1e-6
    assert math.hypot(*velocity) <= limit


def test_a_line_track_goes_north_and_returns():
    line = Line((0, 0, 5), course=0, speed=2, length=10)
    assert line.at(1) == (pytest.approx((0, 2, 5)), pytest.approx((0, 2, 0)))
    assert line.at(6) == (pytest.approx((0, 8, 5)), pytest.approx((0, -2, 0)))
    assert line.at(10)[0] == pytest.approx((0, 0, 5))


def test_a_circle_is_round_and_clockwise():
    circle = Circle((10, 0, 7), radius=5, speed=5 * math.pi / 2)
    assert circle.at(0)[0] == pytest.approx((10, 5, 7))
    assert circle.at(1)[0] == pytest.approx((15, 0, 7))
    assert circle.at(0)[1] == pytest.approx((5 * math.pi / 2, 0, 0))


def test_waypoints_are_visited():
    once = Waypoints([(0, 0, 0), (10, 0, 0), (10, 0, 0), (10, 20, 0)], speed=10, loop=False)
    assert once.at(1)[0] == (10, 0, 0)
    assert once.at(2) == ((10, 10, 0), (0, 10, 0))
    assert once.at(100) == ((10, 20, 0), (0, 0, 0))
    around = Waypoints([(0, 0, 0), (10, 0, 0)], speed=10)
    assert around.at(1.5)[0] == (5, 0, 0)
    assert around.at(2.5)[0] == (5, 0, 0)


@given(st.integers(0, 2**32), st.floats(1, 100), st.floats(0.1, 1000))
def test_a_walk_stays_inside_and_repeats_with_its_seed(seed, extent, speed):
    walks = [RandomWalk((5, -5, 1), speed=speed, extent=extent, turn=90, rng=random.Random(seed)) for _ in range(2)]
    for tick in range(300):
        place, _ = walks[0].at(tick / 7)
        assert abs(place[0] - 5) <= extent / 2 + 1e-9
        assert abs(place[1] + 5) <= extent / 2 + 1e-9
    assert walks[1].at(299 / 7) == walks[0].at(299 / 7)


def test_every_beacon_finds_a_fresh_position_of_a_track_by_default():
    codec = Codec("dcp-2.0")
    source = open_source("track:circle", codec, rng=random.Random(1))
    node = Node(NodeConfig(node_id=bytes(6), codec=codec), rng=random.Random(2), now=0, wall=0)
    node.start(0, 0)
    beacons = reports = 0
    while beacons < 200:
        sample_at, beacon_at = source.poll_timeout(), node.poll_timeout()
        now = min(sample_at, beacon_at)
        for sample in source.poll(now, now):
            node.srp.update_safety_data(sample, now=now, wall=now)
        before = node.bp.counters()
        node.handle_timeout(now, now)
        after = node.bp.counters()
        # Slots without anything to send count: a beacon without a report is none here.
        beacons += sum(after.get(name, 0) - before.get(name, 0) for name in ("beacons-sent", "beacons-without-payload"))
        reports += after.get("payloads-sent/1", 0) - before.get("payloads-sent/1", 0)
    assert reports == beacons


def test_a_track_is_sampled_at_its_rate():
    source = opened("track:line,course=90,speed=10,rate=4,z=2")
    assert source.poll_timeout() == 0
    assert source.fileno() == -1
    start = 1000 * S
    assert source.poll(start, 0) == [{"x": 0, "y": 0, "z": 2}]
    assert source.poll_timeout() == start + S // 4
    assert source.poll(start + S // 4 - 1, 0) == []
    # Late by three periods: one sample, and the next one when it would have been.
    (sample,) = source.poll(start + S, 0)
    assert sample["x"] == pytest.approx(10)
    assert source.poll_timeout() == start + S + S // 4
    assert not source.finished


def test_a_track_that_leaves_the_range_of_its_profile_is_reported_once():
    source = opened("track:line,course=90,speed=20000,rate=1", "student-2024")
    for second in range(5):
        source.poll(second * S, 0)
    assert source.counts == {"out-of-range": 3}
    (sentence,) = source.take_complaints()
    assert "position_x" in sentence
    assert source.take_complaints() == []


# -- replays -------------------------------------------------------------------------------------------------------


@pytest.fixture
def table(tmp_path):
    def write(text):
        path = tmp_path / "flight.csv"
        path.write_text(text, encoding="utf-8")
        return path

    return write


def test_csv_is_replayed_at_its_times(table):
    path = table("# a comment\ntime, x, y, z\n10.0,1,2,3\n\n10.5,4,5,6\n10.5,7,8,9\n")
    source = opened(f"csv:{path}")
    assert source.poll(5 * S, 0) == [{"x": 1, "y": 2, "z": 3}]
    assert source.poll_timeout() == 5 * S + S // 2
    assert source.poll(5 * S + S // 2 - 1, 0) == []
    assert [sample["x"] for sample in source.poll(9 * S, 0)] == [4, 7]
    assert source.finished
    assert source.poll_timeout() is None
    assert source.poll(99 * S, 0) == []


@pytest.mark.parametrize(("column", "unit"), [("time_s", S), ("time_ms", 10**6), ("time_us", 10**3), ("time_ns", 1)])
def test_times_have_units_and_keep_their_ns(table, column, unit):
    path = table(f"x,{column}\n1,1700000000000000001\n2,1700000000000000004\n")
    source = opened(f"csv:{path},speed=3")
    source.poll(0, 0)
    assert source.poll_timeout() == unit


def test_csv_with_velocities_and_names(table):
    path = table("time,position.x,vx,velocity_y\n0,1,2,3\n")
    (sample,) = opened(f"csv:{path}", "sim-2.0").poll(0, 0)
    assert (sample["position_x"], sample["velocity_x"], sample["velocity_y"]) == (1, 2, 3)


def test_a_loop_starts_again(table):
    path = table("time,x\n0,1\n1,2\n")
    source = opened(f"csv:{path},loop=yes")
    seen = []
    for tick in range(9):
        seen += [sample["x"] for sample in source.poll(tick * S // 2, 0)]
    assert seen == [1, 2, 1, 2, 1]
    assert not source.finished
    assert len(source.poll(10**6 * S, 0)) <= 4


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "no header line"),
        ("time,x\n", "no row"),
        ("x,y\n1,2\n", ":1: there is no time column"),
        ("time,time_ms,x\n1,2,3\n", ":1: there is more than one time column"),
        ("time\n1\n", ":1: there are no columns beside"),
        ("time,x,heading\n0,1,2\n", ":1: profile dcp-2.0 has no safety data field 'heading'"),
        ("time,x,position.x\n0,1,2\n", ":1: the columns 'x' and 'position.x' are the same"),
        ("time,x\n0,1\n1\n", ":3: there are 1 values for 2 columns"),
        ("time,x\n0,1\n\n1,a\n", ":4: x is not a number: 'a'"),
        ("time,x\ninf,1\n", ":2: time is not a number"),
        ("time,x\n1,1\n0,1\n", ":3: the time decreases"),
        ('time,x\n0,"1\n', ":2:"),
    ],
)
def test_csv_errors_name_the_line(table, text, words):
    with pytest.raises(SourceError, match=r"flight\.csv") as error:
        opened(f"csv:{table(text)}")
    assert words in str(error.value)


def test_csv_of_another_encoding(tmp_path):
    path = tmp_path / "x.csv"
    path.write_bytes("time,x\n0,1\n".encode("utf-16"))
    with pytest.raises(SourceError, match="not UTF-8"):
        opened(f"csv:{path}")


def test_a_file_name_may_hold_commas(tmp_path):
    path = tmp_path / "a,b=c.csv"
    path.write_text("time,x\n0,1\n")
    assert opened(f"csv:{path},speed=2").poll(0, 0) == [{"x": 1, "y": 0, "z": 0}]


@pytest.mark.parametrize("times", [[0], [0, 0, 0], [5, 5, 9]])
@given(polls=st.lists(st.integers(0, 10**12), min_size=1, max_size=20).map(sorted))
def test_loops_end_their_polls(times, polls):
    source = Replay("r", [(time, {"x": time}) for time in times], loop=True)
    for now in polls:
        source.poll(now, 0)
        assert source.poll_timeout() > now


def test_a_recording_is_replayed():
    source = opened(f"capture:{CAPTURES}/a_bus3.mcap,node=02:00:00:00:00:01", "cpp-2.0")
    (first,) = source.poll(0, 0)
    assert set(first) == {"x", "y", "z"}
    now, count = 0, 1
    while (due := source.poll_timeout()) is not None:
        assert due >= now
        now = due
        count += len(source.poll(now, 0))
    # The manifest counts 689 state reports of three nodes, repetitions included.
    assert 100 < count <= 689
    assert source.finished


def test_a_recording_of_another_profile_is_converted():
    spec = f"capture:{CAPTURES}/a_bus3.mcap,node=02:00:00:00:00:02,profile=cpp-2.0"
    (theirs,) = opened(spec, "cpp-2.0").poll(0, 0)
    (ours,) = opened(spec, "sim-2.0").poll(0, 0)
    assert (ours["position_x"], ours["position_y"]) == (theirs["x"], theirs["y"])


# -- JSON lines ----------------------------------------------------------------------------------------------------


@pytest.fixture
def pipe():
    reading, writing = os.pipe()
    yield reading, writing
    for descriptor in (reading, writing):
        try:
            os.close(descriptor)
        except OSError:
            continue


def test_lines_become_samples(pipe):
    reading, writing = pipe
    source = opened("stdin", stdin=reading)
    assert source.fileno() == reading
    assert source.poll_timeout() is None
    assert source.poll(0, 0) == []
    os.write(writing, b'{"x": 1, "y": 2, "z": 3}\n{"x": 4')
    assert source.poll(0, 0) == [{"x": 1, "y": 2, "z": 3}]
    os.write(writing, b', "vx": 5}\r\n\n{"position.y": 9}')
    assert source.poll(0, 0) == [{"x": 4, "y": 0, "z": 0}]
    os.close(writing)
    assert source.poll(0, 0) == [{"x": 0, "y": 9, "z": 0}]
    assert source.finished
    assert source.fileno() == -1
    assert source.take_complaints() == []


def test_bad_lines_are_counted_and_reported_once_per_kind(pipe):
    reading, writing = pipe
    source = opened("stdin", stdin=reading)
    lines = [b"nonsense", b"[1,2]", b"\xff\xfe", b"[" * 5000, b"{}", b'{"q": 1}', b'{"x": "1"}', b'{"x": 1}']
    os.write(writing, b"\n".join(lines) + b"\n")
    assert source.poll(0, 0) == [{"x": 1, "y": 0, "z": 0}]
    assert source.counts == {"bad-json": 4, "bad-field": 3}
    told = source.take_complaints()
    assert len(told) == 2
    assert "line 1 is not valid JSON" in told[0]
    assert "line 5" in told[1]


def test_endless_lines_take_no_memory(pipe):
    reading, writing = pipe
    source = opened("stdin", stdin=reading)
    for _ in range(40):
        os.write(writing, b"x" * 10_000)
        source.poll(0, 0)
        assert len(source._lines) <= LONGEST_LINE
    os.write(writing, b'\n{"x": 1}\n')
    assert source.poll(0, 0) == [{"x": 1, "y": 0, "z": 0}]
    assert source.counts == {"too-long": 1}


def test_a_closed_descriptor_is_an_end():
    source = JsonLines("stdin", fields_of(), fd=987)
    assert source.poll(0, 0) == []
    assert source.finished
    assert "reading ended" in source.take_complaints()[0]
    source.close()


@given(st.lists(st.binary(max_size=60), max_size=10))
def test_no_lines_raise(chunks):
    reading, writing = os.pipe()
    try:
        source = JsonLines("stdin", fields_of("student-2024"), fd=reading)
        for chunk in chunks:
            os.write(writing, chunk)
            source.poll(0, 0)
    finally:
        os.close(reading)
        os.close(writing)


json_values = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=3),
    lambda inner: st.lists(inner, max_size=2) | st.dictionaries(st.sampled_from(["x", "vx", "speed", "?"]), inner),
    max_leaves=5,
)


@given(st.lists(json_values, max_size=5))
def test_no_json_raises(values):
    reading, writing = os.pipe()
    try:
        source = JsonLines("stdin", fields_of("student-2024"), fd=reading)
        os.write(writing, b"".join(json.dumps(value).encode() + b"\n" for value in values))
        source.poll(0, 0)
    finally:
        os.close(reading)
        os.close(writing)


# -- MAVLink -------------------------------------------------------------------------------------------------------


def needs_pymavlink():
    try:
        from pymavlink.dialects.v20 import common
    except ImportError:
        message = "pymavlink is not installed (pip install pymavlink)"
        if os.environ.get("DCP_REQUIRE_TOOLS") == "1":
            pytest.fail(message, pytrace=False)
        pytest.skip(message)
    return common


class Vehicle:
    """Sends MAVLink over UDP as an autopilot would."""

    def __init__(self, port, system=1):
        self.common = needs_pymavlink()
        self.mav = self.common.MAVLink(self, srcSystem=system, srcComponent=1)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.connect(("127.0.0.1", port))

    def write(self, octets):
        self.socket.send(octets)

    def close(self):
        self.socket.close()


@pytest.fixture
def stream():
    """Opens a MAVLink source on a free port and a vehicle that sends to it."""
    needs_pymavlink()
    made = []

    def make(options="", profile="sim-2.0"):
        port = own_port()
        source = opened(f"mavlink:udpin:127.0.0.1:{port}{options}", profile)
        vehicle = Vehicle(port)
        made.extend((source, vehicle))
        return source, vehicle

    yield make
    for each in made:
        each.close()


def arrived(source, now=0):
    """Poll until something came."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        if found := source.poll(now, 0):
            return found
    return []


def position_of(sample):
    return [sample[f"position_{axis}"] for axis in "xyz"] + [sample[f"velocity_{axis}"] for axis in "xyz"]


def test_ned_becomes_enu(stream):
    source, vehicle = stream()
    assert source.fileno() >= 0
    vehicle.mav.heartbeat_send(2, 3, 0, 0, 0)
    vehicle.mav.local_position_ned_send(1000, 10.0, 20.0, -30.0, 1.0, 2.0, -3.0)
    (sample,) = arrived(source)
    assert position_of(sample) == [20, 10, 30, 2, 1, 3]


def test_ned_can_be_kept(stream):
    source, vehicle = stream(",frame=ned")
    vehicle.mav.local_position_ned_send(1000, 10.0, 20.0, -30.0, 1.0, 2.0, -3.0)
    assert position_of(arrived(source)[0]) == [10, 20, -30, 1, 2, -3]


def test_global_positions_need_an_origin(stream):
    source, vehicle = stream(",origin=-43.5225/172.5794/20")
    vehicle.mav.local_position_ned_send(1000, 10.0, 20.0, -30.0, 1.0, 2.0, -3.0)
    vehicle.mav.global_position_int_send(1000, -435216000, 1725806000, 50_000, 30_000, 100, 200, -300, 0)
    (sample,) = arrived(source)
    east, north, up, *velocity = position_of(sample)
    # 0.0009 degrees of latitude are 100 m; 0.0012 of longitude at 43.5 south are 97 m.
    assert (east, north, up) == (pytest.approx(97.0, abs=0.3), pytest.approx(100.0, abs=0.3), pytest.approx(30))
    assert velocity == [2, 1, 3]


def test_other_vehicles_are_ignored(stream):
    source, vehicle = stream(",system=1")
    other = Vehicle(vehicle.socket.getpeername()[1], system=2)
    other.mav.local_position_ned_send(1, 9.0, 9.0, 9.0, 0.0, 0.0, 0.0)
    vehicle.mav.local_position_ned_send(1, 1.0, 2.0, 3.0, 0.0, 0.0, 0.0)
    assert position_of(arrived(source)[0])[:3] == [2, 1, -3]
    other.close()
    assert source.counts["other-system"] == 1
    assert "system 2" in source.take_complaints()[0]


def test_garbage_is_counted(stream):
    source, vehicle = stream()
    for octets in (b"hello", b"\xfd" * 40, bytes(range(256)), b"\xfe\x01"):
        vehicle.socket.send(octets)
    vehicle.mav.local_position_ned_send(1, 1.0, 2.0, 3.0, 0.0, 0.0, 0.0)
    for _ in range(20):
        vehicle.mav.local_position_ned_send(1, 1.0, 2.0, 3.0, 0.0, 0.0, 0.0)
    assert arrived(source)
    assert source.counts["bad-data"] > 0
    assert "not valid MAVLink" in source.take_complaints()[0]


def test_numbers_that_do_not_fit_are_counted(stream):
    source, vehicle = stream(profile="student-2024")
    vehicle.mav.local_position_ned_send(1, float("nan"), 2.0, 3.0, 0.0, 0.0, 0.0)
    vehicle.mav.local_position_ned_send(1, 1.0, 2.0, 3.0, 0.0, 0.0, 0.0)
    assert arrived(source)[0]["position_x"] == 2
    assert source.counts["out-of-range"] == 1


@pytest.mark.part("links")
def test_silence_is_reported_once(stream):
    source, vehicle = stream()
    assert source.poll_timeout() == 0
    source.poll(0, 0)
    assert source.poll_timeout() == 5 * S
    source.poll(5 * S, 0)
    (told,) = source.take_complaints()
    assert "no LOCAL_POSITION_NED for 5 s" in told
    assert source.poll_timeout() is None
    vehicle.mav.local_position_ned_send(1, 1.0, 2.0, 3.0, 0.0, 0.0, 0.0)
    assert arrived(source, 6 * S)
    source.poll(20 * S, 0)
    assert source.counts["silent"] == 2
    assert source.take_complaints() == []


@pytest.mark.part("links")
def test_a_tcp_connection_comes_back():
    common = needs_pymavlink()
    port = own_port()
    source = opened(f"mavlink:tcp:127.0.0.1:{port}", "sim-2.0")
    end = time.monotonic() + PATIENCE
    # There is no listener yet.
    while source.fileno() >= 0 and time.monotonic() < end:
        source.poll(0, 0)
    assert source.counts["disconnected"] == 1
    assert source.poll_timeout() == S
    assert source.poll(S - 1, 0) == []
    now = S
    for _ in range(2):
        with socket.create_server(("127.0.0.1", port)) as server:
            source.poll(now, 0)
            while not select.select([server], [], [], 0)[0]:
                # It has to see that the connection before is at its end, and then to wait for a second.
                assert time.monotonic() < end
                now += S
                source.poll(now, 0)
            connection, _ = server.accept()
            with connection:
                mav = common.MAVLink(None, srcSystem=1, srcComponent=1)
                message = common.MAVLink_local_position_ned_message(1, 1.0, 2.0, 3.0, 0.0, 0.0, 0.0)
                connection.sendall(message.pack(mav))
                assert position_of(arrived(source, now)[0])[:3] == [2, 1, -3]
        while source.fileno() >= 0:
            source.poll(now, 0)
        assert source.poll_timeout() == now + S
    assert len(source.take_complaints()) == 1
    source.close()
    source.close()
    assert source.finished
    assert source.poll_timeout() is None
    assert source.poll(99 * S, 0) == []


@pytest.mark.part("links")
def test_a_serial_line_is_read():
    common = needs_pymavlink()
    import pty
    import tty

    master, slave = pty.openpty()
    try:
        tty.setraw(slave)
        source = opened(f"mavlink:serial:{os.ttyname(slave)}:57600", "sim-2.0")
        mav = common.MAVLink(None, srcSystem=1, srcComponent=1)
        os.write(master, common.MAVLink_local_position_ned_message(1, 1.0, 2.0, 3.0, 0.0, 0.0, 0.0).pack(mav))
        assert position_of(arrived(source)[0])[:3] == [2, 1, -3]
        source.close()
    finally:
        os.close(master)
        os.close(slave)


def test_without_pymavlink_the_error_gives_a_remedy(monkeypatch):
    monkeypatch.setitem(sys.modules, "pymavlink", None)
    monkeypatch.setitem(sys.modules, "pymavlink.dialects.v20.common", None)
    with pytest.raises(SourceError, match=r"pip install 'dcp-conformance-kit\[mavlink\]'"):
        opened("mavlink:udpin:127.0.0.1:14550")


def test_a_port_in_use_is_an_error():
    needs_pymavlink()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        with pytest.raises(SourceError, match="cannot be opened"):
            opened(f"mavlink:udpin:127.0.0.1:{taken.getsockname()[1]}")


def test_local_coordinates_against_a_sphere_of_the_same_curvature():
    origin = (47.0, 11.0, 500.0)
    assert local(47.0, 11.0, 530.0, origin) == (0, 0, 30)
    east, north, _ = local(47.001, 11.001, 500.0, origin)
    assert north == pytest.approx(111.18, rel=1e-3)
    assert east == pytest.approx(76.06, rel=1e-3)
    # Across the date line the short way.
    assert local(0.0, -179.999, 0.0, (0.0, 179.999, 0.0))[0] == pytest.approx(222.6, rel=1e-3)


# -- opening -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ("", "no position source ''"),
        ("tracks:line", "did you mean 'track'"),
        ("gps", "known sources are track, csv, capture, stdin, mavlink"),
        ("track:", "no track ''; known tracks are line, circle, waypoints, walk"),
        ("track:line,velocity=3", "no option 'velocity'; known options are climb"),
        ("track:line,speed", "'speed' is not of the form key=value"),
        ("track:line,speed=fast", "speed takes a number, not 'fast'"),
        ("track:line,speed=inf", "speed takes a number"),
        ("track:line,speed=1,speed=2", "speed is given twice"),
        ("track:line,length=0", "length must be greater than 0"),
        ("track:circle,radius=-1", "radius must be greater than 0"),
        ("track:circle,rate=0", "rate must be"),
        ("track:waypoints", "points takes three numbers"),
        ("track:waypoints,points=0/0/0", "two different points"),
        ("track:waypoints,points=0/0/0;1/0/0,speed=0", "speed must be greater"),
        ("track:waypoints,points=0/0/0;1/0/0,loop=maybe", "loop takes yes or no"),
        ("track:walk,extent=0", "extent must be greater"),
        ("csv:/no/such/file", "No such file"),
        ("csv:", "cannot be read"),
        ("capture:/no/such/file", "No such file"),
        (f"capture:{CAPTURES}/a_bus3.mcap,profile=none", "none"),
        (f"capture:{CAPTURES}/a_bus3.mcap,profile=cpp-2.0", "which node? Add node=ID, one of 02:00:00:00:00:01, "),
        (f"capture:{CAPTURES}/a_bus3.mcap,profile=cpp-2.0,node=5", "no state report of 5; the nodes are 02:00"),
        (f"capture:{CAPTURES}/a_bus3.mcap,profile=cpp-2.0,node=02:00:00:00:00:01,speed=0", "speed must be greater"),
        (f"capture:{CAPTURES}/a_bus3.mcap,profile=sim-2.0", "no state report in it"),
        ("stdin:x", "stdin takes no options"),
        ("mavlink:", "a connection is udpin:HOST:PORT"),
        ("mavlink:udpin:host", "a connection is udpin:HOST:PORT"),
        ("mavlink:udpin:host:0", "a port is 1 to 65535"),
        ("mavlink:udpin:127.0.0.1:14550,frame=xyz", "frame is enu or ned"),
        ("mavlink:udpin:127.0.0.1:14550,origin=1/2", "origin takes three numbers"),
        ("mavlink:udpin:127.0.0.1:14550,origin=100/2/3", "latitude"),
        ("mavlink:udpin:127.0.0.1:14550,system=0", "system takes an integer from 1 to 255"),
        ("mavlink:serial:/dev/null:57600", "is not a serial line"),
        ("mavlink:serial:/dev/null:5", "5 baud"),
    ],
)
def test_errors_name_the_source_and_what_is_wrong(spec, words):
    if spec.startswith("mavlink:serial"):
        needs_pymavlink()
    with pytest.raises(SourceError) as error:
        opened(spec)
    assert str(error.value).startswith(f"{spec}: ")
    assert words in str(error.value)


@pytest.mark.parametrize("spec", ["track:line", "stdin", "mavlink:udpin:127.0.0.1:14550"])
def test_a_profile_without_safety_data_has_no_sources(spec):
    with pytest.raises(SourceError, match="no safety data"):
        opened(spec, "sim-1.0")


def test_a_profile_without_a_position_has_no_tracks():
    codec = type(get_codec("dcp-2.0"))(profile_with("bare", ("battery", "u8", "", "")))
    for spec in ("track:line", "mavlink:udpin:127.0.0.1:14550"):
        with pytest.raises(SourceError, match="no fields for a position"):
            open_source(spec, codec, rng=random.Random(1))


@given(st.text(max_size=30), st.sampled_from(["", "track:", "track:line,", "track:waypoints,points=", "mavlink:"]))
def test_any_text_raises_at_most_a_source_error(text, start):
    if start == "mavlink:" and text.partition(":")[0] in ("udpin", "tcp", "serial"):
        return
    with contextlib.suppress(SourceError):
        opened(start + text, stdin=0).close()


def test_standard_input_is_the_default(monkeypatch, pipe):
    reading, _ = pipe
    with os.fdopen(os.dup(reading)) as file:
        monkeypatch.setattr(sys, "stdin", file)
        assert opened("stdin").fileno() == file.fileno()


def test_the_parts_are_usable_alone():
    assert Track("t", Line((0, 0, 0), course=0, speed=1), fields_of()).poll_timeout() == 0
    with pytest.raises(ValueError, match="nothing to replay"):
        Replay("r", [])
    with pytest.raises(SourceError):
        port_opener("udpout:1:2")
    assert MavlinkStream.__doc__


@pytest.mark.parametrize("profile", ["dcp-2.0", "sim-2.0", "student-2024"])
def test_integers_beyond_all_floats_are_refused(profile):
    with pytest.raises(FieldError, match="so large an integer"):
        fields_of(profile).from_sample({"x": 10**400, "y": 1, "z": 2})
    with pytest.raises(FieldError, match="cannot be 1000"):
        fields_of("student-2024").from_sample({"position_x": 10**400})


@pytest.mark.parametrize(
    "spec",
    [
        "track:circle,radius=1e-300,speed=1e200",
        "track:line,length=1e-320,speed=1e200",
    ],
)
def test_tracks_at_the_end_of_the_number_range_are_reported(spec):
    source = opened(spec)
    assert [each for second in range(1, 5) for each in source.poll(second * S, 0)][1:] == []
    assert source.counts["out-of-range"] >= 3
    assert len(source.take_complaints()) == 1


def test_an_unknown_position_of_the_autopilot_is_not_used(stream):
    source, vehicle = stream()
    vehicle.mav.local_position_ned_send(1, float("nan"), 2.0, 3.0, 0.0, 0.0, 0.0)
    vehicle.mav.local_position_ned_send(1, 1.0, 2.0, 3.0, float("nan"), 0.0, 0.0)
    # The velocity may be unknown by itself.
    assert [position_of(sample) for sample in arrived(source)] == [[2, 1, -3, 0, 0, 0]]
    assert source.counts["out-of-range"] == 1
