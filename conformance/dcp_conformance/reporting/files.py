"""Write and read the files of a report: ``results.json``, ``junit.xml``, ``report.html``, recordings of the cases."""

from __future__ import annotations

from pathlib import Path

import msgspec
from dcp_spec.profile.loading import ProfileError, profile_names

from dcp_codec.codec import Codec
from dcp_codec.common.atomic_write import write_whole
from dcp_conformance.definitions.input_files import load_file
from dcp_conformance.definitions.results import SCHEMA, RunResult
from dcp_conformance.errors import UsageError

RESULTS = "results.json"


def write_report(run: RunResult, directory: Path, codec: Codec | None = None) -> Path:
    """Write all files into ``directory``, which is created if necessary. Returns the path of the HTML page.

    ``codec`` dissects the frames on the page; the default is the codec of the built-in profile that the run names.
    Each file of an earlier report is replaced atomically. Raises :class:`UsageError` if a file cannot be written.
    """
    from .junit import junit_xml
    from .page import render
    from .recordings import write_recordings

    make_folder(directory)
    try:
        run = write_recordings(run, directory)
        write_whole(directory / RESULTS, msgspec.json.format(msgspec.json.encode(run), indent=1))
        write_whole(directory / "junit.xml", junit_xml(run))
        page = directory / "report.html"
        write_whole(page, render(run, codec or codec_of(run)).encode())
    except OSError as error:
        raise UsageError(f"{error.filename or directory}: cannot be written: {error.strerror or error}") from None
    return page


def make_folder(directory: Path) -> None:
    """Create the folder of a report, before the run starts. Raises :class:`UsageError` if it cannot be created."""
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        why = "exists and is not a folder" if isinstance(error, FileExistsError) else error.strerror or error
        raise UsageError(f"{error.filename or directory}: cannot be written: {why}") from None


def load_results(path: Path) -> RunResult:
    """Read results from a file, or from ``results.json`` in a folder.

    Raises :class:`UsageError` if the file cannot be read, is not a result file, or has an unknown schema version.
    """
    file = path / RESULTS if path.is_dir() else path
    run = load_file(file, RunResult, what="a result file of dcp-conformance")
    if run.schema != SCHEMA:
        raise UsageError(f"{file}: follows the schema {run.schema!r}; this version can read {SCHEMA!r} only")
    return run


def codec_of(run: RunResult) -> Codec | None:
    """Return the codec of the built-in profile that a run names; None if it names no built-in profile.

    Profile files are not opened: results are untrusted, and could name any path.
    """
    if run.profile not in profile_names():
        return None
    try:
        return Codec(run.profile)
    except ProfileError:
        return None
