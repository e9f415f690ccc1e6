"""Properties for all frames, all places to cut a file off, and all octets."""

import io
import itertools
from typing import get_args

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dcp_codec.capture import FORMATS, MAX_TIME_NS, CaptureError, Frame, Reason, convert, create_capture, open_capture

from ..chance import examples
from ..parts import every

#: Limits of each format, beyond the octets.
LAST_TIME = {"pcap": 2**32 * 10**9 - 1, "pcapng": MAX_TIME_NS, "mcap": MAX_TIME_NS}
INTERFACES = {"pcap": 0, "pcapng": 20, "mcap": 2**32 - 1}

MANY = settings(max_examples=examples(60))


@st.composite
def frames_for(draw, formats):
    last, interfaces = min(LAST_TIME[each] for each in formats), min(INTERFACES[each] for each in formats)
    edges = st.sampled_from([0, 1, 999, 10**9 - 1, 10**9, last])
    frames = []
    for number in range(1, draw(st.integers(0, 12)) + 1):
        data = draw(st.binary(max_size=80) | st.integers(1000, 70_000).map(lambda size: bytes(size)))
        frames.append(
            Frame(
                number,
                draw(edges | st.integers(0, last)),
                data,
                # A frame without length at time 0 is all that a zeroed end of a file looks like.
                draw(st.sampled_from([max(1, len(data)), 2**32 - 1]) | st.integers(len(data) + 1, 2**32 - 1)),
                draw(st.integers(0, interfaces)),
            )
        )
    return frames


def written(frames, format, **options) -> bytes:
    stream = io.BytesIO()
    with create_capture(stream, format=format, **options) as writer:
        for frame in frames:
            writer.write(frame)
    return stream.getvalue()


def plain(frames):
    return [(each.number, each.time_ns, each.data, each.orig_len, each.interface) for each in frames]


def read(octets):
    with open_capture(io.BytesIO(octets)) as reader:
        return plain(reader), reader


@pytest.mark.parametrize("format", FORMATS)
@MANY
@given(st.data())
def test_frames_survive_a_round_trip(format, data):
    frames = data.draw(frames_for([format]))
    octets = written(frames, format)
    found, reader = read(octets)
    assert found == plain(frames)
    assert reader.problems == []
    assert reader.position == reader.size == len(octets)


@pytest.mark.parametrize(("first", "second"), every(2, itertools.product(FORMATS, FORMATS)))
@MANY
@given(st.data())
def test_conversion_loses_nothing(first, second, data):
    frames = data.draw(frames_for([first, second]))
    there, back = io.BytesIO(), io.BytesIO()
    report = convert(io.BytesIO(written(frames, first)), there, format=second)
    assert (report.frames, report.problems) == (len(frames), ())
    assert read(there.getvalue())[0] == plain(frames)
    there.seek(0)
    convert(there, back, format=first)
    assert read(back.getvalue())[0] == plain(frames)


@pytest.mark.parametrize("format", ["pcap", "pcapng"])
@MANY
@given(st.data())
def test_microseconds_are_exact_without_finer_times(format, data):
    frames = [
        Frame(each.number, each.time_ns // 1000 * 1000, each.data, each.orig_len, each.interface)
        for each in data.draw(frames_for([format]))
    ]
    assert read(written(frames, format, resolution="us"))[0] == plain(frames)


SOME = [Frame(n, 10**18 + n, bytes([n]) * (n * 7 % 50), 50 + n, 0) for n in range(1, 9)]


@pytest.mark.parametrize(
    ("format", "compression"),
    [("pcap", "none"), ("pcapng", "none"), *(("mcap", each) for each in ("zstd", "lz4", "none"))],
)
def test_frames_before_any_truncation_are_read_with_a_problem(format, compression):
    octets = written(SOME, format, metadata={"section": {"os": "x"}}, compression=compression)
    counts = []
    # Where a record ends, pcap and pcapng files may just as well have been finished.
    ends = set()
    for length in range(len(octets)):
        try:
            frames, reader = read(octets[:length])
        except CaptureError:
            assert not counts, "a header is not shorter than one that could be read"
            continue
        assert frames == plain(SOME[: len(frames)])
        if not reader.problems:
            assert reader.position == length
            ends.add(length)
        else:
            (problem,) = reader.problems
            assert problem.reason in ("truncated-record", "truncated-header", "unfinished")
            assert 0 <= problem.offset <= length
            assert problem.available <= length - problem.offset
            assert problem.needed > problem.available or problem.reason == "unfinished"
            assert problem.frame == len(frames)
        counts.append(len(frames))
    assert counts == sorted(counts)
    if format == "mcap":
        assert not ends
    else:
        # After the header and after each frame; in pcapng also after the description of the interface.
        assert len(ends) == len(SOME) + (1 if format == "pcapng" else 0)


def survives(octets: bytes) -> None:
    """Check that reading arbitrary octets ends, raises only `CaptureError`, and yields sound frames."""
    try:
        reader = open_capture(io.BytesIO(octets))
    except CaptureError:
        return
    with reader:
        last = 0
        for frame in reader:
            assert 0 <= frame.time_ns <= MAX_TIME_NS
            assert frame.orig_len >= len(frame.data)
            assert frame.offset < len(octets)
            last = frame.number
        for problem in reader.problems:
            assert problem.reason in get_args(Reason)
            assert problem.message.endswith(".")
            assert "\n" not in problem.message
            assert problem.offset <= len(octets)
        assert last or not reader.frames_read
        assert reader.position <= len(octets)


ALL = {format: written(SOME, format, metadata={"interface.0": {"name": "veth0"}}) for format in FORMATS}
ALL["mcap-none"] = written(SOME, "mcap", metadata={"a": {"b": "c"}}, compression="none")
ALL["mcap-lz4"] = written(SOME[:3], "mcap", compression="lz4")


@pytest.mark.part("suite")
@pytest.mark.parametrize("name", every(2, ALL))
def test_reading_survives_any_changed_octet(name):
    octets = bytearray(ALL[name])
    # Each place, with values that lengths and flags care about.
    for place, value in itertools.product(range(len(octets)), (0x00, 0x0A, 0x7F, 0x80, 0xFF)):
        before, octets[place] = octets[place], value
        survives(bytes(octets))
        octets[place] = before


@pytest.mark.parametrize("name", every(2, ALL))
@settings(max_examples=examples(300))
@given(st.data())
def test_reading_survives_any_replaced_part(name, data):
    octets = ALL[name]
    start = data.draw(st.integers(0, len(octets)))
    stop = data.draw(st.integers(start, len(octets)))
    survives(octets[:start] + data.draw(st.binary(max_size=60)) + octets[stop:])


MAGICS = [
    b"",
    ALL["pcap"][:24],
    ALL["pcapng"][:4],
    ALL["pcapng"][: len(written([], "pcapng"))],
    b"\x89MCAP0\r\n",
    ALL["mcap-none"][: ALL["mcap-none"].index(b"\x06", 1200)],
]


@settings(max_examples=examples(500))
@given(st.sampled_from(MAGICS), st.binary(max_size=400))
def test_reading_survives_anything_after_a_magic(magic, rest):
    survives(magic + rest)
