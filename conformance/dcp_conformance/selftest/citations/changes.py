"""What can be changed in the code that a citation stands on.

Inside functions these are the sites of :mod:`dcp_conformance.selftest.generated.sites`, and values that are replaced
by others
of the same type (:mod:`dcp_conformance.selftest.citations.perturb`): those rarely break the node as a whole.
Entries of tables at module level, which the
sites leave out, are exchanged for what other entries of the table have at the same place.
"""

from __future__ import annotations

import ast
import copy
from collections.abc import Iterator
from functools import cache
from importlib import resources
from itertools import pairwise
from typing import Final, NamedTuple

from dcp_conformance.selftest.generated.sites import MODULES, Site, mutated, sites

from .places import Citation

#: Kinds of changes, those first that take away what a line does and leave the rest at work.
_ORDER: Final = (
    "exchanged", "exchanged elements", "dropped call", "other value", "no value", "dropped assignment",
    "branch never taken", "branch always taken", "dropped deletion", "dropped return", "dropped jump", "comparison",
    "condition left out", "boolean", "branch", "constant", "arithmetic", "swapped arguments", "other return value",
)  # fmt: skip


class CodeChange(NamedTuple):
    """A change of one module of the node."""

    module: str
    """``dcp_stack.bp.queue``."""
    line: int
    text: str
    """What it is, for readers."""
    operator: str
    """One of :data:`_ORDER`."""
    site: Site | None
    """None for what is not one of the generated changes."""
    entry: tuple[int, int] = (0, 0)
    """Of an exchanged entry: its line, and which of its exchanges. Of another value: its node in ``ast.walk``, and
    which of the values of the node."""

    def tree(self) -> ast.Module:
        """The module with the change."""
        if self.site is not None:
            return mutated(self.site)
        tree = ast.parse(_source(self.module))
        if self.operator in ("other value", "no value"):
            return _perturbed(tree, self.entry, "changed" if self.operator == "other value" else "blank")
        if self.operator == "exchanged elements":
            node = list(ast.walk(tree))[self.entry[0]]
            assert isinstance(node, ast.Tuple)
            left = self.entry[1]
            node.elts[left], node.elts[left + 1] = node.elts[left + 1], node.elts[left]
            return tree
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
        CodeChange(
            f"dcp_stack.{each.module}",
            each.line,
            f"{each.operator}: {each.before} -> {each.after}",
            each.operator,
            each,
        )
        for each in _sites_by_module().get(citation.module, ())
        if citation.first <= each.line <= citation.last
    ]
    found += _values_under(citation)
    found += _entries_under(citation)
    # What the cited lines themselves say comes before what stands below them.
    return sorted(found, key=lambda each: (_rank(each), each.line))


def _rank(change: CodeChange) -> int:
    return _ORDER.index(change.operator)


@cache
def _sites_by_module() -> dict[str, list[Site]]:
    found: dict[str, list[Site]] = {}
    for each in sites():
        found.setdefault(each.module, []).append(each)
    return found


@cache
def _source(module: str) -> str:
    package, _, name = module.partition(".")
    return resources.files(package).joinpath(*f"{name.replace('.', '/')}.py".split("/")).read_text(encoding="utf-8")


def _values_under(citation: Citation) -> Iterator[CodeChange]:
    """What the cited code assigns, returns, hands over or goes through."""
    module = f"dcp_stack.{citation.module}"
    if not citation.function:
        return
    for number, node in enumerate(ast.walk(ast.parse(_source(module)))):
        if isinstance(node, ast.Tuple) and citation.first <= node.lineno <= citation.last:
            for left, (one, other) in enumerate(pairwise(node.elts)):
                if ast.dump(one) != ast.dump(other):
                    text = f"exchanged elements: {ast.unparse(one)}, {ast.unparse(other)}"
                    yield CodeChange(module, node.lineno, text, "exchanged elements", None, (number, left))
        for value in _values(node):
            if citation.first <= value.lineno and (value.end_lineno or value.lineno) <= citation.last:
                for operator in ("other value", "no value"):
                    text = f"{operator}: {ast.unparse(value)}"
                    yield CodeChange(module, value.lineno, text, operator, None, (number, _values(node).index(value)))


