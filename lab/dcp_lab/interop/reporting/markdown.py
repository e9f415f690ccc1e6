"""``interop.md``: the matrix for terminals, wikis and pull requests."""

from __future__ import annotations

from collections import Counter

from dcp_conformance.definitions.verdict import Verdict
from dcp_spec.markdown import table

from dcp_lab.interop.results import MatrixResult


def markdown(matrix: MatrixResult) -> str:
    """One table of pairs with their counts, and a list of everything that did not pass or apply."""
    columns = matrix.implementations_of("b")
    counts: dict[tuple[str, str], Counter[Verdict]] = {}
    for cell in matrix.cells:
        counts.setdefault((cell.a, cell.b), Counter())[cell.verdict] += 1
    lines = ["# Interoperability of DCP implementations", "", f"{_total(matrix)}.", ""]
    if matrix.incomplete:
        lines += [f"**{' '.join(matrix.incomplete.split())}.**", ""]
    pairs = ([f"**{a}**", *(_summary(counts.get((a, b))) for b in columns)] for a in matrix.implementations_of("a"))
    lines.append(table(("A \\ B", *columns), pairs))
    if declared := matrix.declared():
        lines += ["", "Profiles declare these deviations from the specification; no cell fails because of them.", ""]
        lines.append(table(("implementation", "requirement", "deviation"), declared))
    bad = [cell for cell in matrix.cells if cell.verdict not in (Verdict.PASS, Verdict.NOT_APPLICABLE)]
    if bad:
        cells = ((each.a, each.b, each.test, each.verdict, each.reason[:400]) for each in bad)
        lines += ["", table(("A", "B", "test", "verdict", "reason"), cells)]
    return "\n".join(lines) + "\n"


def _total(matrix: MatrixResult) -> str:
    counts = matrix.counts()
    told = ", ".join(f"{number} {name.replace('-', ' ')}" for name, number in sorted(counts.items()))
    return f"{len(matrix.cells)} cells in {matrix.elapsed_s:g} s: {told or 'none'}"


def _summary(counts: Counter[Verdict] | None) -> str:
    if not counts:
        return ""
    applied = sum(number for verdict, number in counts.items() if verdict is not Verdict.NOT_APPLICABLE)
    if not applied:
        return "n/a"
    text = f"{counts[Verdict.PASS]} of {applied} pass"
    return text if counts[Verdict.PASS] == applied else f"**{text}**"
