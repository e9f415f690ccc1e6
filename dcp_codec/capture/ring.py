"""A recording in several files whose oldest are deleted, for recorders that run for days."""

from __future__ import annotations

from collections import deque
from pathlib import Path

from .bytesource import Closing
from .compressed import without_compression
from .frame import Frame
from .opening import create_capture
from .writer import CaptureWriter, Metadata

#: Nanoseconds after which a new frame causes a flush.
_FLUSH_NS = 1_000_000_000


class RingWriter(Closing):
    """Writes frames to files of limited size or time; a context manager.

    ``max_octets`` and ``max_ns`` end a file (``None``: never); ``keep`` is the number of files that are kept (None:
    all). With a limit the files are named ``NAME-00001.SUFFIX`` and so on; without one there is a single file ``path``.

    Raises :class:`~dcp_codec.capture.CaptureError` if a file cannot be created or written.
    """

    def __init__(
        self,
        path: Path,
        *,
        max_octets: int | None = None,
        max_ns: int | None = None,
        keep: int | None = None,
        format: str | None = None,
        metadata: Metadata | None = None,
    ) -> None:
        self._path, self._format, self._metadata = path, format, metadata
        self._max_octets, self._max_ns, self._keep = max_octets, max_ns, keep
        self._limited = max_octets is not None or max_ns is not None
        self._writer: CaptureWriter | None = None
        self._began = self._flushed = 0
        #: Existing files, the oldest first.
        self.files: deque[Path] = deque()
        #: Number of files and frames written, including deleted ones.
        self.count = self.frames = 0
        self._next()

    def write(self, frame: Frame) -> None:
        """Append a frame, to a new file if the current one has reached its limit."""
        writer = self._writer
        assert writer is not None
        if writer.frames_written == 0:
            self._began = self._flushed = frame.time_ns
        elif self._full(writer, frame):
            writer = self._next()
            self._began = self._flushed = frame.time_ns
        writer.write(frame)
        self.frames += 1
        if frame.time_ns - self._flushed >= _FLUSH_NS and writer.format != "mcap":
            writer.flush()
            self._flushed = frame.time_ns

    def _full(self, writer: CaptureWriter, frame: Frame) -> bool:
        if self._max_octets is not None and writer.position >= self._max_octets:
            return True
        return self._max_ns is not None and frame.time_ns - self._began >= self._max_ns

    def _next(self) -> CaptureWriter:
        if self._writer is not None:
            self._writer.close()
        self.count += 1
        path = self._path
        if self._limited:
            stem = without_compression(path)
            name = f"{stem.stem}-{self.count:05d}{stem.suffix}{path.name[len(stem.name) :]}"
            path = path.with_name(name)
        self._writer = create_capture(path, format=self._format, metadata=self._metadata)
        self.files.append(path)
        while self._keep is not None and len(self.files) > self._keep:
            self.files.popleft().unlink(missing_ok=True)
        return self._writer

    def close(self) -> None:
        """Finish the last file. May be called again."""
        if self._writer is not None:
            self._writer.close()
