"""Writer of MCAP files. It adds to the mcap library the support of pipes and of attachments of any size."""

from __future__ import annotations

import os
import struct
import zlib
from pathlib import Path
from typing import IO, Any, BinaryIO, Literal, cast

from dcp_spec.version import __version__
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, Channel, McapRecord, Schema
from mcap.writer import CompressionType, Writer

from dcp_codec.capture.bytesink import ByteSink
from dcp_codec.capture.bytesource import READ_SIZE, explain
from dcp_codec.capture.frame import MAX_TIME_NS, CaptureError, Frame
from dcp_codec.capture.writer import CaptureWriter, ChannelMessage, MessageSource, Metadata

from . import raw_frame as rawframe
from .summary import add_attachments

#: Unpacked octets of records after which a chunk ends: the most that a killed process can lose.
CHUNK_LENGTH = 128 * 1024

COMPRESSIONS = {
    "zstd": CompressionType.ZSTD,
    "lz4": CompressionType.LZ4,
    "none": CompressionType.NONE,
}

_MEDIA_TYPES = {
    b"\xd4\xc3\xb2\xa1": "application/vnd.tcpdump.pcap",
    b"\xa1\xb2\xc3\xd4": "application/vnd.tcpdump.pcap",
    b"\x4d\x3c\xb2\xa1": "application/vnd.tcpdump.pcap",
    b"\xa1\xb2\x3c\x4d": "application/vnd.tcpdump.pcap",
    b"\x0a\x0d\x0d\x0a": "application/x-pcapng",
}


class _Output:
    """Output for the library: the sink, with a position also for pipes, or at the end memory."""

    def __init__(self, sink: ByteSink) -> None:
        self._sink = sink
        self.held: list[bytes] | None = None

    def write(self, octets: bytes) -> int:
        if self.held is not None:
            self.held.append(octets)
            return len(octets)
        return self._sink.write(octets)

    def tell(self) -> int:
        return self._sink.position + sum(map(len, self.held or ()))

    def flush(self) -> None:
        self._sink.flush()


class McapWriter(CaptureWriter):
    """Writes an MCAP file: raw frames on one topic, each followed by its messages from `messages`.

    The sequence number of all messages is the number of the frame modulo 2^32. The schema and the channel of the raw
    frames are also before the first chunk: the type of the file is known from its start, and a damaged first chunk does
    not make the others unreadable.

    Metadata is written at the start; new or changed records are written at the end.
    """

    format = "mcap"

    def __init__(
        self,
        sink: ByteSink,
        metadata: Metadata,
        messages: MessageSource | None,
        attachment: OpenAttachment | None,
        compression: Literal["zstd", "lz4", "none"],
    ) -> None:
        super().__init__(sink)
        self._messages = messages
        self._attachment = attachment
        self._metadata = metadata
        self._metadata_written: dict[str, dict[str, str]] = {}
        self._first_time = 0
        self._output = _Output(sink)
        # Any, since not all of its methods are typed.
        self._writer: Any = Writer(
            cast(IO[Any], self._output), chunk_size=CHUNK_LENGTH, compression=COMPRESSIONS[compression]
        )
        self._writer.start(profile="", library=f"dcp-codec {__version__}")
        self._write_metadata()
        self._schemas: dict[tuple[str, str, bytes], int] = {}
        self._channels: dict[tuple[str, str, str, str, bytes], int] = {}
        self._describe_raw_frames()

    def _describe_raw_frames(self) -> None:
        octets = rawframe.schema_octets()
        self._raw = self._channel(
            rawframe.TOPIC, rawframe.SCHEMA_NAME, octets, rawframe.SCHEMA_ENCODING, rawframe.MESSAGE_ENCODING
        )
        schema_id = self._schemas[rawframe.SCHEMA_NAME, rawframe.SCHEMA_ENCODING, octets]
        builder: Any = RecordBuilder()
        records: list[McapRecord] = [
            Schema(id=schema_id, name=rawframe.SCHEMA_NAME, encoding=rawframe.SCHEMA_ENCODING, data=octets),
            Channel(
                id=self._raw,
                topic=rawframe.TOPIC,
                message_encoding=rawframe.MESSAGE_ENCODING,
                schema_id=schema_id,
                metadata={},
            ),
        ]
        for record in records:
            record.write(builder)
        self._sink.write(builder.end())

    def _channel(self, topic: str, schema_name: str, schema: bytes, schema_encoding: str, message_encoding: str) -> int:
        """Return the number of a channel, which is registered with its schema on first use."""
        key = (topic, message_encoding, schema_name, schema_encoding, schema)
        known = self._channels.get(key)
        if known is not None:
            return known
        schema_id: int | None = self._schemas.get((schema_name, schema_encoding, schema))
        if schema_id is None:
            schema_id = self._writer.register_schema(schema_name, schema_encoding, schema)
            self._schemas[schema_name, schema_encoding, schema] = schema_id
        channel: int = self._writer.register_channel(topic, message_encoding, schema_id)
        self._channels[key] = channel
        return channel

    def _write(self, frame: Frame) -> None:
        if not 0 <= frame.interface < 2**32 or frame.number < 1:
            raise self._refuse(frame, f"its number or its interface, {frame.interface}, is out of range")
        if not self._written:
            self._first_time = frame.time_ns
        self._add(self._raw, frame, frame.time_ns, rawframe.encode(frame))
        if self._messages is not None:
            for message in self._messages.messages(frame):
                self._add_message(frame, message)

    def _add_message(self, frame: Frame, message: ChannelMessage) -> None:
        if not 0 <= message.time_ns <= MAX_TIME_NS:
            raise self._refuse(frame, f"its message on {message.topic} is not within 1970 to 2262")
        channel = self._channel(
            message.topic, message.schema_name, message.schema, message.schema_encoding, message.message_encoding
        )
        self._add(channel, frame, message.time_ns, message.data)

    def _add(self, channel: int, frame: Frame, time_ns: int, data: bytes) -> None:
        sequence = frame.number & 0xFFFF_FFFF
        self._writer.add_message(channel, log_time=time_ns, publish_time=time_ns, sequence=sequence, data=data)

    def flush(self) -> None:
        """End the chunk, so that all frames taken so far can be read after a crash. Not meant for use after each
        frame.
        """
        self._writer.flush()

    def _write_metadata(self) -> None:
        for name, values in self._metadata.items():
            record = {_text(key): _text(value) for key, value in values.items()}
            if self._metadata_written.get(name) != record:
                self._metadata_written[name] = record
                self._writer.add_metadata(_text(name), record)

    def _finish(self) -> None:
        self._write_metadata()
        if self._attachment is None:
            self._writer.finish()
            return
        self._writer.flush()
        index = self._attachment.write(self._sink, self._first_time)
        # The library's summary lacks the attachment: write the summary to memory and add the attachment.
        start = self._sink.position
        tail: list[bytes] = []
        self._output.held = tail
        self._writer.finish()
        self._sink.write(add_attachments(b"".join(tail), start, [index]))

    def close(self) -> None:
        """See `CaptureWriter.close`."""
        try:
            super().close()
        finally:
            if self._attachment is not None:
                self._attachment.close()


