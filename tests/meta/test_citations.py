"""Requirement ids in code and tests exist."""

from __future__ import annotations

from pathlib import Path

import pytest
from dcp_conformance.traceability import CODE, TESTS, cited, marked, sources
from dcp_spec.catalogue.requirements import requirements

ROOT = Path(__file__).parents[2]


def test_cited_requirements_exist():
    unknown = {}
    for path in sources(ROOT, *CODE, "conformance", TESTS):
        text = path.read_text(encoding="utf-8")
        if wrong := (cited(text) | marked(text)) - requirements().keys():
            unknown[str(path.relative_to(ROOT))] = wrong
    assert unknown == {}


def test_the_schema_cites_requirements():
    schema = [ROOT / "spec" / "dcp_spec" / "wire" / name for name in ("bp.py", "srp.py", "vardis.py")]
    assert sum(len(cited(path.read_text(encoding="utf-8"))) for path in schema) > 25


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("    ##= BP-RX-15\n    ##= DATA-01 | exception: none\n", {"BP-RX-15", "DATA-01"}),
        ('rule = Rule("VD-IC-03", "UWB-02")', {"VD-IC-03", "UWB-02"}),
        ("# BP-RX-15 in a comment, X34 and 'VD-IC-03'", set()),
    ],
)
def test_forms_of_citations(text, found):
    assert cited(text) == found


def test_forms_of_markers():
    text = '@pytest.mark.req("BP-RX-01", "VD-IC-03")\nparam(1, marks=pytest.mark.req("DATA-02"))\n'
    assert marked(text) == {"BP-RX-01", "VD-IC-03", "DATA-02"}
