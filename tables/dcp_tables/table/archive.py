"""Convert many recordings to tables: find the files, distribute them to workers, and write the output in one step."""

from __future__ import annotations

import glob
import multiprocessing
import os
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

import msgspec

from dcp_codec.capture import SUFFIXES
from dcp_codec.capture.compressed import without_compression
from dcp_codec.codec import get_codec
from dcp_codec.common.atomic_write import rename_durably, sync_tree
from dcp_codec.common.workers import WorkerLostError, completed

from .job import Advance, Job, Outcome, TableError, run, size_of
from .kernel.jit import COMPILING, LOG, announce
from .kernel.shape import ERRORS, HOLDINGS, Shape
from .writing import Format, fitted, joint_schema, open_writer, write_database

Engine = Literal["local", "dask"]


class Order(msgspec.Struct, frozen=True):
    """The recordings to convert, the output, and the options of the conversion."""

    recordings: tuple[str, ...]
    out: Path
    """File or folder of the output."""
    form: Format
    profile: str = "auto"
    """Name of a profile, a profile file, or "auto" to guess it for each recording."""
    ether_type: int | None = None
    tables: tuple[str, ...] | None = None
    """The tables to write; None: all."""
    jobs: int = 1
    """Number of workers."""
    engine: Engine = "local"
    scheduler: str | None = None
    """Address of a Dask scheduler; None starts a local cluster."""
    force: bool = False
    """Whether to replace existing output."""

    @property
    def single(self) -> bool:
        """Whether a single table is written to one file."""
        return self.form != "duckdb" and self.out.suffix.lower() == f".{self.form}"


def find_recordings(names: Sequence[str]) -> list[str]:
    """Return the recordings that file names, folders and glob patterns denote, without duplicates, in their order.

    Raise TableError for a folder or pattern without recordings. A missing file is reported when it is opened.
    """
    found: dict[str, None] = {}
    for name in names:
        if Path(name).is_dir():
            below = sorted(
                str(path) for path in Path(name).rglob("*") if without_compression(path).suffix.lower() in SUFFIXES
            )
            if not below:
                raise TableError(f"{name}: the folder has no recordings ({', '.join(SUFFIXES)})")
        elif not Path(name).exists() and glob.has_magic(name):
            below = sorted(path for path in glob.glob(name, recursive=True) if Path(path).is_file())  # noqa: PTH207
            if not below:
                raise TableError(f"{name}: no file matches this pattern")
        else:
            below = [name]
        found |= dict.fromkeys(below)
    return list(found)


def make(order: Order, advance: Advance = lambda _octets: None) -> list[Outcome]:
    """Write the tables; return the outcomes in the order of the recordings.

    ``advance`` is called with the number of octets read since its last call. ``order.out`` appears only when it is
    complete; if no recording can be read, it is not written. Raise TableError, and ImportError for an engine or format
    whose package is not installed.
    """
    _check(order)
    try:
        order.out.parent.mkdir(parents=True, exist_ok=True)
        with _temporary_folder(order.out) as folder:
            outcomes = _run(order, _jobs(order, folder), advance)
            if all(outcome.failure is not None for outcome in outcomes):
                return outcomes
            _deliver(order, folder, outcomes)
    except OSError as error:
        raise TableError(f"{order.out}: {error.strerror or error}") from error
    return outcomes


def _check(order: Order) -> None:
    if order.single and (order.tables is None or len(order.tables) != 1):
        raise TableError(f"{order.out}: a file holds one table: name it with --tables, or give a folder")
    if order.profile != "auto" and order.tables is not None:
        known = {table.name for table in Shape(get_codec(order.profile).beacon_plan).tables} | {ERRORS, HOLDINGS}
        for name in order.tables:
            if name not in known:
                raise TableError(f"profile {order.profile} has no table {name}, only {', '.join(sorted(known))}")
    if order.tables is not None and HOLDINGS in order.tables and "-" in order.recordings:
        raise TableError(f"standard input cannot be read twice, as the table {HOLDINGS} needs: name a file")
    if order.form == "duckdb":
        # Report a missing package before decoding anything.
        import_module("duckdb")
    out = order.out
    if out.exists() and not (out.is_file() or out.is_dir()):
        raise TableError(f"{out}: is neither a file nor a folder and cannot be replaced")
    if not out.exists() or order.force:
        return
    if not out.is_dir():
        raise TableError(f"{out}: exists already; --force replaces it")
    if order.form == "duckdb":
        raise TableError(f"{out}: is a folder; a DuckDB database is a file")
    if any(out.iterdir()):
        raise TableError(f"{out}: is not empty; --force replaces it")


