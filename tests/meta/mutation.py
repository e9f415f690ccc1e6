"""Which random changes of the product does `make test` notice, and which of the rest `make test-all`?

``python tests/meta/mutation.py FOLDER --seed 1 -n 150`` draws changes of the packages (comparisons, operators,
constants, dropped statements, branches; never texts, which a reader judges). It first runs all tests in a clone in
which each changed statement records the tests that execute it, also in processes that they start, and keeps the result
in FOLDER for a next run. Then each change is made in a clone of the committed tree. The tests of the core that execute
the statement run until one fails, the cheapest first; if none fails, mypy; then the other parts in the same way.
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
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from queue import Queue

import pytest
from dcp_selftest.generated import sites

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("spec", "dcp_codec", "dcp_stack", "conformance", "lab", "tables")
PARTS = ("core", "suite", "tools", "tables", "links")
#: Module of a clone that appends the number of a change and the present test to a file, each pair once a process.
HITS = """
import os
_seen = set()

def hit(numbers):
    test = os.environ.get("PYTEST_CURRENT_TEST", "")
    if (numbers[0], test) not in _seen:
        _seen.add((numbers[0], test))
        file = os.open({path!r}, os.O_APPEND | os.O_CREAT | os.O_WRONLY, 0o666)
        os.write(file, "".join(f"{{number}} {{test}}\\n" for number in numbers).encode())
        os.close(file)
