"""Blocks hold the frames that the readers give out, and what is wrong with a file is in the readers' words."""

from __future__ import annotations

import io
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from dcp_tables import Recording
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import Writer

from dcp_codec.capture import FORMATS, CaptureError, Frame, open_capture
from dcp_codec.capture.mcap import raw_frame as rawframe
from dcp_codec.capture.mcap.index import RECORD_HEAD

from ..capture import test_pcapng as pcapng
from ..capture import test_properties as properties
from ..chance import examples

pytestmark = pytest.mark.part("tables")


def read(path: Path, **options: Any) -> tuple[Any, ...]:
    """Frames and problems of a file by blocks."""
    found = []
    with Recording(path, walk=True, **options) as recording:
        position = 0
        for block in recording.blocks():
            assert block.position >= position
            position = block.position
            for i in range(block.frames):
                data = block.buffer[block.starts[i] : block.stops[i]].tobytes()
                numbers = (block.numbers[i], block.times[i], block.lengths[i], block.interfaces[i])
                found.append((*map(int, numbers), data))
        assert recording.frames == len(found)
        return found, [(p.reason, p.message, p.offset, p.needed, p.available, p.frame) for p in recording.problems]


def expected(path: Path) -> tuple[Any, ...]:
    with open_capture(path) as reader:
        found = [(f.number, f.time_ns, f.orig_len, f.interface, f.data) for f in reader]
        return found, [(p.reason, p.message, p.offset, p.needed, p.available, p.frame) for p in reader.problems]


def refusal(reading: Callable[[Path], Any], path: Path) -> str | None:
    """Why a file cannot be read at all."""
    try:
        reading(path)
    except CaptureError as error:
        return str(error)
    return None


def check(octets: bytes, folder: Path, **options: Any) -> None:
    path = folder / "recording"
    path.write_bytes(octets)
    refused = [refusal(reading, path) for reading in (expected, read)]
    assert refused[0] == refused[1]
    if refused[0] is not None:
        return
    theirs = expected(path)
    ours = read(path, **options)
    assert len(ours[0]) == len(theirs[0])
    for one, other in zip(ours[0], theirs[0], strict=True):
        assert one == other
    assert ours[1] == theirs[1]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("sources")


@pytest.mark.parametrize("form", FORMATS)
def test_our_own_files(form, folder):
    @settings(max_examples=examples(40))
    @given(properties.frames_for([form]), st.integers(1, 5), st.sampled_from([1, 200, 1 << 20]))
    def body(frames: list[Frame], most: int, span: int) -> None:
        check(properties.written(frames, form), folder, frames=most, span=span)

    body()


@pytest.mark.parametrize("form", FORMATS)
def test_damaged_anywhere(form, folder):
    octets = properties.written(properties.SOME, form)

    @settings(max_examples=examples(150))
    @given(st.lists(st.tuples(st.integers(0, len(octets) - 1), st.integers(0, 255)), max_size=4), st.data())
    def body(changes: list[tuple[int, int]], data: st.DataObject) -> None:
        damaged = bytearray(octets)
        for place, octet in changes:
            damaged[place] = octet
        check(bytes(damaged[: data.draw(st.integers(0, len(octets)))]), folder)

    body()


@pytest.mark.parametrize("form", FORMATS)
def test_cut_off_anywhere(form, folder):
    octets = properties.written(properties.SOME[:3], form)
    # Most of an MCAP file is the schema: there, every fifth place will do.
    for size in range(0, len(octets) + 1, 5 if form == "mcap" else 1):
        check(octets[:size], folder)


@pytest.mark.parametrize("magic", ["a1b2c3d4", "d4c3b2a1", "a1b23c4d", "4d3cb2a1"])
def test_pcap_of_every_kind(magic, folder):
    order = ">" if magic.startswith("a1") else "<"
    head = bytes.fromhex(magic) + struct.pack(order + "HHiIII", 2, 4, 0, 0, 65535, 1)
    records = [(1_700_000_000, 999_999, b"abc", 60), (2**32 - 1, 2**32 - 1, b"", 0), (0, 0, b"x", 0), (7, 0, b"", 0)]
    body = b"".join(struct.pack(order + "IIII", s, f, len(d), n) + d for s, f, d, n in records)
    check(head + body, folder)
    check(head + body + bytes(16) + body, folder)  # zeros, as after a power cut
    check(head + body + struct.pack(order + "IIII", 1, 1, 2**31, 5) + bytes(50), folder)
    check(head, folder)


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("resolution", [0, 3, 6, 9, 12, 18, 127, 0x80, 0x80 | 9, 0x80 | 20, 0x80 | 32, 0x80 | 127])
def test_pcapng_clocks(order, resolution, folder):
    options = pcapng.option(9, bytes([resolution]), order) + pcapng.option(14, struct.pack(order + "q", 3), order)
    start = pcapng.section(order=order) + pcapng.interface(options, order)
    stamps = [0, 1, 511, 512, 10**6, 2**33 + 12345, 2**62, 2**63, 2**64 - 1]
    check(start + b"".join(pcapng.packet(b"data", stamp, order=order) for stamp in stamps), folder)


