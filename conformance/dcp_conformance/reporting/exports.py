"""Export results for other documents: requirements as CSV or Markdown, a summary on one page, a badge."""

from __future__ import annotations

import csv
import io
import re
from collections import Counter
from collections.abc import Iterator
from typing import Final, NamedTuple
from xml.sax.saxutils import escape

from dcp_spec.catalogue.requirements import requirements
from dcp_spec.markdown import table

from dcp_codec.common.printable import plain
from dcp_codec.common.spreadsheet import safe_cell
from dcp_conformance.definitions.results import CaseResult, RunResult
from dcp_conformance.definitions.verdict import Verdict

from .overview import certainty, deaths, diagnosed, headline, sentence

#: Colours of a badge. The contrast of each with white text is at least 4.5:1 (WCAG 2 AA).
_GREEN, _RED, _GREY, _DARK = "#1b7a3d", "#b42318", "#5f6670", "#3c434c"
#: Width of a character of a badge in pixels: that of a wide character, because fonts differ.
_CHARACTER: Final = 6.8


class Row(NamedTuple):
    """A requirement and its verdict: a row of the table."""

    requirement: str
    verdict: str
    document: str
    section: str
    step: str
    statement: str
    cases: str
    """Identifiers of the cases that decide the requirement, separated by spaces."""
    why: str
    """The first check with this verdict, if the verdict is not pass or info; otherwise empty."""


def rows(run: RunResult) -> Iterator[Row]:
    """Yield the requirements of a run in the order of the catalogue."""
    known = requirements()
    order = {name: number for number, name in enumerate(known)}
    deciding: dict[str, list[CaseResult]] = {}
    for case in run.cases:
        if case.verdict is Verdict.NOT_APPLICABLE:
            continue
        for name in dict.fromkeys(
            (*case.requirements, *(each for check in case.checks for each in check.requirements))
        ):
            deciding.setdefault(name, []).append(case)
    for name, verdict in sorted(run.requirements.items(), key=lambda each: order.get(each[0], len(order))):
        entry = known.get(name)
        place = (entry.section if entry is not None else "").replace("`", "")
        # A section is named by its anchor ("file#anchor") or by its heading ("file: heading").
        document, section = (*re.split("#|: ", place, maxsplit=1), "")[:2]
        cases = deciding.get(name, [])
        yield Row(
            name,
            str(verdict),
            document,
            section,
            str(entry.step or "") if entry is not None else "",
            entry.statement if entry is not None else "",
            " ".join(case.id for case in cases),
            _why(name, verdict, cases),
        )


def _why(name: str, verdict: Verdict, cases: list[CaseResult]) -> str:
    if verdict.rank <= Verdict.PASS.rank:
        return ""
    checks = (check for case in cases for check in case.checks if check.verdict is verdict)
    check = next((each for each in checks if name in each.requirements), None)
    if check is None:
        return ""
    entry = requirements().get(name)
    expected = "" if entry is not None and entry.statement == check.expected else f"expected {check.expected}; "
    return f"{expected}observed {check.observed}"


def _observed(case: CaseResult) -> str:
    """Return what the first failed check of a case expected and observed."""
    check = next((each for each in case.checks if each.verdict is Verdict.FAIL), None)
    return f"Expected {check.expected}; observed {check.observed}." if check is not None else ""


def requirements_csv(run: RunResult) -> str:
    """Return the requirements as CSV (RFC 4180).

    A cell that a spreadsheet would evaluate as a formula is prefixed with ``'``.
    """
    output = io.StringIO()
    writer = csv.writer(output)
    writer.writerow(Row._fields)
    for row in rows(run):
        writer.writerow([safe_cell(plain(cell)) for cell in row])
    return output.getvalue()


def requirements_markdown(run: RunResult) -> str:
    """Return the requirements as a Markdown table."""
    found: list[tuple[object, ...]] = []
    for row in rows(run):
        section = f"{row.document}: {row.section}" + (f", step {row.step}" if row.step else "")
        count = len(row.cases.split())
        why = f"<br>{_cell(row.why)}" if row.why else ""
        found.append((row.requirement, row.verdict, f"{_cell(row.statement)}{why}", section, count))
    return table(("requirement", "verdict", "statement", "section", "cases"), found, "llllr") + "\n"


