"""``run --failed REPORT``: what did not pass last time comes first."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest
from dcp_conformance.execution.run import ConformanceRun
from dcp_conformance.execution.selection import Selection, select
from dcp_conformance.execution.target import TargetOptions
from dcp_conformance.model.case import SANITY, all_cases
from dcp_conformance.reporting import load_results

from ..command import Command

CASES = ("TC_VD_UPD_BV_01", "TC_BP_HDR_BV_01", "TC_VD_DEL_BI_01", "TC_BP_REG_BV_03")
FAILED, UNDECIDED = "TC_VD_UPD_BV_01", "TC_VD_DEL_BI_01"


@pytest.fixture
def report(dcp_conformance: Command, tmp_path: Path) -> Path:
    """A report in which one case failed and one was undecided; it also names a case that no longer exists."""
    assert dcp_conformance("run", "--in-process", *CASES, "--report-dir", tmp_path).status == 0
    file = tmp_path / "results.json"
    document = msgspec.json.decode(file.read_bytes())
    verdicts = {FAILED: "fail", UNDECIDED: "inconclusive"}
    for case in document["cases"]:
        case["verdict"] = verdicts.get(case["id"], case["verdict"])
    document["cases"].append({**document["cases"][0], "id": "TC_VD_GONE_BV_01", "verdict": "fail"})
    file.write_bytes(msgspec.json.encode(document))
    return tmp_path


def ran(folder: Path) -> list[str]:
    return [case.id for case in load_results(folder).cases]


def test_failed_cases_are_run_first(dcp_conformance: Command, report: Path, tmp_path: Path) -> None:
    out = tmp_path / "again"
    done = dcp_conformance("run", "--in-process", *CASES, "--failed", report, "--report-dir", out)
    assert done.status == 0, done.out
    found = ran(out)
    assert found[0] == SANITY
    assert set(found[1:3]) == {FAILED, UNDECIDED}
    assert set(found[3:-1]) == set(CASES) - {FAILED, UNDECIDED}


def test_only_failed_cases_are_run(dcp_conformance: Command, report: Path, tmp_path: Path) -> None:
    out = tmp_path / "again"
    file = report / "results.json"
    done = dcp_conformance("run", "--in-process", "--failed", file, "--failed-only", "--report-dir", out)
    assert done.status == 0, done.out
    assert set(ran(out)) == {SANITY, FAILED, UNDECIDED}


def test_nothing_to_repeat_is_reported(dcp_conformance: Command, tmp_path: Path) -> None:
    dcp_conformance("run", "--in-process", CASES[0], "--report-dir", tmp_path)
    done = dcp_conformance("run", "--in-process", "--failed", tmp_path, "--failed-only")
    assert done.status == 2
    assert "nothing to run" in done.err


@pytest.mark.parametrize(
    ("options", "words"),
    [(["--failed-only"], "--failed-only needs --failed"), (["--failed", "nowhere"], "nowhere: cannot be read")],
)
def test_contradictory_options_are_refused(dcp_conformance: Command, options: list[str], words: str) -> None:
    done = dcp_conformance("run", "--in-process", CASES[0], *options)
    assert done.status == 2
    assert words in done.err


def test_in_a_concurrent_run_failed_cases_are_executed_alone_first() -> None:
    run = ConformanceRun(
        TargetOptions(in_process=True), Selection(patterns=CASES, first=frozenset({FAILED})), side_by_side=16
    )
    run.execute()
    assert [result.id for result in run.results[:2]] == [SANITY, FAILED]
    assert not run.results[1].side_by_side
    assert any(result.side_by_side for result in run.results[2:])


def test_destructive_cases_stay_last() -> None:
    cases = all_cases()
    destructive = next(case.id for case in cases.values() if case.destructive)
    order = [case.id for case in select(cases, Selection(first=frozenset({destructive})))]
    first = order.index(destructive)
    assert all(cases[name].destructive for name in order[first:])
    assert not any(cases[name].destructive for name in order[:first])
