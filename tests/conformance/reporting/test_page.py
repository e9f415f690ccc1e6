"""``report.html``: what comes first, what is explained, and what is shown once only."""

from __future__ import annotations

import re

import msgspec
import pytest
from dcp_conformance.definitions.results import Check, Mark, RunResult
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.reporting.page import render
from dcp_conformance.reporting.references import requirement_links, section_link
from dcp_conformance.reporting.to_declare import to_declare
from dcp_spec.catalogue.readings import readings
from dcp_spec.catalogue.requirements import requirements
from dcp_spec.constants import SpecVersion

from .test_reporting import a_case, a_run_of, links_of

HANGS = "15 records; but VARDISPAR_MAX_REPETITIONS was taken to be 15: state its value (pixit.max_repetitions)"


def a_failed_run() -> RunResult:
    undecided = a_case(Verdict.INCONCLUSIVE, "TC_VD_Y_BV_01")
    check = msgspec.structs.replace(undecided.checks[0], observed=HANGS)
    undecided = msgspec.structs.replace(undecided, checks=(check,))
    read = msgspec.structs.replace(a_case(Verdict.PASS, "TC_VD_Z_BV_01"), readings={"X02": "length-field", "H1": "yes"})
    return a_run_of(a_case(Verdict.FAIL), undecided, read, notes=["a note"])


def test_the_most_important_sections_come_first() -> None:
    page = render(a_failed_run(), None)
    places = [page.index(each) for each in (
        'class="headline"', 'class="tiles"', 'class="toc"', 'id="failing"', 'id="pics"', 'id="requirements"',
        'id="findings"', 'id="readings"', 'id="notes"', 'id="by-section1"', 'id="cases"',
    )]  # fmt: skip
    assert places == sorted(places)


def test_the_table_of_contents_lists_the_present_sections_in_order() -> None:
    for run in (a_failed_run(), a_run_of(a_case(Verdict.PASS)), a_run_of()):
        page = render(run, None)
        [nav] = re.findall(r'<nav class="toc".*?</nav>', page)
        listed = re.findall(r'href="#([^"]*)"', nav)
        assert listed == [each for each in re.findall(r'<h2 id="([^"]*)"', page) if each != "by-section2"]
        assert "<h2>" not in page


def test_one_failing_requirement_is_a_table() -> None:
    page = render(a_run_of(a_case(Verdict.FAIL)), None)
    section = page[page.index('id="failing"') : page.index('id="requirements"')]
    assert "VD-TYP-01" in section
    assert "One fault can fail many cases" not in section


def test_a_requirement_leads_to_its_sentence_in_the_specification() -> None:
    page = render(a_run_of(a_case(Verdict.FAIL)), None)
    address = requirement_links("2.0")["VD-TYP-01"]
    assert re.fullmatch(
        r"https://github\.com/awillig/dcp-vardis/blob/[0-9a-f]{40}/.*/dcp-vardis\.md\?plain=1#L\d+", address
    )
    assert address in links_of(page).links


@pytest.mark.parametrize("version", [str(each) for each in SpecVersion])
def test_every_requirement_with_a_sentence_has_an_address(version: str) -> None:
    assert requirement_links(version).keys() >= {name for name, each in requirements().items() if not each.derived}


def test_every_section_of_a_reading_has_an_address() -> None:
    sections = [each for reading in readings().values() for each in reading.sections]
    assert all(section_link(each) for each in sections)
    assert sum("#L" in section_link(each) for each in sections) > 0.9 * len(sections)
    assert section_link("our own idea") == ""


def test_readings_and_hazards_are_explained_where_they_are_shown() -> None:
    page = render(a_failed_run(), None)
    section = page[page.index('id="readings"') : page.index('id="notes"')]
    for name in ("X02", "H1"):
        entry = readings()[name]
        assert entry.title in section
        assert entry.problem.split(",")[0][:40] in section
        assert section_link(entry.sections[0]).replace("&", "&amp;") in section


def test_the_page_names_missing_statements_of_the_pics() -> None:
    run = a_failed_run()
    assert [(each.key, each.cases) for each in to_declare(run.cases)] == [("pixit.max_repetitions", ("TC_VD_Y_BV_01",))]
    page = render(run, None)
    assert "[pixit] max_repetitions" in page
    assert "What is VARDISPAR_MAX_REPETITIONS?" in page
    passed = msgspec.structs.replace(a_case(Verdict.PASS), checks=(Check(Verdict.PASS, (), "x", HANGS),))
    assert to_declare([passed]) == []
    assert 'id="pics"' not in render(a_run_of(passed), None)


def test_a_frame_is_dissected_once_with_the_octets_of_all_checks_marked() -> None:
    case = a_case(Verdict.FAIL)
    checks = tuple(
        Check(Verdict.FAIL, ("VD-TYP-01",), f"expectation {number}", "other", (Mark(1, 14 + number, 1),))
        for number in range(4)
    )
    page = render(a_run_of(msgspec.structs.replace(case, checks=checks)), None)
    assert page.count("<h3>Frame 1 ") == 1
    assert page.count("frame 1, shown above") == 3
    assert page.count('class="bad">01</td>') == 4
    assert all(f"expectation {number}" in page for number in range(4))


def test_observations_are_labelled_observed_everywhere() -> None:
    page = render(a_run_of(*(a_case(verdict, f"TC_VD_{n}_BV_01") for n, verdict in enumerate(Verdict))), None)
    assert "<dt>observed</dt>" in page
    assert "<dt>instead</dt>" not in page


def test_addresses_of_stations_stay_on_one_line() -> None:
    page = render(a_run_of(a_case(Verdict.FAIL)), None)
    assert re.search(r"\.time td:nth-child\(-n\+4\) \{ white-space: nowrap; \}", page)
