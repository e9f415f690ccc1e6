"""MCAP files for ROS 2 are read by libraries of others, and say what the recording says."""

from __future__ import annotations

import io
import json
from collections import Counter
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from dcp_codec import get_codec
from dcp_codec.capture import CaptureError, Frame, convert, create_capture, open_capture
from dcp_codec.capture.mcap import raw_frame as rawframe
from dcp_codec.cli import main
from dcp_codec.export.example import example_beacon
from dcp_codec.foxglove.channels import DecodedChannels
from dcp_codec.foxglove.layouts import layout_of
from dcp_codec.framing.frames import FrameDissector
from dcp_codec.framing.locate import OtherTraffic
from dcp_codec.ros2 import DEFINITIONS, write_bag
from dcp_codec.ros2.content import Content, pose_topic

CAPTURES = Path(__file__).resolve().parents[2] / "captures"
PROFILES = {"a_bus3": "cpp-2.0", "a_bus3_v1.3.6": "cpp-1.3", "b_crud": "cpp-2.0", "c_latejoin": "cpp-2.0"}
SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND


def ns(stamp: Any) -> int:
    return stamp.sec * SECOND + stamp.nanosec


def by_rosbags(path: Path) -> list[tuple[str, int, Any]]:
    with AnyReader([path]) as reader:
        return [
            (connection.topic, time, reader.deserialize(octets, connection.msgtype))
            for connection, time, octets in reader.messages()
        ]


def by_mcap(path: Path) -> list[tuple[str, int, Any]]:
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        return [(channel.topic, message.log_time, ros) for _, channel, message, ros in reader.iter_decoded_messages()]


@pytest.fixture(scope="module", params=PROFILES)
def bag(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Any]:
    source = CAPTURES / f"{request.param}.mcap"
    target = tmp_path_factory.mktemp("ros2") / "bag.mcap"
    return source, target, write_bag(source, target, get_codec(PROFILES[request.param]))


def expected(source: Path) -> tuple[list[tuple[Any, ...]], list[tuple[Any, ...]]]:
    """Poses and variables as the dissector reads them."""
    dissector = FrameDissector(get_codec(PROFILES[source.stem]))
    poses, variables = [], []
    with open_capture(source) as reader:
        for frame in reader:
            found = dissector.dissect(frame)
            if isinstance(found, OtherTraffic):
                continue
            for payload in found.as_json()["payloads"]:
                if payload.get("srp") is not None:
                    data = payload["srp"]["sData"]
                    poses.append((payload["srp"]["nodeId"], frame.time_ns, data["x"], data["y"], data["z"]))
                for container in payload.get("vardis", ()):
                    for record in container["records"]:
                        kind = container["icName"]
                        if kind in ("CREATE-VARIABLES", "UPDATES", "DELETE-VARIABLES"):
                            update = record.get("upd", record)
                            spec = record.get("spec", {})
                            variables.append(
                                (
                                    frame.number, found.sender, kind, update["varId"], update.get("seqno", 0),
                                    update.get("value", ""), spec.get("prodId", ""), spec.get("descr", ""),
                                    spec.get("repCnt", 0), spec.get("timeout", 0),
                                )
                            )  # fmt: skip
    return poses, variables


@pytest.mark.parametrize("read", [by_rosbags, by_mcap])
def test_other_readers_get_the_contents_of_the_recording(bag, read):
    source, target, report = bag
    messages = read(target)
    poses, variables = expected(source)
    assert variables
    assert Counter(topic for topic, _, _ in messages) == report.messages
    names = {1: "CREATE-VARIABLES", 2: "UPDATES", 3: "DELETE-VARIABLES"}
    found = []
    for topic, time, each in messages:
        assert ns(each.header.stamp) == time
        if topic == "/dcp/variables":
            value = bytes(each.value).hex()
            fields = (names[each.kind], each.var_id, each.seqno, value, each.prod_id, each.descr)
            found.append((each.frame, each.sender, *fields, each.rep_cnt, each.timeout_ms))
    # rosbags sorts by time; records of one frame have one.
    assert sorted(found) == sorted(variables)
    positions = [(topic, time, each.pose) for topic, time, each in messages if topic.startswith("/dcp/pose/")]
    assert sorted((topic, time, p.position.x, p.position.y, p.position.z) for topic, time, p in positions) == sorted(
        (pose_topic(node), *rest) for node, *rest in poses
    )
    assert {(p.orientation.x, p.orientation.y, p.orientation.z, p.orientation.w) for _, _, p in positions} <= {
        (0.0, 0.0, 0.0, 1.0)
    }


