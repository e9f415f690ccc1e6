"""The files of a report: ``interop.json``, its schema, ``junit.xml``, ``interop.md``, ``interop.html``, ``failed/``."""

from __future__ import annotations

import re
from pathlib import Path

import msgspec
from dcp_conformance.definitions.input_files import load_file
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.errors import UsageError
from dcp_conformance.reporting.junit import Entry, file_of

from dcp_codec.common.atomic_write import write_whole
from dcp_lab.interop.results import SCHEMA, MatrixResult

from .markdown import markdown

NAME = "interop.json"


def load_matrix(path: Path) -> MatrixResult:
    """Read ``interop.json``, or the one in a folder. Raises ``UsageError``."""
    path = path / NAME if path.is_dir() else path
    found = load_file(path, MatrixResult, what="the result of dcp-conformance interop")
    if found.schema != SCHEMA:
        raise UsageError(f"{path}: has the schema {found.schema!r}, expected {SCHEMA!r}")
    return found


def write_reports(matrix: MatrixResult, folder: Path) -> Path:
    """Write all reports into a folder; returns the page. Raises ``OSError``."""
    from .page import render

    folder.mkdir(parents=True, exist_ok=True)
    write_whole(folder / NAME, msgspec.json.format(msgspec.json.encode(matrix), indent=1))
    schema = {"title": SCHEMA, **msgspec.json.schema(MatrixResult)}
    write_whole(folder / "interop.schema.json", msgspec.json.format(msgspec.json.encode(schema), indent=1))
    write_whole(folder / "junit.xml", junit_xml(matrix))
    write_whole(folder / "interop.md", markdown(matrix).encode())
    for cell in matrix.cells:
        if cell.verdict in (Verdict.FAIL, Verdict.ERROR):
            (folder / "failed").mkdir(exist_ok=True)
            name = re.sub(r"[^A-Za-z0-9._@+=-]", "_", f"{cell.a}-{cell.b}-{cell.test}-{cell.seed}")
            write_whole(folder / "failed" / f"{name}.json", msgspec.json.format(msgspec.json.encode(cell), indent=1))
    page = folder / "interop.html"
    write_whole(page, render(matrix).encode())
    return page


def junit_xml(matrix: MatrixResult) -> bytes:
    """Return the results as JUnit XML: one suite for each pair of implementations, one test case for each cell."""
    suites: dict[str, list[Entry]] = {}
    for cell in matrix.cells:
        entry = Entry(cell.test, f"dcp.interop.{cell.a}.{cell.b}", cell.elapsed_s, cell)
        suites.setdefault(f"{cell.a} with {cell.b}", []).append(entry)
    return file_of("dcp-conformance interop", suites)
