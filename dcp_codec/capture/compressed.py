"""Compressed captures: gzip and zstd, read and written as streams in bounded memory."""

from __future__ import annotations

import gzip
import zlib
from pathlib import Path
from typing import Any, BinaryIO, cast

from .bytesource import ByteSource

#: Suffix after that of the format -> compression.
COMPRESSED_SUFFIXES = {".gz": "gzip", ".zst": "zstd", ".zstd": "zstd"}
_GZIP, _ZSTD = b"\x1f\x8b", b"\x28\xb5\x2f\xfd"
#: Compressed octets that are read at once; their content is returned in pieces.
_STEP = 64 * 1024
#: Compressed octets that zstd gets at once: they expand to 64 MiB at most.
_ZSTD_STEP = 2048
#: Decompressed octets per call at most: small input can expand to gigabytes.
_MOST = 1024 * 1024


def decompressed(source: ByteSource) -> ByteSource:
    """Return ``source``, or its decompressed content if it is gzip or zstd.

    The size is then unknown, as that of a pipe. Damage or a cut-off ends the content, and ``failure`` gives the reason.
    """
    start = source.more(0, 4)[:4]
    if start.startswith(_GZIP):
        return ByteSource(cast(BinaryIO, _Inflated(source)), source.name, None, owned=True)
    if start == _ZSTD:
        return ByteSource(cast(BinaryIO, _Unzstd(source)), source.name, None, owned=True)
    return source


class _Expanded:
    """Binary stream for :class:`ByteSource`: the decompressed octets of another source."""

    def __init__(self, source: ByteSource) -> None:
        self._source = source

    def read(self, size: int) -> bytes:
        """Return at least one octet and at most ``size``, none at the end. Raises OSError for damaged data."""
        raise NotImplementedError

    def close(self) -> None:
        """Close the compressed source."""
        self._source.close()

    def _take(self) -> bytes:
        self._source.need(1)
        octets = self._source.take(min(_STEP, max(1, len(self._source.buffer) - self._source.start)))
        if not octets and self._source.failure:
            raise OSError(self._source.failure)
        return octets


class _Inflated(_Expanded):
    """Decompressed members of a gzip file, in succession."""

    def __init__(self, source: ByteSource) -> None:
        super().__init__(source)
        self._member: Any = None
        self._waiting = b""

    def read(self, size: int) -> bytes:
        """See the base class."""
        while True:
            if not self._waiting:
                self._waiting = self._take()
                if not self._waiting:
                    if self._member is not None:
                        raise OSError("its gzip data is cut off")
                    return b""
            if self._member is None:
                # Zeros after the last member are padding in gzip.
                if not self._waiting.strip(b"\0"):
                    self._waiting = b""
                    continue
                self._member = zlib.decompressobj(wbits=31)
            try:
                octets = bytes(self._member.decompress(self._waiting, min(size, _MOST)))
            except zlib.error as error:
                raise OSError(f"its gzip data is damaged ({error})") from None
            if self._member.eof:
                self._waiting, self._member = self._member.unused_data, None
            else:
                self._waiting = self._member.unconsumed_tail
            if octets:
                return octets


class _Unzstd(_Expanded):
    """Decompressed frames of a zstd file, in succession."""

    def __init__(self, source: ByteSource) -> None:
        import zstandard

        super().__init__(source)
        self._errors = zstandard.ZstdError
        self._library = zstandard.ZstdDecompressor()
        self._frame: Any = None
        self._waiting = b""
        self._expanded = b""

    def read(self, size: int) -> bytes:
        """See the base class."""
        while not self._expanded:
            self._waiting = self._waiting or self._take()
            if not self._waiting:
                if self._frame is not None:
                    raise OSError("its zstd data is cut off")
                return b""
            self._frame = self._frame or self._library.decompressobj()
            # The library does not bound the output of one call; four octets can expand to 128 KiB.
            step, self._waiting = self._waiting[:_ZSTD_STEP], self._waiting[_ZSTD_STEP:]
            try:
                self._expanded = self._frame.decompress(step)
            except self._errors as error:
                raise OSError(f"its zstd data is damaged ({error})") from None
            if self._frame.eof:
                self._waiting, self._frame = self._frame.unused_data + self._waiting, None
        octets, self._expanded = self._expanded[:size], self._expanded[size:]
        return octets


def compression_of(name: str | Path) -> str | None:
    """Return the compression that the suffix of a file stands for, None for none."""
    return COMPRESSED_SUFFIXES.get(Path(name).suffix.lower())


def without_compression(name: str | Path) -> Path:
    """Return the name without the suffix of a compression; the suffix of the format precedes it."""
    path = Path(name)
    return path.with_suffix("") if compression_of(path) else path


def compressing(stream: BinaryIO, compression: str) -> BinaryIO:
    """Return a stream that compresses into ``stream`` and closes it at the end."""
    if compression == "gzip":
        return cast(BinaryIO, _Gzip(stream))
    import zstandard

    return cast(BinaryIO, zstandard.ZstdCompressor().stream_writer(stream, write_return_read=True, closefd=True))


class _Gzip(gzip.GzipFile):
    """A gzip file that closes the stream it writes to, and whose octets do not depend on the time."""

    def __init__(self, stream: BinaryIO) -> None:
        super().__init__(fileobj=stream, mode="wb", mtime=0, filename="")
        self._below = stream

    def close(self) -> None:
        """Write the end, and close the stream."""
        try:
            super().close()
        finally:
            self._below.close()
