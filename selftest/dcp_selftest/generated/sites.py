"""All single changes (sites) that can be generated in the source of the protocol cores."""

from __future__ import annotations

import ast
import copy
import hashlib
from collections.abc import Iterator
from functools import cache
from importlib import resources
from typing import Final, NamedTuple

from dcp_selftest.traceability import cited_in_comments

from .reports import Reports, is_guard, reports_of, without_reports

#: The modules of BP, SRP and VarDis. Modules that only compose them, name effects, count or read configurations are
#: left out.
MODULES: Final = (
    "bp.entity", "bp.clients", "bp.parameters", "bp.queue", "bp.receive", "bp.services", "bp.timing", "bp.wire",
    "srp.entity", "srp.neighbour_table", "timestamps",
    "vardis.entity", "vardis.compose", "vardis.confirms", "vardis.core", "vardis.database", "vardis.parameters",
    "vardis.receive", "vardis.services", "record_sizes", "vardis.state_table", "vardis.wire",
    "bp.client_port",
)  # fmt: skip

_COMPARISONS: Final[dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
_ARITHMETIC: Final[dict[type[ast.operator], type[ast.operator]]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.FloorDiv,
    ast.FloorDiv: ast.Mult,
    ast.Div: ast.Mult,
    ast.Mod: ast.Add,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
}


#: The maximum distance of a citation from a change to count as near, in lines.
_NEAR: Final = 20


class Site(NamedTuple):
    """One change at one place."""

    module: str
    """Without the package ``dcp_stack``: ``vardis.compose``."""
    function: str
    """The qualified name of the enclosing function or class; empty at module level."""
    line: int
    operator: str
    """The kind of the change: ``comparison``, ``dropped call``, ..."""
    before: str
    after: str
    number: int
    """The index of the changed syntax node in ``ast.walk`` of the module."""
    variant: int
    """The index of the change among those of this kind at the node."""
    key: str
    """A fingerprint of function, statement and change; edits elsewhere in the file do not change it."""
    first: int = 0
    last: int = 0
    """First and last line of the statement without nested statements; 0 if it is executed during the import."""

    def __str__(self) -> str:
        path = f"dcp_stack/{self.module.replace('.', '/')}.py"
        return f"{path}:{self.line} {self.function}: {self.operator}: {self.before} -> {self.after}"


class _Change(NamedTuple):
    operator: str
    replacement: ast.AST | None
    """The new syntax node; None drops the statement."""


@cache
def _source(module: str) -> str:
    return resources.files("dcp_stack").joinpath(f"{module.replace('.', '/')}.py").read_text(encoding="utf-8")


@cache
def sites() -> tuple[Site, ...]:
    """Return all changes in the order of :data:`MODULES` and of their syntax nodes."""
    return tuple(site for module in MODULES for site in _sites_of(module))


@cache
def _citations(module: str) -> tuple[tuple[int, str], ...]:
    """Return the citations of a module as (line, requirement)."""
    return tuple(
        (number, identifier)
        for number, line in enumerate(_source(module).splitlines(), 1)
        for identifier in cited_in_comments(line)
    )


def cited(site: Site) -> tuple[str, ...]:
    """Return the requirements that are cited within 20 lines of the change, the nearest first."""
    near = sorted((abs(line - site.line), identifier) for line, identifier in _citations(site.module))
    return tuple(dict.fromkeys(identifier for distance, identifier in near if distance <= _NEAR))


def mutated(site: Site) -> ast.Module:
    """Return the syntax tree of the module with the change of ``site``."""
    tree = ast.parse(_source(site.module))
    node = _nodes(tree)[site.number]
    change = [each for each in changes(node) if each.operator == site.operator][site.variant]
    replacement = ast.Pass() if change.replacement is None else change.replacement
    replace(tree, node, ast.copy_location(replacement, node))
    return ast.fix_missing_locations(tree)


def _sites_of(module: str) -> Iterator[Site]:
    tree = ast.parse(_source(module))
    place = {id(node): number for number, node in enumerate(_nodes(tree))}
    seen: dict[str, int] = {}
    functions = {id(each) for top in ast.walk(tree) if isinstance(top, ast.FunctionDef) for each in ast.walk(top)}
    for function, statement, node in _candidates(tree):
        span = _lines(statement) if id(statement) in functions else (0, 0)
        variants: dict[str, int] = {}
        for change in changes(node):
            variant = variants[change.operator] = variants.get(change.operator, -1) + 1
            before = ast.unparse(node)
            after = "dropped" if change.replacement is None else ast.unparse(change.replacement)
            if before == after:
                continue
            text = "\0".join((module, function, _head(statement), change.operator, before, after))
            # The same change of the same text can occur several times in a statement: number them.
            nth = seen[text] = seen.get(text, -1) + 1
            key = hashlib.sha256(f"{text}\0{nth}".encode()).hexdigest()[:12]
            line = getattr(node, "lineno", 0)
            short = _short(before), _short(after)
            yield Site(module, function, line, change.operator, *short, place[id(node)], variant, key, *span)


def _head(statement: ast.stmt) -> str:
    """Return the source of a statement without nested statements."""
    head = copy.copy(statement)
    for name in ("body", "orelse", "finalbody", "handlers", "cases"):
        if getattr(head, name, None):
            setattr(head, name, [])
    try:
        return ast.unparse(head)
    except (ValueError, IndexError, AttributeError):
        return type(statement).__name__


def _lines(statement: ast.stmt) -> tuple[int, int]:
    """Return the first and last line of a statement without nested statements."""
    inner = [
        each.lineno
        for name in ("body", "orelse", "finalbody", "handlers")
        for each in getattr(statement, name, ())
        if isinstance(each, ast.stmt)
    ]
    last = statement.end_lineno or statement.lineno
    return statement.lineno, max(statement.lineno, min([last, *(line - 1 for line in inner)]))


def _nodes(tree: ast.Module) -> list[ast.AST]:
    return list(ast.walk(tree))


def _candidates(tree: ast.Module) -> Iterator[tuple[str, ast.stmt, ast.AST]]:
    """Yield the syntax nodes that may be changed, each with its function and its statement."""
    yield from _in_body(tree.body, "", reports_of(tree))


def _in_body(body: list[ast.stmt], function: str, reports: Reports) -> Iterator[tuple[str, ast.stmt, ast.AST]]:
    for statement in body:
        yield from _in_statement(statement, function, reports)


def _in_statement(statement: ast.stmt, function: str, reports: Reports) -> Iterator[tuple[str, ast.stmt, ast.AST]]:
    if isinstance(statement, ast.FunctionDef | ast.ClassDef):
        if statement.name not in reports.functions:
            inner = f"{function}.{statement.name}" if function else statement.name
            yield from _in_body(statement.body, inner, reports)
        return
    if not function or _is_only_for_readers(statement) or is_guard(statement) or reports.is_report(statement):
        return
    yield function, statement, statement
    for child in ast.iter_child_nodes(statement):
        if isinstance(child, ast.stmt):
            yield from _in_statement(child, function, reports)
        elif isinstance(child, ast.match_case | ast.ExceptHandler):
            yield from _in_body(child.body, function, reports)
        elif not (isinstance(statement, ast.AnnAssign) and child is statement.annotation):
            for node in without_reports(child):
                yield function, statement, node


def _is_only_for_readers(statement: ast.stmt) -> bool:
    """Return whether a statement is a docstring, an assertion, a raise, an import or a declaration without value."""
    if isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant):
        return True
    if isinstance(statement, ast.AnnAssign) and statement.value is None:
        return True
    return isinstance(statement, ast.Assert | ast.Raise | ast.Import | ast.ImportFrom | ast.Global | ast.Nonlocal)


