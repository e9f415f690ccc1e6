"""``dcp-conformance interop`` with processes is interrupted: it reports results so far and removes everything."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from dcp_lab.interop.workers.pool import _END
from dcp_lab.sim.testbed import namespaces

from ..waiting import PATIENCE, eventually

pytestmark = pytest.mark.tool("ip")
COMMAND = Path(sys.executable).with_name("dcp-conformance")
MARK = "DCP_TEST_MARK"
#: A cell that ends soon, and one that takes half a minute.
TESTS = ("IT_VD_ONEWAY-pair", "IT_NET_BABBLER-pair", "IT_VD_LOSS-pair-50")


class Running:
    """The command, and every process that descends from it."""

    def __init__(self, folder: Path) -> None:
        self.mark = uuid.uuid4().hex
        words = [word for test in TESTS for word in ("--test", test)]
        self.process = subprocess.Popen(
            [str(COMMAND), "interop", "--with", "node:dcp-2.0", *words, "--jobs", "3", "--report-dir", str(folder)],
            env={**os.environ, MARK: self.mark, "PYTHONUNBUFFERED": "1"},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            text=True,
        )

    def lines(self) -> Iterator[str]:
        assert self.process.stdout is not None
        return iter(self.process.stdout.readline, "")

    def descendants(self) -> list[int]:
        found = []
        for entry in Path("/proc").iterdir():
            with contextlib.suppress(OSError):
                if entry.name.isdigit() and f"{MARK}={self.mark}".encode() in (entry / "environ").read_bytes():
                    found.append(int(entry.name))
        return [pid for pid in found if pid != self.process.pid]

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        for pid in self.descendants():
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        assert self.process.stdout is not None
        self.process.stdout.close()
        namespaces.sweep()


@pytest.fixture
def running(tmp_path: Path) -> Iterator[Running]:
    if not namespaces.permitted():
        pytest.skip("network namespaces cannot be made here")
    made = Running(tmp_path / "report")
    try:
        yield made
    finally:
        made.close()


def namespaces_of(pids: list[int]) -> list[str]:
    return [name for name in namespaces.existing() if int(name.split("-")[1]) in pids]


def after_the_first_cell(running: Running) -> list[int]:
    """Wait until a cell was judged while others run; returns all processes of the command."""
    for line in running.lines():
        if line.startswith("1/"):
            break
    else:
        pytest.fail("no cell was finished")
    eventually(lambda: namespaces_of(running.descendants()), "a cell is running")
    return running.descendants()


def to_the_process(number: int) -> Callable[[Running], None]:
    return lambda running: running.process.send_signal(number)


def to_the_group(number: int) -> Callable[[Running], None]:
    return lambda running: os.killpg(running.process.pid, number)


@pytest.mark.parametrize(
    "send",
    [
        pytest.param(to_the_process(signal.SIGTERM), id="SIGTERM"),
        pytest.param(to_the_process(signal.SIGHUP), id="SIGHUP"),
        pytest.param(to_the_group(signal.SIGINT), id="Ctrl-C"),
        pytest.param(to_the_group(signal.SIGTERM), id="SIGTERM to the group, as timeout(1) sends it"),
    ],
)
def test_an_interrupted_matrix_is_reported_and_removed(running: Running, tmp_path: Path, send) -> None:
    pids = after_the_first_cell(running)
    send(running)
    said = "".join(running.lines())
    # The command waits for a worker that does not end, and then ends without it.
    assert running.process.wait(_END - 10) == 130, said
    assert "Traceback" not in said
    assert running.descendants() == []
    assert namespaces_of(pids) == []
    report = json.loads((tmp_path / "report" / "interop.json").read_bytes())
    assert [cell["test"] for cell in report["cells"]] == ["IT_VD_ONEWAY-pair"]
    assert report["ended_early"] == "interrupted"
    assert report["unfinished"] == 2
    assert "interrupted: 2 of 3 cells were not run" in said
    assert "interrupted: 2 of 3 cells" in (tmp_path / "report" / "interop.html").read_text()
    assert "interrupted: 2 of 3 cells" in (tmp_path / "report" / "interop.md").read_text()


def test_nothing_remains_of_a_killed_command(running: Running) -> None:
    pids = after_the_first_cell(running)
    running.process.kill()
    eventually(lambda: not running.descendants(), "all processes have ended")
    assert namespaces_of(pids) == []


def test_a_killed_worker_is_an_error_of_the_tester_and_the_report_is_written(running: Running, tmp_path: Path) -> None:
    pids = after_the_first_cell(running)
    worker = int(namespaces_of(pids)[0].split("-")[1])
    os.kill(worker, signal.SIGKILL)
    said = "".join(running.lines())
    assert running.process.wait(PATIENCE) == 4, said
    assert "a worker process ended by itself" in said
    assert running.descendants() == []
    assert namespaces_of(pids) == []
    assert len(json.loads((tmp_path / "report" / "interop.json").read_bytes())["cells"]) == 1
