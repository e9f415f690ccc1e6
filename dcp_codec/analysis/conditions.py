"""Conditions on frames, in the language of display filters: ``vardis.icType == 6 and bp.seqno > 100``.

Names are those of the Wireshark dissector that ``dcp-codec export lua`` writes, and their prefixes ``dcp.`` and
``payloads.`` can be omitted; the last parts of a name stand for all fields whose names end with them. A field can occur
several times in a frame: a comparison holds if it holds for one occurrence, and ``!=`` holds if none is equal. A name
alone holds if the field occurs.

The text is parsed as a Python expression by :mod:`ast`, and a small set of node types is interpreted; no part of it is
executed.
"""

from __future__ import annotations

import ast
import difflib
import operator
import re
from collections.abc import Callable, Iterator
from typing import Any

from dcp_spec.profile.definition import Profile

from dcp_codec.framing.frames import DissectedFrame
from dcp_codec.jsonform import scalar_json
from dcp_codec.plan.tree import Exact, Fill, Group, Many, Node, Region, Rest, Scalar, Select, Text

#: Additional names, for properties of the capture and the dissection of a frame.
FRAME_FIELDS = (
    *("frame.number", "frame.time_ns", "frame.len", "frame.interface", "eth.src", "eth.dst", "eth.type", "padding"),
    *("errors.reason", "errors.path", "errors.requirement"),
    *("warnings.reason", "warnings.path", "warnings.requirement"),
)
#: Maximum number of characters and of nested parts: neither parsing nor testing may exhaust the stack.
_LONGEST, _DEEPEST = 4096, 60
_COMPARE: dict[type[ast.cmpop], Callable[[Any, Any], bool]] = {
    ast.Eq: operator.eq,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
}
#: Tokens that ast cannot parse: identifiers with colons and the operators of C; strings are left unchanged.
_TOKENS = re.compile(
    r"""("[^"]*"|'[^']*')|\b((?:[0-9A-Fa-f]{1,2}:){2,}[0-9A-Fa-f]{1,2})\b|(&&)|(\|\|)|(!(?!=))|\b(icName)\b"""
)

Values = dict[str, list[Any]]
Test = Callable[[Values], bool]


class WhereError(ValueError):
    """A condition cannot be used. The message says why and where."""


class Where:
    """A condition on the frames of a profile. Raises :class:`WhereError`, also for names that the profile does not
    have.
    """

    def __init__(self, text: str, profile: Profile, plan: Node) -> None:
        self._representation = profile.types.node_id.representation
        self._names = {name.lower(): name for name in field_names(plan)}
        #: For each field that the condition uses, the keys under which its values are found.
        self._used: dict[str, set[str]] = {}
        if len(text) > _LONGEST:
            raise WhereError(f"the condition has {len(text)} characters, more than {_LONGEST}")
        try:
            tree = ast.parse(_TOKENS.sub(_python, text).strip(), mode="eval")
        except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
            reason = getattr(error, "msg", None) or str(error)
            raise WhereError(f"{text!r} is not a condition: {reason}") from None
        if _depth(tree) > _DEEPEST:
            raise WhereError("the condition is nested too deeply")
        self._test = self._condition(tree.body)

    def __call__(self, frame: DissectedFrame) -> bool:
        """Return whether the condition holds for a frame."""
        return self._test(self._values(frame))

    # -- compiling ---------------------------------------------------------------------------------------------

    def _condition(self, node: ast.expr) -> Test:
        match node:
            case ast.BoolOp(op=ast.And(), values=parts):
                tests = [self._condition(part) for part in parts]
                return lambda values: all(test(values) for test in tests)
            case ast.BoolOp(op=ast.Or(), values=parts):
                tests = [self._condition(part) for part in parts]
                return lambda values: any(test(values) for test in tests)
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                inner = self._condition(operand)
                return lambda values: not inner(values)
            case ast.Compare(left=left, ops=ops, comparators=comparators):
                pairs = zip([left, *comparators], ops, comparators, strict=False)
                tests = [self._comparison(first, op, second) for first, op, second in pairs]
                return lambda values: all(test(values) for test in tests)
            case ast.Name() | ast.Attribute():
                name = self._field(node)
                return lambda values: bool(values.get(name))
            case _:
                raise WhereError(f"{ast.unparse(node)!r}: use comparisons, names, and, or, not")

    def _comparison(self, left: ast.expr, op: ast.cmpop, right: ast.expr) -> Test:
        if not isinstance(left, ast.Name | ast.Attribute):
            turned = {ast.Lt: ast.Gt, ast.Gt: ast.Lt, ast.LtE: ast.GtE, ast.GtE: ast.LtE}
            if isinstance(op, ast.In | ast.NotIn) or not isinstance(right, ast.Name | ast.Attribute):
                raise WhereError(f"{ast.unparse(left)!r}: a comparison needs the name of a field")
            return self._comparison(right, turned.get(type(op), type(op))(), left)
        name = self._field(left)
        if isinstance(op, ast.In | ast.NotIn):
            if not isinstance(right, ast.Tuple | ast.List | ast.Set):
                raise WhereError(f"{ast.unparse(right)!r}: in needs a list, as in {name} in (1, 2)")
            choices = [_constant(each) for each in right.elts]
            wanted = isinstance(op, ast.In)
            return lambda values: any(_same(v, c) for v in values.get(name, ()) for c in choices) == wanted
        value = _constant(right)
        if isinstance(op, ast.Eq | ast.NotEq):
            equal = isinstance(op, ast.Eq)
            return lambda values: any(_same(found, value) for found in values.get(name, ())) == equal
        compare = _COMPARE.get(type(op))
        if compare is None:
            raise WhereError(f"{name}: compare with ==, !=, <, <=, >, >=, in, not in")
        return lambda values: any(_ordered(compare, found, value) for found in values.get(name, ()))

    def _field(self, node: ast.expr) -> str:
        text = ast.unparse(node)
        plain = text.lower().removeprefix("dcp.")
        for name in (plain, f"payloads.{plain}", f"payloads.vardis.{plain}"):
            if name in self._names:
                whole = self._names[name]
                self._used.setdefault(whole, set()).add(whole)
                return whole
        ending = [each for name, each in self._names.items() if name.endswith(f".{plain}") and each not in FRAME_FIELDS]
        for each in ending:
            self._used.setdefault(each, set()).add(plain)
        if ending:
            return plain
        short = [each.removeprefix("payloads.") for each in self._names.values()]
        near = difflib.get_close_matches(text.removeprefix("dcp."), short, n=3, cutoff=0.5)
        hint = f"; did you mean {' or '.join(near)}?" if near else "; dcp-codec filter --fields lists the names"
        raise WhereError(f"{text!r} is not the name of a field{hint}")

    # -- values ------------------------------------------------------------------------------------------------

    def _values(self, frame: DissectedFrame) -> Values:
        captured, framing, found = frame.frame, frame.framing, frame.dissection
        values: Values = {
            "frame.number": [captured.number],
            "frame.time_ns": [captured.time_ns],
            "frame.len": [captured.orig_len],
            "frame.interface": [captured.interface],
            "eth.src": [framing.src.hex(":")] if framing.src is not None else [],
            "eth.dst": [framing.dst.hex(":")] if framing.dst is not None else [],
            "eth.type": [framing.ether_type] if framing.ether_type is not None else [],
            "padding": [len(found.padding)],
        }
        for kind, problems in (("errors", found.errors), ("warnings", found.warnings)):
            for part in ("reason", "path", "requirement"):
                values[f"{kind}.{part}"] = [getattr(each, part) for each in problems]
        if self._used.keys() <= values.keys():
            return values
        for field in found.root.walk():
            name = re.sub(r"\[\d+\]", "", field.path)
            for key in self._used.get(name, ()):
                if not isinstance(field.layout, Scalar | Text | Rest | Fill):
                    values.setdefault(key, []).append(True)
                elif field.value is not None:
                    value = scalar_json(field.layout, field.value, self._representation)
                    values.setdefault(key, []).append((value, field.label) if field.label else value)
        return values


