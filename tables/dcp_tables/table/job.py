"""Convert one recording to one file for each table: the work of a worker in this process, another, or a cluster."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path

import msgspec
from dcp_spec.profile.definition import Link

from dcp_codec.analysis.guess import guess, sample
from dcp_codec.capture import CaptureError, open_capture
from dcp_codec.codec import Codec, get_codec
from dcp_codec.framing.frames import with_ether_type
from dcp_codec.framing.locate import OtherTraffic, locate

from .decoding import Batch, ColumnDecoder, worth_compiling
from .holdings import read_holdings
from .input.sources import Recording
from .kernel.shape import HOLDINGS
from .writing import SUFFIXES, Format, Writer, file_schema, open_writer, with_file

#: Number of frames that are examined to describe the traffic of a recording without beacons.
_EXAMINED = 10_000

Advance = Callable[[int], object]


class TableError(Exception):
    """Tables cannot be made or written; the message is for the user."""


class Job(msgspec.Struct, frozen=True):
    """The conversion of one recording; it can be sent to another process.

    ``profile`` is a name, a profile file, or "auto". ``tables`` are the tables to write, None for all. The files are
    ``folder/TABLE/STEM.SUFFIX``, or ``folder/TABLE.SUFFIX`` if ``stem`` is None. ``file`` is the name of the recording
    in the column ``file``, None for no such column. ``threads`` is the number of threads that write tables during
    decoding; with 0, rows are written after each block, which takes less processor time.
    """

    path: str
    folder: str
    stem: str | None
    file: str | None
    profile: str
    ether_type: int | None
    tables: tuple[str, ...] | None
    form: Format
    threads: int = 0


class Outcome(msgspec.Struct):
    """The outcome of a job. ``failure`` is the reason of a failure; ``notes`` and ``problems`` are for the user."""

    path: str
    profile: str = ""
    notes: list[str] = msgspec.field(default_factory=list)
    problems: list[str] = msgspec.field(default_factory=list)
    failure: str | None = None
    frames: int = 0
    malformed: int = 0
    other: int = 0
    #: Numbers of other frames by EtherType, if the recording has no DCP at all; and the link that was assumed for DCP.
    others: dict[str, int] = msgspec.field(default_factory=dict)
    link: Link | None = None
    rows: dict[str, int] = msgspec.field(default_factory=dict)
    files: dict[str, str] = msgspec.field(default_factory=dict)


def resolve(path: str | Path, profile: str, ether_type: int | None) -> tuple[Codec, Link, str]:
    """Return the codec of a recording, its link, and a description of the guess ("" with a given profile).

    Raise CaptureError and ProfileError.
    """
    if profile != "auto":
        codec = get_codec(profile)
        link = codec.profile.link
        return codec, link if ether_type is None else with_ether_type(link, ether_type), ""
    with open_capture(path) as reader:
        first, _ = sample(reader, ether_type=ether_type)
    found = guess(first, ether_type=ether_type)
    text = f"profile {found}" if found.warning is None else f"profile {found}; {found.warning}"
    return get_codec(found.best.profile.name), found.best.link, text


def run(job: Job, advance: Advance = lambda _octets: None) -> Outcome:
    """Decode one recording into its files. ``advance`` is called with the number of octets read since its last call.

    A recording that cannot be opened is reported in the outcome, not by an exception. Raise OSError if a file cannot be
    written.
    """
    outcome = Outcome(job.path)
    try:
        codec, link, note = resolve(job.path, job.profile, job.ether_type)
        if note:
            outcome.notes.append(note)
        outcome.profile = codec.profile.name
        with Recording(job.path) as recording:
            _write(job, recording, decoder_for(recording, codec, link), outcome, advance)
            outcome.problems += [problem.message for problem in recording.problems]
        if job.tables is not None and HOLDINGS in job.tables:
            _write_holdings(job, codec, link, outcome)
        tell_others(outcome, link)
    except CaptureError as error:
        outcome.failure = str(error)
    return outcome


def decoder_for(recording: Recording, codec: Codec, link: Link) -> ColumnDecoder:
    """Return a decoder for a recording: machine code if that saves time."""
    return ColumnDecoder(codec, link, interpret=not worth_compiling(recording.size))


def batches(
    recording: Recording,
    decoder: ColumnDecoder,
    outcome: Outcome,
    advance: Advance,
    enough: Callable[[], bool] = lambda: False,
) -> Iterator[Batch]:
    """Yield the rows of a recording, and count its frames in ``outcome``; ``advance`` is called as by :func:`run`.

    After the block at whose end ``enough`` is true no more is read.
    """
    position = 0
    for block in recording.blocks():
        for batch in decoder.batches(block):
            outcome.frames += batch.frames
            outcome.malformed += batch.malformed
            outcome.other += batch.other
            yield batch
        advance(block.position - position)
        position = block.position
        if enough():
            break


def _write(job: Job, recording: Recording, decoder: ColumnDecoder, outcome: Outcome, advance: Advance) -> None:
    names = [name for name in decoder.schemas if job.tables is None or name in job.tables]
    schemas = {name: decoder.schemas[name] for name in names}
    if job.file is not None:
        schemas = {name: file_schema(schema) for name, schema in schemas.items()}
    with ExitStack() as stack:
        executor = stack.enter_context(ThreadPoolExecutor(job.threads)) if job.threads else None
        writers: dict[str, Writer] = {}
        for name in names:
            path = _path(job, name)
            writers[name] = open_writer(job.form, path, schemas[name], executor)
            stack.callback(writers[name].close)
            outcome.files[name] = str(path)
            outcome.rows[name] = 0
        for batch in batches(recording, decoder, outcome, advance):
            for name in names:
                rows = batch.tables[name]
                outcome.rows[name] += rows.num_rows
                writers[name].write(rows if job.file is None else with_file(rows, schemas[name], job.file))
        for writer in writers.values():
            writer.flush()


def _write_holdings(job: Job, codec: Codec, link: Link, outcome: Outcome) -> None:
    """Read the recording again, and write the states of its ledger."""
    rows = read_holdings(job.path, codec, link)
    if job.file is not None:
        rows = with_file(rows, file_schema(rows.schema), job.file)
    path = _path(job, HOLDINGS)
    writer = open_writer(job.form, path, rows.schema)
    writer.write(rows)
    writer.close()
    outcome.files[HOLDINGS], outcome.rows[HOLDINGS] = str(path), rows.num_rows


def _path(job: Job, table: str) -> Path:
    """Return the file of a table; its folder exists then."""
    stem = table if job.stem is None else f"{table}/{job.stem}"
    path = Path(job.folder) / f"{stem}{SUFFIXES[job.form]}"
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def size_of(path: str) -> int:
    """Return the size of a recording in octets; 0 if it cannot be read."""
    try:
        return Path(path).stat().st_size
    except OSError:
        return 0


def tell_others(outcome: Outcome, link: Link) -> None:
    """Add the assumed link, and the frames by EtherType, the most frequent first, if a recording has no beacons."""
    if outcome.other < outcome.frames:
        return
    outcome.link = link
    if outcome.path == "-":
        return
    found: dict[str, int] = {}
    with open_capture(outcome.path) as reader:
        for frame in reader:
            framing = locate(frame.data, link)
            if isinstance(framing, OtherTraffic):
                kind = framing.reason if framing.ether_type is None else f"0x{framing.ether_type:04x}"
                found[kind] = found.get(kind, 0) + 1
            if reader.frames_read >= _EXAMINED:
                break
    outcome.others = dict(sorted(found.items(), key=lambda item: -item[1]))
