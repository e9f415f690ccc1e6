"""Base of the writers of all formats: checks of frames, and completion of the file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import TracebackType
from typing import Protocol

import msgspec

from .bytesink import ByteSink
from .bytesource import Closing
from .frame import MAX_FRAME_LENGTH, MAX_TIME_NS, CaptureError, Frame

#: Named records of names and values.
Metadata = Mapping[str, Mapping[str, str]]

#: Octets of records that are collected before they are written.
BATCH_LENGTH = 64 * 1024

MAX_LENGTH_ON_WIRE = 2**32 - 1


class ChannelMessage(msgspec.Struct, frozen=True):
    """A message for a channel of an MCAP file beside the raw frames, such as a decoded frame."""

    #: Such as "/dcp/beacons". A topic may carry messages of several schemas.
    topic: str
    schema_name: str
    #: By default a JSON Schema of type "object", UTF-8. The same name with other octets is another schema.
    schema: bytes
    #: By default a JSON object, UTF-8.
    data: bytes
    #: Nanoseconds since the Unix epoch, 0..`MAX_TIME_NS`.
    time_ns: int
    #: Names of encodings as MCAP registers them (mcap.dev/spec/registry): "jsonschema", "protobuf", "ros2msg"...
    schema_encoding: str = "jsonschema"
    #: ... and "json", "protobuf", "cdr".
    message_encoding: str = "json"


class MessageSource(Protocol):
    """Supplies the messages that go into an MCAP file after each raw frame."""

    def messages(self, frame: Frame) -> Iterable[ChannelMessage]:
        """Return the messages that belong to `frame`, in the order of writing."""
        ...


class CaptureWriter(Closing):
    """Writes frames to one capture; a context manager.

    `close` finishes the file; leaving the with-block calls it, also after an exception. pcap and pcapng files grow by
    whole records, at the latest every `BATCH_LENGTH` octets, MCAP files by whole chunks: the file of a killed process
    can be read up to the last batch. Slow recorders should call `flush` from time to time.
    """

    #: "pcap", "pcapng" or "mcap".
    format: str = ""

    def __init__(self, sink: ByteSink) -> None:
        self._sink = sink
        self._batch: list[bytes] = []
        self._batched = 0
        self._closed = False
        self._written = 0

    @property
    def name(self) -> str:
        """Return the name of the file, as the caller gave it."""
        return self._sink.name

    @property
    def frames_written(self) -> int:
        """Return the number of frames written so far."""
        return self._written

    @property
    def position(self) -> int:
        """Return the size of the file in octets, without those that are still buffered."""
        return self._sink.position

    def write(self, frame: Frame) -> None:
        """Append one frame.

        Raises `CaptureError` if the format cannot hold the frame, or the file cannot be written. In the first case the
        writer can still be used.
        """
        if self._closed:
            raise ValueError(f"{self.name}: is closed")
        length = len(frame.data)
        if (
            length > MAX_FRAME_LENGTH
            or not length <= frame.orig_len <= MAX_LENGTH_ON_WIRE
            or not 0 <= frame.time_ns <= MAX_TIME_NS
        ):
            raise self._refuse(frame, _unfit(frame))
        self._write(frame)
        self._written += 1

    def _write(self, frame: Frame) -> None:
        raise NotImplementedError

    def _append(self, record: bytes) -> None:
        """Add a whole record to the next batch."""
        self._batch.append(record)
        self._batched += len(record)
        if self._batched >= BATCH_LENGTH:
            self._hand_over()

    def _hand_over(self) -> None:
        batch, self._batch, self._batched = self._batch, [], 0
        if batch:
            self._sink.write(b"".join(batch))

    def _finish(self) -> None:
        """Write the end of the file."""
        self._hand_over()

    def _refuse(self, frame: Frame, why: str) -> CaptureError:
        return CaptureError(f"{self.name}: frame {frame.number} cannot be written: {why}")

    def flush(self) -> None:
        """Write everything that is buffered to the system. In MCAP this ends the chunk, so call it sparingly."""
        self._hand_over()
        self._sink.flush()

    def close(self) -> None:
        """Finish and close the file; a stream of the caller stays open. May be called again.

        Raises `CaptureError` if the end cannot be written, unless writing has failed before.
        """
        if self._closed:
            return
        self._closed = True
        try:
            if not self._sink.failed:
                self._finish()
        finally:
            self._sink.close()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is not None:
            self._sink.abandon()
        try:
            self.close()
        except CaptureError as second:
            if error is None:
                raise
            # The first error is the one that the user needs.
            error.add_note(str(second))


def _unfit(frame: Frame) -> str:
    if len(frame.data) > MAX_FRAME_LENGTH:
        return f"it has {len(frame.data)} octets, and {MAX_FRAME_LENGTH} is the most that capture files hold"
    if not 0 <= frame.time_ns <= MAX_TIME_NS:
        return f"its time, {frame.time_ns} ns, is not within 1970 to 2262"
    return f"its length on the wire, {frame.orig_len}, is not within {len(frame.data)}..{MAX_LENGTH_ON_WIRE}"
