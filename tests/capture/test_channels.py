"""Decoded channels of MCAP files, read back with the mcap library alone, as a viewer does."""

from __future__ import annotations

import hashlib
import json
import math
import random
import tomllib
from collections import Counter
from pathlib import Path

import jsonschema
import msgspec
import pytest
from dcp_spec.profile.definition import Link, Profile
from dcp_spec.profile.loading import load_profile, profile_names
from dcp_spec.version import __version__
from mcap.reader import make_reader

from dcp_codec import Codec, get_codec
from dcp_codec.capture import Frame, create_capture
from dcp_codec.capture.mcap import raw_frame as rawframe
from dcp_codec.export.example import example_beacon
from dcp_codec.foxglove.channels import MAX_POSE_TOPICS, DecodedChannels, capture_metadata, pose_topic
from dcp_codec.values import (
    Beacon,
    BPHeader,
    Container,
    ExtendedSafetyData,
    Payload,
    VarCreate,
    VarDelete,
    VarReqCreate,
    VarSpec,
    VarSumm,
    VarUpdate,
)

from ..parts import every

CAPTURES = Path(__file__).resolve().parents[2] / "captures"
RECORDINGS = tomllib.loads((CAPTURES / "manifest.toml").read_text())["capture"]
ETHERNET = bytes.fromhex("ffffffffffff 020000000001 4953")
TIME_NS = 1_700_000_000_123_456_789


@pytest.fixture(params=every(4, RECORDINGS), ids=lambda recording: recording["file"])
def recording(request):
    return request.param


def read(path):
    """(summary, [(schema, channel, message)], metadata by name, attachments by name) of an MCAP file."""
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        return (
            reader.get_summary(),
            list(reader.iter_messages(log_time_order=False)),
            {record.name: record.metadata for record in reader.iter_metadata()},
            {attachment.name: attachment for attachment in reader.iter_attachments()},
        )


def assert_valid_messages(messages):
    validators = {}
    for schema, channel, message in messages:
        if schema.encoding == "protobuf":
            assert (channel.topic, channel.message_encoding) == ("/dcp/frames", "protobuf")
            assert rawframe.decode(message.data).data
            continue
        assert schema.encoding == "jsonschema"
        assert channel.message_encoding == "json"
        if schema.id not in validators:
            document = json.loads(schema.data)
            jsonschema.Draft202012Validator.check_schema(document)
            assert_viewer_reads(document)
            validators[schema.id] = jsonschema.Draft202012Validator(document)
        found = next(validators[schema.id].iter_errors(json.loads(message.data)), None)
        assert found is None, f"{channel.topic}: {found.json_path}: {found.message}"


def assert_viewer_reads(schema):
    """Viewers turn a schema into columns: an object of columns, each of one type."""
    assert schema["type"] == "object"
    for name, column in schema["properties"].items():
        assert column["type"] in ("boolean", "string", "number", "integer", "object", "array"), name
        assert "oneOf" not in column
        assert "contentEncoding" not in column or column["contentEncoding"] == "base64"
        if column["type"] == "array":
            column = column["items"]
            assert column["type"] in ("boolean", "string", "number", "integer", "object"), name
        if column["type"] == "object":
            assert_viewer_reads(column)
    assert "$ref" not in json.dumps(schema)


def decoded(codec, *frames, link=None):
    """topic -> messages of frames given as bearer payloads."""
    source, found = DecodedChannels(codec, link), {}
    for number, octets in enumerate(frames, start=1):
        frame = Frame(number, TIME_NS + number, ETHERNET + octets, len(ETHERNET + octets))
        for message in source.messages(frame):
            assert message.time_ns == frame.time_ns
            check = jsonschema.Draft202012Validator(json.loads(message.schema))
            check.validate(json.loads(message.data))
            found.setdefault(message.topic, []).append(json.loads(message.data))
    return found


# -- the recordings ---------------------------------------------------------------------------------------------


def test_every_message_fits_the_schema_of_its_channel(recording):
    _, messages, _, _ = read(CAPTURES / recording["file"])
    assert_valid_messages(messages)


