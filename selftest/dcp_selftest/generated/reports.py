"""Recognition of code that only reports: changes of it cannot alter the behaviour of the protocols.

All kinds are recognised by their syntax:

* statements that emit a ``Dropped`` effect (the log of the protocol cores) or count an event in the counters of BP;
* functions that consist of such statements, and the calls of these functions;
* descriptions of faults for the log;
* functions that show or check the state for a reader, with the private functions that only these use;
* guards against misuse by the program around the node, which only raise an exception;
* comparisons that choose a reading, because every alternative of a reading is permitted.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from typing import Final, NamedTuple

#: The effect by which a core reports a drop with its reason, and the calls that describe reasons.
_REPORT: Final = "Dropped"
_DESCRIPTIONS: Final = frozenset({_REPORT, "Fault"})
#: The object and its method by which BP counts events.
_COUNTERS, _COUNT = "_counters", "count"
#: Names of the object with the selected alternatives of readings (``dcp_stack.readings.Readings``).
_READINGS: Final = frozenset({"readings", "selected_readings"})
#: Methods that show or check the state of an object.
_SHOWING: Final = frozenset({"__repr__", "snapshot", "check_invariants"})


class Reports(NamedTuple):
    """The functions of a module that only report or show something."""

    functions: frozenset[str]
    """Names of functions that only report or show."""

    def is_report(self, statement: ast.stmt) -> bool:
        """Return whether a statement is a call that only reports."""
        if not isinstance(statement, ast.Expr) or not isinstance(statement.value, ast.Call):
            return False
        call = statement.value
        counts = isinstance(call.func, ast.Attribute) and (_name(call.func.value), call.func.attr) == (
            _COUNTERS,
            _COUNT,
        )
        reports = any(isinstance(each, ast.Call) and _name(each.func) == _REPORT for each in call.args)
        return counts or reports or _name(call.func) in self.functions


def is_guard(statement: ast.stmt) -> bool:
    """Return whether a statement only raises an exception under a condition."""
    return (
        isinstance(statement, ast.If)
        and not statement.orelse
        and all(isinstance(each, ast.Raise) for each in statement.body)
    )


def without_reports(expression: ast.AST) -> Iterator[ast.AST]:
    """Yield the syntax nodes of an expression, except descriptions of faults and choices of a reading."""
    if isinstance(expression, ast.Call) and _name(expression.func) in _DESCRIPTIONS:
        return
    left = expression.left if isinstance(expression, ast.Compare) else None
    if isinstance(left, ast.Attribute) and _name(left.value) in _READINGS:
        return
    yield expression
    for child in ast.iter_child_nodes(expression):
        yield from without_reports(child)


def reports_of(tree: ast.Module) -> Reports:
    """Find the functions of a module that only report or show something."""
    functions = [each for each in ast.walk(tree) if isinstance(each, ast.FunctionDef)]
    found = Reports(_SHOWING)
    while True:
        more = {each.name for each in functions if _only_reports(each, found) or _only_used_by(each, functions, found)}
        if more <= found.functions:
            return found
        found = Reports(found.functions | more)


def _only_reports(function: ast.FunctionDef, known: Reports) -> bool:
    body = [each for each in function.body if not _is_docstring(each)]
    return bool(body) and all(_is_report_or_branch(each, known) for each in body)


def _is_report_or_branch(statement: ast.stmt, known: Reports) -> bool:
    if isinstance(statement, ast.If):
        return all(_is_report_or_branch(each, known) for each in (*statement.body, *statement.orelse))
    return known.is_report(statement)


def _only_used_by(function: ast.FunctionDef, functions: list[ast.FunctionDef], known: Reports) -> bool:
    """Return whether a private function is used, and only by functions that show or check the state."""
    if not function.name.startswith("_") or function.name.startswith("__"):
        return False
    users = {each.name for each in functions if each is not function and function.name in _names_in(each)}
    return bool(users) and users <= known.functions & _SHOWING


def _names_in(function: ast.FunctionDef) -> set[str]:
    return {_name(each) for each in ast.walk(function) if isinstance(each, ast.Name | ast.Attribute)}


def _is_docstring(statement: ast.stmt) -> bool:
    return isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)


def _name(node: ast.AST) -> str:
    """Return the last part of a name (``emit`` of ``self._core.emit``); empty for other expressions."""
    if isinstance(node, ast.Attribute):
        return node.attr
    return node.id if isinstance(node, ast.Name) else ""
