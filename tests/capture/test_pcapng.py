"""pcapng, from octets made by hand."""

import io
import struct
from fractions import Fraction

import pytest

from dcp_codec.capture import MAX_TIME_NS, CaptureError, CaptureReader, Frame, open_capture

ORDERS = pytest.mark.parametrize("order", "<>", ids=["little", "big"])


def block(kind: int, body: bytes, order: str = "<") -> bytes:
    body += bytes(-len(body) % 4)
    total = len(body) + 12
    return struct.pack(order + "II", kind, total) + body + struct.pack(order + "I", total)


def option(code: int, value: bytes, order: str = "<") -> bytes:
    return struct.pack(order + "HH", code, len(value)) + value + bytes(-len(value) % 4)


def section(options: bytes = b"", order: str = "<", length: int = -1, version: int = 1) -> bytes:
    return block(0x0A0D0D0A, struct.pack(order + "IHHq", 0x1A2B3C4D, version, 0, length) + options, order)


def interface(options: bytes = b"", order: str = "<", link: int = 1, snap: int = 0) -> bytes:
    return block(1, struct.pack(order + "HHI", link, 0, snap) + options, order)


def packet(
    data: bytes, stamp: int = 0, which: int = 0, length: int | None = None, order: str = "<", options: bytes = b""
) -> bytes:
    length = len(data) if length is None else length
    head = struct.pack(order + "IIIII", which, stamp >> 32, stamp & 0xFFFFFFFF, len(data), length)
    return block(6, head + data + bytes(-len(data) % 4) + options, order)


def read(octets: bytes) -> tuple[list[Frame], CaptureReader]:
    with open_capture(io.BytesIO(octets)) as reader:
        return list(reader), reader


def reasons(reader: CaptureReader) -> list[str]:
    return [problem.reason for problem in reader.problems]


@ORDERS
def test_frames_in_both_byte_orders(order):
    start = section(order=order) + interface(order=order)
    octets = start + packet(b"abcde", 1_700_000_000_000_001, length=60, order=order) + packet(b"", 1, order=order)
    frames, reader = read(octets)
    assert frames == [
        Frame(1, 1_700_000_000_000_001_000, b"abcde", 60, 0, len(start)),
        Frame(2, 1000, b"", 0, 0, len(start) + 40),
    ]
    assert (reader.format, reader.problems) == ("pcapng", [])
    assert reader.metadata["interface.0"]["resolution"] == "us"
    assert reader.position == reader.size == len(octets)


@ORDERS
@pytest.mark.parametrize(
    ("code", "unit", "resolution"),
    [
        (0, Fraction(1), "s"),
        (3, Fraction(1, 10**3), "ms"),
        (6, Fraction(1, 10**6), "us"),
        (7, Fraction(1, 10**7), "10^-7 s"),
        (9, Fraction(1, 10**9), "ns"),
        (12, Fraction(1, 10**12), "10^-12 s"),
        (127, Fraction(1, 10**127), "10^-127 s"),
        (0x80, Fraction(1), "2^-0 s"),
        (0x80 | 9, Fraction(1, 2**9), "2^-9 s"),
        (0x80 | 20, Fraction(1, 2**20), "2^-20 s"),
        (0x80 | 32, Fraction(1, 2**32), "2^-32 s"),
        (0x80 | 127, Fraction(1, 2**127), "2^-127 s"),
    ],
)
@pytest.mark.parametrize("stamp", [0, 1, 511, 1_234_567_891, 2**33 + 12345])
def test_clocks_are_converted_exactly(order, code, unit, resolution, stamp):
    octets = section(order=order) + interface(option(9, bytes([code]), order), order)
    frames, reader = read(octets + packet(b"a", stamp, order=order))
    exact = stamp * unit * 10**9
    assert frames[0].time_ns == min(int(exact + Fraction(1, 2)), MAX_TIME_NS)
    assert reader.metadata["interface.0"]["resolution"] == resolution
    expected = [] if exact.denominator == 1 else ["rounded-time"]
    assert reasons(reader) == expected + (["time-out-of-range"] if exact > MAX_TIME_NS else [])


