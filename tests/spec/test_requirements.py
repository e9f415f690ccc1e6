import pickle
import re
import subprocess
import sys
import tomllib
from collections import Counter
from importlib import resources

import pytest
from dcp_spec.catalogue.readings import readings
from dcp_spec.catalogue.requirements import UnknownRequirementError, requirement, requirements
from dcp_spec.constants import SpecVersion
from dcp_spec.status import BPStatus, SRPStatus, VardisStatus

ENTRIES = list(requirements().values())
RAW = tomllib.loads(resources.files("dcp_spec").joinpath("data/requirements.toml").read_text())["requirement"]

FILES = {
    "DATA": {"dcp-datatypes.md"},
    "UWB": {"dcp-architecture.md"},
    "BP": {"dcp-bp.md"},
    "SRP": {"dcp-srp.md", "dcp-architecture.md"},
    "VD": {"dcp-vardis.md"},
}

# Shorthand of working notes that a reader of an error message cannot resolve.
SHORTHAND = re.compile(r"\b(VC|VU|VD|VS|RU|RC|SUT|PICS|IUT|obs|rcvd)\b(?!-)|\b[XH]\d\b|->|\.\.\.|<=|>=|!=")


def test_the_catalogue_is_complete():
    # The counts were taken by hand from the specification; a lost entry must not go unnoticed.
    assert Counter(entry.protocol for entry in ENTRIES) == {"DATA": 14, "UWB": 6, "BP": 132, "SRP": 38, "VD": 178}
    assert len(ENTRIES) == 368


def test_no_id_is_used_twice():
    # Looked up in the file: a mapping by id would hide the first of two.
    assert [count for count in Counter(entry["id"] for entry in RAW).items() if count[1] > 1] == []


def test_the_mapping_keeps_the_order_of_the_catalogue():
    assert list(requirements()) == [entry["id"] for entry in RAW]
    protocols = list(dict.fromkeys(entry.protocol for entry in ENTRIES))
    assert protocols == ["DATA", "UWB", "BP", "SRP", "VD"]


def test_numbers_run_without_gaps_in_every_group():
    groups = {}
    for entry in ENTRIES:
        group, _, number = entry.id.rpartition("-")
        groups.setdefault(group, []).append(int(number))
    assert {g: n for g, n in groups.items() if n != list(range(1, len(n) + 1))} == {}


def test_each_entry_is_well_formed():
    for entry in ENTRIES:
        assert re.fullmatch(r"(DATA|UWB)-\d\d|(BP|SRP|VD)-[A-Z]{1,3}-\d\d", entry.id), entry.id
        assert entry.id.split("-")[0] == entry.protocol, entry.id
        assert entry.observable, entry.id
        assert len(set(entry.observable)) == len(entry.observable), entry.id
        # Only a mandatory requirement can need a value of the profile; the level "profile" says it already.
        assert not entry.profile or entry.level == "mandatory", entry.id
        assert all(version > entry.since for version in entry.not_in), entry.id
        assert entry.until is None or entry.since <= entry.until < max(SpecVersion), entry.id
        if entry.step is not None:
            assert re.fullmatch(r"\d+(\.[a-z])?(-\d+)?", entry.step), entry.id


def test_each_section_names_file_and_place():
    for entry in ENTRIES:
        for place in (entry.section, *entry.see):
            assert re.fullmatch(r"dcp-[a-z]+\.md(#[a-z][a-z0-9-]+|: \S.*)", place), entry.id
            assert "same" not in place.split(), entry.id
        assert entry.section.partition("#")[0].partition(":")[0] in FILES[entry.protocol], entry.id
        assert entry.section not in entry.see, entry.id


def test_each_text_is_readable_without_the_table():
    for entry in ENTRIES:
        for text in filter(None, (entry.statement, entry.test, entry.history)):
            assert text[0].isupper(), entry.id
            assert text.endswith("."), entry.id
            assert "  " not in text, entry.id
            assert text.count("(") == text.count(")"), entry.id
            assert text.count('"') % 2 == 0, entry.id
            assert SHORTHAND.search(text) is None, entry.id
        assert len(entry.statement.split()) >= 5, entry.id


def test_requirements_are_distinct():
    repeated = Counter(entry.statement for entry in ENTRIES)
    assert [text for text, count in repeated.items() if count > 1] == []


def test_every_id_named_in_a_text_exists():
    pattern = re.compile(r"\b(?:DATA|UWB|BP|SRP|VD)(?:-[A-Z]{1,3})?-\d\d\b")
    named = {
        name
        for entry in ENTRIES
        for text in (entry.statement, entry.test, entry.history or "")
        for name in pattern.findall(text)
    }
    assert named
    assert named <= requirements().keys()


def test_every_status_named_in_a_statement_exists():
    known = {str(status) for enumeration in (BPStatus, SRPStatus, VardisStatus) for status in enumeration}
    pattern = re.compile(r"\b(?:BP|SRP|VARDIS)-STATUS-[A-Z-]+[A-Z]")
    named = {name for entry in ENTRIES for name in pattern.findall(f"{entry.statement} {entry.test}")}
    assert named
    assert named <= known


