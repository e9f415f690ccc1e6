"""Which random changes of the product does `make test` notice, and which of the rest `make test-all`?

``python tests/meta/mutation.py --reached FOLDER --seed 1 -n 150`` draws changes of the four packages (comparisons,
operators, constants, dropped statements, branches; never texts, which a reader judges). Each is made in a clone of the
committed tree. The tests of the core that execute the changed function run until one fails, the cheapest first; if
none fails, mypy; then the other parts in the same way. ``--reached`` is what ``reached.py`` has recorded::

    DCP_REACHED=FOLDER PYTHONPATH=tests/meta pytest -q -n 2 -p reached

Functions that no test executes in its own process are tried with the part ``links``, which starts processes.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import random
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from queue import Queue

import pytest
from dcp_selftest.generated import sites

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("spec/dcp_spec", "dcp_codec", "dcp_stack", "conformance/dcp_conformance")
#: Seconds of wall time for the tests of a part on one change.
LONGEST = 1500.0


@dataclass(frozen=True)
class Change:
    """One change of the source."""

    path: str
    line: int
    function: tuple[int, ...]
    """The first lines of the functions around it, the innermost first."""
    what: str
    start: int
    end: int
    """Offsets in the source, in octets."""
    after: str

    def __str__(self) -> str:
        return f"{self.path}:{self.line}: {self.what}"


@dataclass
class Reached:
    """The functions that each test executes."""

    costs: dict[str, float] = field(default_factory=dict)
    tests: dict[str, set[str]] = field(default_factory=dict)
    """By ``path:line`` of a function, the items that execute it."""

    def load(self, folder: Path) -> None:
        """Add the files of a folder."""
        for path in folder.glob("*.jsonl"):
            names: dict[int, str] = {}
            for line in path.read_text(encoding="utf-8").splitlines():
                entry = json.loads(line)
                if "new" in entry:
                    names |= {int(number): place for number, place in entry["new"].items()}
                    continue
                self.costs[entry["id"]] = entry["cpu"]
                for number in entry["functions"]:
                    self.tests.setdefault(names[number], set()).add(entry["id"])

    def of(self, change: Change) -> list[str]:
        """The items that execute the changed function, the cheapest first."""
        found: set[str] = set()
        for line in change.function[:1]:
            found |= self.tests.get(f"{change.path}:{line}", set())
        return sorted(found, key=lambda name: self.costs[name])


def changes_of(path: Path) -> Iterator[Change]:
    """All changes of a file."""
    source = path.read_bytes()
    tree = ast.parse(source)
    offsets = [0]
    for row in source.splitlines(keepends=True):
        offsets.append(offsets[-1] + len(row))
    functions = [each for each in ast.walk(tree) if isinstance(each, ast.FunctionDef | ast.AsyncFunctionDef)]
    for _, _, node in sites._candidates(tree):
        for change in sites._changes(node):
            place, after = node, "pass"
            if isinstance(node, ast.If):
                assert isinstance(change.replacement, ast.If)
                place, after = node.test, ast.unparse(change.replacement.test)
            elif change.replacement is not None:
                after = ast.unparse(change.replacement)
                after = after if isinstance(change.replacement, ast.stmt) else f"({after})"
            around = [each for each in functions if each.lineno <= place.lineno <= (each.end_lineno or 0)]
            around.sort(key=lambda each: -each.lineno)
            start = offsets[place.lineno - 1] + place.col_offset
            end = offsets[place.end_lineno - 1] + place.end_col_offset
            before = source[start:end].decode()
            # A function begins with its first decorator.
            first = tuple(min([each.lineno, *(deco.lineno for deco in each.decorator_list)]) for each in around)
            what = f"{change.operator}: {sites._short(before)} -> {sites._short(after)}"
            yield Change(str(path.relative_to(ROOT)), place.lineno, first, what, start, end, after)


class Clone:
    """A clone of the committed tree with an environment of its own."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        subprocess.run(["git", "clone", "--quiet", str(ROOT), str(folder)], check=True)
        uv = str(ROOT / ".venv" / "bin" / "uv")
        subprocess.run([uv, "venv", "--quiet", ".venv"], cwd=folder, check=True)
        install = [uv, "pip", "install", "--quiet", "--python", ".venv/bin/python", "-e", ".[test]", "-e", "./selftest"]
        subprocess.run(install, cwd=folder, check=True)
        if (ROOT / "node_modules").exists():
            (folder / "node_modules").symlink_to(ROOT / "node_modules")
        self.run([".venv/bin/mypy"])

    def run(self, command: list[str]) -> tuple[int, str]:
        """Exit status and output; 124 after ``LONGEST`` seconds."""
        done = subprocess.run(
            ["timeout", "--kill-after=5", str(LONGEST), *command], cwd=self.folder, stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace", check=False,
            env={**os.environ, "PYTHONHASHSEED": "0"},
        )  # fmt: skip
        return done.returncode, done.stdout

    def noticed_by(self, items: list[str], *parts: str) -> str:
        """The first of the items that fails; empty if none does."""
        if not items and parts != ("links",):
            return ""
        listed = self.folder / ".git" / "items"
        listed.write_text("\n".join(items))
        files = sorted({each.partition("::")[0] for each in items})
        command = [".venv/bin/pytest", "-q", "-x", "-p", "no:cacheprovider", "-p", "mutation", f"--only={listed}"]
        command += [f"--part={part}" for part in parts]
        if parts == ("links",):
            command = [".venv/bin/pytest", "-q", "-x", "-n", "4", "--dist", "loadfile", "--part=links"]
        status, output = self.run(["env", "PYTHONPATH=tests/meta", *command, *files])
        if status in (0, 5):
            return ""
        failed = [line for line in output.splitlines() if line.startswith(("FAILED", "ERROR"))]
        return failed[0][:150] if failed else f"status {status}: {output.strip()[-150:]}"

    def judge(self, change: Change, reached: Reached) -> tuple[str, str]:
        """Return the part that notices the change (``core``, ``other`` or ``-``) and the test."""
        path = self.folder / change.path
        source = path.read_bytes()
        path.write_bytes(source[: change.start] + change.after.encode() + source[change.end :])
        try:
            items = reached.of(change)
            if found := self.noticed_by(items, "core"):
                return "core", found
            status, output = self.run([".venv/bin/mypy"])
            if status:
                return "core", f"mypy: {output.splitlines()[0][:120]}"
            if found := self.noticed_by(items, "suite", "tools", "tables"):
                return "other", found
            if not items and (found := self.noticed_by([], "links")):
                return "other", found
            return "-", f"{len(items)} items execute the function"
        finally:
            path.write_bytes(source)