def test_pcapng_of_many_kinds(folder):
    section, interface, packet, block = pcapng.section, pcapng.interface, pcapng.packet, pcapng.block
    big = ">"
    comment = pcapng.option(1, b"a comment") + pcapng.option(0, b"")
    octets = section() + interface() + packet(b"one", 5) + interface(link=105) + packet(b"other link", 6, which=1)
    octets += packet(b"two", 7, options=comment) + packet(b"no interface", 8, which=9) + packet(b"three", 9)
    octets += block(3, struct.pack("<I", 4) + b"four") + packet(b"five", 10, options=b"\1\0\xff\xff")
    octets += block(0xBAD, b"custom00") + block(0x7777, b"unknown") + packet(b"six", 11)
    octets += section(order=big) + interface(order=big) + packet(b"seven", 12, order=big)
    octets += block(5, struct.pack(">III", 0, 0, 0), big) + packet(b"eight", 13, order=big, length=2)
    octets += block(2, struct.pack(">HHIIII", 0, 1, 0, 14, 4, 4) + b"nine", big)
    check(octets, folder)
    check(octets + packet(b"ten", 15), folder)  # in the wrong byte order
    for size in range(0, len(octets), 3):
        check(octets[:size], folder)


def test_pcapng_with_unusual_blocks_only(folder):
    """Every other block is one that the walk stops at; so many of them end it."""
    start = pcapng.section() + pcapng.interface()
    odd = pcapng.block(3, struct.pack("<I", 4) + b"odd!")
    check(start + b"".join(pcapng.packet(b"plain", n) + odd + odd for n in range(1500)), folder)


def mcap_message(**fields: Any) -> bytes:
    """A message as our writer makes it, but for these fields; None leaves a field out."""
    values = {"timestamp": None, "number": 3, "interface": 0, "link_type": 1, "orig_len": 4, "data": b"\0\1\2\3"}
    found = b""
    for number, value in enumerate((values | fields).values(), start=1):
        if isinstance(value, int):
            found += bytes([8 * number]) + varint(value)
        elif value is not None:
            inner = (
                value
                if isinstance(value, bytes)
                else b"".join(bytes([8 * place]) + varint(part) for place, part in enumerate(value, start=1) if part)
            )
            found += bytes([8 * number + 2]) + varint(len(inner)) + inner
    return found


def varint(value: int, least: int = 1) -> bytes:
    """Encode a number as in protobuf, in at least ``least`` octets."""
    value &= 2**64 - 1
    octets = []
    while value or len(octets) < least:
        octets.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*octets[:-1], octets[-1] & 0x7F])


ODD_MESSAGES = [
    *(
        mcap_message(**fields)
        for fields in (
            {},
            {"number": 0},
            {"number": None},
            {"number": 2**62},
            {"number": 2**62 + 1},
            {"number": 2**64 - 1},
            {"interface": None},
            {"interface": 2**32 - 1},
            {"interface": 2**32},
            {"orig_len": 0},
            {"orig_len": None},
            {"orig_len": 2**32 - 1},
            {"link_type": 105},
            {"link_type": None},
            {"link_type": 0},
            {"timestamp": (0, 0)},
            {"timestamp": (7, 0)},
            {"timestamp": (0, 7)},
            {"timestamp": (1, 2)},
            {"timestamp": (9223372036, 854775807)},
            {"timestamp": (9223372036, 854775808)},
            {"timestamp": (5, 1_000_000_000)},
            {"timestamp": (5, 2**31 - 1)},
            {"timestamp": (-1, 0)},
            {"timestamp": (1, -1)},
            {"timestamp": (1, 2, 3)},
            {"timestamp": bytes(200)},
            {"timestamp": b"\x10\x02\x08\x01"},
            {"timestamp": b"\x08" + varint(1, 5) + b"\x10" + varint(2, 10)},
            {"data": b""},
            {"data": None},
            {"data": bytes(300)},
        )
    ),
    mcap_message() + mcap_message(number=9),
    mcap_message() + b"\x3a\x01x",
    mcap_message()[:-1],
    mcap_message()[:10],
    mcap_message(data=None) + b"\x32" + varint(4, 3) + b"abcd",
    mcap_message(data=None) + b"\x32" + varint(2**63 + 4) + b"abcd",
    b"\x32\x04abcd",
    b'{"data":"AAAA"}',
    b"\xff" * 12,
    b"",
]


