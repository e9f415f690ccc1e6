"""Writer of a recording as an MCAP file that ROS 2 and its tools play and read (profile ``ros2``, CDR)."""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import IO, Any, BinaryIO

import msgspec
from dcp_spec.profile.definition import Link

from dcp_codec.capture import CaptureError, CaptureProblem, CaptureReader, open_capture
from dcp_codec.codec import Codec
from dcp_codec.common.atomic_write import refuse_irregular

from .content import LAST_SECOND, Content, Message
from .definitions import DEFINITIONS

#: Frames between two reports of progress.
_STRIDE = 1024
_SECOND = 1_000_000_000


class BagReport(msgspec.Struct, frozen=True):
    """Result of the conversion."""

    #: Number of frames that were read.
    frames: int
    #: Messages by topic.
    messages: dict[str, int]
    #: Number of beacons with a problem; their undamaged parts were written.
    damaged: int
    #: Problems of the source, as in `CaptureReader.problems`.
    problems: tuple[CaptureProblem, ...]


def write_bag(
    source: str | Path | BinaryIO,
    target: str | Path | BinaryIO,
    codec: Codec,
    link: Link | None = None,
    *,
    progress: Callable[[int, int | None], object] | None = None,
) -> BagReport:
    """Write the poses, neighbour tables and variables of a recording as ROS 2 messages.

    A path as `target` is replaced when everything is written. `link` replaces the EtherType or UDP port of the profile;
    `progress` is called with the octets read and the size in octets. Raises `CaptureError` for a source that cannot be
    read, a target that cannot be written, and times after 2038, which ROS 2 cannot represent; ImportError without
    mcap-ros2-support.
    """
    with ExitStack() as stack:
        reader = stack.enter_context(open_capture(source))
        if not isinstance(target, str | Path):
            return _write(reader, target, codec, link, progress)
        path = Path(target)
        try:
            refuse_irregular(path)
            folder = stack.enter_context(tempfile.TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent))
            made = Path(folder) / path.name
            with made.open("wb") as stream:
                report = _write(reader, stream, codec, link, progress)
            made.replace(path)
        except OSError as error:
            raise CaptureError(f"{path}: cannot be written: {error.strerror or error}") from error
    return report


def _write(
    reader: CaptureReader,
    stream: IO[bytes],
    codec: Codec,
    link: Link | None,
    progress: Callable[[int, int | None], object] | None,
) -> BagReport:
    from mcap_ros2.writer import Writer

    writer: Any = Writer(stream)
    schemas = {name: writer.register_msgdef(name, text) for name, text in DEFINITIONS.items()}
    content, count, sequence = Content(codec, link), Counter[str](), 0

    def add(message: Message) -> None:
        nonlocal sequence
        sequence = (sequence + 1) % 2**32
        count[message.topic] += 1
        writer.write_message(
            message.topic,
            schemas[message.type],
            message.fields,
            log_time=message.time_ns,
            publish_time=message.time_ns,
            sequence=sequence,
        )

    for frame in reader:
        if frame.time_ns // _SECOND > LAST_SECOND:
            raise CaptureError(f"{reader.name}: frame {frame.number} is later than 2038, which ROS 2 cannot represent")
        for message in content.messages(frame):
            add(message)
        if progress is not None and reader.frames_read % _STRIDE == 0:
            progress(reader.position, reader.size)
    for message in content.end():
        add(message)
    writer.finish()
    if progress is not None:
        progress(reader.position, reader.size)
    return BagReport(reader.frames_read, dict(count), content.damaged, tuple(reader.problems))
