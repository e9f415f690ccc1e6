"""Input as a sliding window over a stream of octets, for files and pipes."""

from __future__ import annotations

import io
import os
import stat
import sys
import zlib
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Self

from .frame import CaptureError

#: Octets requested at once. A pipe returns what is available, so this causes no delay.
READ_SIZE = 1024 * 1024


class Closing:
    """Base of context managers that are closed at the end of the block."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Release everything. May be called again."""
        raise NotImplementedError


class ByteSource:
    """A window of octets that only moves forward.

    `buffer` holds octets of the stream from the absolute offset `base` on. Readers take what they need from
    `buffer` by index and call `more` when it runs out. The window grows to what one record needs and is never
    the whole stream.

    A stream that fails (`OSError`, a decompressor's error) ends there, and `failure` says why.
    """

    def __init__(self, stream: BinaryIO, name: str, size: int | None, *, owned: bool) -> None:
        self.name = name
        #: Size in octets, None if unknown.
        self.size = size
        self.buffer = b""
        self.base = 0
        #: The cursor, an index into `buffer`, for readers without a cursor.
        self.start = 0
        self.failure = ""
        self._stream = stream
        self._owned = owned
        # read(n) of a buffered pipe waits for all n octets; read1 returns the available ones. A raw file only has read,
        # which does the same.
        self._read: Callable[[int], bytes | None] = getattr(stream, "read1", stream.read)

    @property
    def indexed(self) -> bool:
        """Return whether `name` is a regular file with the same octets, of which any part can be read."""
        return self._owned and self.size is not None and isinstance(self._stream, io.FileIO)

    @property
    def position(self) -> int:
        """Return the absolute offset of the cursor."""
        return self.base + self.start

    def more(self, start: int, need: int) -> bytes:
        """Drop the first `start` octets of the window and read until it has at least `need`, fewer only at the end.

        Returns the new `buffer`, whose first octet is at the cursor; indices into the old one are invalid.
        """
        pieces = [self.buffer[start:]]
        have = len(pieces[0])
        self.base += start
        self.start = 0
        while have < need:
            piece = self._piece()
            if not piece:
                break
            pieces.append(piece)
            have += len(piece)
        self.buffer = b"".join(pieces)
        return self.buffer

    def need(self, count: int) -> int:
        """Read until at least `count` octets follow the cursor, fewer only at the end; return their number."""
        have = len(self.buffer) - self.start
        if have < count:
            have = len(self.more(self.start, count))
        return have

    def skip(self, count: int) -> int:
        """Move the cursor over `count` octets without keeping them; return the number of octets skipped."""
        start, end = self.position, self.position + count
        while self.position < end:
            step = min(end - self.position, len(self.buffer) - self.start)
            if step:
                self.start += step
            elif self.size is not None and self._owned and end - self.position > READ_SIZE:
                self._jump(min(end, self.size))
                if self.position < end:
                    break
            elif not self.more(self.start, 1):
                break
        return self.position - start

    def _jump(self, position: int) -> None:
        """Continue at `position` of a file, with an empty window."""
        try:
            self._stream.seek(position)
        except (OSError, ValueError) as error:
            self.failure = explain(error)
            return
        self.buffer, self.start, self.base = b"", 0, position

    def take(self, count: int) -> bytes:
        """Return the `count` octets at the cursor, fewer only at the end, and move the cursor over them."""
        self.need(count)
        octets = self.buffer[self.start : self.start + count]
        self.start += len(octets)
        return octets

    def _piece(self) -> bytes:
        if self.failure:
            return b""
        try:
            piece = self._read(READ_SIZE)
        except (OSError, EOFError, ValueError, zlib.error) as error:
            self.failure = explain(error)
            return b""
        if piece is None:
            self.failure = "it is non-blocking and had nothing to read"
            return b""
        return piece

    def close(self) -> None:
        """Close the stream; a stream of the caller stays open. May be called again."""
        self.buffer = b""
        self.start = 0
        self.failure = self.failure or "it is closed"
        if self._owned:
            self._owned = False
            self._stream.close()


def open_source(source: str | Path | BinaryIO) -> ByteSource:
    """Open a `ByteSource` on a path, on ``"-"`` (standard input), or on a binary stream from its current position.

    Raises `CaptureError` if there is no such file, it is a directory, or it may not be read.
    """
    if isinstance(source, str) and source == "-":
        return ByteSource(sys.stdin.buffer, "standard input", _file_size(sys.stdin.buffer), owned=False)
    if not isinstance(source, (str, Path)):
        return ByteSource(source, stream_name(source), _stream_size(source), owned=False)
    try:
        # Unbuffered: the window is the buffer.
        stream = Path(source).open("rb", buffering=0)  # noqa: SIM115 - the source closes it
    except (OSError, ValueError) as error:
        raise CaptureError(f"{source}: cannot be read: {explain(error)}") from error
    return ByteSource(stream, str(source), _file_size(stream), owned=True)


def stream_name(stream: BinaryIO) -> str:
    """Return the name of a stream for messages."""
    name = getattr(stream, "name", None)
    return name if isinstance(name, str) and name else "<stream>"


def explain(error: Exception) -> str:
    """Return the reason why a file could not be opened, read or written, for messages."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return str(error) or type(error).__name__


def _file_size(stream: BinaryIO | io.FileIO) -> int | None:
    """Return the size of a regular file by its descriptor; None for pipes, devices and objects without a descriptor."""
    try:
        status = os.fstat(stream.fileno())
    except (OSError, ValueError, AttributeError):
        return None
    return status.st_size if stat.S_ISREG(status.st_mode) else None


def _stream_size(stream: BinaryIO) -> int | None:
    """Return the octets from the position of the stream to its end; None if that is unknown without reading."""
    try:
        here = stream.tell()
        if isinstance(stream, io.BytesIO):
            return len(stream.getbuffer()) - here
        size = _file_size(stream)
    except (OSError, ValueError, AttributeError):
        return None
    return None if size is None else size - here