@contextmanager
def _temporary_folder(out: Path) -> Iterator[Path]:
    """Provide a temporary folder beside ``out``, so that the output can be renamed into place; delete it on exit."""
    folder = Path(tempfile.mkdtemp(prefix=f".{out.name}.", dir=out.parent))
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _jobs(order: Order, folder: Path) -> list[Job]:
    several = len(order.recordings) > 1
    digits = len(str(len(order.recordings)))
    return [
        Job(
            path=path,
            folder=str(folder / "tables"),
            stem=f"{number:0{digits}}-{Path(path).stem}" if several else None,
            file=path if several else None,
            profile=order.profile,
            ether_type=order.ether_type,
            tables=order.tables,
            form="parquet" if order.single else order.form,
        )
        for number, path in enumerate(order.recordings, start=1)
    ]


# -- workers ------------------------------------------------------------------------------------------------------


def _run(order: Order, jobs: Sequence[Job], advance: Advance) -> list[Outcome]:
    if order.engine == "dask":
        from .cluster import run_on_cluster

        return run_on_cluster(jobs, order.jobs, order.scheduler, advance)
    workers = min(order.jobs, len(jobs))
    jobs = [msgspec.structs.replace(job, threads=_threads(workers)) for job in jobs]
    if workers <= 1:
        return [run(job, advance) for job in jobs]
    context = multiprocessing.get_context("spawn")
    done: Any = context.Value("q", 0)
    compiling: Any = context.Value("b", 0)
    seen, logged = 0, False

    def look() -> None:
        nonlocal seen, logged
        if compiling.value and not logged:
            logged = True
            LOG.info(COMPILING)
        before, seen = seen, int(done.value)
        advance(seen - before)

    # Start with the largest recording: started last, it would occupy one worker alone.
    places = sorted(range(len(jobs)), key=lambda index: -size_of(jobs[index].path))
    begin = partial(_Worker.prepare, done, compiling)
    try:
        results = completed(
            _Worker.work, [jobs[each] for each in places], workers, start="spawn", begin=begin, tick=look
        )
        outcomes = {places[number]: outcome for number, outcome in results}
    except WorkerLostError as error:
        raise TableError(f"{error} Or was a file truncated while it was read?") from None
    return [outcomes[index] for index in range(len(jobs))]


def _threads(workers: int) -> int:
    """Return the number of writing threads for each of ``workers`` processes: 0 if each has only one processor."""
    share = len(os.sched_getaffinity(0)) // workers
    return share if share > 1 else 0


class _Worker:
    """The functions of a process of the pool; ``done`` counts the octets that all processes have read."""

    done: Any = None

    @classmethod
    def prepare(cls, done: Any, compiling: Any) -> None:
        """Initialise a process; ``compiling`` is set to 1 if it has to compile the decoder."""
        cls.done = done
        announce(lambda _: setattr(compiling, "value", 1))

    @classmethod
    def work(cls, job: Job) -> Outcome:
        """Execute one job, and count the octets that it reads."""

        def count(octets: int) -> None:
            with cls.done.get_lock():
                cls.done.value += octets

        return run(job, count)


# -- output -------------------------------------------------------------------------------------------------------


def _deliver(order: Order, folder: Path, outcomes: Sequence[Outcome]) -> None:
    """Combine the files of the workers as the format requires, and rename the result to ``order.out``."""
    parts: dict[str, list[Path]] = {}
    for outcome in outcomes:
        for name, path in outcome.files.items() if outcome.failure is None else ():
            parts.setdefault(name, []).append(Path(path))
    made = folder / "tables"
    if order.form == "duckdb":
        made = folder / "database"
        write_database(made, parts)
    elif order.single:
        made = folder / f"table.{order.form}"
        assert order.tables is not None
        if order.tables[0] not in parts:
            raise TableError(f"{order.out}: no recording has the table {order.tables[0]} in its profile")
        _concatenate(parts[order.tables[0]], made, order.form)
    else:
        for outcome in outcomes:
            for path in outcome.files.values() if outcome.failure is not None else ():
                Path(path).unlink(missing_ok=True)
    _replace(made, order.out)


def _concatenate(parts: Sequence[Path], target: Path, form: Format) -> None:
    """Write the parts of one table to one file, with the columns of all parts."""
    from pyarrow import parquet

    if form == "parquet" and len(parts) == 1:
        parts[0].rename(target)
        return
    files = [parquet.ParquetFile(part) for part in parts]
    schema = joint_schema([file.schema_arrow for file in files])
    writer = open_writer(form, target, schema)
    for file in files:
        for batch in file.iter_batches(1 << 16):
            writer.write(fitted(batch, schema))
        file.close()
    writer.close()


def _replace(made: Path, out: Path) -> None:
    if made.is_dir() and out.exists():
        # A folder cannot be renamed to a file, nor to a folder that is not empty.
        out.rename(made.with_name("replaced"))
    elif out.is_dir():
        raise TableError(f"{out}: is a folder, but the output is a file")
    sync_tree(made)
    rename_durably(made, out)
