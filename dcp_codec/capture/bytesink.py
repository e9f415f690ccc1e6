"""Output of octets to files and pipes; each write reaches the system before the call returns."""

from __future__ import annotations

import os
import stat
import sys
from pathlib import Path
from typing import IO, BinaryIO

from .bytesource import explain, stream_name
from .compressed import compressing, compression_of
from .frame import CaptureError


class ByteSink:
    """Output that counts its octets, also for pipes, where the system has no position.

    It does not buffer. Callers write whole records, so a process that is killed leaves whole records.
    """

    def __init__(self, stream: BinaryIO, name: str, *, owned: bool, place: tuple[Path, Path] | None = None) -> None:
        """``place``: the temporary path of the file, and the path that it gets when it is closed."""
        self._place = place
        self._abandoned = False
        self.name = name
        #: Octets written so far.
        self.position = 0
        self.failed = False
        self._stream = stream
        self._owned = owned

    def write(self, octets: bytes | memoryview) -> int:
        """Write all of `octets`. Raises `CaptureError` if that fails."""
        view = memoryview(octets)
        try:
            while view:
                # Raw files and especially pipes may accept fewer octets than given.
                taken = self._stream.write(view)
                if not taken:
                    raise BlockingIOError("the stream is non-blocking and took nothing")
                view = view[taken:]
        except (OSError, ValueError) as error:
            raise self._error(error) from error
        self.position += len(octets)
        return len(octets)

    def flush(self) -> None:
        """Flush the buffer of the stream, if it has one."""
        try:
            self._stream.flush()
        except (OSError, ValueError) as error:
            raise self._error(error) from error

    def close(self) -> None:
        """Close the stream; a stream of the caller is flushed and stays open. May be called again."""
        if self._owned:
            self._owned = False
            try:
                self._stream.close()
                if self._place is not None and not self.failed and not self._abandoned:
                    self._place[0].replace(self._place[1])
            except OSError as error:
                raise self._error(error) from error
            finally:
                if self._place is not None:
                    self._place[0].unlink(missing_ok=True)
        elif not self.failed and not self._stream.closed:
            self.flush()

    def abandon(self) -> None:
        """Do not move the file to its final path when it is closed; a file without a temporary path stays unchanged."""
        self._abandoned = True

    def _error(self, error: Exception) -> CaptureError:
        self.failed = True
        return CaptureError(f"{self.name}: cannot be written: {explain(error)}")


def open_sink(target: str | Path | BinaryIO, *, whole: bool = False) -> ByteSink:
    """Open a `ByteSink` on a path (emptied if it exists), on ``"-"`` (standard output), or on a binary stream.

    A path with the suffix of a compression is compressed. ``whole``: a regular file appears when it is complete.

    Raises `CaptureError` if it cannot be opened.
    """
    if isinstance(target, str) and target == "-":
        return ByteSink(sys.stdout.buffer, "standard output", owned=False)
    if not isinstance(target, (str, Path)):
        return ByteSink(target, stream_name(target), owned=False)
    path, place = Path(target), None
    try:
        if whole and (path.is_file() or not path.exists()):
            # Resolve a symbolic link, so that it keeps pointing to the file with the new contents.
            final = path.resolve()
            path = final.with_name(f".{final.name}.{os.getpid()}.part")
            place = (path, final)
        stream: BinaryIO = path.open("wb", buffering=0)
    except FileNotFoundError as error:
        raise CaptureError(f"{target}: cannot be written: there is no folder {Path(target).parent}") from error
    except (OSError, ValueError) as error:
        raise CaptureError(f"{target}: cannot be written: {explain(error)}") from error
    compression = compression_of(target)
    if compression is not None:
        stream = compressing(stream, compression)
    return ByteSink(stream, str(target), owned=True, place=place)


def same_file(source: str | Path | BinaryIO, target: str | Path | BinaryIO) -> bool:
    """Return whether both are the same regular file, by any names, or as standard input and output."""
    first = _identity(source, sys.stdin)
    return first is not None and first == _identity(target, sys.stdout)


def _identity(place: str | Path | BinaryIO, standard: IO[str]) -> tuple[int, int] | None:
    try:
        if isinstance(place, str) and place == "-":
            status = os.fstat(standard.fileno())
        else:
            status = Path(place).stat() if isinstance(place, (str, Path)) else os.fstat(place.fileno())
    except (OSError, ValueError, AttributeError):
        return None
    return (status.st_dev, status.st_ino) if stat.S_ISREG(status.st_mode) else None
