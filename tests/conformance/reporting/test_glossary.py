"""The glossary of the report: the terms of the page, with the definitions of ``docs/glossary.md``."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.reporting.glossary import terms
from dcp_conformance.reporting.merge import render_matrix
from dcp_conformance.reporting.page import render

from .test_page import a_failed_run
from .test_reporting import a_case, a_run_of, links_of

DOCUMENT = Path(__file__).parents[3] / "docs" / "glossary.md"


@pytest.mark.parametrize("key", terms())
def test_the_document_has_the_same_definition(key: str) -> None:
    term = terms()[key]
    text = " ".join(re.sub(r"[*`]", "", DOCUMENT.read_text()).split())
    assert f"{term.name}: {term.text}" in text


def test_terms_of_the_page_are_explained_and_linked() -> None:
    page = render(a_failed_run(), None)
    listed = re.findall(r'<dt id="g-([^"]*)">', page)
    assert {"dcp", "bp", "srp", "vardis", "sut", "upper-tester", "pics", "pixit", "reading", "hazard"} <= set(listed)
    assert {"rule", "occasion"}.isdisjoint(listed)
    used = {link.removeprefix("#g-") for link in links_of(page).links if link.startswith("#g-")}
    assert used <= set(listed)
    assert {"dcp", "bp", "srp", "vardis", "sut", "upper-tester", "pics", "pixit", "reading", "hazard"} <= used


def test_abbreviations_are_expanded_where_they_first_appear() -> None:
    body = render(a_failed_run(), None).partition('<main id="main">')[2]
    # Links in the table of contents name sections; the sections expand the abbreviations.
    body = re.sub(r'<nav class="toc".*?</nav>', "", body)
    text = " ".join(re.sub(r"<[^>]*>", " ", re.sub(r"<h[12].*?</h[12]>", "", body)).split())
    for short, expanded in {
        "DCP": "Drone Coordination Protocol",
        "BP": "Beaconing Protocol",
        "SRP": "State Reporting Protocol",
        "VarDis": "Variable Dissemination Protocol",
        "SUT": "system under test",
        "PICS": "protocol implementation conformance statement",
        "PIXIT": "extra information for testing",
    }.items():
        first = re.search(rf"\b{short}\b", text)
        assert first is not None, short
        assert expanded in text[max(0, first.start() - 60) : first.start() + 100], short


def test_a_page_of_several_runs_has_a_glossary() -> None:
    page = render_matrix([a_run_of(a_case(Verdict.PASS)), a_run_of(a_case(Verdict.FAIL))])
    assert re.findall(r'<dt id="g-([^"]*)">', page)[:4] == ["dcp", "bp", "srp", "vardis"]
    assert {link for link in links_of(page).links if link.startswith("#")} <= {
        f"#{each}" for each in links_of(page).ids
    }
