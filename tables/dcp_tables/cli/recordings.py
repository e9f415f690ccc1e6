"""Shared parts of the subcommands for many recordings: ``table`` and ``report``."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from dcp_codec.capture.reader import counted
from dcp_codec.cli.common import MALFORMED, load_codec, malformed_note, no_beacons_note, note, progress_bar
from dcp_codec.common.commandline import UNUSABLE, ExpectedError
from dcp_codec.common.extras import REQUIREMENTS, advice

if TYPE_CHECKING:
    from dcp_tables.table.job import Outcome


def check_input(files: Sequence[str], profile: str) -> None:
    """Refuse unusable arguments: standard input twice or among other files, an unknown profile."""
    if "-" in files and (len(files) > 1 or profile == "auto"):
        raise ExpectedError("a pipe is read once and alone: give - as the only FILE, and name the --profile of it")
    if profile != "auto":
        # Report a wrong name once, and before any work starts.
        load_codec(profile)


@contextmanager
def extras() -> Iterator[None]:
    """Report which extra to install if a package is missing, and that the decoder is being compiled."""
    try:
        from dcp_tables.table.kernel.jit import announcing

        with announcing(note):
            yield
    except ImportError as error:
        package = (error.name or "").partition(".")[0]
        raise ExpectedError(advice(package) if package in REQUIREMENTS else str(error)) from None


def need_duckdb() -> None:
    """Refuse early if DuckDB is not installed: it is needed only after compiling and decoding, which take time."""
    with extras():
        if importlib.util.find_spec("duckdb") is None:
            raise ModuleNotFoundError("No module named 'duckdb'", name="duckdb")


def tell(outcome: Outcome) -> int:
    """Report the messages about one recording; return its exit status."""
    name, status = outcome.path, 0
    if outcome.failure is not None:
        note(outcome.failure)
        return UNUSABLE
    for text in outcome.notes:
        note(f"{name}: {text}")
    if outcome.malformed:
        malformed_note(name, outcome.malformed, outcome.frames - outcome.other)
        status = MALFORMED
    if outcome.link is not None:
        no_beacons_note(name, outcome.frames, outcome.others, outcome.link)
    for text in outcome.problems:
        note(f"{name}: {text}")
        status = UNUSABLE
    return status


@contextmanager
def octets_progress(recordings: Sequence[str]) -> Iterator[Callable[[int], object]]:
    """Show one progress bar over all recordings, on a terminal."""
    if not sys.stderr.isatty():
        yield lambda _octets: None
        return
    size = sum(Path(path).stat().st_size for path in recordings if Path(path).is_file())
    with progress_bar(counted(len(recordings), "recording"), size or None) as update:
        yield lambda octets: update(advance=octets)