def described(octets: bytes) -> tuple[bytes, bytes]:
    """The records of a file that describe its raw frames: schema and channel."""
    found = {}
    position = 8
    while position < len(octets) and octets[position] not in (2, 15):
        opcode, length = RECORD_HEAD.unpack_from(octets, position)
        if opcode in (3, 4):
            found[opcode] = octets[position : position + RECORD_HEAD.size + length]
        position += RECORD_HEAD.size + length
    return found[3], found[4]


def test_mcap_messages_of_any_kind(folder):
    """Messages that our writer would not write stand between those that it writes."""
    octets = properties.written(properties.SOME, "mcap", compression="none")
    # A file without chunks: records stand on their own, and may be of any length.
    head = octets[:8]
    schema, channel = described(octets)
    number = struct.unpack_from("<H", channel, 9)[0]

    def record(message: bytes, where: int = number, log_time: int = 77) -> bytes:
        content = struct.pack("<HIQQ", where, 0, log_time, 78) + message
        return RECORD_HEAD.pack(5, len(content)) + content

    plain = record(mcap_message())
    for message in ODD_MESSAGES:
        check(head + schema + channel + plain + record(message) + plain, folder)
    for time in (0, 2**63 - 1, 2**63, 2**64 - 1):
        check(head + schema + channel + plain + record(mcap_message(), log_time=time) + plain, folder)
    everything = b"".join(plain + record(message) for message in ODD_MESSAGES)
    check(head + schema + channel + everything + record(b"{}", number + 1) + plain, folder)
    check(head + schema + channel + everything + RECORD_HEAD.pack(5, 3) + b"abc" + plain, folder)
    inside = schema + channel + everything + plain
    for cut in (0, 5, 20):
        body = inside[: len(inside) - cut]
        fields = struct.pack("<QQQII", 0, 0, len(body), 0, 0) + struct.pack("<Q", len(body)) + body
        check(head + RECORD_HEAD.pack(6, len(fields)) + fields + plain, folder)


def test_mcap_messages_with_another_octet(folder):
    """A message in which any one octet is another: the walk sees every octet of it."""
    octets = properties.written(properties.SOME[3:5], "mcap", compression="none")
    start = octets.index(rawframe.encode(properties.SOME[3])) - 22 - RECORD_HEAD.size
    length = RECORD_HEAD.size + RECORD_HEAD.unpack_from(octets, start)[1]
    message = octets[start : start + length]
    schema, channel = described(octets)
    head = octets[:8] + schema + channel
    for place in range(RECORD_HEAD.size + 22, length):
        for octet in {0x0A, 0x10, 0x32, 0, 0x7F, 0x80, 255, message[place] ^ 1}:
            check(head + message + message[:place] + bytes([octet]) + message[place + 1 :] + message, folder)


def test_mcap_files_with_frames_in_json(folder):
    """Older files have raw frames as JSON; a file may have both, and chunks larger than what a block usually has."""
    stream = io.BytesIO()
    writer = Writer(stream, chunk_size=1 << 24)
    writer.start()
    schemas = [writer.register_schema("dcp.RawFrame", "jsonschema", b"{}") for _ in range(2)]
    channels = [
        writer.register_channel("/new", "protobuf", schemas[0]),
        writer.register_channel("/old", "json", schemas[1]),
    ]
    message = b'{"data":"' + b"QUJD" * 2000 + b'"}'
    for number in range(1, 3000):
        old = number % 700 == 0
        data = message if old else mcap_message(number=number, data=bytes(6000))
        writer.add_message(channels[old], log_time=5, publish_time=5, data=data)
    writer.finish()
    check(stream.getvalue(), folder)
    check(stream.getvalue(), folder, frames=100)


def test_a_pipe_is_read(recording):
    path, _ = recording
    with Recording(io.BytesIO(path.read_bytes())) as source:
        assert sum(block.frames for block in source.blocks()) == len(expected(path)[0])
        assert source.problems == []


def test_files_that_are_not_recordings(tmp_path):
    for name, octets in (("empty", b""), ("text", b"hello, this is text")):
        (tmp_path / name).write_bytes(octets)
        with pytest.raises(CaptureError, match=name):
            Recording(tmp_path / name)
    with pytest.raises(CaptureError, match="No such file"):
        Recording(tmp_path / "absent")
