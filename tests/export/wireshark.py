"""Dissection of beacons by the real tshark with our dissector script, compared with our own dissector."""

from __future__ import annotations

import math
import os
import re
import struct
import subprocess
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from dcp_spec.profile.definition import Link

from dcp_codec import Codec, Field
from dcp_codec.capture import Frame, create_capture, open_capture
from dcp_codec.framing.frames import DissectedFrame, FrameDissector
from dcp_codec.plan.tree import Exact, Group, Many, Text


class Shown(NamedTuple):
    """An item of Wireshark's tree: ``value`` are its octets in hex, ``show`` is how it prints."""

    name: str
    pos: int
    size: int
    show: str
    value: str


class Packet(NamedTuple):
    """A frame dissected by tshark: fields in the order of the tree, additions of tshark, and problems."""

    fields: list[Shown]
    dates: list[Shown]
    padding: int
    problems: list[dict[str, str]]
    experts: list[str]


def tshark(script: str, capture: Path, *arguments: str) -> str:
    """Run tshark with a dissector and without user settings; it must not print errors."""
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
    """Yield tshark's dissection of every frame of a capture; None if it is not recognised as DCP."""
    tree = ET.fromstring(tshark(script, capture, "-T", "pdml", "-J", "dcp"))
    for packet in tree.iter("packet"):
        root = packet.find("proto[@name='dcp']")
        yield None if root is None else _packet(root)


def _packet(root: ET.Element) -> Packet:
    fields = [Shown("dcp", int(root.attrib["pos"]), int(root.attrib["size"]), "", "")]
    dates: list[Shown] = []
    problems: list[dict[str, str]] = []
    padding = 0
    experts: list[str] = []

    def collect(element: ET.Element) -> None:
        nonlocal padding
        for child in element:
            name = child.get("name", "")
            # An item without a value has a label only.
            show = child.get("showname" if name == "_ws.lua.text" else "show", "")
            shown = Shown(name, int(child.get("pos", -1)), int(child.get("size", -1)), show, child.get("value", ""))
            if name in ("dcp.errors", "dcp.warnings"):
                problem = {part.attrib["name"].removeprefix(f"{name}."): part.attrib["show"] for part in child}
                problems.append({"severity": name[4:-1], **problem})
            elif name == "_ws.expert":
                # Wireshark has remarks of its own, about strings.
                parts = {part.get("name", ""): part.get("show", "") for part in child}
                if any(part.startswith("dcp.expert.") for part in parts):
                    experts.append(parts["_ws.expert.message"])
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


def filter_name(path: str) -> str:
    """Return the display filter name of the field at ``path`` (a path of our JSON, with or without indices)."""
    return "dcp." + re.sub(r"\[\d+\]", "", path)


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
            # Wireshark shows the octets and the lengths before them, our parts of the field.
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
    # Wireshark attaches them to the fields, so that their order is that of the tree.
    told = sorted(
        str(problem).removeprefix(f"{problem.path or 'beacon'} at octet {problem.offset}: ")
        for problem in [*frame.dissection.errors, *frame.dissection.warnings]
    )
    if sorted(packet.experts) != told:
        yield f"we say {told}, the expert information of tshark is {packet.experts}"


def compare(codec: Codec, script: str, capture: Path) -> tuple[int, list[str]]:
    """Number of compared fields of a capture, and all differences."""
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


def framed(link: Link, payload: bytes) -> bytes:
    """A frame on the link of a profile; checksums are left out, which are not checked here."""
    addresses = bytes.fromhex("ffffffffffff0200000000bb")
    if link.transport == "ethernet":
        return addresses + struct.pack(">H", link.ether_type) + payload
    ip = struct.pack(">BBHHHBBH4s4s", 0x45, 0, 28 + len(payload), 0, 0, 64, 17, 0, b"\n\0\0\1", b"\xff\xff\xff\xff")
    return addresses + b"\x08\x00" + ip + struct.pack(">HHHH", 5950, link.udp_port, 8 + len(payload), 0) + payload


def write(path: Path, link: Link, payloads: Iterable[bytes]) -> Path:
    """A pcap file of these bearer payloads."""
    # Wireshark does not show a datagram without octets.
    some = (payload for payload in payloads if payload or link.transport == "ethernet")
    with create_capture(path) as capture:
        for number, payload in enumerate(some, start=1):
            data = framed(link, payload)
            capture.write(Frame(number, 1_700_000_000 * 10**9 + number, data, len(data)))
    return path
