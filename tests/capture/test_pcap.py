"""Classic pcap, from octets made by hand."""

import io
import struct

import pytest

from dcp_codec.capture import CaptureError, CaptureReader, Frame, open_capture

MAGICS = [
    pytest.param("<", 0xA1B2C3D4, 1000, id="little-us"),
    pytest.param(">", 0xA1B2C3D4, 1000, id="big-us"),
    pytest.param("<", 0xA1B23C4D, 1, id="little-ns"),
    pytest.param(">", 0xA1B23C4D, 1, id="big-ns"),
]


def header(order: str = "<", magic: int = 0xA1B23C4D, *, version=(2, 4), snap: int = 65535, link: int = 1) -> bytes:
    return struct.pack(order + "IHHiIII", magic, *version, 0, 0, snap, link)


def record(data: bytes, sec: int = 1, fraction: int = 2, length: int | None = None, order: str = "<") -> bytes:
    return struct.pack(order + "IIII", sec, fraction, len(data), len(data) if length is None else length) + data


def read(octets: bytes) -> tuple[list[Frame], CaptureReader]:
    with open_capture(io.BytesIO(octets)) as reader:
        return list(reader), reader


@pytest.mark.parametrize(("order", "magic", "scale"), MAGICS)
def test_both_resolutions_in_both_byte_orders(order, magic, scale):
    octets = header(order, magic) + record(b"abc", 1_700_000_000, 999, 60, order) + record(b"", 0, 1, 14, order)
    frames, reader = read(octets)
    assert frames == [
        Frame(1, 1_700_000_000 * 10**9 + 999 * scale, b"abc", 60, 0, 24),
        Frame(2, scale, b"", 14, 0, 43),
    ]
    assert (reader.format, reader.problems) == ("pcap", [])
    assert reader.position == reader.size == len(octets)
    assert reader.frames_read == 2


def test_the_last_second_of_the_format():
    frames, _ = read(header() + record(b"a", 2**32 - 1, 999_999_999))
    assert frames[0].time_ns == (2**32 - 1) * 10**9 + 999_999_999


def test_a_captured_length_above_the_original_length_is_tolerated():
    frames, reader = read(header() + record(b"abcd", length=2))
    assert (frames[0].data, frames[0].orig_len, reader.problems) == (b"abcd", 4, [])


def test_checksum_bits_are_not_part_of_the_link_type():
    # Flag "length of the checksum is there", two units of 16 bits.
    _, reader = read(header(link=1 | 0x2400_0000) + record(b"a"))
    assert reader.metadata == {"pcap": {"fcsLength": "4"}}


@pytest.mark.parametrize("order", "<>")
def test_modified_magic_is_named(order):
    with pytest.raises(CaptureError, match=r"modified \(Kuznetzov\)"):
        read(header(order, 0xA1B2CD34))


@pytest.mark.parametrize("version", [(2, 3), (2, 5), (543, 0)])
def test_other_versions_are_refused(version):
    with pytest.raises(CaptureError, match=rf"version {version[0]}\.{version[1]}"):
        read(header(version=version))


@pytest.mark.parametrize(
    ("link", "name", "advice"),
    [
        (113, r"Linux cooked \(113\)", "instead of 'any'"),
        (127, r"IEEE 802.11 with radiotap header \(127\)", "not monitor"),
        (4711, r"unknown link type \(4711\)", "Ethernet"),
    ],
)
def test_other_link_types_are_refused_by_name_with_advice(link, name, advice):
    with pytest.raises(CaptureError, match=rf"<stream>: has link type {name}, not Ethernet \(1\): .*{advice}"):
        read(header(link=link))


def test_other_link_types_can_be_requested():
    with open_capture(io.BytesIO(header(link=113) + record(b"a")), link_types=frozenset({1, 113})) as reader:
        assert len(list(reader)) == 1


@pytest.mark.parametrize("length", range(1, 24))
def test_a_header_that_is_cut_off(length):
    with pytest.raises(CaptureError, match="<stream>: "):
        read(header()[:length])


def test_a_record_that_is_cut_off_is_measured():
    good = header() + record(b"abcd")
    frames, reader = read(good + record(bytes(100))[:50])
    assert len(frames) == 1
    (problem,) = reader.problems
    assert (problem.reason, problem.offset, problem.needed, problem.available, problem.frame) == (
        "truncated-record",
        len(good),
        116,
        50,
        1,
    )
    assert problem.message == "record 2 at octet 44 needs 116 octets, and 50 are left; 1 frame before it could be read."


def test_a_record_header_that_is_cut_off():
    frames, reader = read(header() + record(b"abcd") + bytes([1] * 15))
    assert len(frames) == 1
    (problem,) = reader.problems
    assert (problem.reason, problem.offset, problem.needed, problem.available) == ("truncated-header", 44, 16, 15)


@pytest.mark.parametrize(
    ("snap", "captured", "bad"),
    [
        (65535, 262_144, False),
        (65535, 262_145, True),
        (0, 262_145, True),
        (300_000, 300_000, False),
        (300_000, 300_001, True),
        # Some writers promise everything; four gigabytes are still no frame.
        (0xFFFF_FFFF, 16 * 1024 * 1024 + 1, True),
    ],
)
def test_absurd_lengths_end_the_reading(snap, captured, bad):
    octets = header(snap=snap) + record(b"good") + struct.pack("<IIII", 1, 1, captured, captured)
    frames, reader = read(octets if bad else octets + bytes(captured))
    assert len(frames) == (1 if bad else 2)
    assert [problem.reason for problem in reader.problems] == (["bad-record-length"] if bad else [])


def test_zeros_at_the_end_are_not_frames():
    frames, reader = read(header() + record(b"good") + bytes(4096))
    assert len(frames) == 1
    (problem,) = reader.problems
    assert (problem.reason, problem.offset) == ("zero-filled", 44)


def test_a_record_larger_than_a_read_of_the_file():
    big = bytes(range(256)) * 4096 * 3
    frames, reader = read(header(snap=2**24) + record(b"a") + record(big) + record(b"z"))
    assert [len(frame.data) for frame in frames] == [1, len(big), 1]
    assert frames[1].data == big
    assert not reader.problems
