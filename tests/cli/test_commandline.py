"""How a command ends, whatever it does: its exit status, and one line on stderr."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

COMMAND = """
from dcp_codec.common.commandline import CommandLine

class Apart(Exception):
    pass

class Further(Apart):
    pass

main = CommandLine(name="trial", package="trial", commands={"end-it": "End.", "broken": "Cannot be imported."},
    about="Try.", exit_status="0 well.", failures={Apart: 4}, fault_status=7)
"""

SUBCOMMAND = """
import click, sys
from dcp_codec.common.commandline import ExpectedError
from rich.console import Console
from trial import Further

def stop(error):
    raise error

ENDS = {
    "nothing": lambda: None,
    "three": lambda: 3,
    "expected": lambda: stop(ExpectedError("put the fuse in")),
    "expected-5": lambda: stop(ExpectedError("put the fuse in", 5)),
    "failure": lambda: stop(Further("no tester")),
    "fault": lambda: stop(KeyError("an unexpected fault")),
    "absent": lambda: stop(ModuleNotFoundError("No module named scapy", name="scapy.all")),
    "interrupted": lambda: stop(KeyboardInterrupt()),
    "usage": lambda: stop(click.UsageError("not so")),
    "system": lambda: open("/nowhere/at/all"),
    "table": lambda: Console(width=60).print("± " * 100_000),
    "characters": lambda: print("± " + chr(0xDCF6)),
}

@click.command()
@click.argument("way")
@click.option("--lines", default=1)
def command(way, lines):
    for _ in range(lines):
        sys.stdout.write("said\\n")
    return ENDS[way]()
"""

Ends = Callable[..., "subprocess.CompletedProcess[str]"]


@pytest.fixture
def trial(tmp_path: Path) -> Ends:
    """Run ``trial ARGS`` in a process of its own."""
    package = tmp_path / "trial"
    package.mkdir()
    (package / "__init__.py").write_text(COMMAND)
    (package / "end_it.py").write_text(SUBCOMMAND)
    (package / "broken.py").write_text("raise RuntimeError('imported')\n")

    environment = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}

    def run(
        *args: str, stdout: int = subprocess.PIPE, shell: str = "", **more: str
    ) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-c", "from trial import main; main()", *args]
        if shell:
            command = ["sh", "-c", f'exec "$@" {shell}', "sh", *command]
        both = {**environment, **more}
        return subprocess.run(
            command, cwd=tmp_path, env=both, stdout=stdout, stderr=subprocess.PIPE, text=True, check=False
        )

    return run


@pytest.mark.parametrize(
    ("way", "status", "message"),
    [
        ("nothing", 0, ""),
        ("three", 3, ""),
        ("expected", 2, "trial: put the fuse in\n"),
        ("expected-5", 5, "trial: put the fuse in\n"),
        ("failure", 4, "trial: no tester\n"),
        (
            "absent",
            2,
            "trial: scapy is not installed: pip install 'dcp-conformance-kit[scapy]', "
            "in a clone of the kit pip install '.[scapy]'\n",
        ),
        ("interrupted", 130, "\n"),
        ("system", 2, "trial: /nowhere/at/all: No such file or directory\n"),
    ],
)
def test_a_subcommand_determines_the_exit_status(trial: Ends, way: str, status: int, message: str):
    done = trial("end-it", way)
    assert done.returncode == status
    assert done.stderr == message
    # Unreadable input ends the command; its output until then is complete.
    assert done.stdout == "said\n"


def test_wrong_usage(trial: Ends):
    done = trial("end-it", "usage")
    assert done.returncode == 2
    assert "Error: not so" in done.stderr
    assert trial("end-it").returncode == 2
    assert trial("end").returncode == 2


def test_an_internal_error_has_its_own_status_and_a_traceback(trial: Ends):
    done = trial("end-it", "fault")
    assert done.returncode == 7
    assert "Traceback" in done.stderr
    assert "an unexpected fault" in done.stderr


def test_help_imports_no_subcommand(trial: Ends):
    done = trial("--help")
    assert done.returncode == 0
    assert "broken  Cannot be imported." in done.stdout
    assert "Exit status: 0 well. 'trial COMMAND --help' has the details." in " ".join(done.stdout.split())
    assert trial("broken").returncode == 7


@pytest.mark.parametrize(("lines", "status"), [(10, 3), (100_000, 0)])
def test_a_closed_pipe_is_not_a_failure(trial: Ends, lines: int, status: int):
    reading, writing = os.pipe()
    os.close(reading)
    done = trial("end-it", "three", "--lines", str(lines), stdout=writing)
    os.close(writing)
    # Remaining output in the buffer at the end does not change the exit status of the subcommand.
    assert (done.returncode, done.stderr) == (status, "")


def test_a_closed_pipe_during_a_table_is_not_a_failure(trial: Ends):
    reading, writing = os.pipe()
    os.close(reading)
    done = trial("end-it", "table", stdout=writing)
    os.close(writing)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("way", ["characters", "table"])
def test_characters_that_the_terminal_cannot_show_are_escaped(trial: Ends, way: str):
    done = trial("end-it", way, PYTHONIOENCODING="ascii")
    assert (done.returncode, done.stderr) == (0, "")
    assert "\\xb1 " in done.stdout


@pytest.mark.parametrize("closed", ["<&-", ">&-", "2>&-", "<&- >&- 2>&-"])
def test_a_standard_stream_may_be_closed(trial: Ends, closed: str):
    done = trial("end-it", "three", shell=closed)
    assert (done.returncode, done.stderr) == (3, "")
    assert done.stdout == ("" if ">&-" in closed.split() else "said\n")


@pytest.mark.parametrize("lines", [10, 100_000])
@pytest.mark.parametrize("way", ["nothing", "expected-5"])
def test_a_full_disk_is_reported_in_one_line(trial: Ends, way: str, lines: int):
    with Path("/dev/full").open("w") as full:
        done = trial("end-it", way, "--lines", str(lines), stdout=full.fileno())
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1] == "trial: output cannot be written: No space left on device"
    assert "Traceback" not in done.stderr
    assert "Exception ignored" not in done.stderr