def _values(node: ast.AST) -> list[ast.expr]:
    """The values of a node that can be replaced."""
    if isinstance(node, ast.Assign | ast.AugAssign):
        return [node.value]
    if isinstance(node, ast.AnnAssign | ast.Return):
        return [node.value] if node.value is not None else []
    if isinstance(node, ast.For):
        return [node.iter]
    if isinstance(node, ast.Call):
        return [
            *(each for each in node.args if not isinstance(each, ast.Starred)),
            *(each.value for each in node.keywords),
        ]
    if isinstance(node, ast.Dict):
        return list(node.values)
    return []


def _perturbed(tree: ast.Module, place: tuple[int, int], function: str) -> ast.Module:
    old = _values(list(ast.walk(tree))[place[0]])[place[1]]
    helper = ast.parse("from dcp_conformance.selftest.citations.perturb import changed, blank").body[0]
    new = ast.copy_location(ast.Call(ast.Name(function, ast.Load()), [old], []), old)
    for parent in ast.walk(tree):
        for name, value in ast.iter_fields(parent):
            if value is old:
                setattr(parent, name, new)
            elif isinstance(value, list):
                setattr(parent, name, [new if each is old else each for each in value])
    # After the docstring and the imports from __future__.
    first = next(number for number, each in enumerate(tree.body) if not isinstance(each, ast.Expr | ast.ImportFrom))
    tree.body.insert(first, helper)
    return ast.fix_missing_locations(tree)


def _entries_under(citation: Citation) -> Iterator[CodeChange]:
    module = f"dcp_stack.{citation.module}"
    if citation.function or citation.module not in MODULES:
        return
    for table in _tables(ast.parse(_source(module))):
        for index, key in enumerate(table.keys):
            if key is None or not citation.first <= key.lineno <= citation.last:
                continue
            for number, other in enumerate(_exchanges(table, index)):
                before, after = ast.unparse(table.values[index]), ast.unparse(other)
                text = f"exchanged: {ast.unparse(key)}: {before} -> {after}"
                yield CodeChange(module, key.lineno, text, "exchanged", None, (key.lineno, number))


def _tables(tree: ast.Module) -> Iterator[ast.Dict]:
    """The dictionaries at module level with more than one entry."""
    for statement in tree.body:
        if isinstance(statement, ast.Assign | ast.AnnAssign) and statement.value is not None:
            for node in ast.walk(statement.value):
                if isinstance(node, ast.Dict) and len(node.keys) > 1:
                    yield node


#: Entries of a table that are tried in place of a part, or of a whole entry.
_OTHERS: Final = 4


def _exchanges(table: ast.Dict, index: int) -> Iterator[ast.expr]:
    """The entry with two parts exchanged, or one part as another entry has it; without parts another entry."""
    mine = table.values[index]
    others = [each for number, each in enumerate(table.values) if number != index]
    parts = _parts(mine)
    for left, (one, other) in enumerate(pairwise(parts)) if isinstance(mine, ast.Tuple) else ():
        if ast.dump(one) != ast.dump(other):
            changed = copy.deepcopy(mine)
            theirs = _parts(changed)
            theirs[left], theirs[left + 1] = theirs[left + 1], theirs[left]
            yield changed
    for place in range(len(parts)):
        found: dict[str, ast.expr] = {}
        for other in others:
            theirs = _parts(other)
            if len(theirs) == len(parts) and ast.dump(theirs[place]) != ast.dump(parts[place]):
                found.setdefault(ast.dump(theirs[place]), theirs[place])
        for part in list(found.values())[:_OTHERS]:
            changed = copy.deepcopy(mine)
            _parts(changed)[place] = copy.deepcopy(part)
            yield changed
    if not parts:
        # Entries of the same form say something else most plainly; what stands last differs most from its neighbours.
        form = ast.dump(mine.func) if isinstance(mine, ast.Call) else ""
        alike = [each for each in others if isinstance(each, ast.Call) and ast.dump(each.func) == form]
        yield from (copy.deepcopy(each) for each in [*reversed(alike), *others][:_OTHERS])


def _parts(entry: ast.expr) -> list[ast.expr]:
    if isinstance(entry, ast.Call):
        return entry.args if len(entry.args) > 1 else []
    return entry.elts if isinstance(entry, ast.Tuple) else []
