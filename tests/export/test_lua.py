"""The Wireshark dissector, run by the real tshark, shows what our dissector shows: every field, octet for octet."""

from __future__ import annotations

import math
import os
import runpy
import struct
import subprocess
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from dcp_spec.profile import Link
from dcp_spec.profile_loading import BUILTIN_PROFILES
from hypothesis import HealthCheck, Phase, given, settings

from dcp_codec import (
    Beacon,
    BPHeader,
    Codec,
    Container,
    ExtendedSafetyData,
    Field,
    Payload,
    VarCreate,
    VarDelete,
    VarReqCreate,
    VarReqUpdate,
    VarSpec,
    VarSumm,
    VarUpdate,
    get_codec,
    strategies,
)
from dcp_codec.capture import Frame, create_capture, open_capture
from dcp_codec.export.lua import filter_name, wireshark_dissector
from dcp_codec.frames import DissectedFrame, FrameDissector
from dcp_codec.plan import Exact, Group, Many, Scalar, Text

TESTS = Path(__file__).parent.parent
ODD_PROFILES = runpy.run_path(str(TESTS / "codec" / "conftest.py"))["ODD_PROFILES"]
RECORDINGS = sorted((TESTS.parent / "captures").glob("*.mcap"))

pytestmark = pytest.mark.tool("tshark")


