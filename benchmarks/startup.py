"""Time until the first output of commands: CPU time and the best wall time of each, beside bare Python.

``python benchmarks/startup.py [--rounds N] [PATTERN ...]``: patterns are globs of typed commands.

CPU time hardly depends on what else the machine does, wall time does: compare ratios within one run. Modules are
compiled once, as by an installation, whatever the environment sets for bytecode.
"""

from __future__ import annotations

import argparse
import fnmatch
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from dcp_conformance.cli import main as conformance
from rich.console import Console
from rich.table import Table

from dcp_codec.cli import main as codec
from dcp_codec.common.commandline import CommandLine
from dcp_stack.cli import main as node

RECORDING = Path(__file__).resolve().parents[1] / "captures" / "b_crud.mcap"
COMMANDS: tuple[CommandLine, ...] = (codec, node, conformance)
#: Commands that do some work, but should start as fast as help.
WORK = ("dcp-conformance list", f"dcp-codec decode {RECORDING} | head -1", "dcp-node run --link udp --print-config")


class Cost(NamedTuple):
    """Of one run of a command, in ms."""

    cpu: float
    wall: float


def typed() -> list[str]:
    """The commands as a user types them."""
    found = []
    for command in COMMANDS:
        found.append(f"{command.name} --help")
        found += [f"{command.name} {subcommand} --help" for subcommand in command.subcommands]
    return [*found, *WORK]


def argv(line: str) -> list[str]:
    """The command as a process of this interpreter and of this tree, without the shell where that is not needed."""
    name, _, rest = line.partition(" ")
    package = next(command.package for command in COMMANDS if command.name == name)
    program = [sys.executable, "-c", f"from {package} import main; main()"]
    if "|" not in rest:
        return [*program, *rest.split()]
    return ["/bin/sh", "-c", f"'{program[0]}' -c '{program[2]}' {rest}"]


def once(command: Sequence[str], environment: Mapping[str, str]) -> Cost:
    """Run it to its end."""
    before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment, check=True)
    wall, after = time.perf_counter() - begun, resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return Cost(1000 * cpu, 1000 * wall)


def best(commands: dict[str, list[str]], rounds: int) -> dict[str, Cost]:
    """The least of each, taken in turns so that no command has the quiet time for itself."""
    costs: dict[str, list[Cost]] = {name: [] for name in commands}
    with tempfile.TemporaryDirectory() as compiled:
        environment = {**os.environ, "PYTHONPYCACHEPREFIX": compiled}
        environment.pop("PYTHONDONTWRITEBYTECODE", None)
        for command in commands.values():
            once(command, environment)
        for _ in range(rounds):
            for name, command in commands.items():
                costs[name].append(once(command, environment))
    return {name: Cost(min(e.cpu for e in each), min(e.wall for e in each)) for name, each in costs.items()}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("patterns", nargs="*", default=["*"])
    parser.add_argument("--rounds", type=int, default=10)
    options = parser.parse_args()
    chosen = [line for line in typed() if any(fnmatch.fnmatch(line, pattern) for pattern in options.patterns)]
    bare = "python -c pass"
    costs = best({bare: [sys.executable, "-c", "pass"], **{line: argv(line) for line in chosen}}, options.rounds)
    table = Table(box=None)
    for heading in ("command", "processor ms", "wall ms", "bare Pythons"):
        table.add_column(heading, justify="left" if heading == "command" else "right", no_wrap=True)
    for line, cost in costs.items():
        shown = line.replace(str(RECORDING), RECORDING.name)
        table.add_row(shown, f"{cost.cpu:.0f}", f"{cost.wall:.0f}", f"{cost.cpu / costs[bare].cpu:.1f}")
    Console(width=110).print(table)


if __name__ == "__main__":
    main()
