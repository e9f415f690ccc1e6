"""Write ``junit.xml`` for build servers.

A *failure* is a fault of the implementation, an *error* a fault of the tester. A verdict that is neither of them and no
pass is a skipped test case with its reason.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from dcp_codec.common.printable import plain
from dcp_conformance.definitions.results import CaseResult, RunResult
from dcp_conformance.definitions.verdict import Verdict

_OUTCOMES = {
    Verdict.FAIL: "failure",
    Verdict.ERROR: "error",
    Verdict.NOT_APPLICABLE: "skipped",
    Verdict.TOO_LITTLE: "skipped",
    Verdict.INCONCLUSIVE: "skipped",
}


class Entry(NamedTuple):
    """A test case of the file."""

    name: str
    class_name: str
    seconds: float
    result: Any
    """The result of a case, or of a cell of a matrix."""
    kind: str = ""
    """The type of a failure or error."""
    properties: Sequence[tuple[str, str]] = ()


def junit_xml(run: RunResult) -> bytes:
    """Return the results as JUnit XML: one test suite for each section, requirements and verdict as properties."""
    suites: dict[str, list[Entry]] = {}
    for case in run.cases:
        if case.counted:
            suites.setdefault(case.section, []).append(_entry(case))
    return file_of(f"dcp-conformance {run.profile}", suites, {"timestamp": run.started.removesuffix("Z")})


def _entry(case: CaseResult) -> Entry:
    name = case.id if case.attempt == 1 else f"{case.id} (attempt {case.attempt})"
    class_name = "dcp." + ".".join(case.id.split("_")[1:3]).lower()
    properties = [("requirement", each) for each in case.requirements]
    properties += [("verdict", str(case.verdict)), ("purpose", case.purpose)]
    return Entry(name, class_name, case.duration, case, case.table, properties)


def file_of(name: str, suites: Mapping[str, Sequence[Entry]], attributes: Mapping[str, str] = {}) -> bytes:
    """Return the contents of the file, without characters that XML does not allow.

    ``suites``: test cases by the name of their suite. ``attributes``: further attributes of each suite.
    """
    every = [entry for entries in suites.values() for entry in entries]
    root = ET.Element("testsuites", _counts(every) | {"name": name})
    for suite, entries in suites.items():
        inside = ET.SubElement(root, "testsuite", {**_counts(entries), "name": suite, **attributes})
        for entry in entries:
            _add(inside, entry)
    for element in root.iter():
        element.attrib = {name: plain(value) for name, value in element.attrib.items()}
        element.text = plain(element.text, keep="\n\t") if element.text else element.text
    ET.indent(root)
    octets: bytes = ET.tostring(root, encoding="utf-8", xml_declaration=True)
    return octets + b"\n"


def _add(suite: ET.Element, entry: Entry) -> None:
    about = {"name": entry.name, "classname": entry.class_name, "time": f"{entry.seconds:.3f}"}
    element, result = ET.SubElement(suite, "testcase", about), entry.result
    if entry.properties:
        properties = ET.SubElement(element, "properties")
        for name, value in entry.properties:
            ET.SubElement(properties, "property", {"name": name, "value": value})
    outcome = _OUTCOMES.get(result.verdict)
    if outcome is None:
        return
    detail = ET.SubElement(element, outcome, {"message": f"{result.verdict}: {result.reason}"})
    if outcome != "skipped":
        if entry.kind:
            detail.set("type", entry.kind)
        bad = (check for check in result.checks if check.verdict in (Verdict.FAIL, Verdict.ERROR))
        lines = [f"expected: {check.expected}\nobserved: {check.observed}" for check in bad]
        detail.text = "\n".join([*lines, f"again: {result.rerun}", result.error_detail]).strip()


def _counts(entries: Iterable[Entry]) -> dict[str, str]:
    entries = list(entries)
    outcomes = [_OUTCOMES.get(entry.result.verdict) for entry in entries]
    return {
        "tests": str(len(entries)),
        "failures": str(outcomes.count("failure")),
        "errors": str(outcomes.count("error")),
        "skipped": str(outcomes.count("skipped")),
        "time": f"{sum(entry.seconds for entry in entries):.3f}",
    }
