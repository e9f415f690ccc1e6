"""Citations of requirements in our own code: ``##= ID ID`` on the line above the code that fulfils the requirements.

A citation refers to the statement, or the entry of a table, that follows it. If that statement only assigns local
variables, the citation includes the following statements, up to the first that does more. Adjacent citations refer to
the same code. Sources are read as text; no module is imported.
"""

from __future__ import annotations

import ast
import tokenize
from collections.abc import Iterator
from functools import cache
from importlib.util import find_spec
from io import StringIO
from pathlib import Path
from typing import Final, NamedTuple

from dcp_selftest.traceability import CITATION

PACKAGES: Final = ("dcp_spec", "dcp_codec", "dcp_stack")
"""Packages whose code fulfils requirements and may cite them."""


class Citation(NamedTuple):
    """A citation of one requirement, with the cited code."""

    requirement: str
    path: str
    """Path of the file, relative to the folder that has the package: ``dcp_stack/bp/queue.py``."""
    line: int
    """Line of the comment, from 1."""
    first: int
    """First line of the cited code."""
    last: int
    """Last line of the cited code."""
    function: str
    """Qualified name of the function or class around it; empty at module level."""
    remark: str = ""
    """Text after the identifier: ``exception: reason``."""

    def __str__(self) -> str:
        return f"{self.path}:{self.line}"

    @property
    def module(self) -> str:
        """The module name without the package: ``bp.queue``."""
        return self.path.partition("/")[2].removesuffix(".py").replace("/", ".")


@cache
def citations() -> tuple[Citation, ...]:
    """Return all citations in the order of packages, paths and lines."""
    return tuple(_all())


@cache
def citations_by_requirement() -> dict[str, tuple[Citation, ...]]:
    """Return the citations of each cited requirement."""
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
    """Yield the citations in the source of one file. ``path`` is stored in each citation."""
    comments = [
        (token.start[0], match)
        for token in tokenize.generate_tokens(StringIO(source).readline)
        if token.type == tokenize.COMMENT and (match := CITATION.match(token.string))
    ]
    if not comments:
        return
    places = sorted(_places(ast.parse(source), ""), key=lambda place: (place[0], -place[1]))
    for line, match in comments:
        first, last, function = next((place for place in places if place[0] > line), (line, line, ""))
        for requirement in match[1].split():
            yield Citation(requirement, path, line, first, last, function, match[2] or "")


def _places(node: ast.AST, function: str) -> Iterator[tuple[int, int, str]]:
    """Yield first line, last line and function of all citable code: statements, match cases, entries of tables."""
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
    """Return the last line of the code that a citation of the first of these statements refers to."""
    for statement in statements:
        if not _only_names(statement):
            return statement.end_lineno or statement.lineno
    return statements[-1].end_lineno or statements[-1].lineno


def _only_names(statement: ast.stmt) -> bool:
    """Return whether a statement only assigns local variables."""
    if isinstance(statement, ast.AnnAssign):
        return isinstance(statement.target, ast.Name)
    if not isinstance(statement, ast.Assign):
        return False
    targets = [part for each in statement.targets for part in (each.elts if isinstance(each, ast.Tuple) else [each])]
    return all(isinstance(each, ast.Name) for each in targets)
