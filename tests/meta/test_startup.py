"""Imports of commands before their first output: only modules that they use, checked by name and not by time.

benchmarks/startup.py measures the time.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from dcp_conformance.cli import main as conformance
from dcp_selftest.cli import main as selftest

from dcp_codec.cli import main as codec
from dcp_codec.common.commandline import CommandLine
from dcp_stack.cli import main as node

pytestmark = pytest.mark.part("tools")

RECORDING = str(Path(__file__).resolve().parents[2] / "captures" / "b_crud.mcap")
COMMANDS: tuple[CommandLine, ...] = (codec, node, conformance, selftest)
#: Of extras, of the tests, or slow: for those who ask for what needs them.
HEAVY = frozenset(
    (
        *("scapy", "numba", "numpy", "pyarrow", "pandas", "polars", "duckdb", "distributed", "bokeh", "psutil"),
        *("hypothesis", "pytest", "jinja2", "prometheus_client", "pymavlink", "yaml", "asyncio", "http.server"),
    )
)
#: Modules for commands that show tables and bars, or recordings.
SHOWING = frozenset(("rich", "mcap"))
#: Schemas, and all that is made of them.
SCHEMAS = frozenset(("construct", "dcp_spec.profile.loading", "dcp_codec.codec"))
#: Node, tester.
MACHINES = frozenset(
    (
        "dcp_stack.node",
        "dcp_stack.control.server",
        "dcp_conformance.test_system.bench",
        "dcp_conformance.execution.runner",
    )
)
#: Subcommands whose help still imports modules of their work; these commands spend their time on the work.
_WITH_SCHEMAS = frozenset(f"dcp-codec {name}" for name in codec.commands)


def helps() -> Iterator[tuple[str, frozenset[str]]]:
    """Yield each command for its help, and the modules that it must not import."""
    for command in COMMANDS:
        yield f"{command.name} --help", HEAVY | SHOWING | SCHEMAS | MACHINES | {"msgspec", "subprocess", "socket"}
        for subcommand in command.commands:
            name = f"{command.name} {subcommand}"
            yield f"{name} --help", HEAVY | SHOWING | MACHINES | (frozenset() if name in _WITH_SCHEMAS else SCHEMAS)


#: Commands that do something, and what that takes nothing of.
WORK = {
    "dcp-conformance list": HEAVY | SHOWING | {"dcp_stack.node"},
    "dcp-conformance run --dry-run": HEAVY | {"mcap", "dcp_stack.node"},
    "dcp-selftest mutants --list": HEAVY | {"mcap"},
    f"dcp-conformance check {RECORDING} --quiet": HEAVY - {"jinja2"} | {"dcp_stack.node"},
    "dcp-node run --link udp --print-config": HEAVY | SHOWING,
    "dcp-node status --control /no-such-folder/node.sock": HEAVY | SHOWING | SCHEMAS | MACHINES,
    f"dcp-codec decode --count 1 {RECORDING}": HEAVY | {"rich"},
    f"dcp-codec stats {RECORDING}": HEAVY,
    f"dcp-codec guess {RECORDING}": HEAVY | {"rich"},
    "dcp-codec profiles": HEAVY | SHOWING | {"construct"},
    "dcp-codec export lua --profile dcp-2.0": HEAVY | SHOWING,
}
PROGRAM = """
import sys
from {package} import main
try:
    main(sys.argv[1:])
except SystemExit as stop:
    print("STATUS", stop.code, file=sys.stderr)
print("MODULES", *sys.modules, file=sys.stderr)
"""


def imported(line: str) -> set[str]:
    """The modules that a process has imported which ran this command to its end."""
    name, *arguments = line.split()
    package = next(command.package for command in COMMANDS if command.name == name)
    program = PROGRAM.format(package=package)
    done = subprocess.run([sys.executable, "-c", program, *arguments], capture_output=True, text=True, check=True)
    *said, modules = done.stderr.splitlines()
    assert "STATUS 2" not in said, done.stderr
    return set(modules.split()[1:])


@pytest.mark.parametrize(("line", "without"), [pytest.param(*each, id=each[0]) for each in helps()])
def test_help_imports_nothing_that_it_does_not_show(line: str, without: frozenset[str]):
    assert not imported(line) & without


@pytest.mark.parametrize("line", WORK)
def test_work_imports_nothing_that_it_does_not_need(line: str):
    assert not imported(line) & WORK[line]


def test_packages_export_all_listed_names():
    packages = ("dcp_spec", "dcp_codec", "dcp_codec.table", "dcp_stack", "dcp_stack.control", "dcp_conformance")
    program = (
        "import importlib, sys\n"
        f"for package in {packages}:\n"
        "    module = importlib.import_module(package)\n"
        "    assert not {'construct', 'numba'} & set(sys.modules)\n"
        "    assert not hasattr(module, 'nothing_like_it')\n"
        f"for package in {packages}:\n"
        "    module = importlib.import_module(package)\n"
        "    assert all(getattr(module, name) is not None for name in module.__all__)\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True)