def test_there_is_a_message_for_everything(recording):
    _, messages, _, _ = read(CAPTURES / recording["file"])
    expected = recording["expected"]
    topics = Counter(channel.topic for _, channel, _ in messages)
    poses = sum(number for topic, number in topics.items() if topic.startswith("/dcp/pose/"))
    assert topics["/dcp/frames"] == recording["frames"]
    assert topics["/dcp/bp"] == expected["beacons"]
    assert topics["/dcp/srp"] == poses == expected["srp"]
    assert topics["/dcp/vardis"] == sum(expected["containers"].values())
    assert topics["/dcp/errors"] == 0
    containers = [json.loads(message.data) for _, channel, message in messages if channel.topic == "/dcp/vardis"]
    assert Counter(container["icName"] for container in containers) == expected["containers"]
    records = Counter()
    for container in containers:
        records[container["icName"]] += len(container["records"])
    assert records == expected["records"]


def test_messages_follow_their_frame_with_its_time(recording):
    _, messages, _, _ = read(CAPTURES / recording["file"])
    frame = None
    for _, channel, message in messages:
        body = json.loads(message.data)
        assert body["timestamp"]["sec"] * 10**9 + body["timestamp"]["nsec"] == message.log_time == message.publish_time
        if channel.topic == "/dcp/frames":
            frame = body
        elif not channel.topic.startswith("/dcp/pose/"):
            assert body["frame"] == frame["number"] == message.sequence
            assert body["timestamp"] == frame["timestamp"]


def test_poses_have_the_schema_of_foxglove(recording):
    _, messages, _, _ = read(CAPTURES / recording["file"])
    for schema, channel, message in messages:
        if channel.topic.startswith("/dcp/pose/"):
            assert schema.name == "foxglove.PoseInFrame"
            body = json.loads(message.data)
            assert set(body) == {"timestamp", "frame_id", "pose"}
            assert set(body["timestamp"]) == {"sec", "nsec"}
            assert set(body["pose"]) == {"position", "orientation"}
            assert set(body["pose"]["position"]) == set("xyz")
            assert body["pose"]["orientation"] == {"x": 0, "y": 0, "z": 0, "w": 1}
    topics = {channel.topic for _, channel, _ in messages if "/pose/" in channel.topic}
    nodes = {f"/dcp/pose/02-00-00-00-00-0{number}" for number in (1, 2, 3)}
    assert topics == (nodes if recording["expected"]["srp"] else set())


def test_the_recording_itself_is_attached(recording):
    _, _, _, attachments = read(CAPTURES / recording["file"])
    assert list(attachments) == [recording["original"]]
    attachment = attachments[recording["original"]]
    assert attachment.media_type == "application/vnd.tcpdump.pcap"
    assert hashlib.sha256(attachment.data).hexdigest() == recording["original_sha256"]


def test_a_file_contains_schemas_and_profile(recording):
    summary, _, metadata, _ = read(CAPTURES / recording["file"])
    assert summary.statistics.metadata_count == len(metadata) == 4
    assert metadata["dcp.tool"]["name"] == "dcp-codec"
    assert metadata["dcp.recording"] == {"what": recording["what"], "origin": recording["origin"]}
    about = metadata["dcp.profile"]
    assert about["name"] == recording["profile"]
    profile = load_profile(recording["profile"])
    assert metadata["dcp.specification"]["version"] == profile.spec_version
    assert msgspec.convert(tomllib.loads(about["toml"]), Profile).types == profile.types
    assert msgspec.json.decode(about["json"], type=Profile).bp == profile.bp


# -- metadata -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", every(3, profile_names()))
def test_the_text_of_a_profile_is_the_profile(name, tmp_path):
    codec = get_codec(name)
    metadata = capture_metadata(codec)
    assert set(metadata) == {"dcp.tool", "dcp.specification", "dcp.profile"}
    assert metadata["dcp.tool"]["version"] == __version__
    path = tmp_path / "again.toml"
    path.write_text(metadata["dcp.profile"]["toml"])
    assert load_profile(path) == codec.profile
    assert msgspec.json.decode(metadata["dcp.profile"]["json"], type=Profile) == codec.profile


# -- profiles and frames of all kinds -----------------------------------------------------------------------------


