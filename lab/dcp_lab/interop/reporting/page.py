"""``interop.html``: one self-contained page with links to recordings and logs."""

from __future__ import annotations

import re
from collections import Counter
from typing import Any, Final

from dcp_conformance.definitions.verdict import Verdict
from markupsafe import Markup

from dcp_codec.common import pages
from dcp_lab.interop.results import CellResult, MatrixResult

from .chart import chart

#: Cells up to which those that pass have a chart as well.
_FEW: Final = 250
#: Files that the page links to: only names of files that the runner writes, never addresses of other sites.
_FILE: Final = re.compile(r"cells(/[A-Za-z0-9_@+=-][A-Za-z0-9._@+=-]*)+")
_ORDER: Final = (Verdict.FAIL, Verdict.ERROR, Verdict.INCONCLUSIVE, Verdict.PASS, Verdict.NOT_APPLICABLE)


def render(matrix: MatrixResult) -> str:
    """The page of a matrix."""
    cells = [_cell(cell, number, len(matrix.cells)) for number, cell in enumerate(matrix.cells)]
    by_pair: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for each in cells:
        by_pair.setdefault((each["of"].a, each["of"].b), []).append(each)
    counts = matrix.counts()
    return pages.render(
        __package__,
        "interop.html",
        pages.text("dcp_conformance.reporting", "page.js"),
        matrix=matrix,
        rows=matrix.implementations_of("a"),
        columns=matrix.implementations_of("b"),
        by_pair=by_pair,
        summaries={pair: _summary(found) for pair, found in by_pair.items()},
        counted=[(counts[each], each.replace("-", " "), each) for each in map(str, _ORDER) if counts[each]],
        headline=_headline(counts),
        tests=list(dict.fromkeys(cell.test for cell in matrix.cells)),
        declared=matrix.declared(),
        what={each.name: each for each in matrix.implementations},
    )


def _headline(counts: Counter[str]) -> str:
    bad = counts["fail"] + counts["error"]
    applied = sum(counts.values()) - counts["not-applicable"]
    if not applied:
        return "No test applies to these implementations"
    return f"{counts['pass']} of {applied} cells pass" + (f", {bad} do not" if bad else "")


def _summary(cells: list[dict[str, Any]]) -> dict[str, Any]:
    counts = Counter(str(each["of"].verdict) for each in cells)
    applied = sum(counts.values()) - counts["not-applicable"]
    first = next((each for each in cells if each["failed"]), None) or next(
        (each for each in cells if each["of"].verdict is not Verdict.NOT_APPLICABLE), cells[0]
    )
    return {"first": first["key"], "pass": counts["pass"], "applied": applied, "bad": counts["fail"] + counts["error"]}


def _cell(cell: CellResult, number: int, many: int) -> dict[str, Any]:
    failed = cell.verdict in (Verdict.FAIL, Verdict.ERROR)
    shown = many <= _FEW or cell.verdict is not Verdict.PASS
    slowest = max((each.took for each in cell.spreads if each.took is not None), default=None)
    return {
        "of": cell,
        "key": f"c{number}",
        "failed": failed,
        "slowest": slowest,
        # Made of escaped texts and numbers only.
        "chart": Markup(chart(cell)) if shown else "",  # noqa: S704
        "checks": [each for each in cell.checks if each.verdict is not Verdict.PASS],
        "passed": sum(each.verdict is Verdict.PASS for each in cell.checks),
        "recording": cell.recording if _FILE.fullmatch(cell.recording) else "",
        "stations": [
            {
                "of": each,
                "recording": each.recording if _FILE.fullmatch(each.recording) else "",
                "log": each.log if _FILE.fullmatch(each.log) else "",
            }
            for each in cell.stations
        ],
    }
