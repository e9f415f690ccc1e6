import re
import tomllib
from collections import Counter
from importlib import resources

import pytest
from dcp_spec.catalogue.readings import (
    UnknownReadingError,
    differs_from_reference,
    reading,
    readings,
    with_reference_reading,
)
from dcp_spec.catalogue.requirements import requirements

ENTRIES = list(readings().values())
RAW = tomllib.loads(resources.files("dcp_spec").joinpath("data/readings.toml").read_text())["reading"]


def test_contradictions_and_hazards_are_complete_and_in_order():
    assert [entry["id"] for entry in RAW] == [f"X{n:02}" for n in range(1, 55)] + [f"H{n}" for n in range(1, 14)]
    assert list(readings()) == [entry["id"] for entry in RAW]


def test_each_entry_is_well_formed():
    for entry in ENTRIES:
        assert entry.kind == {"X": "contradiction", "H": "hazard"}[entry.id[0]], entry.id
        assert entry.sections, entry.id
        for place in entry.sections:
            assert re.fullmatch(r"dcp-[a-z-]+\.md(#[a-z][a-z0-9-]+|: \S.*)", place), entry.id
        assert not entry.title.endswith("."), entry.id
        for text in filter(None, (entry.problem, entry.reading, entry.why, entry.implementations)):
            assert text.endswith("."), entry.id
            assert "  " not in text, entry.id
            assert text.count("(") == text.count(")"), entry.id


def test_every_reading_affects_a_requirement():
    cited = {reading_id for each in requirements().values() for reading_id in each.readings}
    assert {entry.id for entry in ENTRIES} <= cited


def test_alternatives_can_be_selected_by_name():
    for entry in [each for each in ENTRIES if each.alternatives]:
        names = [alternative.name for alternative in entry.alternatives]
        assert len(names) >= 2, "a single alternative is not a choice"
        assert [name for name, count in Counter(names).items() if count > 1] == [], entry.id
        for name in names:
            assert re.fullmatch(r"[a-z]+(-[a-z]+)+", name), entry.id
            assert entry.alternative(name).name == name, entry.id
        for alternative in entry.alternatives:
            assert alternative.description[0].isupper() or alternative.description.startswith("summaryQ"), entry.id
            assert alternative.description.endswith("."), entry.id
        assert entry.default is entry.alternatives[0], entry.id


def test_hazards_offer_no_choice():
    # A hazard is what the text does; there is nothing to choose between, only something to report.
    assert [e.id for e in ENTRIES if e.kind == "hazard" and e.alternatives] == []


def test_an_unknown_alternative_is_refused_with_the_known_ones():
    with pytest.raises(ValueError, match="write-then-increment, increment-then-write"):
        reading("X03").alternative("start-at-seven")
    with pytest.raises(ValueError, match="it has: none"):
        reading("X01").alternative("literal")


def test_a_reading_without_choice_has_no_default():
    assert reading("X01").default is None


def test_unknown_ids_are_answered_with_similar_ones():
    with pytest.raises(UnknownReadingError, match=r"did you mean .*X01") as caught:
        reading("x011")
    assert isinstance(caught.value, KeyError)
    assert str(caught.value).startswith("no reading 'x011'")


def test_entries_cannot_be_changed():
    with pytest.raises(AttributeError):
        reading("X01").reading = "as you like it"
    with pytest.raises(TypeError):
        readings()["X01"] = reading("X02")


@pytest.mark.parametrize(
    ("reading_id", "observed", "differs", "said"),
    [
        ("X03", "write-then-increment", False, "write-then-increment"),
        ("X03", "increment-then-write", True, "increment-then-write (reference: write-then-increment)"),
        ("X03", "in words", False, "in words"),
        ("X15", "the current sequence number", False, "the current sequence number"),
        ("H1", "without end", False, "without end"),
        ("X99", "anything", False, "anything"),
    ],
)
def test_an_observed_alternative_is_compared_with_the_reference(
    reading_id: str, observed: str, differs: bool, said: str
):
    assert differs_from_reference(reading_id, observed) is differs
    assert with_reference_reading(reading_id, observed) == said
