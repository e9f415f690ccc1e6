"""Recording of the frames of a link, in both directions, to an MCAP file."""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Callable, Mapping
from itertools import chain, count
from pathlib import Path

from dcp_codec.capture import MAX_TIME_NS, CaptureError, CaptureWriter, Frame, create_capture
from dcp_codec.codec import Codec
from dcp_codec.foxglove.channels import DecodedChannels, capture_metadata
from dcp_codec.framing.envelope import Envelope

from .base import LinkError

log = logging.getLogger(__name__)

#: ns after which recorded frames are flushed: the most that a killed node can lose. Each flush ends a chunk, and the
#: index of chunks stays in memory until the end. A long recording therefore flushes less often; in the end hardly
#: more often than chunks are full.
FLUSH_INTERVAL, LONGEST_FLUSH_INTERVAL = 1_000_000_000, 30_000_000_000
#: Between the two limits the interval is this fraction of the recording's age: 1 s for the first half hour, then more.
_FLUSHES_PER_AGE = 1800


def recording_path(place: str | Path, node_id: bytes, wall: int) -> Path:
    """Return the file to record to: ``place``, or, if that is a folder or ends with "/", a new file in it.

    The name of a new file contains the node identifier and ``wall`` (ns since 1970) as UTC. If that file exists, as
    when a clock starts at the same time after each boot, a number is appended.
    """
    path = Path(place)
    if not (path.is_dir() or str(place).endswith("/")):
        return path
    stem = f"{node_id.hex()}-{time.strftime('%Y%m%dT%H%M%SZ', time.gmtime(wall / 1e9))}"
    names = chain([f"{stem}.mcap"], (f"{stem}-{number}.mcap" for number in count(2)))
    return next(each for each in map(path.joinpath, names) if not each.exists())


class FrameFile:
    """A file of frames, whose first error ends it: nothing is raised then, ``problem`` has the text."""

    def __init__(self, writer: CaptureWriter) -> None:
        self.frames = 0
        self.problem = ""
        self._writer: CaptureWriter | None = writer

    @property
    def recording(self) -> bool:
        """Whether frames are still written."""
        return self._writer is not None

    def add(self, data: bytes, wall: int) -> None:
        """Write a frame with its time, ns since 1970."""
        if self._writer is not None:
            frame = Frame(self.frames + 1, min(max(wall, 0), MAX_TIME_NS), data, len(data))
            if self._done(self._writer.write, frame):
                self.frames += 1

    def flush(self) -> None:
        """Pass the frames to the system."""
        if self._writer is not None:
            self._done(self._writer.flush)

    def close(self) -> None:
        """Finish the file; may be called twice."""
        writer, self._writer = self._writer, None
        if writer is not None:
            self._done(writer.close)

    def _done(self, step: Callable[..., object], *args: object) -> bool:
        try:
            step(*args)
        except CaptureError as error:
            self.problem = str(error)
            log.error("recording ends after %d frames: %s", self.frames, error)
            writer, self._writer = self._writer, None
            if writer is not None:
                with contextlib.suppress(CaptureError):
                    writer.close()
            return False
        return True


class Recorder(FrameFile):
    """A :class:`~dcp_stack.links.base.Watcher` that writes frames to an MCAP file, raw and decoded.

    It keeps one chunk (128 KiB) in memory, and the index of chunks for the end of the MCAP file: 0.6 to 1 KB for
    each flush, which at 30 frames/s is 2 to 3 MB in the first hour and 6 to 10 MB in the first day. Each node with
    a position takes another 50 octets. There is no thread: the user calls :meth:`tick` regularly. If frames cannot
    be written (disk full), the recording ends: the error is logged once and kept in ``problem``. Nothing is raised
    after the file was created.
    """

    def __init__(
        self,
        path: str | Path,
        codec: Codec,
        *,
        decoded: bool = True,
        about: Mapping[str, str] | None = None,
        overwrite: bool = False,
        clock: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        """``decoded``: also write decoded messages for viewers, which takes 0.2 ms per frame instead of 6 us.

        ``about`` is added to the metadata of the file.
        Raises :class:`LinkError` if the file cannot be created, or if it exists and ``overwrite`` is False.
        """
        self.path = Path(path)
        self._envelope = Envelope(codec.profile.link)
        self._clock = clock
        self._begun_at = self._flushed_at = clock()
        self._pending = False
        if not overwrite and self.path.exists():
            raise LinkError(f"{path}: exists already; name a new file, recordings are not overwritten")
        try:
            messages = DecodedChannels(codec) if decoded else None
            metadata = capture_metadata(codec, about)
            super().__init__(create_capture(self.path, format="mcap", metadata=metadata, messages=messages))
        except CaptureError as error:
            raise LinkError(f"cannot record to {error}") from error

    def saw(self, octets: bytes, wall: int, *, outgoing: bool, source: bytes) -> None:  # noqa: ARG002
        """Write one bearer payload in an envelope with the sender's address ``source``; ``wall``: ns since 1970."""
        if self.recording:
            self.add(self._envelope.frame(octets, source), wall)
            self._pending = True

    def tick(self) -> None:
        """Flush recorded frames if the last flush was at least 1 s ago (up to 30 s in a recording of hours)."""
        now = self._clock()
        interval = max(FLUSH_INTERVAL, min((now - self._begun_at) // _FLUSHES_PER_AGE, LONGEST_FLUSH_INTERVAL))
        if now - self._flushed_at < interval:
            return
        self._flushed_at = now
        if self._pending:
            self._pending = False
            self.flush()
