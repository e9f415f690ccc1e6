"""Citations of requirements in our own code: ``##= ID`` on the line above what fulfils it.

A citation stands on the statement (or the entry of a table) that follows it; where that only gives a local variable its
value, also on the statements that follow, up to the first that does more. Several citations in a row stand on the same
code. Sources are read as text; nothing is imported.
"""

from __future__ import annotations

import ast
import re
import tokenize
from collections.abc import Iterator
from functools import cache
from importlib.util import find_spec
from io import StringIO
from pathlib import Path
from typing import Final, NamedTuple

PACKAGES: Final = ("dcp_spec", "dcp_codec", "dcp_stack")
"""Packages whose code fulfils requirements."""

_CITATION: Final = re.compile(r"##= *((?:DATA|UWB)-\d\d|(?:BP|SRP|VD)-[A-Z]+-\d\d)\b *(\|.*)?")


class Citation(NamedTuple):
    """A requirement cited at a place."""

    requirement: str
    path: str
    """Below the folder of the packages: ``dcp_stack/bp/queue.py``."""
    line: int
    first: int
    """First line of the code that it stands on."""
    last: int
    function: str
    """Qualified name of the function or class around it; empty at module level."""
    remark: str = ""
    """What follows the identifier: ``exception: reason``."""

    def __str__(self) -> str:
        return f"{self.path}:{self.line}"

    @property
    def module(self) -> str:
        """The module inside its package: ``bp.queue``."""
        return self.path.partition("/")[2].removesuffix(".py").replace("/", ".")


@cache
def citations() -> tuple[Citation, ...]:
    """All citations, file by file, from top to bottom."""
    return tuple(_all())


@cache
def citations_by_requirement() -> dict[str, tuple[Citation, ...]]:
    """The citations of each requirement that is cited."""
    found: dict[str, list[Citation]] = {}
    for each in citations():
        found.setdefault(each.requirement, []).append(each)
    return {name: tuple(each) for name, each in found.items()}


def _all() -> Iterator[Citation]:
    for package in PACKAGES:
        spec = find_spec(package)
        folder = Path(spec.origin).parent if spec is not None and spec.origin is not None else None
        for path in sorted(folder.rglob("*.py")) if folder is not None else ():
            name = f"{package}/{path.relative_to(folder or path).as_posix()}"
            yield from citations_in(name, path.read_text(encoding="utf-8"))


def citations_in(path: str, source: str) -> Iterator[Citation]:
    """The citations in one file, with the code that each stands on."""
    comments = [
        (token.start[0], match)
        for token in tokenize.generate_tokens(StringIO(source).readline)
        if token.type == tokenize.COMMENT and (match := _CITATION.match(token.string))
    ]
    if not comments:
        return
    places = sorted(_places(ast.parse(source), ""), key=lambda place: (place[0], -place[1]))
    for line, match in comments:
        first, last, function = next((place for place in places if place[0] > line), (line, line, ""))
        yield Citation(match[1], path, line, first, last, function, (match[2] or "").lstrip("| "))


def _places(node: ast.AST, function: str) -> Iterator[tuple[int, int, str]]:
    """First line, last line and function of everything that a citation can stand on: statements, cases, entries."""
    for name, value in ast.iter_fields(node):
        children = value if isinstance(value, list) else [value]
        for number, child in enumerate(children):
            if not isinstance(child, ast.AST):
                continue
            inner = function
            if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
                inner = f"{function}.{child.name}" if function else child.name
            if isinstance(child, ast.stmt) and name in ("body", "orelse", "finalbody"):
                first = min(each.lineno for each in (child, *getattr(child, "decorator_list", ())))
                yield first, _last_line(children[number:]), inner
            elif isinstance(child, ast.match_case):
                yield child.pattern.lineno, child.body[-1].end_lineno or child.pattern.lineno, inner
            elif isinstance(child, ast.Dict):
                for key, entry in zip(child.keys, child.values, strict=True):
                    yield (key or entry).lineno, entry.end_lineno or entry.lineno, inner
            elif isinstance(child, ast.expr | ast.keyword):
                yield child.lineno, child.end_lineno or child.lineno, inner
            yield from _places(child, inner)


def _last_line(statements: list[ast.stmt]) -> int:
    """Where the code ends that the first of these statements belongs to."""
    for statement in statements:
        if not _only_names(statement):
            return statement.end_lineno or statement.lineno
    return statements[-1].end_lineno or statements[-1].lineno


def _only_names(statement: ast.stmt) -> bool:
    """Whether a statement does nothing but give local variables their values."""
    if isinstance(statement, ast.AnnAssign):
        return isinstance(statement.target, ast.Name)
    if not isinstance(statement, ast.Assign):
        return False
    targets = [part for each in statement.targets for part in (each.elts if isinstance(each, ast.Tuple) else [each])]
    return all(isinstance(each, ast.Name) for each in targets)
