"""MCAP: files of ours, files of others, and what is left of them after a crash."""

import io
import random
import struct
import zlib
from pathlib import Path

import pytest
from dcp_spec.version import __version__
from mcap.reader import NonSeekingReader, make_reader
from mcap.writer import CompressionType, Writer
from mcap_protobuf.decoder import DecoderFactory

from dcp_codec.capture import (
    CaptureError,
    ChannelMessage,
    Frame,
    attachments,
    convert,
    create_capture,
    extract_attachment,
    open_capture,
)
from dcp_codec.capture.mcap.index import Place, read_index

FRAMES = [Frame(n, 1_700_000_000_000_000_000 + n, n.to_bytes(2, "big") * 50, 100 + n, n % 3) for n in range(1, 4001)]
MAGIC = b"\x89MCAP0\r\n"


def plain(frames):
    return [(each.number, each.time_ns, each.data, each.orig_len, each.interface) for each in frames]


def written(frames=FRAMES, **options) -> bytes:
    stream = io.BytesIO()
    with create_capture(stream, format="mcap", **options) as writer:
        for frame in frames:
            writer.write(frame)
    return stream.getvalue()


def read(octets: bytes):
    with open_capture(io.BytesIO(octets)) as reader:
        return list(reader), reader


def records(octets: bytes):
    """Opcode, offset and content of each record of the file itself."""
    position = len(MAGIC)
    while position < len(octets) - len(MAGIC):
        opcode, length = struct.unpack_from("<BQ", octets, position)
        yield opcode, position, octets[position + 9 : position + 9 + length]
        position += 9 + length


class Lengths:
    """A message beside each frame, on topics that come up over time."""

    SCHEMA = b'{"type": "object", "properties": {"length": {"type": "integer"}}}'

    def messages(self, frame):
        yield ChannelMessage(
            f"/lengths/{frame.number % 3}",
            "test.Length",
            self.SCHEMA,
            b'{"length": %d}' % frame.orig_len,
            frame.time_ns,
        )


def by_topic(octets: bytes):
    found: dict[str, list] = {}
    reader = make_reader(io.BytesIO(octets), validate_crcs=True)
    for schema, channel, message in reader.iter_messages(log_time_order=False):
        found.setdefault(channel.topic, []).append((schema, channel, message))
    return reader, found


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_the_library_reads_what_we_write(compression):
    octets = written(compression=compression, messages=Lengths(), metadata={"about": {"profile": "draft"}})
    reader, found = by_topic(octets)
    header = reader.get_header()
    assert (header.profile, header.library) == ("", f"dcp-codec {__version__}")
    summary = reader.get_summary()
    assert summary.statistics.message_count == 2 * len(FRAMES)
    assert (summary.statistics.schema_count, summary.statistics.channel_count) == (2, 4)
    assert {topic: len(each) for topic, each in found.items()} == {
        "/dcp/frames": 4000,
        "/lengths/0": 1333,
        "/lengths/1": 1334,
        "/lengths/2": 1333,
    }
    assert [(each.name, each.metadata) for each in reader.iter_metadata()] == [("about", {"profile": "draft"})]
    sizes = [index.uncompressed_size for index in summary.chunk_indexes]
    assert all(64 * 1024 <= size <= 256 * 1024 for size in sizes[:-1])
    assert {index.compression for index in summary.chunk_indexes} == {"" if compression == "none" else compression}
    frames, ours = read(octets)
    assert (plain(frames), ours.problems, ours.metadata) == (plain(FRAMES), [], {"about": {"profile": "draft"}})
    assert ours.position == ours.size


