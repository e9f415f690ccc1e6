"""Nodes that are wrong in one thing: each must be noticed by a case that names the requirement it violates."""

from __future__ import annotations

import json
import random
import re
from collections.abc import Iterable
from pathlib import Path

import pytest
from click.testing import CliRunner
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.errors import UsageError
from dcp_conformance.reference.inprocess import plain_node
from dcp_selftest import runner
from dcp_selftest.cli.mutants import command
from dcp_selftest.kill_matrix import markdown
from dcp_selftest.mutants import Mutant, all_mutants, mutant, node_with
from dcp_selftest.mutants.mutant import replaced
from dcp_selftest.runner import Baseline, Finding, SelftestResult, Trial, chosen, selftest, trial, trials
from dcp_spec.catalogue.requirements import requirements
from dcp_spec.constants import SpecVersion

from dcp_codec.codec import get_codec
from dcp_stack.config import NodeConfig
from dcp_stack.node import Node
from dcp_stack.vardis.receive import Receiver

from ..conformance.rig import known_cases, sampled_cases

MUTANTS = all_mutants()
DOCUMENT = Path(__file__).parents[2] / "docs" / "selftest.md"
EQUAL = "M-VD-RU-03-equal-answered"


def check_killed(outcomes: Iterable[Trial]) -> None:
    """Check that a case which names a violated requirement has failed in each trial."""
    for outcome in outcomes:
        assert not outcome.errors, [(each.case, each.reason) for each in outcome.errors]
        also = [each.case for each in outcome.also[:5]]
        what = f"{outcome.mutant} on {outcome.profile}: {outcome.what}"
        assert outcome.killed, f"{what}: none of {outcome.candidates} cases; others that fail: {also}"


#: Mutants that only cases of the long plan kill: seconds each.
LONG = ("M-BP-HDR-08-sixteen-bits", "M-SRP-SEQ-01-sixteen-bits")


@pytest.mark.parametrize("requirement", dict.fromkeys(each.requirement for each in MUTANTS.values()))
def test_each_mutant_of_a_requirement_is_killed_on_its_newest_version(requirement):
    check_killed(trial(each) for each in MUTANTS.values() if each.requirement == requirement and each.id not in LONG)


@pytest.mark.part("suite")
@pytest.mark.parametrize("identifier", LONG)
def test_a_mutant_is_killed_by_a_case_of_the_long_plan(identifier):
    outcome = trial(MUTANTS[identifier])
    check_killed([outcome])
    assert known_cases()[outcome.killers[0].case].long


@pytest.mark.part("suite")
@pytest.mark.parametrize("requirement", dict.fromkeys(each.requirement for each in MUTANTS.values()))
def test_each_mutant_of_a_requirement_is_killed_on_an_older_version(requirement):
    """Each mutant on one of them, in turn: the document of the self-test has all."""
    older = [each for each in MUTANTS.values() if each.requirement == requirement and len(each.profiles) > 1]
    check_killed(
        trial(each, profile=each.profiles[1 + number % (len(each.profiles) - 1)])
        for number, each in enumerate(older, sum(requirement.encode()))
    )


@pytest.mark.part("suite")
@pytest.mark.parametrize("identifier", [each.id for each in MUTANTS.values() if each.unseen])
def test_a_mutant_that_is_not_tried_on_a_version_has_a_reason_and_would_survive(identifier):
    made = MUTANTS[identifier]
    for version, why in made.unseen.items():
        assert why
        assert version not in made.versions
        assert not trial(made, profile=f"dcp-{version}", every=True).killed


def test_a_mutant_is_tried_on_each_version_that_has_its_requirement():
    for made in MUTANTS.values():
        holding = {each for each in SpecVersion if requirements()[made.requirement].holds_in(each)}
        assert holding <= {*made.versions, *made.unseen}, made.id


def test_a_version_that_is_neither_tried_nor_excused_is_refused():
    with pytest.raises(ValueError, match=r"not tried on 1\.0, which has VD-RU-03: give a reason in unseen"):
        mutant("x", "VD-RU-03", "nothing", since=SpecVersion.V1_1)


def test_an_unknown_profile_is_reported():
    with pytest.raises(UsageError, match="unknown profile 'none-such'"):
        selftest([MUTANTS[EQUAL]], profiles=["none-such"])


