"""``dcp-selftest provenance``: what another version of the specification changes is reported with the right ids.

The specification in these tests is made up; no text of the real one stands here.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import msgspec
import pytest
from dcp_conformance.errors import UsageError
from dcp_selftest.cli.provenance import SearchNotes
from dcp_selftest.provenance import report
from dcp_selftest.provenance.anchors import read_anchors, reference
from dcp_selftest.provenance.checkout import read_checkout
from dcp_selftest.provenance.recording import record
from dcp_selftest.provenance.report import Baseline, ProvenanceResult, compare
from dcp_selftest.provenance.statements import distance, statements
from dcp_spec.catalogue.origins import OriginsFile
from dcp_spec.constants import SpecVersion

from ..conformance.command import Command

LETTERS = """\
---
# Letters {#letters}

Some **words** about letters.

## Format {#format}

- A letter carries a stamp of 4 cents. It must not weigh more than 20 grams,
  see [Limits](#limits).
- The `colour` of the envelope is left to the sender, e.g. White is fine.

## Posting

~~~
1.     If (stamp missing) then
          return the letter
2.     If (weight > 20) then
          return the letter
3.     put the letter into the bag
4      mark the letter as posted
~~~

## Limits {#limits}

A bag holds at most 50 letters.
A second sentence follows here, and it is only for readers.
"""
PARCELS = """\
# Parcels

## Weight

A parcel shall weigh at least 2 kilograms. The default label is red.

## Tracking

Every parcel must carry a number of 8 digits that never changes on its way.
Each post office shall write the number into its book when the parcel arrives.
"""

#: Requirements of the real catalogue substitute those of the made-up specification.
ANCHORED = {
    "stamp of 4 cents": "BP-HDR-01",
    "more than 20 grams": "BP-HDR-02",
    "stamp missing": "BP-RX-01",
    "weight > 20": "BP-RX-02",
    "into the bag": "BP-RX-06",
    "as posted": "BP-RX-07",
    "at most 50": "VD-PAR-01",
    "at least 2 kilograms": "SRP-TYP-01",
    "number of 8 digits": "SRP-TYP-02",
    "into its book": "SRP-TYP-03",
}


@pytest.fixture
def specification(tmp_path) -> Path:
    """A checkout of the made-up specification, in folders as the real one has."""
    folder = tmp_path / "spec" / "project" / "specification"
    folder.mkdir(parents=True)
    (folder / "dcp-bp.md").write_text(LETTERS)
    (folder / "dcp-srp.md").write_text(PARCELS)
    (folder / "README.md").write_text("A reader must not treat this as a rule.\n")
    return folder


@pytest.fixture
def baseline(specification) -> Baseline:
    """The made-up specification as the version that the catalogue follows."""
    found = read_checkout(specification).statements()
    users = {
        (each.file, each.line, each.fingerprint): (name,)
        for each in found
        for text, name in ANCHORED.items()
        if text in each.text
    }
    assert len(users) == len(ANCHORED)
    # As in the recorded baseline, the wording is not there.
    return Baseline("2.0", "0" * 40, tuple(replace(each, text="") for each in found), users)


def edit(folder: Path, file: str, old: str, new: str) -> None:
    text = (folder / file).read_text()
    assert text.count(old) == 1
    (folder / file).write_text(text.replace(old, new))


def touched(result: ProvenanceResult) -> dict[str, str]:
    return {each.id: each.change for each in result.touched}


def of(result: ProvenanceResult, change: str) -> list[str]:
    return [each.text for each in result.statements if each.change == change and each.matters]


# -- one statement -----------------------------------------------------------------------------------------------------


def test_sentences_and_steps_with_their_places():
    found = statements("dcp-bp.md", LETTERS)
    assert [(each.line, each.step, each.text[:24]) for each in found if each.headings[-1] == "Posting"] == [
        (12, "", "Posting"),
        (15, "1", "If (stamp missing) then "),
        (17, "2", "If (weight > 20) then re"),
        (19, "3", "put the letter into the "),
        (20, "4", "mark the letter as poste"),
    ]
    stamp, weight, colour = (each for each in found if each.headings[-1] == "Format" and each.kind == "sentence")
    assert (stamp.line, weight.line, colour.line) == (8, 8, 10)
    assert weight.headings == ("Letters", "Format")
    assert weight.anchor == "format"
    assert "White" in colour.text, "an abbreviation does not end a sentence"


@pytest.mark.parametrize(
    "same",
    [
        "A *bag* holds `at most`\n50 letters.",
        "- A bag holds at most 50 letters",
        "A [bag](#elsewhere) **holds**  at most 50 letters.",
    ],
)
def test_typesetting_does_not_count(same):
    (plain,) = statements("a.md", "A bag holds at most 50 letters.")
    (other,) = statements("a.md", same)
    assert other.fingerprint == plain.fingerprint


@pytest.mark.parametrize("other", ["A bag holds at most 51 letters.", "A bag holds at least 50 letters."])
def test_wording_counts(other):
    (plain,) = statements("a.md", "A bag holds at most 50 letters.")
    (changed,) = statements("a.md", other)
    assert changed.fingerprint != plain.fingerprint
    (unrelated,) = statements("a.md", "The colour of an envelope is left to the sender of it.")
    assert distance(plain.sketch, changed.sketch) < distance(plain.sketch, unrelated.sketch)


# -- edits -------------------------------------------------------------------------------------------------------------


def test_nothing_changed(specification, baseline):
    result = compare(read_checkout(specification), baseline)
    assert result.statements == ()
    assert result.touched == ()
    assert result.exit_status() == 0


def test_a_line_break_and_lines_above_change_nothing(specification, baseline):
    edit(specification, "dcp-bp.md", "Some **words** about letters.", "Some\nwords about\nletters.")
    result = compare(read_checkout(specification), baseline)
    assert result.exit_status() == 0


def test_a_changed_number(specification, baseline):
    edit(specification, "dcp-bp.md", "at most 50", "at most 60")
    result = compare(read_checkout(specification), baseline)
    assert touched(result) == {"VD-PAR-01": "changed"}
    assert of(result, "changed") == ["A bag holds at most 60 letters."]
    (entry,) = result.touched
    assert "TC_VD_PAR_BV_02" in entry.cases
    assert any(each.startswith("dcp_stack/vardis/parameters.py:") for each in entry.code)
    assert result.exit_status() == 1


def test_a_changed_step(specification, baseline):
    edit(specification, "dcp-bp.md", "weight > 20", "weight >= 20")
    assert touched(compare(read_checkout(specification), baseline)) == {"BP-RX-02": "changed"}


def test_a_removed_step_and_the_steps_that_get_its_number(specification, baseline):
    edit(specification, "dcp-bp.md", "2.     If (weight > 20) then\n          return the letter\n3. ", "2. ")
    edit(specification, "dcp-bp.md", "4      mark", "3.     mark")
    result = compare(read_checkout(specification), baseline)
    assert touched(result) == {"BP-RX-02": "gone", "BP-RX-06": "renumbered", "BP-RX-07": "renumbered"}


def test_a_new_step(specification, baseline):
    edit(
        specification, "dcp-bp.md", "4      mark the letter as posted", "4. mark the letter as posted\n5. ring the bell"
    )
    result = compare(read_checkout(specification), baseline)
    assert touched(result) == {}
    assert of(result, "new") == ["ring the bell"]
    assert result.exit_status() == 1


def test_new_text_without_rules_needs_no_action(specification, baseline):
    edit(specification, "dcp-bp.md", "Some **words** about letters.", "Some words about letters. People like them.")
    result = compare(read_checkout(specification), baseline)
    assert result.counts["new"] == 1
    assert result.exit_status() == 0


def test_a_section_that_moves_to_another_file(specification, baseline):
    section = "## Tracking\n" + PARCELS.partition("## Tracking\n")[2]
    edit(specification, "dcp-srp.md", section, "")
    (specification / "dcp-bp.md").write_text(LETTERS + "\n" + section)
    result = compare(read_checkout(specification), baseline)
    assert touched(result) == {"SRP-TYP-02": "moved", "SRP-TYP-03": "moved"}


def test_a_section_with_another_name(specification, baseline):
    edit(specification, "dcp-srp.md", "## Tracking", "## Following Parcels")
    assert touched(compare(read_checkout(specification), baseline)) == {"SRP-TYP-02": "moved", "SRP-TYP-03": "moved"}


def test_a_file_with_another_name(specification, baseline):
    (specification / "dcp-srp.md").rename(specification / "dcp-parcels.md")
    result = compare(read_checkout(specification), baseline)
    assert touched(result) == dict.fromkeys(("SRP-TYP-01", "SRP-TYP-02", "SRP-TYP-03"), "moved")
    assert result.counts["gone"] == result.counts["new"] == 0


def test_several_edits_are_distinguished(specification, baseline):
    edit(specification, "dcp-bp.md", "stamp of 4 cents", "stamp of 5 cents")
    edit(specification, "dcp-srp.md", "A parcel shall weigh at least 2 kilograms. ", "")
    edit(specification, "dcp-bp.md", "1.     If (stamp missing)", "1. wash hands\n2.     If (stamp missing)")
    edit(specification, "dcp-bp.md", "2.     If (weight", "3.     If (weight")
    edit(specification, "dcp-bp.md", "3.     put", "4.     put")
    edit(specification, "dcp-bp.md", "4      mark", "5      mark")
    result = compare(read_checkout(specification), baseline)
    assert touched(result) == {
        "BP-HDR-01": "changed",
        "BP-RX-01": "renumbered",
        "BP-RX-02": "renumbered",
        "BP-RX-06": "renumbered",
        "BP-RX-07": "renumbered",
        "SRP-TYP-01": "gone",
    }
    assert of(result, "new") == ["wash hands"]


# -- checkouts ---------------------------------------------------------------------------------------------------------


def git(folder: Path, *arguments: str) -> None:
    program = shutil.which("git")
    assert program is not None
    identity = ("-c", "user.name=x", "-c", "user.email=x@example.org", "-c", "commit.gpgsign=false")
    subprocess.run([program, *identity, "-C", str(folder), *arguments], check=True, capture_output=True)


@pytest.fixture
def repository(tmp_path, specification) -> Path:
    """A bare repository of the made-up specification with the tags v1 (at most 40), v2 and the draft after it."""
    root = tmp_path / "spec"
    git(root, "init", "-q", "-b", "main")
    for tag, number in (("v1", "40"), ("v2", "50")):
        (specification / "dcp-bp.md").write_text(LETTERS.replace("at most 50", f"at most {number}"))
        git(root, "add", "-A")
        git(root, "commit", "-q", "-m", tag)
        git(root, "tag", tag)
    git(tmp_path, "clone", "-q", "--bare", str(root), "bare.git")
    return tmp_path / "bare.git"


def test_a_bare_repository_and_its_revisions(repository, specification, baseline):
    assert touched(compare(read_checkout(repository), baseline)) == {}
    assert touched(compare(read_checkout(repository, "v1"), baseline)) == {"VD-PAR-01": "changed"}
    assert read_checkout(repository).files == read_checkout(specification).files
    edit(specification, "dcp-bp.md", "at most 50", "at most 70")
    work_tree = specification.parents[1]
    assert touched(compare(read_checkout(work_tree), baseline)) == {"VD-PAR-01": "changed"}
    assert touched(compare(read_checkout(work_tree, "HEAD"), baseline)) == {}


def test_wrong_places_are_named(tmp_path, repository, specification):
    (tmp_path / "other").mkdir()
    with pytest.raises(UsageError, match="is not a folder"):
        read_checkout(tmp_path / "none")
    with pytest.raises(UsageError, match="holds no DCP specification"):
        read_checkout(tmp_path / "other")
    with pytest.raises(UsageError, match="is not a git repository"):
        read_checkout(tmp_path / "other", "HEAD")
    with pytest.raises(UsageError, match="has no revision 'v9'"):
        read_checkout(repository, "v9")
    shutil.copytree(specification, tmp_path / "spec" / "copy")
    with pytest.raises(UsageError, match="several specifications"):
        read_checkout(tmp_path / "spec")
    (specification / "dcp-bp.md").write_bytes(b"\xff\xfe")
    with pytest.raises(UsageError, match="cannot be read"):
        read_checkout(specification)


# -- the command -------------------------------------------------------------------------------------------------------


@pytest.fixture
def made_up(monkeypatch, baseline) -> None:
    """The command compares with the made-up specification."""
    monkeypatch.setattr(report, "recorded_baseline", lambda: baseline)


@pytest.mark.usefixtures("made_up")
class TestCommand:
    def test_unchanged_specification(self, dcp_selftest: Command, specification):
        done = dcp_selftest("provenance", specification)
        assert done.status == 0
        assert re.search(r"^unchanged +\d+ +\d+$", done.out, re.MULTILINE)
        assert "Changed" not in done.out

    def test_a_change_is_listed_with_everything_affected(self, dcp_selftest: Command, specification):
        edit(specification, "dcp-bp.md", "at most 50", "at most 60")
        edit(specification, "dcp-srp.md", "## Tracking", "## Following Parcels")
        done = dcp_selftest("provenance", specification)
        assert done.status == 1
        assert "dcp-bp.md:25  Limits\n    | A bag holds at most 60 letters.\n    VD-PAR-01\n" in done.out
        assert "dcp-srp.md, Tracking -> dcp-srp.md, Following Parcels\n    SRP-TYP-02 SRP-TYP-03\n" in done.out
        assert "TC_VD_PAR_BV_02" in done.out
        assert "dcp_stack/vardis/parameters.py:" in done.out
        # The folder may have any length; everything else is wrapped.
        assert max(len(line) for line in done.out.splitlines() if str(specification) not in line) <= 80

    def test_json(self, dcp_selftest: Command, specification):
        edit(specification, "dcp-bp.md", "at most 50", "at most 60")
        done = dcp_selftest("provenance", specification, "--json")
        assert done.status == 1
        data = json.loads(done.out)
        assert data["schema"] == report.SCHEMA
        (change,) = data["statements"]
        assert change["change"] == "changed"
        assert change["requirements"] == ["VD-PAR-01"]
        assert change["before"]["line"] == change["now"]["line"] == 25
        (entry,) = [each for each in data["requirements"] if each["change"] != "unchanged"]
        assert entry["id"] == "VD-PAR-01"
        assert "TC_VD_PAR_BV_02" in entry["cases"]

    def test_text_without_rules_is_shown_on_demand(self, dcp_selftest: Command, specification):
        edit(specification, "dcp-bp.md", "Some **words** about letters.", "Some words about letters. People like them.")
        assert "People like them" not in dcp_selftest("provenance", specification).out
        assert "People like them" in dcp_selftest("provenance", specification, "--all").out

    @pytest.mark.parametrize("words", [[], ["/nowhere"], ["--requirement", "BP-RX-999"]])
    def test_usage(self, dcp_selftest: Command, words):
        done = dcp_selftest("provenance", *words)
        assert done.status == 2
        assert done.err.count("\n") == 1


def test_the_places_of_a_requirement(dcp_selftest: Command):
    done = dcp_selftest("provenance", "--requirement", "BP-RX-06", "--requirement", "BP-RX-16")
    assert done.status == 0
    assert re.search(r"2\.0  [0-9a-f]{12}  dcp-bp\.md:\d+ \(Receive Path, step 2\)", done.out)
    assert "BP-RX-16" in done.out
    assert "no sentence of its own: General requirement" in done.out


# -- recording ---------------------------------------------------------------------------------------------------------

ANCHORS = """\
[[revision]]
version = "2.0"
revision = "v2"

[[revision]]
version = "1.3"
revision = "v1"

[requirement.VD-PAR-01]
"2.0" = ["{bag}"]

[requirement.BP-RX-16]
"2.0" = []
why = "a general rule"
"""


def anchors_file(tmp_path: Path, specification: Path, text: str = ANCHORS) -> Path:
    (bag,) = [each for each in read_checkout(specification).statements() if "at most 50" in each.text]
    (tmp_path / "anchors.toml").write_text(text.replace("{bag}", reference(bag)))
    return tmp_path / "anchors.toml"


def test_anchors_are_followed_into_older_versions(tmp_path, repository, specification):
    recording = record(repository, read_anchors(anchors_file(tmp_path, specification)))
    file = msgspec.json.decode(recording.files["origins.json"], type=OriginsFile)
    new, old = (file.origins["VD-PAR-01"][version] for version in (SpecVersion("2.0"), SpecVersion("1.3")))
    assert new[0][:3] == old[0][:3], "the place is the same"
    assert new[0][3] != old[0][3], "the number is another"
    assert file.why == {"BP-RX-16": "a general rule"}
    assert "holds at most" not in recording.files["origins.json"] + recording.files["statements.json"]
    assert all("VD-PAR-01" not in each for each in recording.remarks)
    assert any(each.startswith("BP-RX-01 has no entry") for each in recording.remarks)


def test_a_statement_missing_in_an_older_version_is_reported(tmp_path, repository, specification):
    text = ANCHORS.replace('"2.0" = ["{bag}"]', '"2.0" = ["{bag}"]\n"1.3" = []')
    recording = record(repository, read_anchors(anchors_file(tmp_path, specification, text)))
    assert any(each.startswith("VD-PAR-01 holds in 1.3, but none") for each in recording.remarks)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("VD-PAR-01", "VD-PAR-999", "has no requirement VD-PAR-999"),
        ('"2.0" = [', '"2.2" = [', "'2.2' is neither a version"),
        ('version = "1.3"', 'version = "2.0"', "not ordered"),
        ("{bag}", "dcp-bp.md:1 000000000000", "has no statement"),
        ('"v1"', '"v7"', "has no revision"),
        ("why = ", "why ", "anchors.toml"),
    ],
)
def test_invalid_anchors_are_reported(tmp_path, repository, specification, old, new, message):
    with pytest.raises(UsageError, match=re.escape(message)):
        record(repository, read_anchors(anchors_file(tmp_path, specification, ANCHORS.replace(old, new))))


def test_anchors_are_followed_into_newer_versions(tmp_path, repository, specification):
    path = anchors_file(tmp_path, specification)
    (old,) = [each for each in read_checkout(repository, "v1").statements() if "at most 40" in each.text]
    text = re.sub(r'"2\.0" = \["dcp-bp.*"\]', f'"1.3" = ["{reference(old)}"]', path.read_text())
    path.write_text(text)
    recording = record(repository, read_anchors(path))
    file = msgspec.json.decode(recording.files["origins.json"], type=OriginsFile)
    assert file.origins["VD-PAR-01"][SpecVersion("2.0")][0][1] == old.line


def test_a_long_search_reports_its_folder(capsys):
    """Nothing in the first 2 s; then a note, and further ones every 10 s."""
    now = [0.0]
    notes = SearchNotes(lambda: now[0])
    for second in (0.0, 1.9, 2.0, 3.0, 11.9, 12.0):
        now[0] = second
        notes(Path(f"/spec/{second}"))
    shown = capsys.readouterr()
    assert not shown.out
    assert shown.err.splitlines() == [
        "searching for the specification: 3 folders so far, now /spec/2.0",
        "searching for the specification: 6 folders so far, now /spec/12.0",
    ]


def test_every_folder_is_reported_before_it_is_searched(tmp_path):
    (tmp_path / "a" / "b").mkdir(parents=True)
    (tmp_path / ".git" / "objects").mkdir(parents=True)
    (tmp_path / "a" / "b" / "dcp-bp.md").write_text("# BP\n")
    seen = []
    checkout = read_checkout(tmp_path, on_folder=seen.append)
    assert seen == [tmp_path, tmp_path / "a", tmp_path / "a" / "b"]
    assert set(checkout.files) == {"dcp-bp.md"}