def test_messages_are_valid_by_their_schema():
    _, found = by_topic(written(FRAMES[:5]))
    for frame, (schema, channel, message) in zip(FRAMES, found["/dcp/frames"], strict=False):
        assert (schema.name, schema.encoding, channel.message_encoding) == ("dcp.RawFrame", "protobuf", "protobuf")
        # By the library of others, from the schema in the file alone.
        decode = DecoderFactory().decoder_for(channel.message_encoding, schema)
        found = decode(message.data)
        # The time is that of the log, and not in the message a second time.
        assert not found.HasField("timestamp")
        assert (found.number, found.interface, found.link_type) == (frame.number, frame.interface, 1)
        assert (found.orig_len, found.data) == (frame.orig_len, frame.data)
        # Nothing is packed twice: the message contains the octets of the frame unchanged.
        assert message.data.endswith(frame.data)
        assert len(message.data) - len(frame.data) < 40
        assert (message.log_time, message.publish_time, message.sequence) == (
            frame.time_ns,
            frame.time_ns,
            frame.number,
        )


def test_frame_numbers_are_kept():
    kept = [FRAMES[4], FRAMES[9], Frame(2**32 + 5, 1, b"a", 1)]
    octets = written(kept)
    assert plain(read(octets)[0]) == plain(kept)
    _, found = by_topic(octets)
    assert [message.sequence for _, _, message in found["/dcp/frames"]] == [5, 10, 5]


def test_metadata_added_while_writing_is_written_at_the_end():
    about = {"first": {"a": "1"}, "changing": {"b": "1"}}
    stream = io.BytesIO()
    with create_capture(stream, format="mcap", metadata=about) as writer:
        writer.write(FRAMES[0])
        about["changing"] = {"b": "2"}
        about["late"] = {"c": "\udcff"}
    _, reader = read(stream.getvalue())
    assert reader.metadata == {"first": {"a": "1"}, "changing": {"b": "2"}, "late": {"c": "?"}}


def test_messages_that_do_not_fit_are_refused():
    class Early:
        def messages(self, frame):
            yield ChannelMessage("/early", "test", b"{}", b"{}", -1)

    with (
        create_capture(io.BytesIO(), format="mcap", messages=Early()) as writer,
        pytest.raises(CaptureError, match="message on /early"),
    ):
        writer.write(FRAMES[0])


def test_a_reader_that_can_not_seek_agrees():
    octets = written(messages=Lengths())
    found = list(NonSeekingReader(io.BytesIO(octets), validate_crcs=True).iter_messages())
    assert len(found) == 2 * len(FRAMES)


# Attachments.


@pytest.mark.parametrize("contents", [b"", b"x", b"\x4d\x3c\xb2\xa1" + bytes(range(256)) * 20_000], ids=len)
@pytest.mark.parametrize("count", [0, 3, 4000])
def test_attachments_come_back_byte_for_byte(tmp_path, contents, count):
    original, path, again = tmp_path / "original.pcap", tmp_path / "a.mcap", tmp_path / "again"
    original.write_bytes(contents)
    with create_capture(path, attachment=original, metadata={"a": {"b": "c"}}) as writer:
        for frame in FRAMES[:count]:
            writer.write(frame)
    (found,) = attachments(path)
    media_type = "application/vnd.tcpdump.pcap" if len(contents) > 1 else "application/octet-stream"
    assert (found.name, found.media_type, found.size) == ("original.pcap", media_type, len(contents))
    extract_attachment(path, found, again)
    assert again.read_bytes() == contents
    assert sorted(each.name for each in tmp_path.iterdir()) == ["a.mcap", "again", "original.pcap"]
    # The library finds it by the summary, and its checksums hold.
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert summary.statistics.attachment_count == 1
        assert summary.statistics.metadata_count == 1
        assert summary.statistics.message_count == count
        (index,) = summary.attachment_indexes
        assert (index.data_size, index.name, index.offset) == (len(contents), "original.pcap", found.offset - 9)
        assert [each.data for each in reader.iter_attachments()] == [contents]
        assert sum(1 for _ in reader.iter_messages()) == count
        assert [each.name for each in reader.iter_metadata()] == ["a"]
    frames, ours = read(path.read_bytes())
    assert (plain(frames), ours.problems) == (plain(FRAMES[:count]), [])