# -- as a plugin of pytest ---------------------------------------------------------------------------------------------


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--only", type=Path, help="run only the items listed in this file, in its order")


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    order = {name: number for number, name in enumerate(config.getoption("--only").read_text().splitlines())}
    items[:] = sorted((each for each in items if each.nodeid in order), key=lambda each: order[each.nodeid])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--reached", type=Path, action="append", required=True, help="output of reached.py")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("-n", type=int, default=150, help="number of changes (default 150)")
    parser.add_argument("--jobs", type=int, default=2, help="changes that are tried at the same time (default 2)")
    parser.add_argument("--seconds", type=float, default=1e9, help="begin no change later than this")
    parser.add_argument("--list", action="store_true", help="only print the changes")
    arguments = parser.parse_args()
    paths = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
    known = [change for path in paths for change in changes_of(path)]
    drawn = random.Random(arguments.seed).sample(known, arguments.n)
    print(f"{arguments.n} of {len(known)} changes, seed {arguments.seed}", flush=True)
    if arguments.list:
        print(*drawn, sep="\n")
        return 0
    reached = Reached()
    for folder in arguments.reached:
        reached.load(folder)
    counted: Counter[str] = Counter()
    begun = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="mutation-") as temporary:
        clones: Queue[Clone] = Queue()
        for number in range(arguments.jobs):
            clones.put(Clone(Path(temporary) / f"clone{number}"))

        def attempt(change: Change) -> tuple[str, str] | None:
            if time.monotonic() > begun + arguments.seconds:
                return None
            clone = clones.get()
            try:
                return clone.judge(change, reached)
            finally:
                clones.put(clone)

        with ThreadPoolExecutor(arguments.jobs) as pool:
            for number, (change, done) in enumerate(zip(drawn, pool.map(attempt, drawn), strict=True), 1):
                if done is None:
                    continue
                counted[done[0]] += 1
                print(f"{number:3} {done[0]:5} {change}\n          {done[1]}", flush=True)
    noticed = counted["core"] + counted["other"]
    print(f"noticed by make test: {counted['core']}; by the other parts only: {counted['other']}; by none:", end=" ")
    print(f"{counted['-']}; share of make test: {counted['core'] / max(1, noticed):.1%}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