@pytest.mark.parametrize("read", [by_rosbags, by_mcap])
def test_neighbour_tables(bag, read):
    source, target, report = bag
    tables = [(time, each) for topic, time, each in read(target) if topic == "/dcp/neighbours"]
    dissector = FrameDissector(get_codec(PROFILES[source.stem]))
    beacons = Counter()
    with open_capture(source) as reader:
        for frame in reader:
            found = dissector.dissect(frame)
            if not isinstance(found, OtherTraffic):
                beacons[found.sender] += 1
    times = [time for time, _ in tables]
    assert times == sorted(times)
    assert all(later - one >= SECOND for one, later in pairwise(times[:-1]))
    for time, table in tables:
        names = [each.node_id for each in table.neighbours]
        assert names == sorted(set(names))
        assert all(time - 5 * SECOND <= ns(each.last_heard) <= time for each in table.neighbours)
    last = {each.node_id: each.beacons for each in tables[-1][1].neighbours}
    assert last.items() <= beacons.items()
    assert last
    assert report.damaged == 0


def test_definitions_are_those_of_ros(bag):
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    for name, text in DEFINITIONS.items():
        for other, definition in get_types_from_msg(text.partition("=" * 80)[0], name).items():
            if other in store.types:
                store.register({other: definition})
    standard = DEFINITIONS["geometry_msgs/msg/PoseStamped"].split("=" * 80 + "\nMSG: ")[1:]
    for part in standard:
        name, _, text = part.partition("\n")
        full = name.replace("/", "/msg/")
        # Raises if the same name has other fields there.
        store.register(get_types_from_msg(text, full))


def content_of(profile: str, frames: list[Frame]) -> tuple[Content, list[Any]]:
    content = Content(get_codec(profile))
    return content, [message for frame in frames for message in content.messages(frame)] + list(content.end())


def framed(codec: Any, beacon: Any, number: int, time_ns: int, *, cut: int = 0) -> Frame:
    octets = codec.encode(beacon)
    data = bytes(range(6)) + bytes([2, 0, 0, 0, 0, 9]) + codec.profile.link.ether_type.to_bytes(2, "big") + octets
    data = data[: len(data) - cut]
    return Frame(number, time_ns, data, len(data))


def test_sound_payloads_of_damaged_beacons_count():
    codec = get_codec("cpp-2.0")
    with open_capture(CAPTURES / "a_bus3.mcap") as reader:
        frames = list(reader)
    whole, sound = content_of("cpp-2.0", frames)
    # Cut within the last payload: the contents before it are still there.
    cut = [Frame(f.number, f.time_ns, f.data[:-1], len(f.data) - 1) for f in frames]
    damaged, found = content_of("cpp-2.0", cut)
    assert whole.damaged == 0
    assert damaged.damaged > 0
    assert any(message.topic.startswith("/dcp/pose/") for message in found)
    assert 0 < len(found) <= len(sound)
    assert codec.profile.name == "cpp-2.0"


def test_a_silence_gives_one_table():
    codec = get_codec("cpp-2.0")
    beacon = example_beacon(codec)
    times = [0, 100 * SECOND, 100 * SECOND + 1, 101 * SECOND, 101 * SECOND + 1]
    frames = [framed(codec, beacon, number, START + time) for number, time in enumerate(times, start=1)]
    _, messages = content_of("cpp-2.0", frames)
    tables = [each for each in messages if each.topic == "/dcp/neighbours"]
    assert [each.time_ns - START for each in tables] == [100 * SECOND, 101 * SECOND, 101 * SECOND + 1]
    # At the end of the silence no beacon has been received for long.
    assert [len(each.fields["neighbours"]) for each in tables] == [0, 1, 1]


def test_times_outside_the_range_of_ros_are_refused(tmp_path):
    codec = get_codec("cpp-2.0")
    source, target = tmp_path / "late.pcapng", tmp_path / "bag.mcap"
    target.write_bytes(b"precious")
    with create_capture(source) as writer:
        writer.write(framed(codec, example_beacon(codec), 1, 2**31 * SECOND))
    with pytest.raises(CaptureError, match="frame 1 is later than 2038"):
        write_bag(source, target, codec)
    assert target.read_bytes() == b"precious"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bag.mcap", "late.pcapng"]


def test_other_traffic_gives_an_empty_bag():
    stream, source = io.BytesIO(), io.BytesIO()
    with create_capture(source, format="pcap") as writer:
        writer.write(Frame(1, START, bytes(60), 60))
    source.seek(0)
    report = write_bag(source, stream, get_codec("cpp-2.0"))
    assert (report.frames, report.messages, report.damaged) == (1, {}, 0)


def run(*arguments: Any) -> int:
    with pytest.raises(SystemExit) as ended:
        main([str(each) for each in arguments])
    return int(ended.value.code or 0)