def test_summary_offsets_point_at_their_groups(tmp_path):
    original = tmp_path / "original"
    original.write_bytes(b"\x0a\x0d\x0d\x0a" + bytes(100))
    octets = written(FRAMES, attachment=original, messages=Lengths(), metadata={"a": {"b": "c"}})
    offsets = [struct.unpack("<BQQ", content) for opcode, _, content in records(octets) if opcode == 0x0E]
    assert [each[0] for each in offsets] == [0x03, 0x04, 0x0B, 0x08, 0x0D, 0x0A]
    for kind, start, length in offsets:
        inside = {opcode for opcode, at, _ in records(octets) if start <= at < start + length}
        assert inside == {kind}
    # The first group starts where the footer says that the summary does.
    (footer,) = [content for opcode, _, content in records(octets) if opcode == 0x02]
    assert struct.unpack_from("<Q", footer)[0] == offsets[0][1]


def test_the_source_of_a_conversion_can_be_restored(tmp_path):
    source, target, again = tmp_path / "a.pcapng", tmp_path / "b.mcap", tmp_path / "again.pcapng"
    with create_capture(source) as writer:
        for frame in FRAMES:
            writer.write(frame)
    convert(source, target, attach_source=True)
    (found,) = attachments(target)
    assert found.media_type == "application/x-pcapng"
    assert found.log_time == FRAMES[0].time_ns
    extract_attachment(target, found, again)
    assert again.read_bytes() == source.read_bytes()
    with pytest.raises(CaptureError, match="not a file"):
        convert(io.BytesIO(source.read_bytes()), target, attach_source=True)


def test_a_damaged_attachment_is_not_extracted(tmp_path):
    original, path, again = tmp_path / "original", tmp_path / "a.mcap", tmp_path / "again"
    original.write_bytes(b"contents")
    again.write_bytes(b"precious")
    octets = written(FRAMES[:3], attachment=original)
    path.write_bytes(octets.replace(b"contents", b"c0ntents"))
    (found,) = attachments(path)
    with pytest.raises(CaptureError, match="does not match its checksum"):
        extract_attachment(path, found, again)
    path.write_bytes(octets[: found.offset + 50])
    with pytest.raises(CaptureError, match=r"has no attachment|ends within"):
        extract_attachment(path, found, again)
    assert again.read_bytes() == b"precious"
    path.write_bytes(octets)
    with pytest.raises(CaptureError, match="cannot be written"):
        extract_attachment(path, found, tmp_path / "none" / "again")


@pytest.mark.parametrize("cut", [1, 4, 10, 100, 120])
def test_attachments_that_are_cut_off_are_not_listed(tmp_path, cut):
    original, path = tmp_path / "original", tmp_path / "a.mcap"
    original.write_bytes(bytes(100))
    octets = written(FRAMES[:3], attachment=original)
    path.write_bytes(octets)
    (found,) = attachments(path)
    ((offset, length),) = [(at, 9 + len(content)) for opcode, at, content in records(octets) if opcode == 0x09]
    path.write_bytes(octets[: offset + length])
    assert attachments(path) == [found]
    path.write_bytes(octets[: offset + length - cut])
    assert attachments(path) == []


@pytest.mark.parametrize("place", [25, 37, 65])
def test_inconsistent_attachments_are_not_listed(tmp_path, place):
    original, path = tmp_path / "original", tmp_path / "a.mcap"
    original.write_bytes(bytes(100))
    octets = bytearray(written(FRAMES[:3], attachment=original))
    (offset,) = [at for opcode, at, _ in records(bytes(octets)) if opcode == 0x09]
    # The lengths of the name, of the media type, and of the contents.
    octets[offset + place : offset + place + 4] = b"\xff\xff\xff\x7f"
    path.write_bytes(octets)
    assert attachments(path) == []


def test_attachments_of_a_file_without_any(tmp_path):
    path = tmp_path / "a"
    path.write_bytes(b"no MCAP")
    with pytest.raises(CaptureError, match="is not an MCAP file"):
        attachments(path)
    path.write_bytes(written(FRAMES[:3]))
    assert attachments(path) == []


def test_an_attachment_in_a_file_by_the_library(tmp_path):
    path, again = tmp_path / "a.mcap", tmp_path / "again"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        writer.add_attachment(create_time=1, log_time=2, name="über", media_type="text/plain", data=b"contents")
        writer.finish()
    (found,) = attachments(path)
    assert (found.name, found.media_type, found.size, found.log_time, found.create_time) == (
        "über",
        "text/plain",
        8,
        2,
        1,
    )
    extract_attachment(path, found, again)
    assert again.read_bytes() == b"contents"


