"""Conversion from one capture format to another."""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import BinaryIO, Literal, cast

import msgspec

from .bytesink import same_file
from .frame import CaptureError, CaptureProblem
from .opening import create_capture, open_capture
from .writer import MessageSource, Metadata

#: Frames between two reports of progress.
_STRIDE = 1024


class ConvertReport(msgspec.Struct, frozen=True):
    """Result of a conversion."""

    #: Number of frames that were read and written.
    frames: int
    #: Problems of the source, as in `CaptureReader.problems`.
    problems: tuple[CaptureProblem, ...]
    #: "pcap", "pcapng" or "mcap".
    source_format: str
    target_format: str


def convert(
    source: str | Path | BinaryIO,
    target: str | Path | BinaryIO,
    *,
    format: str | None = None,
    resolution: Literal["ns", "us"] = "ns",
    metadata: Metadata | None = None,
    messages: MessageSource | None = None,
    attach_source: bool = False,
    compression: Literal["zstd", "lz4", "none"] = "zstd",
    lossy: bool = False,
    progress: Callable[[int, int | None], object] | None = None,
) -> ConvertReport:
    """Write the frames of `source` to `target` with their times, octets, lengths and interfaces unchanged.

    Options are those of `create_capture`. The metadata of the source is copied as far as the format can hold it;
    `metadata` is added and takes precedence. `attach_source` puts the source itself, byte for byte, into an MCAP
    target. `progress` is called from time to time and at the end, with the number of octets read and the size in octets
    (None for pipes).

    A target that is a file appears when it is complete: if a frame cannot be written, or the conversion is interrupted,
    an earlier file stays. If the source is cut off or damaged, the target holds the frames before the damage, and the
    report has a problem. Raises `CaptureError` also if both are the same file.
    """
    if same_file(source, target):
        raise CaptureError(f"{target}: source and target are the same file")
    attachment = None
    if attach_source:
        if not isinstance(source, (str, Path)) or source == "-":
            raise CaptureError("a source that is not a file cannot be attached")
        attachment = Path(source)
    with open_capture(source) as reader:
        # Looked up while it fills: the source may have metadata anywhere, also at its end.
        about = ChainMap(*(cast("dict[str, Mapping[str, str]]", each) for each in (metadata or {}, reader.metadata)))
        with create_capture(
            target,
            format=format,
            resolution=resolution,
            metadata=about,
            messages=messages,
            attachment=attachment,
            compression=compression,
            lossy=lossy,
            whole=True,
        ) as writer:
            for frame in reader:
                writer.write(frame)
                if progress is not None and writer.frames_written % _STRIDE == 0:
                    progress(reader.position, reader.size)
        if progress is not None:
            progress(reader.position, reader.size)
        return ConvertReport(writer.frames_written, tuple(reader.problems), reader.format, writer.format)