def test_rounding_is_reported_once():
    octets = section() + interface(option(9, b"\x0c"))
    _, reader = read(octets + packet(b"a", 1000) + packet(b"b", 1001) * 3)
    (problem,) = reader.problems
    assert problem.reason == "rounded-time"
    assert problem.message == (
        "3 times of interface 0, whose clock counts in 10^-12 s, rounded to the nearest nanosecond."
    )


@ORDERS
def test_offset_of_the_clock(order):
    options = option(9, b"\x09", order) + option(14, struct.pack(order + "q", 1_700_000_000), order)
    frames, reader = read(section(order=order) + interface(options, order) + packet(b"a", 5, order=order))
    assert (frames[0].time_ns, reader.problems) == (1_700_000_000_000_000_005, [])


def test_times_before_1970_are_moved_and_counted():
    options = option(14, struct.pack("<q", -10))
    frames, reader = read(section() + interface(options) + packet(b"a", 5) * 2 + packet(b"b", 11_000_000))
    assert [frame.time_ns for frame in frames] == [0, 0, 10**9]
    assert reasons(reader) == ["time-out-of-range"]
    assert reader.problems[0].message.startswith("2 times")


def test_sections_of_both_byte_orders_in_one_file():
    octets = b"".join(
        section(order=order, length=length) + interface(order=order) + packet(b"a", 7, order=order)
        for order, length in [("<", -1), (">", 80), ("<", -1)]
    )
    frames, reader = read(octets)
    # Each section has an interface 0 of its own; in the file they are three.
    assert [(frame.number, frame.interface, frame.time_ns) for frame in frames] == [
        (1, 0, 7000),
        (2, 1, 7000),
        (3, 2, 7000),
    ]
    assert reader.problems == []


def test_interfaces_and_section_are_described():
    about = option(1, b"a comment") + option(2, b"a box") + option(3, b"an os") + option(4, b"a program")
    first = option(2, b"veth0") + option(3, "über".encode()) + option(0, b"") + b"\xff" * 8
    octets = section(about) + interface(first) + interface(option(9, b"\x09"))
    frames, reader = read(octets + packet(b"a", 3, which=1) + packet(b"b", 3))
    assert [(frame.interface, frame.time_ns) for frame in frames] == [(1, 3), (0, 3000)]
    assert reader.metadata == {
        "section": {"hardware": "a box", "os": "an os", "userappl": "a program"},
        "interface.0": {"name": "veth0", "description": "über", "linkType": "1", "resolution": "us"},
        "interface.1": {"linkType": "1", "resolution": "ns"},
    }
    assert reader.problems == []


@ORDERS
def test_simple_packets_have_no_time(order):
    octets = section(order=order) + interface(order=order, snap=4)
    simple = block(3, struct.pack(order + "I", 60) + b"abcd", order)
    frames, reader = read(octets + simple * 2)
    assert [(frame.time_ns, frame.data, frame.orig_len) for frame in frames] == [(0, b"abcd", 60)] * 2
    assert reasons(reader) == ["no-time"]
    assert "2 simple packet blocks" in reader.problems[0].message


@ORDERS
def test_obsolete_packets(order):
    old = struct.pack(order + "HHIIII", 1, 77, 0, 5, 3, 60) + b"abc"
    frames, reader = read(section(order=order) + interface(order=order) + interface(order=order) + block(2, old, order))
    assert [(frame.time_ns, frame.data, frame.orig_len, frame.interface) for frame in frames] == [(5000, b"abc", 60, 1)]
    assert reader.problems == []


