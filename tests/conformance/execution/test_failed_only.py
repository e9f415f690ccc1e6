"""``run --failed REPORT``: only cases that did not pass last time."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest
from dcp_conformance.definitions.case import SANITY
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


def test_only_failed_cases_are_run(dcp_conformance: Command, report: Path, tmp_path: Path) -> None:
    out = tmp_path / "again"
    file = report / "results.json"
    done = dcp_conformance("run", "--in-process", "--failed", file, "--report-dir", out)
    assert done.status == 0, done.out
    assert set(ran(out)) == {SANITY, FAILED, UNDECIDED}


def test_nothing_to_repeat_is_reported(dcp_conformance: Command, tmp_path: Path) -> None:
    dcp_conformance("run", "--in-process", CASES[0], "--report-dir", tmp_path)
    done = dcp_conformance("run", "--in-process", "--failed", tmp_path)
    assert done.status == 2
    assert "nothing to run" in done.err


def test_a_missing_report_is_refused(dcp_conformance: Command) -> None:
    done = dcp_conformance("run", "--in-process", CASES[0], "--failed", "nowhere")
    assert done.status == 2
    assert "nowhere: cannot be read" in done.err