@pytest.mark.parametrize("name", every(3, profile_names()))
def test_every_profile_has_channels(name, tmp_path):
    codec = get_codec(name)
    link = Link(transport="ethernet", ether_type=0x4953)
    octets = ETHERNET + codec.encode(example_beacon(codec))
    path = tmp_path / "some.mcap"
    with create_capture(path, messages=DecodedChannels(codec, link)) as writer:
        writer.write(Frame(1, TIME_NS, octets, len(octets)))
    _, messages, _, _ = read(path)
    assert_valid_messages(messages)
    topics = Counter(channel.topic for _, channel, _ in messages)
    assert topics["/dcp/bp"] == 1
    assert topics["/dcp/vardis"] == 2
    assert topics["/dcp/srp"] == (codec.srp_plan is not None)
    positions = [member for member in codec.profile.srp.safety_data if member.role.startswith("position")]
    assert sum("/pose/" in topic for topic in topics) == bool(positions)


def test_contents_of_a_beacon_message():
    codec = get_codec("cpp-2.0")
    found = decoded(codec, codec.encode(example_beacon(codec)) + bytes(5))
    (beacon,) = found["/dcp/bp"]
    assert beacon == {
        "timestamp": {"sec": 1_700_000_000, "nsec": 123_456_790},
        "frame": 1,
        "sender": "02:00:00:00:00:01",
        "src": "02:00:00:00:00:01",
        "dst": "ff:ff:ff:ff:ff:ff",
        "etherType": 0x4953,
        "version": 1,
        "magicNo": 0x497E,
        "senderId": "02:00:00:00:00:01",
        "networkId": 0x1111,
        "length": 109,
        "numPayloads": 2,
        "seqno": 41,
        "payloads": [{"protocolId": 1, "length": 64}, {"protocolId": 2, "length": 37}],
        "padding": 5,
        "errors": 0,
        "warnings": 0,
    }
    assert [(each["payload"], each["container"], each["icName"]) for each in found["/dcp/vardis"]] == [
        (1, 0, "CREATE-VARIABLES"),
        (1, 1, "SUMMARIES"),
    ]
    assert found["/dcp/vardis"][0]["records"][0]["upd"]["value"] == "41424344"
    assert found["/dcp/srp"][0]["sData"] == {"x": 1.5, "y": 3.0, "z": 4.5}
    assert found["/dcp/pose/02-00-00-00-00-01"][0]["pose"]["position"] == {"x": 1.5, "y": 3.0, "z": 4.5}


def test_a_message_without_columns_is_refused_unless_malformed():
    codec = get_codec("cpp-2.0")
    frame = ETHERNET + codec.encode(example_beacon(codec))
    for message in DecodedChannels(codec).messages(Frame(1, TIME_NS, frame, len(frame))):
        check = jsonschema.Draft202012Validator(json.loads(message.schema))
        body = json.loads(message.data)
        if "errors" not in body:
            continue
        for name in ("timestamp", "frame", "errors", "seqno", "nodeId", "icName", "records", "senderId"):
            if name in body:
                without = {key: value for key, value in body.items() if key != name}
                assert not check.is_valid(without), (message.topic, name)
        if "icType" in body:
            assert not check.is_valid({**body, "icType": 2})
            assert not check.is_valid({**body, "records": [{"value": "00"}]})


def test_other_traffic_has_no_messages():
    source = DecodedChannels(get_codec("cpp-2.0"))
    assert list(source.messages(Frame(1, TIME_NS, b"", 0))) == []
    assert list(source.messages(Frame(1, TIME_NS, bytes(60), 60))) == []


def test_errors_and_warnings_have_messages():
    codec = get_codec("cpp-2.0")
    octets = bytearray(codec.encode(example_beacon(codec)))
    octets[1] = 0
    (problem,) = decoded(codec, bytes(octets))["/dcp/errors"]
    assert problem["severity"] == "error"
    assert (problem["reason"], problem["path"], problem["offset"]) == ("bad-magic", "bp.magicNo", 15)
    assert (problem["requirement"], problem["needed"], problem["available"]) == ("BP-RX-02", 0x497E, 0x007E)
    assert problem["message"].startswith("bp.magicNo at octet 15: bad-magic")
    beacon = example_beacon(codec)
    report = msgspec.structs.replace(beacon.payloads[0].srp, node_id=b"\x02\0\0\0\0\x09")
    foreign = msgspec.structs.replace(beacon, payloads=(Payload(1, report),))
    found = decoded(codec, codec.encode(foreign))
    assert [(each["severity"], each["reason"]) for each in found["/dcp/errors"]] == [("warning", "foreign-node-id")]
    assert "requirement" in found["/dcp/errors"][0]
    assert "needed" not in found["/dcp/errors"][0]
    assert found["/dcp/bp"][0]["warnings"] == 1
    assert "/dcp/pose/02-00-00-00-00-09" in found