def test_the_command(tmp_path, capsys):
    target = tmp_path / "bag.mcap"
    assert run("convert", "--to", "ros2", CAPTURES / "c_latejoin.mcap", target) == 0
    assert "messages on /dcp/neighbours" in capsys.readouterr().err
    assert by_mcap(target)
    for arguments in ((CAPTURES / "c_latejoin.mcap", "-"), (target, target), ("-", target)):
        assert run("convert", "--to", "ros2", *arguments) == 2
        assert len(capsys.readouterr().err.splitlines()) == 1


# -- layouts for Foxglove -----------------------------------------------------------------------------------------


def used(layout: Any) -> list[str]:
    """The panels that the arrangement names."""
    if isinstance(layout, str):
        return [layout]
    assert set(layout) == {"direction", "first", "second", "splitPercentage"}
    assert 0 < layout["splitPercentage"] < 100
    return used(layout["first"]) + used(layout["second"])


def topics_of(path: Path) -> set[str]:
    with path.open("rb") as stream:
        return {channel.topic for channel in make_reader(stream).get_summary().channels.values()}


@pytest.mark.parametrize("ros2", [False, True])
def test_a_layout_names_what_is_in_the_file(tmp_path, ros2):
    source, path = CAPTURES / "a_bus3.mcap", tmp_path / "file.mcap"
    codec = get_codec("cpp-2.0")
    if ros2:
        write_bag(source, path, codec)
    else:
        convert(source, path, messages=DecodedChannels(codec))
    layout = layout_of(path)
    assert sorted(used(layout["layout"])) == sorted(layout["configById"])
    topics = topics_of(path)
    poses = {topic for topic in topics if topic.startswith("/dcp/pose/")}
    scene = layout["configById"]["3D!positions"]
    assert set(scene["topics"]) == poses
    assert len(poses) == 3
    # The camera sees them all: it points to the middle of the three, 1000 m apart from each other.
    assert all(1000 < each < 4000 for each in scene["cameraState"]["targetOffset"])
    assert 2000 < scene["cameraState"]["distance"] < 10_000
    for name, panel in layout["configById"].items():
        paths = [each["value"] for each in panel.get("paths", ())] + [panel.get("topicPath", "/dcp/vardis")][:1]
        for value in paths:
            topic = value.partition("{")[0].partition(".")[0]
            assert topic in topics | {"/dcp/vardis"}, name
    if not ros2:
        lines = [each["value"] for each in layout["configById"]["Plot!beacons"]["paths"]]
        assert lines == [f'/dcp/bp{{sender=="02:00:00:00:00:0{node}"}}.seqno' for node in (1, 2, 3)]
        assert len({each["color"] for each in layout["configById"]["Plot!beacons"]["paths"]}) == 3


def test_the_command_for_layouts(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run("layout", CAPTURES / "b_crud.mcap") == 0
    assert json.loads((tmp_path / "b_crud.foxglove.json").read_text())["configById"]
    assert run("layout", CAPTURES / "b_crud.mcap") == 2
    assert "give --force to replace it" in capsys.readouterr().err
    assert run("layout", CAPTURES / "b_crud.mcap", "-o", "-") == 0
    assert json.loads(capsys.readouterr().out)["layout"]


@pytest.mark.parametrize("what", ["absent", "text", "raw", "cut"])
def test_files_without_a_layout(tmp_path, what, capsys):
    path = tmp_path / f"{what}.mcap"
    if what == "text":
        path.write_text("hello, this is not an MCAP file, and it is long enough to look for the end of one in it")
    elif what in ("raw", "cut"):
        convert(CAPTURES / "b_crud.mcap", path)
        if what == "cut":
            path.write_bytes(path.read_bytes()[:-100])
    assert run("layout", path, "-o", tmp_path / "x.json") == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert str(path) in line
    assert not (tmp_path / "x.json").exists()


# -- the document -------------------------------------------------------------------------------------------------


def test_the_document_has_the_definitions():
    text = (CAPTURES.parent / "docs" / "mcap.md").read_text()
    for definition in DEFINITIONS.values():
        for line in definition.partition("=" * 80)[0].splitlines():
            assert line.startswith("#") or line in text or "geometry_msgs/Pose pose" in line, line
    neighbour = DEFINITIONS["dcp_msgs/msg/NeighbourTable"].partition("MSG: dcp_msgs/Neighbour\n")[2]
    assert all(line.startswith("#") or line in text for line in neighbour.splitlines())
    for number, (name, _) in enumerate(rawframe.FIELDS, start=1):
        assert f" {name} = {number};" in text
