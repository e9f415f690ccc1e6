"""The traceability matrix is complete and up to date, and errors in it are noticed."""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner
from dcp_conformance.definitions.case import Case, Kind
from dcp_conformance.errors import UsageError
from dcp_selftest import traceability
from dcp_selftest.cli.matrix import command as matrix_command
from dcp_selftest.traceability import DOCUMENT, LEDGER, UNDECIDED, matrix, outdated, render, write
from dcp_spec.catalogue.requirements import requirements

ROOT = Path(__file__).parents[2]
ALL = tuple(requirements())
MANDATORY = next(name for name, each in requirements().items() if each.level == "mandatory")


def test_nothing_is_missing():
    problems = matrix(ROOT).problems()
    assert not problems, f"{len(problems)} problems (make matrix):\n" + "\n".join(problems[:20])


def test_the_committed_document_is_up_to_date():
    assert not outdated(ROOT, matrix(ROOT)), f"{DOCUMENT} is outdated: run make matrix"


def test_the_same_repository_gives_the_same_document():
    assert render(matrix(ROOT)) == render(matrix(ROOT))


# -- a small repository ------------------------------------------------------------------------------------------------


def case_of(identifier: str, *ids: str) -> Case:
    return Case(
        id=identifier,
        purpose="shows something",
        requirements=ids,
        kind=Kind.VALID,
        stimulus="",
        expect="",
        window=4,
        section="",
        module="",
        run=lambda _: None,
    )


EVERYTHING = {"TC_VD_PAY_BV_01-a": case_of("TC_VD_PAY_BV_01-a", *ALL)}


@pytest.fixture
def repository(tmp_path):
    """A repository in which nothing is wrong: one module cites all requirements, one case decides them."""
    for folder in (*traceability.CODE, "tests/unit", "docs", Path(LEDGER).parent, Path(UNDECIDED).parent):
        (tmp_path / folder).mkdir(parents=True, exist_ok=True)
    (tmp_path / "dcp_stack" / "all.py").write_text("".join(f"##= {name}\n" for name in ALL))
    (tmp_path / LEDGER).write_text("TC_VD_PAY_BV_01-a\n")
    return tmp_path


def problems_of(repository: Path, cases: dict[str, Case] | None = None) -> list[str]:
    return matrix(repository, EVERYTHING if cases is None else cases).problems()


def test_a_complete_repository_has_no_problems(repository):
    assert problems_of(repository) == []


def test_citations_tests_and_cases_are_joined(repository):
    (repository / "spec" / "dcp_spec" / "some.py").write_text('rule = "VD-IC-03"\n')
    (repository / "tests" / "unit" / "test_some.py").write_text('@pytest.mark.req("VD-IC-03")\ndef test_it(): ...\n')
    row = next(each for each in matrix(repository, EVERYTHING).rows if each.requirement.id == "VD-IC-03")
    assert row.code == ("dcp_stack/all", "spec/dcp_spec/some")
    assert row.tests == ("unit/test_some",)
    assert row.cases == ("TC_VD_PAY_BV_01",)
    (line,) = [each for each in render(matrix(repository, EVERYTHING)).splitlines() if each.startswith("| VD-IC-03 ")]
    assert line.startswith("| VD-IC-03 | M | W | vardis ")
    assert line.endswith("| all, some | unit/test_some | VD_PAY_BV_01 |  |")


def test_rules_of_recordings_are_in_the_ledger_and_beside_their_requirements():
    found = matrix(ROOT)
    assert {"CK_VD_SEQNO", "CK_BP_JITTER"} <= set(found.rule_ids) <= set(found.ledger)
    row = next(each for each in found.rows if each.requirement.id == "VD-PU-06")
    assert "CK_VD_SEQNO" in row.rules
    (line,) = [each for each in render(found).splitlines() if each.startswith("| VD-PU-06 ")]
    assert "VD_SEQNO" in line.rsplit("|", 2)[1]


def test_the_identifier_of_a_rule_is_never_used_again(repository):
    found = dataclasses.replace(matrix(repository, EVERYTHING), rule_ids=("CK_NEW",))
    assert any("not in" in each and "CK_NEW" in each for each in found.problems())
    retired = dataclasses.replace(found, ledger={**found.ledger, "CK_NEW": True})
    assert any("CK_NEW is retired" in each for each in retired.problems())


def test_unknown_ids_are_found_everywhere(repository):
    (repository / "dcp_codec" / "some.py").write_text("##= VD-XYZ-99\n")
    (repository / "tests" / "unit" / "test_some.py").write_text('@pytest.mark.req("BP-RX-77")\n')
    (repository / UNDECIDED).write_text('[[undecided]]\nid = "VD-NO-01"\nwhy = "none"\n')
    found = "\n".join(problems_of(repository))
    assert "VD-XYZ-99 is not a requirement, but is named in dcp_codec/some" in found
    assert "BP-RX-77 is not a requirement, but is named in unit/test_some" in found
    assert f"VD-NO-01 is not a requirement, but is named in {UNDECIDED}" in found