def test_every_section_has_mutants_and_there_are_many():
    groups = {each.requirement.rpartition("-")[0] for each in MUTANTS.values()}
    assert len(MUTANTS) >= 130
    receiving = {f"VD-{name}" for name in ("RX", "PC", "PD", "PU", "PS", "RU", "RC", "SCP", "ROB")}
    sending = {f"VD-{name}" for name in ("PAY", "CMP", "IC", "TYP", "RUN", "SCR", "INI")}
    services = {f"VD-{name}" for name in ("CRE", "DEL", "UPD", "REA", "DDB", "DVA", "MGT", "PAR")}
    bp = {
        f"BP-{name}"
        for name in [
            "HDR",
            "QM",
            "REG",
            "DRG",
            "LST",
            "RXP",
            "TXP",
            "CLR",
            "PTI",
            "QRY",
            "MGT",
            "PAR",
            "FMT",
            "INI",
            "TX",
            "RX",
        ]
    }
    srp = {f"SRP-{name}" for name in ("TYP", "NT", "SEQ", "SRV", "PAR", "FMT", "INI", "RUN", "RX")}
    assert {"DATA", *receiving, *sending, *services, *bp, *srp} <= groups


def test_identifiers_name_the_violated_requirement():
    for made in MUTANTS.values():
        assert re.fullmatch(rf"M-{made.requirement}-[A-Za-z0-9-]+", made.id), made.id
        assert set(made.requirements) <= set(requirements()), made.id
        assert made.until is None or made.since <= made.until, made.id


def test_our_node_is_not_killed():
    for identifier in (EQUAL, "M-BP-HDR-06-with-header", "M-SRP-RX-06-forwarded"):
        known = MUTANTS[identifier]
        harmless = Mutant("M-none", known.requirement, known.also, "nothing", plain_node, known.since, known.until)
        outcome = trial(harmless, every=True)
        assert not outcome.killed
        assert not outcome.also
        assert outcome.candidates