def test_readable_parts_of_a_malformed_frame_have_messages():
    codec = get_codec("cpp-2.0")
    octets = codec.encode(example_beacon(codec))
    found = decoded(codec, octets[:-1])
    (beacon,) = found["/dcp/bp"]
    assert beacon["seqno"] == 41
    assert beacon["errors"] >= 1
    assert found["/dcp/srp"][0]["nodeId"] == "02:00:00:00:00:01"
    assert found["/dcp/vardis"][1]["records"] == [{"varId": 7, "seqno": 3}, {"varId": 9}]
    assert not any("/pose/" in topic for topic in found)
    header = decoded(codec, octets[:5])["/dcp/bp"][0]
    assert "senderId" not in header
    assert header["magicNo"] == 0x497E
    assert decoded(codec, b"")["/dcp/bp"][0]["payloads"] == []


def test_holdings_of_nodes():
    codec = get_codec("dcp-2.0")
    one, two = b"\x02\0\0\0\0\1", b"\x02\0\0\0\0\2"
    create = VarCreate(VarSpec(7, one, 1, b"x", 5, 0), VarUpdate(7, 0, b"v"))
    sent = [
        (one, create), (two, VarSumm(7, 0)), (one, VarUpdate(7, 1, b"v")), (two, VarSumm(7, 0)), (one, VarSumm(7, 1)),
        (one, VarUpdate(7, 2, b"v")), (two, VarUpdate(7, 1, b"v")), (one, VarDelete(7)), (two, VarReqCreate(8)),
    ]  # fmt: skip
    numbers = codec.profile.vardis.container_types.by_name()
    source, found = DecodedChannels(codec), []
    for number, (node, record) in enumerate(sent, 1):
        container = Container(numbers[record.IC_TYPE.label], (record,))
        frame = ETHERNET + codec.encode(Beacon(BPHeader(node, number, 0), (Payload(2, (container,)),)))
        for message in source.messages(Frame(number, TIME_NS + number, frame, len(frame))):
            if message.topic == "/dcp/holdings":
                found.append(json.loads(message.data))
    rows = [
        (each["frame"], each["sender"][-1], each["varId"], each["state"], each.get("seqno"), each.get("lag"))
        for each in found
    ]
    assert rows == [
        (1, "1", 7, "held", 0, 0),
        (2, "2", 7, "held", 0, 0),
        (3, "1", 7, "held", 1, 0),
        (6, "1", 7, "held", 2, 0),
        (7, "2", 7, "held", 1, 1),
        (8, "1", 7, "deleted", None, None),
        (9, "2", 8, "unknown", None, None),
    ]


def test_a_bad_state_report_has_no_message_and_hides_nothing():
    codec = get_codec("dcp-1.2")
    vardis = codec.encode_containers((Container(1, (VarSumm(7, 3),)),))
    blocks = (Payload(1, bytes(range(0x20, 0x48))), Payload(2, vardis))
    octets = codec.encode_envelope(Beacon(BPHeader(b"\x02\0\0\0\0\1", 4), blocks))
    found = decoded(codec, octets)
    assert set(found) == {"/dcp/bp", "/dcp/vardis", "/dcp/holdings", "/dcp/errors"}
    assert found["/dcp/vardis"][0]["records"] == [{"varId": 7, "seqno": 3}]
    # Nothing that the bad report says breaks a rule of its own.
    (error,) = found["/dcp/errors"]
    assert (error["reason"], error["path"]) == ("wrong-length", "payloads[0].srp")


def test_a_bad_container_leaves_the_state_report_and_its_position():
    codec = get_codec("cpp-2.0")
    report = example_beacon(codec).payloads[0]
    blocks = (Payload(1, codec.encode_report(report.srp)), Payload(2, b"\x09\x01\x05"))
    found = decoded(codec, codec.encode_envelope(Beacon(BPHeader(b"\x02\0\0\0\0\1", 4, 0x1111), blocks)))
    assert [each["reason"] for each in found["/dcp/errors"]] == ["unknown-type"]
    assert len(found["/dcp/srp"]) == len(found["/dcp/pose/02-00-00-00-00-01"]) == 1


