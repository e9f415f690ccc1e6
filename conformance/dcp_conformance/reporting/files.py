"""The files of a report: ``results.json``, ``junit.xml``, ``report.html`` and the recordings of the cases."""

from __future__ import annotations

from pathlib import Path

import msgspec
from dcp_spec.profile.loading import ProfileError, profile_names

from dcp_codec.codec import Codec
from dcp_codec.common.atomic_write import write_whole
from dcp_conformance.errors import UsageError
from dcp_conformance.model.results import SCHEMA, RunResult

RESULTS = "results.json"


def write_report(run: RunResult, directory: Path, codec: Codec | None = None) -> Path:
    """Write all files into ``directory``, which is made if it is not there; the path of the page.

    ``codec`` takes the frames apart that the page shows; by default that of the profile the run names. Files of an
    earlier report are replaced, each at once. Raises :class:`UsageError` if that cannot be done.
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
    """Have the folder of a report before there is anything to lose. Raises :class:`UsageError` if that cannot be."""
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        why = "is there, and is no folder" if isinstance(error, FileExistsError) else error.strerror or error
        raise UsageError(f"{error.filename or directory}: cannot be written: {why}") from None


def load_results(path: Path) -> RunResult:
    """Read a ``results.json``, or the one in a folder. Raises :class:`UsageError` that says what is wrong with it."""
    file = path / RESULTS if path.is_dir() else path
    try:
        octets = file.read_bytes()
    except OSError as error:
        raise UsageError(f"{file}: cannot be read: {error.strerror or error}") from None
    try:
        run = msgspec.json.decode(octets, type=RunResult)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise UsageError(f"{file}: no results of dcp-conformance: {error}") from None
    if run.schema != SCHEMA:
        raise UsageError(f"{file}: follows {run.schema!r}, which this version does not know; it knows {SCHEMA!r}")
    return run


def codec_of(run: RunResult) -> Codec | None:
    """The codec of the built-in profile that a run names, None if there is none.

    Results are data: a path in them is not opened.
    """
    if run.profile not in profile_names():
        return None
    try:
        return Codec(run.profile)
    except ProfileError:
        return None