# Files by others.


def foreign(messages, *, schema="dcp.RawFrame", encoding="json", topic="/their/frames", **options) -> bytes:
    stream = io.BytesIO()
    writer = Writer(stream, **options)
    writer.start()
    other = writer.register_channel("/other", "json", writer.register_schema("other", "jsonschema", b"{}"))
    channel = writer.register_channel(topic, encoding, writer.register_schema(schema, "jsonschema", b"{}"))
    writer.add_message(other, log_time=1, publish_time=1, data=b"{}")
    for message in messages:
        writer.add_message(channel, log_time=77, publish_time=77, data=message)
    writer.finish()
    return stream.getvalue()


#: A frame in JSON, as older files have them, and the same in protobuf.
MESSAGE = b'{"data": "YWJj"}'
IN_PROTOBUF = b"\x32\x03abc"


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"compression": CompressionType.LZ4},
        {"compression": CompressionType.NONE},
        {"use_chunking": False},
        {"enable_data_crcs": True},
        {"enable_crcs": False},
        {"chunk_size": 1},
    ],
)
def test_raw_frames_by_others(options):
    full = b'{"timestamp":{"sec":1,"nsec":5},"number":9,"interface":2,"linkType":1,"origLen":60,"data":"YWJj","x":[]}'
    frames, reader = read(foreign([MESSAGE, full, MESSAGE], **options))
    assert plain(frames) == [
        (1, 77, b"abc", 3, 0),
        (9, 1_000_000_005, b"abc", 60, 2),
        (10, 77, b"abc", 3, 0),
    ]
    assert reader.problems == []


def test_raw_frames_by_others_in_protobuf():
    full = b"\x0a\x04\x08\x01\x10\x05\x10\x09\x18\x02\x20\x01\x28\x3c\x32\x03abc\x3a\x01x"
    backwards = b"\x32\x03abc\x28\x3c\x0a\x02\x08\x07"
    frames, reader = read(foreign([IN_PROTOBUF, full, backwards, b"\x32\x00"], encoding="protobuf"))
    assert plain(frames) == [
        (1, 77, b"abc", 3, 0),
        (9, 1_000_000_005, b"abc", 60, 2),
        (10, 7_000_000_000, b"abc", 60, 0),
        (11, 77, b"", 0, 0),
    ]
    assert reader.problems == []


@pytest.mark.parametrize(
    "bad",
    [
        b"",
        b"\x10\x05",
        b'{"data": "YWJj"}',
        b"\x32\x04abc",
        b"\x0a\x0b\x08\xff\xff\xff\xff\xff\xff\xff\xff\xff\x01\x32\x00",
        b"\x0a\x0b\x10\xff\xff\xff\xff\xff\xff\xff\xff\xff\x01\x32\x00",
        b"\x10\xff\xff\xff\xff\xff\xff\xff\xff\xff\x01\x32\x00",
    ],
    ids=["empty", "no data", "JSON", "cut off", "negative seconds", "negative nanoseconds", "number"],
)
def test_protobuf_messages_that_are_not_frames_are_counted(bad):
    frames, reader = read(foreign([IN_PROTOBUF, bad, bad, IN_PROTOBUF], encoding="protobuf"))
    assert len(frames) == 2
    (problem,) = reader.problems
    assert (problem.reason, problem.frame) == ("bad-message", 1)
    assert problem.message.startswith("2 messages")


@pytest.mark.parametrize("options", [{"use_chunking": False}, {"compression": CompressionType.NONE}])
def test_uncompressed_frames_have_offsets(options):
    octets = foreign([MESSAGE, MESSAGE], **options)
    frames, _ = read(octets)
    for frame in frames:
        assert octets[frame.offset] == 0x05
        assert octets[frame.offset + 9 + 22 :].startswith(MESSAGE)
    assert [frame.offset for frame in read(foreign([MESSAGE]))[0]] == [-1]