class OpenAttachment:
    """A file that becomes an attachment: opened, measured, and copied in pieces."""

    def __init__(self, path: Path) -> None:
        """Open the file. Raises `CaptureError` if it cannot be read."""
        self._path = path
        try:
            # Unbuffered, since it is read in large pieces.
            self._stream: BinaryIO = cast(BinaryIO, path.open("rb", buffering=0))
        except (OSError, ValueError) as error:
            raise CaptureError(f"{path}: cannot be read: {explain(error)}") from error
        try:
            self.size = os.fstat(self._stream.fileno()).st_size
            self.media_type = _MEDIA_TYPES.get(self._stream.read(4), "application/octet-stream")
            self._stream.seek(0)
        except OSError as error:
            self._stream.close()
            raise CaptureError(f"{path}: cannot be attached: {explain(error)}") from error

    def write(self, sink: ByteSink, time_ns: int) -> AttachmentIndex:
        """Write the attachment record, logged at `time_ns`.

        The creation time of the file is omitted: the same frames must give the same octets, wherever and whenever a
        file was copied.
        """
        name, media_type = _text(self._path.name), self.media_type
        head = struct.pack("<QQ", time_ns, 0) + _prefixed(name) + _prefixed(media_type)
        head += struct.pack("<Q", self.size)
        offset = sink.position
        sink.write(struct.pack("<BQ", Opcode.ATTACHMENT, len(head) + self.size + 4) + head)
        sink.write(struct.pack("<I", self._copy(sink, zlib.crc32(head))))
        return AttachmentIndex(
            offset=offset,
            length=sink.position - offset,
            log_time=time_ns,
            create_time=0,
            data_size=self.size,
            name=name,
            media_type=media_type,
        )

    def _copy(self, sink: ByteSink, crc: int) -> int:
        left = self.size
        while left:
            try:
                piece = self._stream.read(min(left, READ_SIZE))
            except OSError as error:
                raise CaptureError(f"{self._path}: cannot be attached: {explain(error)}") from error
            if not piece:
                raise CaptureError(f"{self._path}: became shorter while it was attached to {sink.name}")
            sink.write(piece)
            crc = zlib.crc32(piece, crc)
            left -= len(piece)
        return crc

    def close(self) -> None:
        """Close the file."""
        self._stream.close()


def _prefixed(text: str) -> bytes:
    octets = text.encode()
    return struct.pack("<I", len(octets)) + octets


def _text(text: str) -> str:
    """Return `text` without surrogates, which file names can contain and UTF-8 cannot encode."""
    return text.encode("utf-8", "replace").decode()