def _depth(tree: ast.AST) -> int:
    depth, level = 0, [tree]
    while level and depth <= _DEEPEST:
        depth += 1
        level = [child for node in level for child in ast.iter_child_nodes(node)]
    return depth


def _python(match: re.Match[str]) -> str:
    text, identifier, both, either, negation, label = match.groups()
    if text is not None:
        return str(text)
    if identifier is not None:
        return repr(identifier.lower())
    return "icType" if label else " and " if both else " or " if either else " not " if negation else ""


def _constant(node: ast.expr) -> int | float | str:
    match node:
        case ast.Constant(value=bool(value)):
            return int(value)
        case ast.Constant(value=int(value) | float(value) | str(value)):
            return value
        case ast.UnaryOp(op=ast.USub(), operand=ast.Constant(value=int(value) | float(value))):
            return -value
        case _:
            raise WhereError(f"{ast.unparse(node)!r}: compare with a number, a text in quotes or an identifier")


def _same(found: Any, value: int | float | str) -> bool:
    if isinstance(found, tuple):
        return value in found
    if isinstance(found, str) and isinstance(value, str):
        # Octets are hex with or without colons.
        return found == value or found.replace(":", "") == value.lower().replace(":", "").removeprefix("0x")
    return bool(found == value)


def _ordered(compare: Callable[[Any, Any], bool], found: Any, value: int | float | str) -> bool:
    found = found[0] if isinstance(found, tuple) else found
    return isinstance(found, str) == isinstance(value, str) and compare(found, value)


def field_names(plan: Node) -> list[str]:
    """Return the names that a condition can use for a profile, those of the frame first, then in wire order."""
    return list(dict.fromkeys([*FRAME_FIELDS, *_paths(plan, "")]))


def _paths(node: Node, above: str) -> Iterator[str]:
    def path(name: str) -> str:
        return f"{above}.{name}".strip(".")

    match node:
        case Scalar() | Text() | Rest() | Fill():
            yield path(node.name)
        case Group():
            here = path(node.name) if node.name else above
            if node.name:
                yield here
            for member in node.members:
                yield from _paths(member, here)
        case Many():
            yield path(node.name)
            yield from _paths(node.element, path(node.name))
        case Region():
            yield from _paths(node.content, above)
        case Exact():
            yield from _paths(node.content, above)
        case Select():
            for case in [*node.cases.values(), *([node.default] if node.default is not None else [])]:
                yield from _paths(case, above)
