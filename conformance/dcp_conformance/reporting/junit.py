"""Write ``junit.xml`` for build servers.

A *failure* is a fault of the implementation, an *error* a fault of the tester.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable

from dcp_codec.common.printable import plain
from dcp_conformance.model.results import CaseResult, RunResult
from dcp_conformance.model.verdict import Verdict

_OUTCOMES = {
    Verdict.FAIL: "failure",
    Verdict.ERROR: "error",
    Verdict.NOT_APPLICABLE: "skipped",
    Verdict.TOO_LITTLE: "skipped",
    Verdict.INCONCLUSIVE: "skipped",
}


def junit_xml(run: RunResult) -> bytes:
    """Return the results as JUnit XML: one test suite for each section, requirements and verdict as properties."""
    counted = [case for case in run.cases if case.counted]
    root = ET.Element("testsuites", _counts(counted) | {"name": f"dcp-conformance {run.profile}"})
    for section in dict.fromkeys(case.section for case in counted):
        cases = [case for case in counted if case.section == section]
        attributes = _counts(cases) | {"name": section, "timestamp": run.started.removesuffix("Z")}
        suite = ET.SubElement(root, "testsuite", attributes)
        for case in cases:
            _add(suite, case)
    return file_of(root)


def file_of(root: ET.Element) -> bytes:
    """Return the contents of an XML file, without characters that XML does not allow."""
    for element in root.iter():
        element.attrib = {name: plain(value) for name, value in element.attrib.items()}
        element.text = plain(element.text, keep="\n\t") if element.text else element.text
    ET.indent(root)
    octets: bytes = ET.tostring(root, encoding="utf-8", xml_declaration=True)
    return octets + b"\n"


def _add(suite: ET.Element, case: CaseResult) -> None:
    name = case.id if case.attempt == 1 else f"{case.id} (attempt {case.attempt})"
    element = ET.SubElement(
        suite, "testcase", {"name": name, "classname": _class_name(case), "time": f"{case.duration:.3f}"}
    )
    properties = ET.SubElement(element, "properties")
    for requirement in case.requirements:
        ET.SubElement(properties, "property", {"name": "requirement", "value": requirement})
    ET.SubElement(properties, "property", {"name": "verdict", "value": str(case.verdict)})
    ET.SubElement(properties, "property", {"name": "purpose", "value": case.purpose})
    outcome = _OUTCOMES.get(case.verdict)
    if outcome is None:
        return
    detail = ET.SubElement(element, outcome, {"message": f"{case.verdict}: {case.reason}"})
    if outcome != "skipped":
        detail.set("type", case.table)
        lines = [
            f"expected: {check.expected}\nobserved: {check.observed}" for check in case.checks if _bad(check.verdict)
        ]
        detail.text = "\n".join([*lines, f"again: {case.rerun}", case.error_detail]).strip()


def _bad(verdict: Verdict) -> bool:
    return verdict in (Verdict.FAIL, Verdict.ERROR)


def _class_name(case: CaseResult) -> str:
    return "dcp." + ".".join(case.id.split("_")[1:3]).lower()


def _counts(cases: Iterable[CaseResult]) -> dict[str, str]:
    cases = list(cases)
    outcomes = [_OUTCOMES.get(case.verdict) for case in cases]
    return {
        "tests": str(len(cases)),
        "failures": str(outcomes.count("failure")),
        "errors": str(outcomes.count("error")),
        "skipped": str(outcomes.count("skipped")),
        "time": f"{sum(case.duration for case in cases):.3f}",
    }