@ORDERS
def test_drop_counters(order):
    drops = option(5, struct.pack(order + "Q", 3), order) + option(7, struct.pack(order + "Q", 4), order)
    early = block(5, struct.pack(order + "III", 0, 0, 0) + option(5, struct.pack(order + "Q", 1), order), order)
    late = block(5, struct.pack(order + "III", 0, 0, 0) + drops, order)
    silent = block(5, struct.pack(order + "III", 1, 0, 0), order)
    start = section(order=order) + interface(order=order) * 2
    frames, reader = read(start + early + packet(b"a", order=order) + late + silent)
    assert len(frames) == 1
    assert reader.problems == []


def test_drop_counters_that_are_ignored():
    other = block(5, struct.pack("<III", 0, 0, 0) + option(5, struct.pack("<Q", 1)))
    unknown = block(5, struct.pack("<III", 9, 0, 0))
    short = block(5, struct.pack("<III", 1, 0, 0) + option(5, b"1234"))
    _, reader = read(section() + interface(link=113) + interface() + other + unknown + short + packet(b"a", which=1))
    assert reasons(reader) == ["unknown-interface", "bad-option"]


def test_simple_packets_of_another_link_type_and_of_no_interface():
    simple = block(3, struct.pack("<I", 4) + b"abcd")
    frames, reader = read(section() + simple + interface(link=113) + interface() + simple + packet(b"a", which=1))
    assert [frame.number for frame in frames] == [3]
    assert reasons(reader) == ["unknown-interface", "wrong-link-type"]


def test_too_many_interfaces():
    frames, reader = read(section() + interface() * 65_537 + packet(b"a"))
    assert frames == []
    assert reasons(reader) == ["bad-record"]
    assert len(reader.metadata) == 1000


@pytest.mark.parametrize("kind", [4, 7, 8, 9, 10, 0x0BAD, 0x40000BAD])
def test_known_irrelevant_blocks_are_skipped(kind):
    frames, reader = read(section() + interface() + block(kind, bytes(3000)) + packet(b"a"))
    assert (len(frames), reader.problems) == (1, [])


def test_unknown_blocks_are_skipped_and_counted():
    strange = block(0x1234, b"whatever")
    frames, reader = read(section() + strange + interface() + strange + packet(b"a") + strange)
    assert len(frames) == 1
    (problem,) = reader.problems
    assert (problem.reason, problem.offset, problem.frame) == ("unknown-block", 28, 0)
    assert problem.message.startswith("3 blocks of the unknown type 0x00001234")


def test_an_irrelevant_block_larger_than_the_buffer():
    huge = block(0x0BAD, bytes(40 * 1024 * 1024))
    frames, reader = read(section() + interface() + huge + packet(b"a"))
    assert (len(frames), reader.problems) == (1, [])


def test_comments_on_frames_are_skipped():
    commented = packet(b"abc", 1, options=option(1, b"hello") + option(0, b""))
    frames, reader = read(section() + interface() + commented)
    assert (frames[0].data, reader.problems) == (b"abc", [])


@pytest.mark.parametrize("damage", [struct.pack("<HH", 1, 500), struct.pack("<HH", 1, 5) + bytes(4)])
def test_a_frame_with_damaged_options_is_read(damage):
    frames, reader = read(section() + interface() + packet(b"abc", 1, options=damage) * 2 + packet(b"d"))
    assert len(frames) == 3
    assert reasons(reader) == ["bad-option"]
    assert reader.problems[0].message.startswith("2 blocks with options that are damaged")


@pytest.mark.parametrize(
    "options", [option(9, b""), option(9, b"\x06\x06"), option(14, b"1234"), struct.pack("<HH", 2, 9999)]
)
def test_damaged_options_of_an_interface_are_ignored(options):
    frames, reader = read(section() + interface(options) + packet(b"a", 1))
    assert frames[0].time_ns == 1000
    assert reasons(reader) == ["bad-option"]