def test_statements_name_the_status_of_the_version_since_which_they_hold():
    pattern = re.compile(r"\bVARDIS-STATUS-[A-Z-]+[A-Z]")
    too_early = {
        entry.id: name
        for entry in ENTRIES
        for name in pattern.findall(entry.statement)
        if not VardisStatus.parse(name).holds_in(entry.since)
    }
    assert too_early == {}


def test_every_reading_named_by_a_requirement_exists():
    named = {reading for entry in ENTRIES for reading in entry.readings}
    assert named <= readings().keys()


@pytest.mark.parametrize(
    ("requirement_id", "versions"),
    [
        ("BP-HDR-04", "2.0"),
        ("BP-HDR-06", "1.2 1.3 2.0"),
        ("BP-MGT-01", "1.2 1.3 2.0"),
        ("BP-QM-02", "1.1 1.2 1.3 2.0"),
        ("SRP-INI-03", "1.3 2.0"),
        ("VD-PAR-04", "1.0 1.2 1.3 2.0"),
        ("VD-PC-06", "1.2 1.3 2.0"),
        ("VD-SCR-05", "2.0"),
        ("VD-RC-01", "1.1 1.2 1.3 2.0"),
        ("BP-RX-02", "1.0 1.1 1.2 1.3 2.0"),
    ],
)
def test_requirements_hold_in_the_versions_that_state_them(requirement_id, versions):
    entry = requirement(requirement_id)
    assert [version.value for version in SpecVersion if entry.holds_in(version)] == versions.split()


def test_a_version_may_be_given_as_a_string_but_must_exist():
    assert requirement("BP-HDR-04").holds_in("2.0")
    with pytest.raises(ValueError, match=r"1\.4"):
        requirement("BP-HDR-04").holds_in("1.4")


BEFORE_2_0 = "1.0 1.1 1.2 1.3"
ENDED = {
    **dict.fromkeys(("VD-CMP-14", "SRP-INI-08"), "1.0 1.1 1.2"),
    "BP-TXP-11": "1.0 1.1",
    **dict.fromkeys(
        ("BP-HDR-13", "BP-QM-10", "BP-REG-11", "BP-REG-12", "BP-LST-03", "BP-TXP-12", "BP-TXP-13"),
        "1.0",
    ),
    **dict.fromkeys(("BP-PAR-12", "BP-PAR-13"), "1.0"),
    **dict.fromkeys(("VD-RX-10", "VD-PAY-07", "VD-INI-07", "VD-RU-05", "VD-RC-04"), "1.0"),
    **dict.fromkeys(("VD-RX-11", "VD-INI-08", "VD-PAR-10"), "1.1"),
    **dict.fromkeys(
        ("VD-CRE-16", "VD-DEL-08", "VD-DEL-09", "VD-UPD-12", "VD-REA-06", "VD-PC-11"),
        BEFORE_2_0,
    ),
}


def test_the_draft_has_every_requirement():
    # But for rules that have ended.
    assert {entry.id for entry in ENTRIES if not entry.holds_in("2.0")} == set(ENDED)


@pytest.mark.parametrize(("requirement_id", "versions"), ENDED.items())
def test_a_rule_that_has_ended_holds_up_to_its_last_version(requirement_id: str, versions: str):
    entry = requirement(requirement_id)
    assert entry.until is not None
    assert [version.value for version in SpecVersion if entry.holds_in(version)] == versions.split()


def test_unknown_ids_are_answered_with_similar_ones():
    with pytest.raises(UnknownRequirementError, match=r"did you mean .*BP-RX-15") as caught:
        requirement("bp-rx-155")
    assert isinstance(caught.value, KeyError)
    assert str(caught.value).startswith("no requirement 'bp-rx-155'")


def test_an_error_can_travel_between_processes():
    with pytest.raises(UnknownRequirementError) as caught:
        requirement("bp-rx-155")
    assert str(pickle.loads(pickle.dumps(caught.value))) == str(caught.value)


def test_an_id_like_no_other_gets_no_suggestion():
    with pytest.raises(UnknownRequirementError) as caught:
        requirement("42")
    assert str(caught.value) == "no requirement '42'"


def test_entries_cannot_be_changed():
    entry = requirement("BP-RX-15")
    with pytest.raises(AttributeError):
        entry.statement = "anything goes"
    with pytest.raises(TypeError):
        requirements()["BP-RX-15"] = entry


def test_cite_gives_id_place_and_statement():
    line = requirement("BP-REG-02").cite()
    assert line.startswith("BP-REG-02 (dcp-bp.md#bp-interface-service-bp-register-protocol, step 1): Registering ")


def test_nothing_is_read_at_import():
    program = (
        "import sys\n"
        "sys.addaudithook(lambda event, args: event == 'open' and str(args[0]).endswith('.toml') and print(args[0]))\n"
        "import dcp_spec.catalogue.requirements, dcp_spec.catalogue.readings, dcp_spec.parameters\n"
        "print('imported')\n"
        "dcp_spec.catalogue.readings.reading('X01')\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    before, after = done.stdout.split("imported\n")
    assert before == ""
    assert after.endswith("data/readings.toml\n")