def changes(node: ast.AST) -> Iterator[_Change]:
    if isinstance(node, ast.Compare) and len(node.ops) == 1:
        for other in _COMPARISONS.get(type(node.ops[0]), ()):
            yield _Change("comparison", ast.Compare(node.left, [other()], node.comparators))
    elif isinstance(node, ast.BinOp) and type(node.op) in _ARITHMETIC:
        yield _Change("arithmetic", ast.BinOp(node.left, _ARITHMETIC[type(node.op)](), node.right))
    elif isinstance(node, ast.BoolOp):
        other_op: ast.boolop = ast.Or() if isinstance(node.op, ast.And) else ast.And()
        yield _Change("boolean", ast.BoolOp(other_op, node.values))
        for number in range(len(node.values)):
            left = node.values[:number] + node.values[number + 1 :]
            yield _Change("condition left out", left[0] if len(left) == 1 else ast.BoolOp(node.op, left))
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        yield _Change("boolean", node.operand)
    elif isinstance(node, ast.Constant):
        if node.value is True or node.value is False:
            yield _Change("constant", ast.Constant(not node.value))
        elif isinstance(node.value, int):
            yield _Change("constant", ast.Constant(node.value + 1))
            if node.value:
                yield _Change("constant", ast.Constant(node.value - 1))
    elif isinstance(node, ast.Call) and _order_matters(node):
        swapped = [node.args[1], node.args[0], *node.args[2:]]
        yield _Change("swapped arguments", ast.Call(node.func, swapped, node.keywords))
    elif isinstance(node, ast.IfExp):
        yield _Change("branch", node.body)
        yield _Change("branch", node.orelse)
    elif isinstance(node, ast.stmt):
        yield from _changes_of_statement(node)


def _order_matters(node: ast.Call) -> bool:
    """Return whether a call has two positional arguments that are not interchangeable."""
    symmetric = isinstance(node.func, ast.Name) and node.func.id in ("min", "max")
    return len(node.args) >= 2 and not symmetric and not any(isinstance(each, ast.Starred) for each in node.args)


def _changes_of_statement(node: ast.stmt) -> Iterator[_Change]:
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Call | ast.Yield | ast.Await):
        yield _Change("dropped call", None)
    elif isinstance(node, ast.AugAssign):
        yield _Change("dropped assignment", None)
    elif isinstance(node, ast.Assign) and all(isinstance(each, ast.Attribute | ast.Subscript) for each in node.targets):
        # Assignments to local names are left out: dropping them would only raise NameError.
        yield _Change("dropped assignment", None)
    elif isinstance(node, ast.Delete):
        yield _Change("dropped deletion", None)
    elif isinstance(node, ast.If):
        yield _Change("branch always taken", ast.If(ast.Constant(True), node.body, node.orelse))
        yield _Change("branch never taken", ast.If(ast.Constant(False), node.body, node.orelse))
    elif isinstance(node, ast.Break | ast.Continue):
        yield _Change("dropped jump", None)
    elif isinstance(node, ast.Return):
        if node.value is None:
            yield _Change("dropped return", None)
        elif isinstance(node.value, ast.Constant) and isinstance(node.value.value, bool):
            return
        else:
            yield _Change("other return value", ast.Return(ast.Constant(None)))


def replace(tree: ast.Module, old: ast.AST, new: ast.AST) -> None:
    for parent in ast.walk(tree):
        for name, value in ast.iter_fields(parent):
            if value is old:
                setattr(parent, name, new)
                return
            if isinstance(value, list):
                for number, each in enumerate(value):
                    if each is old:
                        value[number] = new
                        return
    raise LookupError("the node is not in the tree")


def _short(text: str) -> str:
    line = " ".join(text.split())
    return line if len(line) <= 80 else f"{line[:77]}..."
