"""The possible changes of cited code.

Inside functions these are the sites of :mod:`dcp_selftest.generated.sites`, and replacements of values by
others of the same type (:mod:`dcp_selftest.citations.perturb`), which rarely break the node as a whole.
Sites do not cover tables at module level: a part of an entry is replaced by the same part of another entry.
"""

from __future__ import annotations

import ast
import copy
from collections.abc import Iterator
from functools import cache
from importlib import resources
from itertools import pairwise
from typing import Final, NamedTuple

from dcp_selftest.generated.sites import MODULES, Site, mutated, sites

from .places import Citation

#: Kinds of changes. The first ones remove the effect of a line without other effects on the node.
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
    """Description of the change for reports."""
    operator: str
    """One of :data:`_ORDER`."""
    site: Site | None
    """The generated change; None for a change of this module."""
    entry: tuple[int, int] = (0, 0)
    """For ``exchanged``: line of the entry, and index of the exchange. For other values and exchanged elements: index
    of the node in ``ast.walk``, and index of the value or element in the node."""

    def tree(self) -> ast.Module:
        """Return the syntax tree of the module with the change. Raise LookupError if the source has changed."""
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
    """Return the changes of the cited code, the most specific kinds first; empty for code outside of ``dcp_stack``."""
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
    # Within a kind, the lines nearest to the citation come first.
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
    """Yield replacements of the values that the cited code assigns, returns, passes as arguments or iterates over."""
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
    """Return the values of a syntax node that can be replaced."""
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
    helper = ast.parse("from dcp_selftest.citations.perturb import changed, blank").body[0]
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
    """Yield the dictionaries with more than one entry at module level."""
    for statement in tree.body:
        if isinstance(statement, ast.Assign | ast.AnnAssign) and statement.value is not None:
            for node in ast.walk(statement.value):
                if isinstance(node, ast.Dict) and len(node.keys) > 1:
                    yield node


#: Maximum number of replacements for a part of an entry, or for a whole entry without parts.
_OTHERS: Final = 4


def _exchanges(table: ast.Dict, index: int) -> Iterator[ast.expr]:
    """Yield the entry with two adjacent parts exchanged, then with one part of another entry.

    An entry without parts is replaced by other entries.
    """
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
        # Prefer entries that call the same function, and of these the last ones: neighbours are often alike.
        form = ast.dump(mine.func) if isinstance(mine, ast.Call) else ""
        alike = [each for each in others if isinstance(each, ast.Call) and ast.dump(each.func) == form]
        yield from (copy.deepcopy(each) for each in [*reversed(alike), *others][:_OTHERS])


def _parts(entry: ast.expr) -> list[ast.expr]:
    if isinstance(entry, ast.Call):
        return entry.args if len(entry.args) > 1 else []
    return entry.elts if isinstance(entry, ast.Tuple) else []