@pytest.mark.parametrize("name", every(3, ["cpp-2.0", "cpp-1.3", "dcp-1.0", "sim-1.0", "student-2024"]))
def test_no_frame_raises(name):
    codec = get_codec(name)
    link = Link(transport="ethernet", ether_type=0x4953)
    whole, rnd = codec.encode(example_beacon(codec)), random.Random(4)
    frames = [rnd.randbytes(rnd.randrange(100)) for _ in range(50)]
    for _ in range(100):
        octets = bytearray(whole)
        for _ in range(rnd.randrange(1, 6)):
            octets[rnd.randrange(len(octets))] = rnd.randrange(256)
        frames.append(bytes(octets[: rnd.randrange(len(octets) + 1)]))
    found = decoded(codec, *frames, link=link)
    assert len(found["/dcp/bp"]) == len(frames)
    assert found["/dcp/errors"]


# -- positions ----------------------------------------------------------------------------------------------------


def with_report(codec, **values):
    beacon = example_beacon(codec)
    report = beacon.payloads[0].srp
    known = report.s_data.as_dict() | values
    changed = msgspec.structs.replace(report, s_data=codec.safety_data_type(**known))
    return codec.encode(msgspec.structs.replace(beacon, payloads=(Payload(1, changed),)))


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf])
def test_numbers_that_json_does_not_have_are_left_out(number):
    codec = get_codec("cpp-2.0")
    found = decoded(codec, with_report(codec, y=number))
    assert found["/dcp/srp"][0]["sData"] == {"x": 1.5, "z": 4.5}
    assert not any("/pose/" in topic for topic in found)


@pytest.mark.parametrize(
    ("unit", "position"), [("cm", {"x": 1.5, "y": -0.02, "z": 0.0}), ("", {"x": 150, "y": -2, "z": 0}), ("deg", None)]
)
def test_positions_are_in_metres(tmp_path, unit, position):
    path = tmp_path / "own.toml"
    path.write_text(
        'extends = "dcp-2.0"\nname = "own"\ntitle = "Own"\n[srp]\nsafety_data = ['
        f'{{ name = "east", type = "i32", unit = "{unit}", role = "position.x" }},'
        f'{{ name = "north", type = "i32", unit = "{unit}", role = "position.y" }}]\n'
    )
    codec = Codec(load_profile(path))
    found = decoded(codec, with_report(codec, east=150, north=-2))
    poses = found.get("/dcp/pose/02-00-00-00-00-01")
    assert (poses[0]["pose"]["position"] if poses else None) == (position and pytest.approx(position))


def test_topics_of_nodes_have_plain_characters_and_bounded_length():
    assert pose_topic("02:00:00:00:00:01") == "/dcp/pose/02-00-00-00-00-01"
    assert pose_topic("a/b {c}") == "/dcp/pose/a-b-c-"
    assert pose_topic("") == "/dcp/pose/-"
    codec = get_codec("cpp-2.0")
    source = DecodedChannels(codec)
    beacon = example_beacon(codec)
    topics = set()
    for node in range(MAX_POSE_TOPICS + 5):
        report: ExtendedSafetyData = msgspec.structs.replace(beacon.payloads[0].srp, node_id=node.to_bytes(6, "big"))
        octets = ETHERNET + codec.encode(msgspec.structs.replace(beacon, payloads=(Payload(1, report),)))
        topics |= {message.topic for message in source.messages(Frame(1, TIME_NS, octets, len(octets)))}
    assert sum("/pose/" in topic for topic in topics) == MAX_POSE_TOPICS


def test_a_profile_may_use_the_names_of_columns(tmp_path):
    path = tmp_path / "own.toml"
    path.write_text(
        'extends = "student-2024"\nname = "own"\ntitle = "Own"\n[vardis]\ncontainer_extra = ['
        '{ extra = { width = 8 }, name = "timestamp" }, { extra = { width = 1 }, name = "frame" }]\n'
    )
    codec = Codec(load_profile(path))
    found = decoded(codec, codec.encode(example_beacon(codec)), link=Link(ether_type=0x4953))
    assert found["/dcp/vardis"][0]["timestamp"] == {"sec": 1_700_000_000, "nsec": 123_456_790}
    assert found["/dcp/vardis"][0]["frame"] == 1