def test_frames_of_other_link_types_are_counted_per_interface():
    start = section() + interface(link=113) + interface() + interface(link=127)
    frames, reader = read(start + packet(b"a") * 2 + packet(b"b", which=1) + packet(b"c", which=2) + packet(b"d"))
    # Numbers are those that Wireshark shows.
    assert [(frame.number, frame.interface, frame.data) for frame in frames] == [(3, 1, b"b")]
    assert [problem.message for problem in reader.problems] == [
        "3 frames of interface 0 passed over: its link type is Linux cooked (113).",
        "1 frame of interface 2 passed over: its link type is IEEE 802.11 with radiotap header (127).",
    ]
    assert reader.frames_read == 1


@pytest.mark.parametrize("tail", [b"", packet(b"a"), packet(b"a") + section(), packet(b"a") + section()[:20]])
def test_a_file_of_other_link_types_alone_is_refused(tail):
    with pytest.raises(CaptureError, match=r"Linux cooked \(113\).*instead of 'any'"):
        read(section() + interface(link=113) + tail)


def test_a_later_section_may_have_the_right_link_type():
    frames, reader = read(section() + interface(link=113) + packet(b"x") + section() + interface() + packet(b"a"))
    assert [(frame.number, frame.interface) for frame in frames] == [(2, 1)]
    assert reasons(reader) == ["wrong-link-type"]


def test_a_section_without_interfaces_is_an_empty_capture():
    assert read(section())[0] == []


def test_frames_of_an_undescribed_interface():
    frames, reader = read(section() + interface() + packet(b"a", which=7) + packet(b"b"))
    assert [frame.number for frame in frames] == [2]
    assert reasons(reader) == ["unknown-interface"]


def test_only_a_frame_longer_than_its_block_is_skipped():
    bad = block(6, struct.pack("<IIIII", 0, 0, 0, 100, 100) + bytes(40))
    simple = block(3, struct.pack("<I", 100) + bytes(40))
    frames, reader = read(section() + interface() + bad + simple + packet(b"a"))
    assert [frame.number for frame in frames] == [3]
    assert reasons(reader) == ["bad-record"]


@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        (struct.pack("<II", 6, 31) + bytes(40), "bad-block-length"),
        (struct.pack("<II", 6, 28) + bytes(20), "bad-block-length"),
        (struct.pack("<II", 6, 0x7FFFFFFC) + bytes(40), "bad-block-length"),
        (struct.pack("<II", 9, 8) + bytes(40), "bad-block-length"),
        (packet(b"abcd")[:-4] + struct.pack("<I", 40), "bad-block-length"),
        (block(9, b"abcd")[:-4] + struct.pack("<I", 40), "bad-block-length"),
        (packet(b"abcd")[:-1], "truncated-record"),
        (block(9, b"abcd")[:-1], "truncated-record"),
        (packet(b"abcd")[:11], "truncated-header"),
        (bytes(4096), "zero-filled"),
        (section(version=2), "unknown-version"),
        (b"\x0a\x0d\x0d\x0a" + bytes(40), "bad-record"),
    ],
)
def test_damage_ends_the_reading_and_is_located(damage, reason):
    good = section() + interface() + packet(b"abcd", 1)
    frames, reader = (
        read(good + damage + packet(b"never"))
        if reason
        not in (
            "truncated-record",
            "truncated-header",
        )
        else read(good + damage)
    )
    assert len(frames) == 1
    (problem,) = reader.problems
    assert (problem.reason, problem.offset, problem.frame) == (reason, len(good), 1)


@pytest.mark.parametrize("start", [section()[:20], section(version=3), b"\x0a\x0d\x0d\x0a" + bytes(24)])
def test_a_damaged_first_section_is_refused(start):
    with pytest.raises(CaptureError, match="<stream>: "):
        read(start)


def test_damage_before_any_interface_is_reported_once():
    frames, reader = read(section() + struct.pack("<II", 6, 31) + bytes(40))
    assert frames == []
    assert reasons(reader) == ["bad-block-length"]