@pytest.fixture
def sampled(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the self-test execute a sample of the suite, where its findings about the node are not the point."""
    monkeypatch.setattr(runner, "cases", lambda *_: sampled_cases(0, "BP-HDR-10", "BP-HDR-11", "VD-RU-03"))


@pytest.mark.part("suite")
@pytest.mark.usefixtures("sampled")
def test_a_failure_for_another_reason_is_distinguished():
    outcome = trial(MUTANTS["M-BP-HDR-11-swapped-protocol"], full=True)
    assert outcome.killers
    assert outcome.also
    assert not {each.case for each in outcome.killers} & {each.case for each in outcome.also}
    for each in outcome.also:
        assert not set(each.requirements) & set(outcome.requirements)


def test_a_crash_kills_a_mutant_and_the_next_case_gets_a_new_node():
    outcome = trial(MUTANTS["M-VD-ROB-01-dies-of-zero"], every=True)
    assert outcome.killers
    assert len(outcome.killers) < outcome.candidates


def test_the_case_that_killed_a_mutant_on_one_version_is_tried_first_on_the_next():
    first, *rest = trials(MUTANTS["M-VD-RC-02-deletion-answered"])
    assert [each.profile for each in (first, *rest)] == ["dcp-2.0", "dcp-1.3", "dcp-1.2", "dcp-1.1", "dcp-1.0"]
    assert all(each.cases == 2 for each in rest), "the sanity case and the killer"


def test_parts_are_put_into_the_node():
    class Other(Receiver):
        pass

    def part(made_of: type[Node]) -> type:
        node = made_of(NodeConfig(node_id=bytes(6), codec=get_codec("dcp-2.0")), rng=random.Random(1), now=0, wall=0)
        node.reset(1, 1)
        return type(node.vardis._receiver)

    assert part(node_with(Other)) is Other
    assert part(Node) is Receiver
    with pytest.raises(ZeroDivisionError), replaced({Receiver: Other}):
        1 / 0  # noqa: B018
    assert part(Node) is Receiver
    with pytest.raises(TypeError, match="does not derive from a part of the node"):
        node_with(int)


def test_a_mutant_of_an_unknown_requirement_cannot_be_made():
    with pytest.raises(KeyError):
        mutant("x", f"VD-RU-{99}", "nothing")


def test_mutants_are_chosen_by_name_requirement_or_glob():
    assert [each.id for each in chosen([EQUAL])] == [EQUAL]
    assert {each.requirement for each in chosen(["VD-RU-03", "BP-CLR-*"])} == {
        "VD-RU-03",
        "BP-CLR-01",
        "BP-CLR-02",
        "BP-CLR-03",
    }
    assert len(chosen([])) == len(MUTANTS)
    with pytest.raises(UsageError, match="no mutant is called 'M-nothing'"):
        chosen(["M-nothing"])


@pytest.mark.usefixtures("few_cases")
def test_a_mutant_is_tried_on_versions_where_it_is_a_fault():
    old = MUTANTS["M-VD-RU-05-requested"]
    assert old.profile == "dcp-1.0"
    result = selftest([old, MUTANTS[EQUAL]], profiles=["cpp-2.0"], jobs=1)
    assert [(each.mutant, each.profile) for each in result.mutants] == [(EQUAL, "cpp-2.0")]
    assert [each.profile for each in result.baselines] == ["cpp-2.0"]
    assert result.exit_status() == 0


# -- the result --------------------------------------------------------------------------------------------------------

GOOD = Baseline("dcp-2.0", 10, (), 1.0)
KILL = Finding("TC_VD_RU_BO_01", Verdict.FAIL, ("VD-RU-03",), "it answers")


def _trial(**changes: object) -> Trial:
    base = {
        "mutant": EQUAL,
        "requirements": ("VD-RU-03",),
        "what": "answers | everything",
        "profile": "dcp-2.0",
        "candidates": 3,
        "cases": 3,
        "killers": (KILL,),
        "also": (),
        "errors": (),
        "seconds": 0.1,
    }
    return Trial(**{**base, **changes})


@pytest.mark.parametrize(
    ("result", "status"),
    [
        (SelftestResult(baselines=(GOOD,), mutants=(_trial(),)), 0),
        (SelftestResult(baselines=(GOOD,), mutants=(_trial(killers=()),)), 1),
        (SelftestResult(baselines=(Baseline("dcp-1.0", 9, (KILL,), 1.0),), mutants=(_trial(),)), 1),
        (SelftestResult(baselines=(GOOD,), mutants=(_trial(errors=(Finding("TC", Verdict.ERROR),)),)), 4),
        (SelftestResult(baselines=(Baseline("dcp-1.0", 9, (Finding("TC", Verdict.ERROR),), 1.0),)), 4),
    ],
    ids=["all-killed", "survivor", "node-fails", "error-with-a-mutant", "error-with-the-node"],
)
def test_exit_status(result, status):
    assert result.exit_status() == status


def test_the_matrix_does_not_depend_on_time_and_names_survivors():
    survivor = _trial(killers=(), also=(KILL,))
    one = SelftestResult(started="now", duration=1.0, full=True, baselines=(GOOD,), mutants=(survivor,))
    two = SelftestResult(started="then", duration=9.0, full=True, baselines=(GOOD,), mutants=(survivor,))
    text = markdown(one)
    assert text == markdown(two)
    assert "**no case** on dcp-2.0" in text
    assert "answers \\| everything" in text
    assert "0 of 1 mutants" in text


# -- the command -------------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("few_cases")
@pytest.mark.parametrize("width", [60, 160])
def test_command(tmp_path, width):
    arguments = [EQUAL, "--profile", "dcp-2.0", "--jobs", "1", "--report-dir", str(tmp_path)]
    found = CliRunner().invoke(command, arguments, env={"COLUMNS": str(width)}, standalone_mode=False)
    assert found.exception is None
    assert found.return_value == 0, found.output
    assert "passes" in found.output
    assert "1 of 1 mutants killed" in found.output
    assert max(map(len, found.output.splitlines())) <= max(width, 100)
    data = json.loads((tmp_path / "selftest.json").read_bytes())
    assert data["schema"] == "dcp-conformance-selftest/1"
    assert data["mutants"][0]["mutant"] == EQUAL
    assert data["mutants"][0]["killers"][0]["requirements"]


def test_command_lists_mutants():
    found = CliRunner().invoke(command, ["--list", "BP-CLR-*"], standalone_mode=False)
    assert found.return_value == 0
    assert "M-BP-CLR-01-ok" in found.output
    assert f"since {SpecVersion.V1_1}]" in found.output


def test_command_reports_unknown_mutants():
    with pytest.raises(UsageError, match="no mutant is called"):
        CliRunner().invoke(command, ["M-nothing"], standalone_mode=False, catch_exceptions=False)


def test_command_reports_an_unwritable_file_before_it_begins(tmp_path, monkeypatch):
    monkeypatch.setattr(runner, "selftest", None)
    (tmp_path / "file").write_text("")
    arguments = [EQUAL, "--profile", "dcp-2.0", "--jobs", "1", "--report-dir", str(tmp_path / "file")]
    with pytest.raises(UsageError, match="cannot be written"):
        CliRunner().invoke(command, arguments, standalone_mode=False, catch_exceptions=False)


# -- the document ------------------------------------------------------------------------------------------------------


def test_the_document_has_all_mutants_and_no_survivor():
    text = DOCUMENT.read_text(encoding="utf-8").partition("\n## Mutants\n")[2].partition("\n## ")[0]
    rows = [
        tuple(cell.strip() for cell in line.split(" | "))
        for line in text.replace("\\|", "/").splitlines()
        if line.startswith("| `M-")
    ]
    shown = {row[0].strip("|` "): row[1:3] for row in rows}
    known = {each.id: (each.what.replace("|", "/"), ", ".join(each.requirements)) for each in MUTANTS.values()}
    assert shown == known, "make selftest-doc"
    assert "**no case**" not in text
