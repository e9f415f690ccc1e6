"""Networks of processes in namespaces: cells in real time."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from dcp_conformance.interop.cell import Cell, run_cell
from dcp_conformance.interop.definition import all_tests
from dcp_conformance.interop.implementations import Implementation, built_in
from dcp_conformance.interop.results import CellResult
from dcp_conformance.model.verdict import Verdict

from dcp_stack.sim.testbed import namespaces

pytestmark = [pytest.mark.tool("ip"), pytest.mark.real_time]
NODE = "node:dcp-2.0"


@pytest.fixture(autouse=True)
def _nothing_stays_behind():
    if not namespaces.permitted():
        pytest.skip("network namespaces cannot be made here")
    yield
    assert namespaces.existing(namespaces.own_prefix()) == []


def play(b: Implementation, test: str, folder: Path | None = None) -> CellResult:
    cell = Cell(a="ours", b="theirs", test=test, implementations=(built_in(NODE), b), world="real")
    return run_cell(cell, all_tests()[test], folder)


def test_processes_pass_and_leave_recordings_and_logs(tmp_path: Path) -> None:
    result = play(built_in(NODE), "IT_VD_UPDATE-line3", tmp_path)
    assert result.verdict is Verdict.PASS, result.reason
    assert result.links["0>1"]["delivered"] > 0
    assert "0>2" not in result.links
    assert (tmp_path / result.recording).stat().st_size > 1000
    for station in result.stations:
        assert (tmp_path / station.recording).stat().st_size > 1000
        assert (tmp_path / station.log).is_file()
        assert station.beacons > 0


def test_a_faulty_process_turns_the_cell_red() -> None:
    result = play(built_in("mutant:M-VD-PU-07-ignored"), "IT_VD_UPDATE-pair")
    assert result.verdict is Verdict.FAIL
    assert "theirs" in result.reason


def test_a_death_fails_the_cell_with_the_last_words() -> None:
    command = [sys.executable, "-c", "import time; time.sleep(1); raise SystemExit('out of battery')"]
    result = play(Implementation(start=command, ready_s=3, srp=False), "IT_VD_UPDATE-pair")
    assert result.verdict is Verdict.FAIL
    assert "out of battery" in result.reason


def test_a_silent_implementation_without_upper_tester_fails_on_the_air() -> None:
    command = [sys.executable, "-c", "import time; time.sleep(1000)"]
    result = play(Implementation(start=command, ready_s=1), "IT_VD_UPDATE-pair")
    assert result.verdict is Verdict.FAIL
    assert "place 1 (theirs) said nothing of variable 20" in result.reason


def test_a_command_that_does_not_exist_is_an_error_with_its_name() -> None:
    result = play(Implementation(start="no-such-program-anywhere -i {interface}", ready_s=2), "IT_VD_UPDATE-pair")
    assert result.verdict in (Verdict.FAIL, Verdict.ERROR)
    assert "no-such-program-anywhere" in result.reason
