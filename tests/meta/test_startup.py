"""Imports of commands before their first output: only modules that they use, checked by name and not by time.

benchmarks/startup.py measures the time.
"""

from __future__ import annotations

import subprocess
import sys
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
        *(
            "scapy",
            "numba",
            "numpy",
            "pyarrow",
            "pandas",
            "polars",
            "duckdb",
            "distributed",
            "bokeh",
            "psutil",
            "matplotlib",
        ),
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
#: The package whose subcommands need schemas for their help; these commands spend their time on the work.
_WITH_SCHEMAS = "dcp-codec"
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
for line in sys.argv[1:]:
    try:
        main(line.split())
    except SystemExit as stop:
        print("STATUS", stop.code, file=sys.stderr)
    print("MODULES", *sys.modules, file=sys.stderr)
"""


def imported(name: str, *lines: str) -> list[set[str]]:
    """Return the modules of a process after each of these lines: it calls the command with one after another."""
    package = next(command.package for command in COMMANDS if command.name == name)
    program = PROGRAM.format(package=package)
    done = subprocess.run([sys.executable, "-c", program, *lines], capture_output=True, text=True, check=True)
    said = done.stderr.splitlines()
    assert "STATUS 2" not in said, done.stderr
    return [set(line.split()[1:]) for line in said if line.startswith("MODULES ")]


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.name)
def test_help_imports_nothing_that_it_does_not_show(command: CommandLine):
    [modules] = imported(command.name, "--help")
    assert not modules & (HEAVY | SHOWING | SCHEMAS | MACHINES | {"msgspec", "subprocess", "socket"})
    without = (
        HEAVY
        | SHOWING
        | MACHINES
        | {"importlib.metadata"}
        | (frozenset() if command.name == _WITH_SCHEMAS else SCHEMAS)
    )
    lines = [f"{name} --help" for name in command.subcommands]
    for line, modules in zip(lines, imported(command.name, *lines), strict=True):
        assert not modules & without, line


@pytest.mark.parametrize("line", WORK)
def test_work_imports_nothing_that_it_does_not_need(line: str):
    name, _, arguments = line.partition(" ")
    [modules] = imported(name, arguments)
    assert not modules & WORK[line]


def test_packages_export_all_listed_names():
    packages = ("dcp_spec", "dcp_codec", "dcp_tables", "dcp_stack", "dcp_conformance")
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