@pytest.mark.parametrize("options", [{"schema": "else.RawFrame"}, {"encoding": "cbor"}])
def test_a_file_without_raw_frames_is_refused_with_its_topics(options):
    with pytest.raises(CaptureError, match="its topics: /other, /their/frames"):
        read(foreign([MESSAGE], **options))


def test_a_file_without_anything_is_refused():
    stream = io.BytesIO()
    writer = Writer(stream)
    writer.start()
    writer.finish()
    with pytest.raises(CaptureError, match=r"its topics: none"):
        read(stream.getvalue())


@pytest.mark.parametrize(
    "bad",
    [
        b"",
        b"{}",
        b"[1]",
        b'{"data": 5}',
        b'{"data": "!"}',
        b'{"data": "YWJj", "number": -1}',
        b'{"data": "YWJj", "interface": 99999999999}',
        b'{"data": "YWJj", "timestamp": {"sec": 1}}',
        b'{"data": "YWJj", "timestamp": {"sec": -1, "nsec": 0}}',
        b'{"data": "\xff"}',
    ],
)
def test_messages_that_are_not_frames_are_counted(bad):
    frames, reader = read(foreign([MESSAGE, bad, bad, MESSAGE]))
    assert len(frames) == 2
    (problem,) = reader.problems
    assert (problem.reason, problem.frame) == ("bad-message", 1)
    assert problem.message.startswith("2 messages")


def test_frames_of_other_link_types_are_counted():
    frames, reader = read(foreign([MESSAGE, b'{"data": "YWJj", "linkType": 113}', MESSAGE]))
    assert len(frames) == 2
    assert [problem.reason for problem in reader.problems] == ["wrong-link-type"]


def test_times_outside_the_range_of_a_frame():
    frames, reader = read(foreign([b'{"data": "YWJj", "timestamp": {"sec": 99999999999, "nsec": 0}}']))
    assert frames[0].time_ns == 2**63 - 1
    assert [problem.reason for problem in reader.problems] == ["time-out-of-range"]


# Damage.


def test_an_unfinished_file_is_read_to_its_last_chunk():
    octets = written()
    chunks = [(offset, 9 + len(content)) for opcode, offset, content in records(octets) if opcode == 0x06]
    assert len(chunks) > 4
    offset, length = chunks[3]
    frames, reader = read(octets[: offset + length])
    assert plain(frames) == plain(FRAMES[: len(frames)])
    assert len(frames) > 1000
    (problem,) = reader.problems
    assert (problem.reason, problem.offset, problem.frame) == ("unfinished", offset + length, len(frames))
    assert f"{len(frames)} frames" in problem.message


# Packed octets come in blocks, so of a short chunk there is only something left near its end.
@pytest.mark.parametrize(("compression", "cut"), [("zstd", 3), ("lz4", 20), ("none", 20), ("none", 50_000)])
def test_complete_frames_of_a_truncated_chunk_are_read(compression, cut):
    octets = written(compression=compression)
    _, offset, content = [each for each in records(octets) if each[0] == 0x06][2]
    whole = len(read(octets[:offset])[0])
    length = 9 + len(content)
    frames, reader = read(octets[: offset + length - cut])
    assert plain(frames) == plain(FRAMES[: len(frames)])
    assert len(frames) > whole
    (problem,) = reader.problems
    assert (problem.reason, problem.offset) == ("truncated-record", offset)
    assert (problem.needed, problem.available) == (length, length - cut)
    assert f"{len(frames) - whole} of them from that chunk" in problem.message


def test_a_chunk_with_a_wrong_checksum_is_read_all_the_same():
    octets = bytearray(written(compression="none"))
    chunks = [each for each in records(bytes(octets)) if each[0] == 0x06]
    _, offset, content = chunks[0]
    octets[offset + 9 + len(content) - 10] ^= 1
    frames, reader = read(bytes(octets))
    assert len(frames) == len(FRAMES)
    different = [mine.number for mine, sent in zip(frames, FRAMES, strict=True) if mine.data != sent.data]
    assert len(different) <= 1
    (problem,) = reader.problems
    assert (problem.reason, problem.offset) == ("bad-crc", offset)
    assert "1 chunk damaged" in problem.message
    assert "read all the same" in problem.message