def test_a_mandatory_requirement_needs_code_or_a_test(repository):
    others = "".join(f"##= {name}\n" for name in ALL if name != MANDATORY)
    (repository / "dcp_stack" / "all.py").write_text(others)
    assert problems_of(repository) == [f"{MANDATORY} is mandatory, but no code cites it and no test is marked with it"]
    (repository / "tests" / "unit" / "test_some.py").write_text(f'@pytest.mark.req("{MANDATORY}")\n')
    assert problems_of(repository) == []


def test_a_requirement_needs_a_case_or_a_reason(repository):
    cases = {"TC_VD_PAY_BV_01-a": case_of("TC_VD_PAY_BV_01-a", *(name for name in ALL if name != "VD-IC-03"))}
    (problem,) = problems_of(repository, cases)
    assert problem.startswith("VD-IC-03 (wire): no case decides it")
    (repository / UNDECIDED).write_text('[[undecided]]\nid = "VD-IC-03"\nwhy = "cannot | be seen"\n')
    assert problems_of(repository, cases) == []
    assert r"*cannot \| be seen*" in render(matrix(repository, cases))


def test_a_reason_beside_a_case_is_a_contradiction(repository):
    (repository / UNDECIDED).write_text('[[undecided]]\nid = "VD-IC-03"\nwhy = "cannot be seen"\n')
    (problem,) = problems_of(repository)
    assert problem == f"{UNDECIDED} has VD-IC-03, but TC_VD_PAY_BV_01 decide it; remove the entry"


@pytest.mark.parametrize("ids", [("VD-IC-03", "VD-IC-01"), ("VD-IC-01", "VD-IC-01")])
def test_reasons_are_sorted_and_unique(repository, ids):
    cases = {"TC_VD_PAY_BV_01-a": case_of("TC_VD_PAY_BV_01-a", *(name for name in ALL if name not in ids))}
    text = "".join(f'[[undecided]]\nid = "{name}"\nwhy = "a reason"\n' for name in ids)
    (repository / UNDECIDED).write_text(text)
    (problem,) = problems_of(repository, cases)
    assert f"{ids[1]} comes after {ids[0]}" in problem


def test_identifiers_are_remembered_and_never_used_again(repository):
    (repository / LEDGER).write_text("TC_VD_OLD_BV_01\nTC_VD_OLD_BV_02 retired\n")
    found = "\n".join(problems_of(repository))
    assert f"not in {LEDGER}: TC_VD_PAY_BV_01-a" in found
    assert f"TC_VD_OLD_BV_01 is in {LEDGER}, but the case does not exist" in found
    assert "TC_VD_OLD_BV_02" not in found
    again = {"TC_VD_OLD_BV_02": case_of("TC_VD_OLD_BV_02", *ALL)}
    assert any("TC_VD_OLD_BV_02 is retired" in each for each in problems_of(repository, again))


def test_the_ledger_only_grows(repository):
    text = traceability.ledger_text({"TC_B": True, "TC_C": False}, ["TC_A", "TC_B"])
    assert text == "TC_A\nTC_B retired\nTC_C\n"


@pytest.mark.parametrize(
    ("file", "text", "message"),
    [
        (LEDGER, "TC_A\nTC_A\n", "line 2: TC_A is a duplicate"),
        (LEDGER, "TC_A gone\n", "line 1: 'TC_A gone'"),
        (UNDECIDED, "[[undecided]]\nid = 3\nwhy = ''\n", "Expected `str`"),
        (UNDECIDED, "[[undecided\n", UNDECIDED),
    ],
)
def test_invalid_files_are_named(repository, file, text, message):
    (repository / file).write_text(text)
    with pytest.raises(UsageError) as error:
        matrix(repository, EVERYTHING)
    assert message in str(error.value)
    assert str(repository) in str(error.value)


def test_another_folder_is_refused(tmp_path):
    with pytest.raises(UsageError, match="not a checkout"):
        matrix(tmp_path)


def test_the_command_writes_both_files_and_checks_them(tmp_path):
    for folder in (*traceability.CODE, "tests"):
        shutil.copytree(ROOT / folder, tmp_path / folder, ignore=shutil.ignore_patterns("__pycache__", "*.mcap"))
    for folder in ("docs", Path(LEDGER).parent, Path(UNDECIDED).parent):
        (tmp_path / folder).mkdir(parents=True)
    if (ROOT / UNDECIDED).exists():
        shutil.copy(ROOT / UNDECIDED, tmp_path / UNDECIDED)
    command = CliRunner().invoke
    done = command(matrix_command, ["--check", str(tmp_path)], standalone_mode=False)
    assert done.return_value == 1
    assert "run make matrix" in done.output
    found = write(tmp_path)
    assert set(found.ledger) == {*found.case_ids, *found.rule_ids}
    assert not outdated(tmp_path, found)
    done = command(matrix_command, [str(tmp_path)], standalone_mode=False)
    assert done.return_value == bool(found.problems())