@pytest.fixture(scope="module", params=[*BUILTIN_PROFILES, *ODD_PROFILES])
def codec(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Codec:
    if request.param not in ODD_PROFILES:
        return get_codec(request.param)
    path = tmp_path_factory.mktemp("profiles") / f"{request.param}.toml"
    path.write_text(ODD_PROFILES[request.param], encoding="utf-8")
    return Codec(path)


# -- what tshark says -------------------------------------------------------------------------------------------


class Shown(NamedTuple):
    """An item of Wireshark's tree: ``value`` are its octets in hex, ``show`` is how it prints."""

    name: str
    pos: int
    size: int
    show: str
    value: str


class Packet(NamedTuple):
    """What tshark made of one frame: fields in the order of the tree, what it adds to them, and problems."""

    fields: list[Shown]
    dates: list[Shown]
    padding: int
    problems: list[dict[str, str]]
    experts: int


def tshark(script: str, capture: Path, *arguments: str) -> str:
    """Run tshark with a dissector and without anybody's settings; it must have nothing to complain about."""
    home = capture.parent / "home"
    home.mkdir(exist_ok=True)
    lua = capture.parent / "dcp.lua"
    lua.write_text(script, encoding="utf-8")
    environment = {**os.environ, "HOME": str(home), "XDG_CONFIG_HOME": str(home), "LC_ALL": "C.UTF-8"}
    environment.pop("WIRESHARK_CONFIG_DIR", None)
    command = ["tshark", "-n", "-X", f"lua_script:{lua}", "-r", str(capture), *arguments]
    done = subprocess.run(command, capture_output=True, env=environment, timeout=300)
    complaints = [line for line in done.stderr.decode().splitlines() if not line.startswith("Running as user")]
    assert (done.returncode, complaints) == (0, [])
    output = done.stdout.decode()
    assert "_ws.lua.error" not in output
    assert "Lua Error" not in output
    return output


def packets(script: str, capture: Path) -> Iterator[Packet | None]:
    """What tshark makes of every frame of a capture; None for what it does not take for DCP."""
    tree = ET.fromstring(tshark(script, capture, "-T", "pdml", "-J", "dcp"))
    for packet in tree.iter("packet"):
        root = packet.find("proto[@name='dcp']")
        yield None if root is None else _packet(root)


def _packet(root: ET.Element) -> Packet:
    fields = [Shown("dcp", int(root.attrib["pos"]), int(root.attrib["size"]), "", "")]
    dates: list[Shown] = []
    problems: list[dict[str, str]] = []
    padding = experts = 0

    def collect(element: ET.Element) -> None:
        nonlocal padding, experts
        for child in element:
            name = child.get("name", "")
            # An item that is only text has nothing but its label.
            show = child.get("showname" if name == "_ws.lua.text" else "show", "")
            shown = Shown(name, int(child.get("pos", -1)), int(child.get("size", -1)), show, child.get("value", ""))
            if name in ("dcp.errors", "dcp.warnings"):
                problem = {part.attrib["name"].removeprefix(f"{name}."): part.attrib["show"] for part in child}
                problems.append({"severity": name[4:-1], **problem})
            elif name == "_ws.expert":
                # Wireshark has remarks of its own, about strings.
                experts += any(part.get("name", "").startswith("dcp.expert.") for part in child)
            elif name == "_ws.malformed":
                # Wireshark adds it to expert information of the group of malformed messages.
                continue
            elif name == "dcp.padding":
                padding = int(shown.show)
                assert shown.size == padding
            elif name.endswith(".date"):
                dates.append(shown)
            else:
                fields.append(shown)
                collect(child)

    collect(root)
    return Packet(fields, dates, padding, problems, experts)


# -- what we say ------------------------------------------------------------------------------------------------


def _expected(root: Field) -> Iterator[tuple[str, int, int, Any]]:
    """Name, offset, length and value of what Wireshark has to show; ... as value for records, None if cut off."""
    for field in root.walk():
        name, layout, value = filter_name(field.path), field.layout, field.value
        if field is root:
            yield "dcp", field.offset, field.length, ...
        elif isinstance(layout, Many):
            continue
        elif isinstance(layout, Group | Exact):
            yield name, field.offset, field.length, ...
        elif isinstance(layout, Text) and field.name != "data" and layout.prefixes:
            # Wireshark shows the octets and the lengths in front of them, our parts of the field.
            continue
        elif isinstance(layout, Text) and value is not None:
            if layout.prefixes:
                name = name.removesuffix(".data")
            yield name, field.offset, len(value), value
            if len(value) < field.length:
                yield f"{name}.terminator", field.offset + len(value), 1, 0
        elif value is None:
            yield layout.name, field.offset, field.length, None
        else:
            yield name, field.offset, field.length, value


def _same_value(shown: Shown, value: Any) -> bool:
    if value is ...:
        return True
    if isinstance(value, int):
        return int(shown.show, 0) == value
    if isinstance(value, float):
        # Wireshark rounds what it prints, the largest numbers up to infinity; the octets are compared, too.
        text = float(shown.show)
        if math.isnan(value) or math.isinf(text):
            return math.isnan(text) or abs(value) > 1e38
        return math.isclose(text, value, rel_tol=1e-5)
    return shown.value == value.hex()


def differences(frame: DissectedFrame, packet: Packet) -> Iterator[str]:
    """Everything that tshark and we do not agree on in one frame."""
    ours = list(_expected(frame.dissection.root))
    for (name, pos, size, value), shown in zip(ours, packet.fields, strict=False):
        if value is None:
            same = shown.name == "_ws.lua.text" and shown.show == f"{name}: cut off ({size} octets)"
        else:
            same = shown.name == name and _same_value(shown, value)
        if value is not ... and value is not None and size:
            same = same and shown.value == frame.frame.data[pos : pos + size].hex()
        if not same or (shown.pos, shown.size) != (pos, size):
            yield f"we say {name} at {pos}+{size} = {value!r}, tshark says {shown}"
            return
    if len(ours) != len(packet.fields):
        yield f"we have {len(ours)} fields, tshark has {len(packet.fields)}: {packet.fields[len(ours) :]}"
    if packet.padding != len(frame.dissection.padding):
        yield f"we have {len(frame.dissection.padding)} octets of padding, tshark has {packet.padding}"
    problems = [
        {
            "severity": problem.severity,
            "reason": problem.reason,
            "path": problem.path,
            "offset": str(problem.offset),
            **({} if problem.needed is None else {"needed": str(problem.needed)}),
            **({} if problem.available is None else {"available": str(problem.available)}),
            **({} if problem.requirement is None else {"requirement": problem.requirement}),
        }
        for problem in [*frame.dissection.errors, *frame.dissection.warnings]
    ]
    if problems != packet.problems:
        yield f"we have the problems {problems}, tshark has {packet.problems}"
    if packet.experts != len(problems):
        yield f"{len(problems)} problems, but {packet.experts} times expert information"


def compare(codec: Codec, script: str, capture: Path) -> tuple[int, list[str]]:
    """How many fields of a capture were compared, and all differences."""
    dissector, compared, found = FrameDissector(codec), 0, []
    with open_capture(capture) as frames:
        for frame, packet in zip(frames, packets(script, capture), strict=True):
            ours = dissector.dissect(frame)
            if not isinstance(ours, DissectedFrame) or packet is None:
                if isinstance(ours, DissectedFrame) or packet is not None:
                    found.append(f"frame {frame.number} is DCP for one of us only ({ours})")
                continue
            compared += len(packet.fields)
            found += [f"frame {frame.number} ({frame.data.hex()}): {text}" for text in differences(ours, packet)]
    return compared, found


# -- beacons to show --------------------------------------------------------------------------------------------


def everything(codec: Codec) -> Beacon:
    """A beacon with every kind of record that the profile has, and a payload of an unknown protocol."""
    profile, types = codec.profile, codec.profile.types
    nodes = [bytes([2, 0, 0, 0, 0, number]) for number in (0xBB, 1)]
    if types.node_id.length is not None:
        sender, producer = (node.hex(":").encode() for node in nodes)
    else:
        sender, producer = (node.rjust(types.node_id.width, b"\7")[-types.node_id.width :] for node in nodes)
    stamp = -5 if types.timestamp.signed else (1 << 8 * types.timestamp.width) - 1
    has, numbers = profile.vardis.var_spec, profile.vardis.container_types.by_name()
    extra = tuple(range(40, 40 + len(profile.vardis.container_extra)))

    def spec(number: int, descr: str, created: int) -> VarSpec:
        timeout = 200 if "timeout" in has else None
        return VarSpec(number, producer, 2, descr.encode(), created if "creationTime" in has else None, timeout)

    now = min(1_700_000_000_123_456_789, (1 << 8 * types.timestamp.width - 1) - 1)
    records: dict[str, tuple[Any, ...]] = {
        "CREATE-VARIABLES": (
            VarCreate(spec(7, "pos", now), VarUpdate(7, 3, b"ABCD")),
            VarCreate(spec(250, "Höhe °", stamp), VarUpdate(250, 255, bytes(range(1, 32)))),
        ),
        "SUMMARIES": (VarSumm(7, 3), VarSumm(9, 0)),
        "UPDATES": (VarUpdate(7, 4, b"\x01"),),
        "REQUEST-VARUPDATES": (VarReqUpdate(9, 254),),
        "REQUEST-VARCREATES": (VarReqCreate(1), VarReqCreate(2), VarReqCreate(255)),
        "DELETE-VARIABLES": (VarDelete(4),),
    }
    containers = [Container(numbers[name], group, extra) for name, group in records.items()]
    payloads = []
    if codec.report_plan is not None:
        members = profile.srp.safety_data
        values = {
            member.name: b"\xfe" * member.octets
            if member.type == "opaque"
            else number * -1.5 + 0.125
            if member.type[0] == "f"
            else -number
            if member.type[0] == "i"
            else number
            for number, member in enumerate(members)
        }
        report = ExtendedSafetyData(codec.safety_data_type(**values), sender, now, 77)
        payloads.append(Payload(1, report))
    # Where lengths have one octet, not all containers fit into one beacon.
    roomy = types.bp_length.width > 1
    payloads += [Payload(2, tuple(containers if roomy else containers[1:])), Payload(99, b"\x00\xff?")]
    network = None if "networkId" not in profile.bp.header else profile.bp.network_id or 0
    return Beacon(BPHeader(sender, 41, network) if profile.bp.header else None, tuple(payloads))


def malformed(codec: Codec, octets: bytes) -> Iterator[bytes]:
    """What is not a beacon in every way that can be made from one on purpose."""
    found = codec.dissect(octets)
    # Of long areas and payloads, not every octet is a place of its own.
    starts = {field.offset + part for field in found.root.walk() for part in (0, 1)}
    yield from (octets[:end] for end in range(len(octets)) if len(octets) < 600 or end in starts)
    for field in found.root.walk():
        if isinstance(field.layout, Scalar) and field.layout.kind == "int":
            raw = int.from_bytes(field.raw, field.layout.order)
            for other in {0, 1, raw + 1, raw - 1, 200, (1 << 8 * field.length) - 1}:
                changed = other % (1 << 8 * field.length)
                wrong = changed.to_bytes(field.length, field.layout.order)
                yield octets[: field.offset] + wrong + octets[field.offset + field.length :]
    yield octets + bytes(12)
    yield octets + octets


def drawn(strategy: Any, count: int) -> list[bytes]:
    """What a hypothesis strategy generates, the same in every run."""
    found: list[bytes] = []

    @settings(
        max_examples=count,
        database=None,
        derandomize=True,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(strategy)
    def draw(octets: bytes) -> None:
        found.append(octets)

    draw()
    return found


def framed(link: Link, payload: bytes) -> bytes:
    """A frame on the link of a profile; checksums are left out, nothing here looks at them."""
    addresses = bytes.fromhex("ffffffffffff0200000000bb")
    if link.transport == "ethernet":
        return addresses + struct.pack(">H", link.ether_type) + payload
    ip = struct.pack(">BBHHHBBH4s4s", 0x45, 0, 28 + len(payload), 0, 0, 64, 17, 0, b"\n\0\0\1", b"\xff\xff\xff\xff")
    return addresses + b"\x08\x00" + ip + struct.pack(">HHHH", 5950, link.udp_port, 8 + len(payload), 0) + payload


def write(path: Path, link: Link, payloads: Iterable[bytes]) -> Path:
    """A pcap file of these bearer payloads."""
    # Wireshark shows nobody a datagram without octets.
    some = (payload for payload in payloads if payload or link.transport == "ethernet")
    with create_capture(path) as capture:
        for number, payload in enumerate(some, start=1):
            data = framed(link, payload)
            capture.write(Frame(number, 1_700_000_000 * 10**9 + number, data, len(data)))
    return path


# -- the tests --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("recording", RECORDINGS, ids=lambda path: path.stem)
def test_every_field_of_the_recordings_agrees(recording: Path, tmp_path: Path) -> None:
    codec = get_codec("cpp-1.3" if "v1.3" in recording.stem else "cpp-2.0")
    capture = tmp_path / "capture.pcap"
    with open_capture(recording) as frames, create_capture(capture) as copy:
        for frame in frames:
            copy.write(frame)
    compared, found = compare(codec, wireshark_dissector(codec), capture)
    assert found == []
    assert compared > 10_000


def test_every_field_of_every_layout_agrees(codec: Codec, tmp_path: Path) -> None:
    octets = codec.encode(everything(codec))
    payloads = [octets, octets + bytes(7), *drawn(strategies.beacons(codec).map(codec.encode), 60)]
    compared, found = compare(
        codec, wireshark_dissector(codec), write(tmp_path / "c.pcap", codec.profile.link, payloads)
    )
    assert found == []
    assert compared > 500


def test_malformed_beacons_have_the_same_fields_and_problems(codec: Codec, tmp_path: Path) -> None:
    beacons = strategies.beacons(codec).map(codec.encode)
    mutations = strategies.mutations(beacons, codec.dissect)
    payloads = [*malformed(codec, codec.encode(everything(codec))), *drawn(mutations, 100)]
    _, found = compare(codec, wireshark_dissector(codec), write(tmp_path / "c.pcap", codec.profile.link, payloads))
    assert found == []