"""
#: Seconds of wall time for the tests of a part on one change.
LONGEST = 1500.0
#: CPU seconds of the tests that are tried with each change alone.
CHEAP = 40.0
#: CPU seconds after which a process of tests that are chosen is ended.
_ENDLESS = 400


@dataclass(frozen=True)
class Change:
    """One change of the source."""

    path: str
    line: int
    what: str
    start: int
    end: int
    """Offsets in the source, in octets."""
    after: str

    def __str__(self) -> str:
        return f"{self.path}:{self.line}: {self.what}"


@dataclass
class Reached:
    """The tests that execute each change."""

    tests: dict[str, list[str]]
    """Items by change, the cheapest first."""
    costs: dict[str, float]
    """CPU seconds of each item."""

    @classmethod
    def record(cls, folder: Path, drawn: list[Change], name: str) -> Reached:
        """Run all tests in a clone whose changed statements record them, unless ``folder`` has the result ``name``."""
        stored = folder / f"{name}.json"
        if not stored.exists():
            folder.mkdir(parents=True, exist_ok=True)
            hits, costs = folder / "hits", dict[str, float]()
            with tempfile.TemporaryDirectory(prefix="mutation-") as temporary:
                clone = Clone(Path(temporary) / "clone")
                clone.mark(drawn, hits)
                for part in PARTS:
                    workers = ["-n", "6", "--dist", "loadfile"] if part == "links" else ["-n", "2"]
                    command = [".venv/bin/pytest", "-q", *workers, f"--part={part}", f"--costs={folder / part}.json"]
                    print(f"{part}: {clone.run(command, 10 * LONGEST)[1].splitlines()[-1]}", flush=True)
                    costs |= json.loads((folder / f"{part}.json").read_text())
            found: dict[str, set[str]] = {}
            for line in hits.read_text().splitlines():
                number, _, item = line.partition(" ")
                found.setdefault(str(drawn[int(number)]), set()).add(item.rpartition(" ")[0])
            tests = {name: sorted(items & costs.keys(), key=lambda each: costs[each]) for name, items in found.items()}
            stored.write_text(json.dumps({"tests": tests, "costs": costs}))
        return cls(**json.loads(stored.read_text()))

    def of(self, change: Change) -> list[str]:
        """The items that execute the change, the cheapest first."""
        return self.tests.get(str(change), [])


def changes_of(path: Path) -> Iterator[Change]:
    """All changes of a file."""
    source = path.read_bytes()
    tree = ast.parse(source)
    offsets = [0]
    for row in source.splitlines(keepends=True):
        offsets.append(offsets[-1] + len(row))
    for _, _, node in sites._candidates(tree):
        for change in sites.changes(node):
            place, after = node, "pass"
            if isinstance(node, ast.If):
                assert isinstance(change.replacement, ast.If)
                place, after = node.test, ast.unparse(change.replacement.test)
            elif change.replacement is not None:
                after = ast.unparse(change.replacement)
                after = after if isinstance(change.replacement, ast.stmt) else f"({after})"
            start = offsets[place.lineno - 1] + place.col_offset
            end = offsets[place.end_lineno - 1] + place.end_col_offset
            before = source[start:end].decode()
            what = f"{change.operator}: {sites._short(before)} -> {sites._short(after)}"
            yield Change(str(path.relative_to(ROOT)), place.lineno, what, start, end, after)


def marked_lines(tree: ast.Module, line: int) -> set[int]:
    """The lines before which a statement records that the change in ``line`` is executed.

    That is the innermost statement in a function. A change outside of functions may have an effect in all functions of
    the module. Functions that are compiled for another machine (Numba) record nothing: their callers do.
    """
    functions = [each for each in ast.walk(tree) if isinstance(each, ast.FunctionDef)]
    plain = [
        each
        for each in functions
        if not any("machine" in ast.dump(one) or "helper" in ast.dump(one) for one in each.decorator_list)
    ]
    around = [
        each for each in functions if each.lineno <= line <= (each.end_lineno or 0) and each.body[0].lineno <= line
    ]
    if not around or around[-1] not in plain:
        return {first for each in plain for first in _first_lines(each)}
    lines = set[int]()
    for node in ast.walk(max(around, key=lambda each: each.lineno)):
        for block in ("body", "orelse", "finalbody"):
            statements = getattr(node, block, [])
            for each in statements if isinstance(statements, list) else []:
                is_elif = isinstance(node, ast.If) and block == "orelse" and each.col_offset == node.col_offset
                same = each.lineno == getattr(node, "lineno", 0)
                if (
                    isinstance(each, ast.stmt)
                    and each.lineno <= line <= (each.end_lineno or 0)
                    and not (is_elif or same)
                ):
                    lines.add(min([each.lineno, *(one.lineno for one in getattr(each, "decorator_list", []))]))
    return {max(lines)} if lines else set()


def _first_lines(function: ast.FunctionDef) -> list[int]:
    """The line of the first statement after the documentation; none if it has no line of its own."""
    body = function.body[1:] if isinstance(function.body[0], ast.Expr) and len(function.body) > 1 else function.body
    return [body[0].lineno] if body[0].lineno > function.lineno and not isinstance(body[0], ast.FunctionDef) else []


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

    def mark(self, drawn: list[Change], hits: Path) -> None:
        """Have the statements of the changes append ``NUMBER TEST`` to the file ``hits``."""
        (self.folder / "spec/dcp_spec/mutation_hits.py").write_text(HITS.format(path=str(hits)))
        marks: dict[str, dict[int, list[int]]] = {}
        for number, change in enumerate(drawn):
            for line in marked_lines(ast.parse((self.folder / change.path).read_text()), change.line):
                marks.setdefault(change.path, {}).setdefault(line, []).append(number)
        for name, lines in marks.items():
            path = self.folder / name
            source = path.read_text().splitlines(keepends=True)
            for line, numbers in lines.items():
                text = source[line - 1]
                indent = text[: len(text) - len(text.lstrip())]
                source[line - 1] = f"{indent}__import__('dcp_spec.mutation_hits').mutation_hits.hit({numbers})\n{text}"
            path.write_text("".join(source))

    def run(self, command: list[str], longest: float = LONGEST) -> tuple[int, str]:
        """Exit status and output; 124 after ``longest`` seconds."""
        done = subprocess.run(
            ["timeout", "--kill-after=5", str(longest), *command], cwd=self.folder, stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace", check=False,
            env={**os.environ, "PYTHONHASHSEED": "0"},
        )  # fmt: skip
        return done.returncode, done.stdout

    @contextmanager
    def changed(self, *changes: Change) -> Iterator[None]:
        """Make the changes in the tree, and undo them at the end."""
        paths = {change.path: (self.folder / change.path).read_bytes() for change in changes}
        try:
            for change in sorted(changes, key=lambda each: each.start, reverse=True):
                path = self.folder / change.path
                source = path.read_bytes()
                path.write_bytes(source[: change.start] + change.after.encode() + source[change.end :])
            yield
        finally:
            for name, source in paths.items():
                (self.folder / name).write_bytes(source)

    def noticed_by(self, items: list[str], *parts: str) -> str:
        """The first of the items that fails; empty if none does."""
        if not items:
            return ""
        listed = self.folder / ".git" / "items"
        listed.write_text("\n".join(items))
        files = sorted({each.partition("::")[0] for each in items})
        command = [".venv/bin/pytest", "-q", "-x", "-p", "no:cacheprovider", "-p", "mutation", f"--only={listed}"]
        command += [f"--part={part}" for part in parts]
        # A change may make a loop endless.
        status, output = self.run(["env", "PYTHONPATH=tests/meta", "prlimit", f"--cpu={_ENDLESS}", *command, *files])
        if status in (0, 5):
            return ""
        failed = _failures(output)
        return failed[0] if failed else f"status {status}: {output.strip()[-150:]}"

    def failures(self, *parts: str) -> set[str]:
        """Run parts of the tests, and return the items that fail."""
        found = set[str]()
        for part in parts:
            workers = ["-n", "6", "--dist", "loadfile"] if part == "links" else ["-n", "2"]
            status, output = self.run([".venv/bin/pytest", "-q", *workers, f"--part={part}"], 3 * LONGEST)
            found.update(_failures(output))
            print(f"  {part}: status {status}, {output.splitlines()[-1]}", flush=True)
        return found


def _failures(output: str) -> list[str]:
    """The items that the summary of pytest names."""
    return [
        line.split(" ", 1)[1].partition(" - ")[0]
        for line in output.splitlines()
        if line.startswith(("FAILED ", "ERROR "))
    ]


class Judge:
    """Judges changes in clones, and keeps the verdicts in a file."""

    def __init__(self, file: Path, clones: list[Clone], reached: Reached) -> None:
        self._file = file
        self._clones = Queue[Clone]()
        for clone in clones:
            self._clones.put(clone)
        self._jobs = len(clones)
        self._reached = reached
        self.verdicts: dict[str, tuple[str, str]] = json.loads(file.read_text()) if file.exists() else {}
        """By change: the part that notices it (``core``, ``other``, ``-``), and the test."""

    def left(self, changes: list[Change]) -> list[Change]:
        """The changes without a verdict."""
        return [each for each in changes if str(each) not in self.verdicts]

    def alone(self, changes: list[Change]) -> None:
        """Stage 1."""

        def attempt(clone: Clone, change: Change) -> str:
            cost, cheap = 0.0, list[str]()
            for item in self._reached.of(change):
                cost += self._reached.costs[item]
                if cost > CHEAP and cheap:
                    break
                cheap.append(item)
            if found := clone.noticed_by(cheap, "core"):
                return found
            status, output = clone.run([".venv/bin/mypy"])
            return f"mypy: {output.splitlines()[0][:120]}" if status else ""

        self._each("core", attempt, changes)

    def together(self, changes: list[Change], verdict: str, *parts: str) -> None:
        """Stages 2 and 3."""
        while changes:
            apart = _apart(changes)
            print(f"{len(apart)} of {len(changes)} changes together", flush=True)
            clone = self._clones.get()
            with clone.changed(*apart):
                failed = sorted(clone.failures(*parts), key=lambda item: self._reached.costs.get(item, 0.0))
            self._halve(clone, apart, failed, verdict, *parts)
            self._clones.put(clone)
            noticed = len(apart) - len(self.left(apart))
            if not noticed and len(apart) == len(changes):
                return
            changes = self.left(changes) if noticed else [each for each in changes if each not in apart]

    def _halve(self, clone: Clone, changes: list[Change], items: list[str], verdict: str, *parts: str) -> None:
        """Store the changes with which one of the items fails: all together, then each half of them, and so on."""
        with clone.changed(*changes):
            found = clone.noticed_by(items, *parts)
        print(f"  {len(changes)} changes, {len(items)} items: {found or 'none fails'}", flush=True)
        if not found:
            return
        if len(changes) == 1:
            self.store(changes[0], verdict, found)
            return
        half = len(changes) // 2
        for some in (changes[:half], changes[half:]):
            self._halve(clone, some, items, verdict, *parts)

    def _each(self, verdict: str, attempt: Callable[[Clone, Change], str], changes: list[Change]) -> None:
        """Try each change alone, several at a time; store those that are noticed."""

        def judge(change: Change) -> str:
            clone = self._clones.get()
            try:
                with clone.changed(change):
                    return attempt(clone, change)
            finally:
                self._clones.put(clone)

        with ThreadPoolExecutor(self._jobs) as pool:
            for change, found in zip(changes, pool.map(judge, changes), strict=True):
                print(f"{verdict if found else '...':5} {change}\n      {found}", flush=True)
                if found:
                    self.store(change, verdict, found)

    def store(self, change: Change, verdict: str, test: str) -> None:
        """Keep the verdict on the change."""
        self.verdicts[str(change)] = verdict, test
        self._file.write_text(json.dumps(self.verdicts, indent=1))


def _apart(changes: list[Change]) -> list[Change]:
    """Changes that do not overlap."""
    taken: list[Change] = []
    for change in changes:
        if not any(each.path == change.path and each.start < change.end and change.start < each.end for each in taken):
            taken.append(change)
    return taken


# -- as a plugin of pytest ---------------------------------------------------------------------------------------------


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--only", type=Path, help="run only the items listed in this file, in its order")


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    order = {name: number for number, name in enumerate(config.getoption("--only").read_text().splitlines())}
    items[:] = sorted((each for each in items if each.nodeid in order), key=lambda each: order[each.nodeid])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="of the tests that execute each change; written if it is missing")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("-n", type=int, default=150, help="number of changes (default 150)")
    parser.add_argument("--jobs", type=int, default=2, help="changes that are tried at the same time (default 2)")
    parser.add_argument("--list", action="store_true", help="only print the changes")
    arguments = parser.parse_args()
    paths = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
    known = [change for path in paths for change in changes_of(path)]
    drawn = random.Random(arguments.seed).sample(known, arguments.n)
    print(f"{arguments.n} of {len(known)} changes, seed {arguments.seed}", flush=True)
    if arguments.list:
        print(*drawn, sep="\n")
        return 0
    reached = Reached.record(arguments.folder, drawn, f"reached-{arguments.seed}-{arguments.n}")
    with tempfile.TemporaryDirectory(prefix="mutation-") as temporary:
        clones = [Clone(Path(temporary) / f"clone{number}") for number in range(arguments.jobs)]
        judge = Judge(arguments.folder / f"verdicts-{arguments.seed}-{arguments.n}.json", clones, reached)
        judge.alone(judge.left(drawn))
        judge.together(judge.left(drawn), "core", "core")
        judge.together(judge.left(drawn), "other", *PARTS[1:])
        for change in judge.left(drawn):
            judge.store(change, "-", f"{len(reached.of(change))} items execute the statement")
    counted = Counter(verdict for verdict, _ in judge.verdicts.values())
    for change in drawn:
        verdict, test = judge.verdicts[str(change)]
        if verdict != "core":
            print(f"{verdict:5} {change}\n      {test}")
    noticed = counted["core"] + counted["other"]
    print(f"noticed by make test: {counted['core']}; by the other parts only: {counted['other']}; by none:", end=" ")
    print(f"{counted['-']}; share of make test: {counted['core'] / max(1, noticed):.1%}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
