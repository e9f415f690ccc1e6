"""What can be changed in the code that a citation stands on.

Inside functions these are the sites of :mod:`dcp_conformance.generated.sites`. Entries of tables at module level, which
those leave out, are exchanged for what other entries of the table have at the same place.
"""

from __future__ import annotations

import ast
import copy
from collections.abc import Iterator
from functools import cache
from importlib import resources
from typing import Final, NamedTuple

from dcp_conformance.generated.sites import Site, mutated, sites

from .places import Citation

#: Kinds of changes, those first that take away what a line does and leave the rest at work.
_ORDER: Final = (
    "exchanged", "dropped call", "dropped assignment", "branch never taken", "branch always taken", "dropped deletion",
    "dropped return", "dropped jump", "comparison", "condition left out", "boolean", "branch", "constant", "arithmetic",
    "swapped arguments", "other return value",
)  # fmt: skip


class CodeChange(NamedTuple):
    """A change of one module of the node."""

    module: str
    """``dcp_stack.bp_queue``."""
    line: int
    text: str
    """What it is, for readers."""
    site: Site | None
    """None for an exchanged entry of a table."""
    entry: tuple[int, int] = (0, 0)
    """Of an exchanged entry: its line, and which of its exchanges."""

    def tree(self) -> ast.Module:
        """The module with the change."""
        if self.site is not None:
            return mutated(self.site)
        tree = ast.parse(_source(self.module))
        line, number = self.entry
        for table in _tables(tree):
            for index, key in enumerate(table.keys):
                if key is not None and key.lineno == line:
                    table.values[index] = list(_exchanges(table, index))[number]
                    return ast.fix_missing_locations(tree)
        raise LookupError(f"{self.module} has no entry of a table in line {line}")


def changes_under(citation: Citation) -> list[CodeChange]:
    """The changes of the code that a citation stands on, the most telling first; none for code outside of the cores."""
    if not citation.path.startswith("dcp_stack/"):
        return []
    found = [
        CodeChange(f"dcp_stack.{each.module}", each.line, f"{each.operator}: {each.before} -> {each.after}", each)
        for each in _sites_by_module().get(citation.module, ())
        if citation.first <= each.line <= citation.last
    ]
    found += _entries_under(citation)
    # What the cited lines themselves say comes before what stands below them.
    return sorted(found, key=lambda each: (_rank(each), each.line))


def _rank(change: CodeChange) -> int:
    return _ORDER.index(change.site.operator if change.site is not None else "exchanged")


@cache
def _sites_by_module() -> dict[str, list[Site]]:
    found: dict[str, list[Site]] = {}
    for each in sites():
        found.setdefault(each.module, []).append(each)
    return found


@cache
def _source(module: str) -> str:
    package, _, name = module.partition(".")
    return resources.files(package).joinpath(*f"{name}.py".split("/")).read_text(encoding="utf-8")


def _entries_under(citation: Citation) -> Iterator[CodeChange]:
    module = f"dcp_stack.{citation.module}"
    if citation.function or "." in citation.module:
        return
    for table in _tables(ast.parse(_source(module))):
        for index, key in enumerate(table.keys):
            if key is None or not citation.first <= key.lineno <= citation.last:
                continue
            for number, other in enumerate(_exchanges(table, index)):
                before, after = ast.unparse(table.values[index]), ast.unparse(other)
                text = f"exchanged: {ast.unparse(key)}: {before} -> {after}"
                yield CodeChange(module, key.lineno, text, None, (key.lineno, number))


def _tables(tree: ast.Module) -> Iterator[ast.Dict]:
    """The dictionaries at module level with more than one entry."""
    for statement in tree.body:
        if isinstance(statement, ast.Assign | ast.AnnAssign) and statement.value is not None:
            for node in ast.walk(statement.value):
                if isinstance(node, ast.Dict) and len(node.keys) > 1:
                    yield node


def _exchanges(table: ast.Dict, index: int) -> Iterator[ast.expr]:
    """The entry with one of its parts as another entry has it, for each part; or another entry, if it has no parts."""
    mine = table.values[index]
    others = [each for number, each in enumerate(table.values) if number != index]
    parts = _parts(mine)
    for place in range(len(parts)):
        seen = {ast.dump(parts[place])}
        for other in others:
            theirs = _parts(other)
            if len(theirs) == len(parts) and ast.dump(theirs[place]) not in seen:
                changed = copy.deepcopy(mine)
                _put(changed, place, copy.deepcopy(theirs[place]))
                yield changed
                break
    for other in others:
        if not parts and ast.dump(other) != ast.dump(mine):
            yield copy.deepcopy(other)
            return


def _parts(entry: ast.expr) -> list[ast.expr]:
    if isinstance(entry, ast.Call):
        return entry.args if len(entry.args) > 1 else []
    return entry.elts if isinstance(entry, ast.Tuple) else []


def _put(entry: ast.expr, place: int, part: ast.expr) -> None:
    _parts(entry)[place] = part
