"""``junit.xml``: one suite for each pair of implementations, one test case for each cell."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence

from dcp_conformance.interop.results import CellResult, MatrixResult
from dcp_conformance.model.verdict import Verdict
from dcp_conformance.reporting.junit import file_of

_OUTCOMES = {Verdict.FAIL: "failure", Verdict.ERROR: "error"}


def junit_xml(matrix: MatrixResult) -> bytes:
    """Verdicts other than pass, fail and error are skipped test cases with their reason."""
    root = ET.Element("testsuites", _counts(matrix.cells) | {"name": "dcp-conformance interop"})
    pairs = dict.fromkeys((cell.a, cell.b) for cell in matrix.cells)
    for a, b in pairs:
        cells = [cell for cell in matrix.cells if (cell.a, cell.b) == (a, b)]
        suite = ET.SubElement(root, "testsuite", _counts(cells) | {"name": f"{a} with {b}"})
        for cell in cells:
            _add(suite, cell)
    return file_of(root)


def _add(suite: ET.Element, cell: CellResult) -> None:
    about = {"name": cell.test, "classname": f"dcp.interop.{cell.a}.{cell.b}", "time": f"{cell.elapsed_s:.3f}"}
    element = ET.SubElement(suite, "testcase", about)
    if cell.verdict is Verdict.PASS:
        return
    outcome = _outcome(cell)
    detail = ET.SubElement(element, outcome, {"message": f"{cell.verdict}: {cell.reason}"})
    if outcome != "skipped":
        lines = [f"expected: {each.expected}\ninstead: {each.observed}" for each in cell.checks if _bad(each.verdict)]
        detail.text = "\n".join([*lines, f"again: {cell.rerun}", cell.error_detail]).strip()


def _outcome(cell: CellResult) -> str:
    return _OUTCOMES.get(cell.verdict, "skipped")


def _bad(verdict: Verdict) -> bool:
    return verdict in _OUTCOMES


def _counts(cells: Sequence[CellResult] | Iterable[CellResult]) -> dict[str, str]:
    cells = list(cells)
    return {
        "tests": str(len(cells)),
        "failures": str(sum(cell.verdict is Verdict.FAIL for cell in cells)),
        "errors": str(sum(cell.verdict is Verdict.ERROR for cell in cells)),
        "skipped": str(sum(cell.verdict is not Verdict.PASS and not _bad(cell.verdict) for cell in cells)),
        "time": f"{sum(cell.elapsed_s for cell in cells):.3f}",
    }
