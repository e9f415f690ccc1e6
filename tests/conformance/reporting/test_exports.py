"""Requirements as a table, the summary on one page, and the badge."""

from __future__ import annotations

import csv
import io
from xml.etree import ElementTree

import msgspec
import pytest
from dcp_conformance.definitions.results import CaseResult, Check, RunResult, Sut
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.reporting.exports import badge, requirements_csv, requirements_markdown, rows, summary_markdown

HOSTILE = "=cmd|'/c calc'!A1"


def run_with(**verdicts: Verdict) -> RunResult:
    found = {name.replace("_", "-"): verdict for name, verdict in verdicts.items()}
    return RunResult(
        spec_version="2.0",
        profile="dcp-2.0",
        sut=Sut(name="drone", link="eth:uwb0"),
        requirements=found,
        cases=tuple(
            CaseResult(
                id=f"TC_{name}",
                purpose="",
                section="dcp-vardis.md: receive",
                kind="BV",
                requirements=(name,),
                verdict=verdict,
                checks=(Check(verdict, (name,), HOSTILE, "<script>"),),
            )
            for name, verdict in found.items()
        ),
    )


RUN = run_with(VD_RU_03=Verdict.FAIL, BP_HDR_01=Verdict.PASS)


def test_rows_are_in_the_order_of_the_catalogue_with_reasons() -> None:
    first, second = rows(RUN)
    assert (first.requirement, first.verdict, first.why) == ("BP-HDR-01", "pass", "")
    assert (second.requirement, second.verdict, second.cases) == ("VD-RU-03", "fail", "TC_VD-RU-03")
    assert second.why == f"expected {HOSTILE}; observed <script>"
    assert second.document == "dcp-vardis.md"


def test_the_csv_has_no_formula() -> None:
    run = msgspec.structs.replace(RUN, requirements={HOSTILE: Verdict.PASS})
    table = list(csv.reader(io.StringIO(requirements_csv(run))))
    assert table[0][:2] == ["requirement", "verdict"]
    assert table[1][0] == f"'{HOSTILE}"


@pytest.mark.parametrize("make", [requirements_markdown, summary_markdown])
def test_markdown_escapes_foreign_text(make) -> None:
    text = make(msgspec.structs.replace(RUN, sut=Sut(name="<b>[x](y)|", link="eth:uwb0")))
    assert "VD-RU-03" in text
    assert "<script>" not in text
    assert "<b>[" not in text


def test_the_summary_begins_with_the_main_result() -> None:
    lines = summary_markdown(RUN).splitlines()
    assert lines[0] == "# drone: conformance to DCP 2.0"
    assert lines[2] == "1 requirement passes, 1 fails."
    assert "| dcp-vardis.md | 1 | 1 | - | - | - | - |" in lines


@pytest.mark.parametrize(
    ("run", "text"),
    [
        (RUN, "DCP 2.0: 1 requirement fails"),
        (run_with(BP_HDR_01=Verdict.PASS, BP_HDR_02=Verdict.PASS), "DCP 2.0: 2 requirements pass"),
        (run_with(), "DCP 2.0: no requirement decided"),
        (msgspec.structs.replace(RUN, spec_version='"><script>'), 'DCP "><script>: 1 requirement fails'),
    ],
)
def test_the_badge_is_an_image_with_the_result(run: RunResult, text: str) -> None:
    root = ElementTree.fromstring(badge(run))
    assert root.attrib["aria-label"] == text
    assert "".join(each.text or "" for each in root.iter("{http://www.w3.org/2000/svg}text")) == text.replace(
        ": ", "", 1
    )
