"""Requirement ids in code and tests exist."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import pytest
from dcp_selftest.traceability import CITATION, CODE, TESTS, cited, marked, sources
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
        (
            "    ##= BP-RX-15 VD-IC-03  DATA-01\n    ##= UWB-02 is a citation, VD-IC-04 none\n",
            {"BP-RX-15", "VD-IC-03", "DATA-01", "UWB-02"},
        ),
        ('rule = Rule("VD-IC-03", "UWB-02")', {"VD-IC-03", "UWB-02"}),
        ("# BP-RX-15 in a comment, X34 and 'VD-IC-03'", set()),
    ],
)
def test_forms_of_citations(text, found):
    assert cited(text) == found


def test_citations_in_code_are_complete_and_joined():
    """A line cites as many requirements as fit, or one with a remark."""
    wrong = []
    for path in sources(ROOT, *CODE):
        lines = path.read_text(encoding="utf-8").splitlines()
        for number, (line, following) in enumerate(pairwise([*lines, ""]), 1):
            if "##=" not in line:
                continue
            match = CITATION.fullmatch(line.strip())
            after = CITATION.fullmatch(following.strip())
            joined = match and after and not match[2] and not after[2] and len(f"{line} {after[1]}") <= 120
            if match is None or joined or (match[2] is not None and (" " in match[1] or not match[2])):
                wrong.append(f"{path.relative_to(ROOT)}:{number}")
    assert wrong == []


def test_forms_of_markers():
    text = '@pytest.mark.req("BP-RX-01", "VD-IC-03")\nparam(1, marks=pytest.mark.req("DATA-02"))\n'
    assert marked(text) == {"BP-RX-01", "VD-IC-03", "DATA-02"}
