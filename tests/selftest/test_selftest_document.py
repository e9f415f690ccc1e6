"""The document of the self-test: each command replaces its own section and keeps the rest."""

from __future__ import annotations

from itertools import permutations
from pathlib import Path

import pytest
from dcp_selftest.document import SECTIONS, DocumentError, section_of, with_section, write_section
from dcp_selftest.variants import campaign

from ..conformance.command import Command

DOCUMENT = Path(__file__).parents[2] / "docs" / "selftest.md"


@pytest.mark.parametrize("order", list(permutations(SECTIONS)), ids=" ".join)
def test_sections_have_a_fixed_order(order: tuple[str, ...]):
    document = ""
    for name in order:
        document = with_section(document, name, f"## {name}\n\ntext\n")
    assert document.startswith("# Tests of the test suite\n")
    places = [document.index(f"## {name}\n") for name in SECTIONS]
    assert places == sorted(places)
    assert [section_of(document, name) for name in SECTIONS] == [f"## {name}\n\ntext" for name in SECTIONS]


def test_a_section_is_replaced_and_everything_else_is_kept():
    first = with_section(with_section("# Mine\n\nforeword\n", "variants", "old"), "mutants", "kept")
    second = with_section(first, "variants", "new")
    assert second == first.replace("old", "new")
    assert second.startswith("# Mine\n\nforeword\n\n")
    assert with_section(second, "variants", "new") == second


def test_text_between_sections_and_after_them_is_kept():
    document = with_section(with_section("", "mutants", "m"), "variants", "v") + "\nafterword\n"
    document = document.replace("<!-- section: variants", "between\n\n<!-- section: variants")
    changed = with_section(with_section(document, "generated", "g"), "mutants", "m2")
    assert "\nbetween\n" in changed
    assert changed.endswith("\nafterword\n")
    assert [section_of(changed, name) for name in ("mutants", "generated", "variants")] == ["m2", "g", "v"]


@pytest.mark.parametrize("kept", ["<!-- section: mutants -->\n", "<!-- end: mutants -->\n"])
def test_a_document_whose_markers_do_not_match_is_refused(kept: str):
    with pytest.raises(DocumentError, match="'mutants' do not match"):
        with_section(f"# Title\n\n{kept}text\n", "mutants", "new")


def test_markers_in_the_wrong_order_are_refused():
    with pytest.raises(DocumentError):
        with_section("<!-- end: mutants -->\ntext\n<!-- section: mutants -->\n", "mutants", "new")


def test_a_section_without_a_place_in_the_order_is_refused():
    with pytest.raises(ValueError, match="no section is called 'others'"):
        with_section("", "others", "text")


def test_a_document_that_is_missing_is_made(tmp_path: Path):
    path = tmp_path / "made.md"
    write_section(path, "generated", "## Generated")
    assert section_of(path.read_text(encoding="utf-8"), "generated") == "## Generated"


@pytest.mark.usefixtures("few_cases")
def test_both_commands_write_into_one_document(tmp_path: Path, dcp_selftest: Command):
    path = tmp_path / "selftest.md"
    for words in (["mutants", "M-BP-HDR-01-two"], ["variants", "V-X27-*"], ["mutants", "M-BP-HDR-02-swapped"]):
        done = dcp_selftest(*words, "--profile", "dcp-2.0", "--jobs", "1", "-q", "--document", path)
        assert done.status == 0, done.out
    text = path.read_text(encoding="utf-8")
    assert "`M-BP-HDR-02-swapped`" in section_of(text, "mutants")
    assert "`M-BP-HDR-01-two`" not in text
    assert "`V-X27-" in section_of(text, "variants")


def test_a_broken_document_is_wrong_usage_before_anything_is_tried(tmp_path: Path, dcp_selftest: Command, monkeypatch):
    monkeypatch.setattr(campaign, "run", None)
    path = tmp_path / "selftest.md"
    path.write_text("<!-- section: variants -->\n", encoding="utf-8")
    done = dcp_selftest("variants", "V-X27-*", "--profile", "dcp-2.0", "--jobs", "1", "-q", "--document", path)
    assert done.status == 2
    assert str(path) in done.err


def test_the_document_of_the_repository_has_sections():
    assert section_of(DOCUMENT.read_text(encoding="utf-8"), "mutants").startswith("## Mutants\n")
