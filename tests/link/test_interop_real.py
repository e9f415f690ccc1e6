"""Networks of processes in namespaces: cells in real time."""

from __future__ import annotations

import contextlib
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.errors import ConformanceError
from dcp_lab.interop.cell import Cell, run_cell
from dcp_lab.interop.definition import PAIR, all_tests
from dcp_lab.interop.implementations import Implementation, built_in
from dcp_lab.interop.nodes.real import RealWorld
from dcp_lab.interop.results import CellResult
from dcp_lab.sim.testbed import namespaces

from dcp_codec.capture import open_capture

from ..waiting import eventually

pytestmark = pytest.mark.tool("ip")
NODE = "node:dcp-2.0"


@pytest.fixture(autouse=True)
def _no_namespace_remains():
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
    # Stations stamp their records with the real time, which rules compare with that of the recording.
    with open_capture(tmp_path / result.recording) as frames:
        assert abs(next(iter(frames)).time_ns - time.time_ns()) < 300 * 10**9
    assert (tmp_path / result.recording).stat().st_size > 1000
    for station in result.stations:
        assert (tmp_path / station.recording).stat().st_size > 1000
        assert (tmp_path / station.log).is_file()
        assert station.beacons > 0


def test_a_faulty_process_fails_the_cell() -> None:
    result = play(built_in("mutant:M-VD-PU-07-ignored"), "IT_VD_UPDATE-pair")
    assert result.verdict is Verdict.FAIL
    assert "theirs" in result.reason


def test_a_crash_fails_the_cell_with_the_last_output() -> None:
    command = [sys.executable, "-c", "import time; time.sleep(1); raise SystemExit('out of battery')"]
    result = play(Implementation(start=command, ready_s=3, srp=False), "IT_VD_UPDATE-pair")
    assert result.verdict is Verdict.FAIL
    assert "out of battery" in result.reason


SOCKET = "import socket, time; time.sleep({before}); s = socket.socket(socket.AF_PACKET, socket.SOCK_RAW); "


def test_a_silent_implementation_without_upper_tester_fails_by_missing_beacons() -> None:
    command = [sys.executable, "-c", SOCKET.format(before=0) + "time.sleep(1000)"]
    result = play(Implementation(start=command, ready_s=30), "IT_VD_UPDATE-pair")
    assert result.verdict is Verdict.FAIL
    assert "place 1 (theirs) sent nothing for variable 20" in result.reason


def test_an_absent_implementation_is_named_and_fails_no_requirement() -> None:
    command = [sys.executable, "-c", "import time; time.sleep(1000)"]
    result = play(Implementation(start=command, ready_s=1), "IT_VD_UPDATE-pair")
    assert result.verdict is Verdict.ERROR
    assert "not ready within 1 s: place 1 (theirs): no beacon, and no packet or UDP socket" in result.reason


FIXED = f"{sys.executable} -m dcp_stack.cli run --interface {{interface}} --node-id 02:00:00:00:00:01"
TALKS = f"{FIXED} --position track:circle,radius=5,speed=1"
SERVES = f"{FIXED} --control {{control}}"


@pytest.mark.parametrize("options", [{"start": TALKS}, {"start": SERVES, "upper_tester": "unix:{control}"}])
def test_an_identifier_of_another_station_is_named_and_fails_no_requirement(options: dict[str, Any]) -> None:
    result = play(Implementation(**options), "IT_VD_UPDATE-pair")
    assert result.verdict is Verdict.ERROR
    assert "place 1 (theirs) uses the node identifier 02:00:00:00:00:01 instead of 02:00:00:00:00:02" in result.reason


def test_a_command_that_does_not_exist_is_an_error_with_its_name() -> None:
    result = play(Implementation(start="no-such-program-anywhere -i {interface}", ready_s=2), "IT_VD_UPDATE-pair")
    assert result.verdict in (Verdict.FAIL, Verdict.ERROR)
    assert "no-such-program-anywhere" in result.reason


def world_of(command: str, told: list[str], **options: Any) -> RealWorld:
    each = Implementation(start=[sys.executable, "-c", command], **options)
    return RealWorld([("ours", built_in(NODE), "dcp-2.0"), ("theirs", each, "dcp-2.0")], PAIR, 1, on_wait=told.append)


def test_a_slow_start_is_awaited_and_takes_no_time_of_the_test() -> None:
    """A process without upper tester that has nothing to say is ready when it listens."""
    told: list[str] = []
    with contextlib.closing(world_of(SOCKET.format(before=4) + "time.sleep(1000)", told)) as world:
        world.power(1, on=True)
        begin = time.monotonic()
        world.run(10_000_000)
        assert 3.5 < time.monotonic() - begin < 60
        assert world.now < 1_000_000_000
    assert told == ["waiting for place 1 (theirs): no beacon, and no packet or UDP socket"]


def test_an_upper_tester_that_never_answers_is_named_after_the_longest_wait() -> None:
    with contextlib.closing(
        world_of("import time; time.sleep(1000)", [], upper_tester="unix:{control}", ready_s=0.5)
    ) as world:
        world.power(1, on=True)
        with pytest.raises(ConformanceError, match=r"within 0.5 s: place 1 \(theirs\): no answer of its upper tester"):
            world.run(10_000_000)


def test_processes_that_a_station_has_started_end_when_it_is_switched_off() -> None:
    command = "import subprocess, time; subprocess.Popen(['sleep', '1000']); " + SOCKET.format(before=0)
    with contextlib.closing(world_of(command + "time.sleep(1000)", [])) as world:
        world.power(1, on=True)
        world.run(10_000_000)
        name = namespaces.existing(namespaces.own_prefix())
        inside = [each for each in name if len(namespaces.run(["ip", "netns", "pids", each]).split()) == 2]
        assert len(inside) == 1
        world.power(1, on=False)
        eventually(lambda: not namespaces.run(["ip", "netns", "pids", inside[0]]).split(), "the child has ended")