@pytest.mark.parametrize("attached", [True, False])
def test_no_single_inverted_bit_costs_more_than_a_part_of_a_chunk(tmp_path, attached):
    """A file is read by its records, by its index, and from the attached original, whichever gives more."""
    good = tmp_path / "good.mcap"
    with open_capture(Path(__file__).resolve().parents[2] / "captures" / "c_latejoin.mcap") as reader:
        sent = list(reader)
    attachment = None
    if attached:
        attachment = tmp_path / "c_latejoin.pcap"
        with create_capture(attachment) as writer:
            for frame in sent:
                writer.write(frame)
    with create_capture(good, attachment=attachment) as writer:
        for frame in sent:
            writer.write(frame)
    octets, path = good.read_bytes(), tmp_path / "flip.mcap"
    rng = random.Random(1)
    for _ in range(60):
        place = rng.randrange(8, len(octets))
        data = bytearray(octets)
        data[place] ^= 1 << rng.randrange(8)
        path.write_bytes(data)
        with open_capture(path) as reader:
            frames = list(reader)
            problems = [each.message for each in reader.problems]
        if attached:
            assert [each.data for each in frames] == [each.data for each in sent], (place, problems)
        assert len(frames) == len(sent) or problems, place


class CountedPlace(Place):
    """A place in the index that counts how often it is compared."""

    looked_up = 0

    @property
    def offset(self):
        CountedPlace.looked_up += 1
        return self[0]


def test_a_record_costs_a_binary_search_in_the_index(tmp_path, monkeypatch):
    monkeypatch.setattr("dcp_codec.capture.mcap.writer.CHUNK_LENGTH", 1)
    path, many = tmp_path / "long.mcap", 1000
    path.write_bytes(written(FRAMES[:many]))
    index = read_index(path)
    assert len(index.chunks) == many
    counted = index._replace(chunks=tuple(CountedPlace(*each) for each in index.chunks))
    monkeypatch.setattr("dcp_codec.capture.mcap.reader.read_index", lambda _: counted)
    monkeypatch.setattr(CountedPlace, "looked_up", 0)
    with open_capture(path) as reader:
        assert plain(reader) == plain(FRAMES[:many])
    # Each chunk has an index of its messages after it.
    assert 2 * many <= CountedPlace.looked_up <= 2 * many * 20


def test_a_chunk_of_unknown_compression_is_skipped():
    octets = written()
    packed = octets.index(b"\x04\0\0\0zstd") + 8 + 8
    frames, reader = read(octets[:packed] + b"Rar!" + octets[packed + 4 :])
    assert 0 < len(frames) < len(FRAMES)
    (problem,) = reader.problems
    assert problem.reason == "bad-compression"
    frames, reader = read(octets.replace(b"\x04\0\0\0zstd", b"\x04\0\0\0rar!", 1))
    assert len(frames) == len(FRAMES)
    (problem,) = reader.problems
    assert "'rar!', which is not known" in problem.message
    assert "read all the same" in problem.message


@pytest.mark.parametrize(("compression", "length"), [("zstd", 44), ("lz4", 43), ("none", 49)])
def test_an_inverted_bit_in_the_head_of_a_chunk_costs_no_frame(compression, length):
    octets = written(FRAMES[:20], compression=compression)
    head = next(offset for opcode, offset, _ in records(octets) if opcode == 0x06) + 9
    for place in range(head, head + length):
        for bit in (0, 3, 7):
            data = bytearray(octets)
            data[place] ^= 1 << bit
            assert plain(read(bytes(data))[0]) == plain(FRAMES[:20]), (place - head, bit)


def test_a_chunk_that_cannot_be_decompressed_is_skipped():
    octets = bytearray(written())
    _, offset, _ = next(each for each in records(bytes(octets)) if each[0] == 0x06)
    octets[offset + 60 : offset + 80] = bytes(20)
    frames, reader = read(bytes(octets))
    assert 0 < len(frames) < len(FRAMES)
    assert reader.problems[0].reason in ("bad-compression", "bad-crc")