def summary_markdown(run: RunResult) -> str:
    """Return a summary in Markdown: headline, numbers of verdicts, diagnosis, failed requirements, and test setup."""
    name = " ".join(filter(None, (run.sut.name, run.sut.version))) or "An implementation of DCP"
    lines = [f"# {_cell(name)}: conformance to DCP {_cell(run.spec_version)}", "", f"{_cell(headline(run))}.", ""]
    counts: dict[str, Counter[str]] = {}
    for case in run.cases:
        if case.counted:
            counts.setdefault(case.section.partition(":")[0], Counter())[str(case.verdict)] += 1
    order = ("pass", "fail", "inconclusive", "error", "info", "not-applicable")
    numbers = ((_cell(section), *(count[each] or "-" for each in order)) for section, count in sorted(counts.items()))
    lines.append(table(("cases", *order), numbers, "l" + "r" * len(order)))
    if run.diagnosis is not None and run.diagnosis.faults:
        lines += ["", "## Diagnosis", "", f"{_cell(diagnosed(run))}.", ""]
        for number, fault in enumerate(run.diagnosis.faults, 1):
            names = ", ".join(fault.requirements)
            text = sentence(fault)
            lines.append(
                f"{number}. {_cell(text[:1].upper() + text[1:])} ({names}). The fault {_cell(certainty(fault))}."
            )
            if not fault.likely and fault.check is not None and fault.check.observed:
                lines.append(f"   Expected {_cell(fault.check.expected)}; observed {_cell(fault.check.observed)}.")
        for death in deaths(run):
            first = death.cases[0].id
            lines += ["", f"In {len(death.cases)} cases, first {first}, the implementation {_cell(death.how)}."]
        if run.diagnosis.unexplained:
            lines += ["", "Unexplained:", ""]
            cases = {case.id: case for case in run.cases}
            for name in run.diagnosis.unexplained:
                lines.append(f"* {name}: {_cell(cases[name].purpose)}. {_cell(_observed(cases[name]))}")
    failing = [row for row in rows(run) if row.verdict in (Verdict.FAIL, Verdict.ERROR)]
    if failing:
        lines += ["", "## Requirements that fail", ""]
        lines += [f"* **{row.requirement}**: {_cell(row.statement)} {_cell(row.why)}" for row in failing]
    upper = f"upper tester {_cell(run.sut.upper_tester)}" if run.sut.upper_tester else "no upper tester"
    lines += [
        "",
        "## How it was tested",
        "",
        f"* wire profile {_cell(run.profile)}, link {_cell(run.sut.link)}, {upper}",
    ]
    lines.append(f"* {_cell(run.tool)}, {_cell(run.started)}, {run.duration:.0f} s")
    if run.command:
        lines.append(f"* `{plain(run.command).replace('`', chr(39))}`")
    return "\n".join(lines) + "\n"


def badge(run: RunResult) -> str:
    """Return a badge in SVG: version of the specification, and number of requirements that fail, or pass if none do."""
    count = Counter(run.requirements.values())
    failed = count[Verdict.FAIL] + count[Verdict.ERROR]
    if failed:
        text, colour = f"{failed} {'requirement fails' if failed == 1 else 'requirements fail'}", _RED
    elif count[Verdict.PASS]:
        text, colour = f"{count[Verdict.PASS]} requirements pass", _GREEN
    else:
        text, colour = "no requirement decided", _GREY
    label = f"DCP {plain(run.spec_version)}"
    left, right = (round(_CHARACTER * len(each)) + 12 for each in (label, text))
    width, name = left + right, escape(f"{label}: {text}", {'"': "&quot;"})
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="20" role="img" aria-label="{name}">'
        f"<title>{name}</title>"
        f'<clipPath id="r"><rect width="{width}" height="20" rx="3"/></clipPath><g clip-path="url(#r)">'
        f'<rect width="{left}" height="20" fill="{_DARK}"/>'
        f'<rect x="{left}" width="{right}" height="20" fill="{colour}"/></g>'
        f'<g fill="#fff" font-family="Verdana,DejaVu Sans,sans-serif" font-size="11" text-anchor="middle">'
        f'<text x="{left / 2:g}" y="14">{escape(label)}</text>'
        f'<text x="{left + right / 2:g}" y="14">{escape(text)}</text></g></svg>\n'
    )


def _cell(text: str) -> str:
    """Escape untrusted text for a line or a table cell of Markdown: no HTML, links or further cells."""
    found = plain(text).replace("\n", " ")
    for sign in "\\`*_[]<>|":
        found = found.replace(sign, f"\\{sign}")
    return found
