"""The tables of ``docs/hazards.md`` are those of explorations, and agree with the catalogue."""

from __future__ import annotations

import re

import pytest
from dcp_spec.catalogue.readings import readings

from tools.docs import hazards

pytestmark = pytest.mark.part("suite")


def test_the_page_is_up_to_date():
    page = hazards.PAGE.read_text(encoding="utf-8")
    blocks = hazards.checked()
    assert hazards.filled(page, blocks) == page, "run python -m tools.docs.hazards"
    # The catalogue has the versions in which explorations find a hazard.
    shown = dict(re.findall(r"^\| (H\d+) \| [^|]* \| ([^|]*) \|", blocks["hazards"], re.MULTILINE))
    assert shown == {
        each.id: f"{each.since} to {each.until}" if each.until else f"{each.since} and later"
        for each in readings().values()
        if each.kind == "hazard"
    }
    # Each proposal removes what it is made for.
    removed = {
        name: set(hazards_.split(", "))
        for name, hazards_ in re.findall(r"^\| \*\*([\w-]+)\*\*[^|]*\| ([^|]*) \|", blocks["proposals"], re.MULTILINE)
    }
    assert removed["creation-times"] >= {"H7", "H8"}
    assert removed["deletions"] >= {"H7", "H8", "H10", "H11"}
    assert removed["silent-requests"] == {"H1"}
    assert removed["take-back"] == {"H2"}
    assert removed["first-stays"] == {"H4"}
    assert removed["wider-numbers"] == {"H9"}
    assert removed["restamp"] >= {"H5", "H7", "H12"}
    assert removed["all"] >= {"H1", "H2", "H3", "H5", "H7", "H9", "H10", "H11", "H12"}


def test_the_closed_spaces_are_those_of_the_generator():
    rows = re.findall(r"^\| (\d nodes[^|]*) \| ([^|]*) \|", hazards.PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    assert rows == [(space.bounds, text) for space in hazards.LARGE for text in ("2.0", "1.3", "2.0, all")]