def chunk(records: bytes, *, size: int | None = None, crc: int | None = None, packed: bytes | None = None) -> bytes:
    stored, name = (records, b"") if packed is None else (packed, b"zstd")
    content = struct.pack(
        "<QQQI", 0, 0, len(records) if size is None else size, zlib.crc32(records) if crc is None else crc
    )
    content += struct.pack("<I", len(name)) + name + struct.pack("<Q", len(stored)) + stored
    return struct.pack("<BQ", 6, len(content)) + content


def unfinished(extra: bytes) -> bytes:
    """A file of ours with one frame in it, and then something else."""
    octets = written(FRAMES[:1])
    (end,) = [offset for opcode, offset, _ in records(octets) if opcode == 0x0F]
    return octets[:end] + extra


def test_a_small_chunk_cannot_fill_the_memory():
    import zstandard

    bomb = zstandard.compress(bytes(1 << 30))
    for size in (10, 1 << 62):
        frames, reader = read(unfinished(chunk(b"", size=size, packed=bomb)))
        assert len(frames) == 1
        assert [problem.reason for problem in reader.problems] == [
            "bad-compression" if size == 10 else "too-large",
            "unfinished",
        ]


@pytest.mark.parametrize(
    ("extra", "expected"),
    [
        (bytes(4096), "zero-filled"),
        (b"\0\1" + bytes(20), "bad-record"),
        (struct.pack("<BQ", 6, 10) + bytes(10), "bad-record"),
        (struct.pack("<BQ", 6, 2**62) + bytes(10), "too-large"),
        (struct.pack("<BQ", 5, 2**62) + bytes(10), "too-large"),
        (struct.pack("<BQ", 5, 3) + bytes(3), "bad-record"),
        (struct.pack("<BQ", 5, 22) + struct.pack("<H", 99) + bytes(20), "bad-record"),
        (struct.pack("<BQ", 4, 5) + b"\1\1\1\1\1", "bad-record"),
        (struct.pack("<BQ", 3, 9) + b"\1\1\3\0\0\0\xff\xff\xff", "bad-record"),
        (struct.pack("<BQ", 12, 4) + b"\x09\0\0\0", "bad-record"),
        (struct.pack("<BQ", 0x42, 4) + b"abcd", "unknown-record"),
        (struct.pack("<BQ", 0x99, 4) + b"abcd", "unfinished"),
        (struct.pack("<BQ", 15, 4) + b"abcd", "bad-crc"),
        (struct.pack("<BQ", 15, 0), "bad-record"),
        (struct.pack("<BQ", 2, 20) + bytes(16) + b"abcd", "bad-crc"),
        (struct.pack("<BQ", 2, 20) + bytes(20), "truncated-record"),
        (struct.pack("<BQ", 2, 20) + bytes(20) + MAGIC[:3], "truncated-record"),
        (struct.pack("<BQ", 2, 20) + bytes(20) + b"no magic", "bad-record"),
        (struct.pack("<BQ", 2, 20) + bytes(20) + MAGIC + b"more", "trailing-data"),
        (chunk(b"\5" + bytes(20)), "bad-record"),
        (chunk(b"\5" + struct.pack("<Q", 500) + bytes(20)), "bad-record"),
        (chunk(b"", size=7), "bad-compression"),
        (chunk(b"\x99" + bytes(8), crc=7), "bad-crc"),
        (b"\5\1\2", "truncated-header"),
        (struct.pack("<BQ", 9, 1000) + bytes(10), "truncated-record"),
    ],
)
def test_damage_after_a_good_frame(extra, expected):
    frames, reader = read(unfinished(extra))
    assert plain(frames) == plain(FRAMES[:1])
    assert reader.problems[0].reason == expected


def test_a_finished_summary_is_checked():
    octets = bytearray(written(FRAMES[:3]))
    at = bytes(octets).rindex(b"/dcp/frames")
    octets[at] ^= 1
    frames, reader = read(bytes(octets))
    assert len(frames) == 3
    assert [problem.reason for problem in reader.problems] == ["bad-crc"]
