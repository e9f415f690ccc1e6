"""Take octets apart for people: a tree of what is there and every problem found. Nothing is judged, nothing raises.

The dissector interprets the same plan that the strict decoder is generated from. Its first error is the one that the
decoder raises; it then goes on wherever the layout allows: behind a region of known length, behind a bad value.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, Final

import msgspec

from .errors import Problem
from .layout import read_scalar
from .plan import Exact, Fill, Group, Many, Node, Region, Rest, Scalar, Select, Text


class Field(msgspec.Struct, eq=False, gc=False):
    """A part of the octets.

    ``path`` is the field path with indices (``payloads[1].vardis[0].records[3].seqno``), ``offset`` the absolute
    octet where it starts, ``length`` how many octets of it are there, ``value`` what it says (None for a record, a
    list, or a field that is cut off), ``children`` its parts, ``layout`` the node of the plan that describes it.

    A message has dozens of them, and making them is most of taking it apart: hence the struct, which holds no
    references that could form a cycle.
    """

    name: str
    path: str
    layout: Node
    _buffer: bytes
    _start: int
    offset: int
    length: int
    value: Any = None
    children: list[Field] = []

    @property
    def raw(self) -> bytes:
        """The octets themselves."""
        return self._buffer[self._start : self._start + self.length]

    @property
    def label(self) -> str | None:
        """The name of an enumerated value (``"SUMMARIES"``), if it has one."""
        layout = self.layout
        if isinstance(layout, Scalar) and layout.names is not None:
            return layout.names.get(self.value)
        return None

    def child(self, name: str) -> Field | None:
        """The direct part of that name."""
        for child in self.children:
            if child.name == name:
                return child
        return None

    def walk(self) -> Iterator[Field]:
        """This field and all its parts, in wire order."""
        waiting = [self]
        while waiting:
            field = waiting.pop()
            yield field
            if field.children:
                waiting.extend(reversed(field.children))

    def find(self, path: str) -> Field | None:
        """The field of that full path."""
        return next((field for field in self.walk() if field.path == path), None)

    def __repr__(self) -> str:
        return f"<{self.path or self.name} at {self.offset}+{self.length} = {self.value!r}>"


class Dissection:
    """What was found: ``root``, ``problems`` in the order of the layout, and ``padding`` behind the message."""

    __slots__ = ("end", "padding", "problems", "root")

    def __init__(self, root: Field, problems: list[Problem], end: int, padding: bytes) -> None:
        self.root = root
        self.problems = problems
        self.end = end
        self.padding = padding

    @property
    def errors(self) -> list[Problem]:
        """What makes the octets no message of the profile."""
        return [problem for problem in self.problems if problem.severity == "error"]

    @property
    def warnings(self) -> list[Problem]:
        """What is well formed and still breaks a rule."""
        return [problem for problem in self.problems if problem.severity == "warning"]


_Scope = dict[str, Any]


def _resolve(scope: _Scope, reference: str) -> Field:
    """The field that a reference of the layout means: those in front of it, by name."""
    found: Any = scope
    for part in reference.split(".") if "." in reference else (reference,):
        found = found[part]
    assert isinstance(found, Field)
    return found


class _Walker:
    """One walk over one buffer. ``o`` is the position; methods return (field, whether to go on behind it)."""

    def __init__(self, buffer: bytes, start: int, base: int) -> None:
        self.b = buffer
        self.o = start
        # Offsets are reported as the caller counts them.
        self.shift = base - start
        self.problems: list[Problem] = []
        self.quiet = 0
        # Whether the region around is cut off at its end.
        self.clipped = False

    def problem(
        self,
        reason: str,
        path: str,
        offset: int,
        needed: int | None,
        available: int | None,
        requirement: str | None,
    ) -> None:
        if not self.quiet:
            self.problems.append(Problem(reason, path, offset + self.shift, needed, available, requirement))

    def field(self, name: str, path: str, layout: Node, start: int, length: int, value: Any = None) -> Field:
        return Field(name, path, layout, self.b, start, start + self.shift, length, value)

    def visit(self, node: Node, path: str, end: int, scope: _Scope) -> tuple[Field, bool]:
        return _VISITS[type(node)](self, node, path, end, scope)

    def rest(self, node: Rest, path: str, end: int, scope: _Scope) -> tuple[Field, bool]:  # noqa: ARG002 - as all
        start, self.o = self.o, end
        return self.field(node.name, path, node, start, end - start, self.b[start:end]), True

    def record(self, node: Group, path: str, end: int, scope: _Scope) -> tuple[Field, bool]:
        inner: _Scope = {}
        scope[node.name] = inner
        return self.group(node, path, end, inner)

    def scalar(self, node: Scalar, path: str, end: int, scope: _Scope) -> tuple[Field, bool]:
        o, size = self.o, node.size
        if o + size > end:
            self.problem("truncated", path, o, size, end - o, node.requirement)
            self.o = end
            return self.field(node.name, path, node, o, end - o), False
        if size == 1 and node.kind == "int" and not node.signed:
            value: Any = self.b[o]
        else:
            value = read_scalar(node, self.b[o : o + size])
        self.o = o + size
        field = scope[node.name] = Field(node.name, path, node, self.b, o, o + self.shift, size, value)
        rule = node.rule
        if rule is not None and (value == 0 if rule.value is None else value != rule.value):
            needed = 1 if rule.value is None else rule.value
            self.problem(rule.reason, path, o, needed, value, rule.requirement)
        return field, True

    def text(self, node: Text, path: str, end: int, scope: _Scope) -> tuple[Field, bool]:  # noqa: ARG002 - as all
        start = self.o
        inner: _Scope = {}
        whole = self.field(node.name, path, node, start, 0)
        parts: list[Field] = []
        if node.prefixes:
            whole.children = parts
        for prefix in node.prefixes:
            length, going = self.scalar(prefix, f"{path}.{prefix.name}", end, inner)
            parts.append(length)
            if not going:
                whole.length = self.o - start
                return whole, False
        going = (
            self.terminated(node, whole, end) if not node.prefixes else self.measured(node, whole, parts, inner, end)
        )
        whole.length = self.o - start
        return whole, going

    def terminated(self, node: Text, whole: Field, end: int) -> bool:
        start, stop = self.o, self.b.find(0, self.o, end)
        if stop < 0:
            self.problem("truncated", whole.path, end, 1, 0, node.requirement)
            self.o = end
            return False
        whole.value = self.b[start:stop]
        self.o = stop + 1
        return True

    def measured(self, node: Text, whole: Field, parts: list[Field], lengths: _Scope, end: int) -> bool:
        start, path = self.o, f"{whole.path}.data"
        first: Field = lengths[node.prefixes[0].name]
        for prefix in node.prefixes[1:]:
            other: Field = lengths[prefix.name]
            if other.value != first.value:
                self.problem(
                    "length-mismatch", other.path, other.offset - self.shift, first.value, other.value, "DATA-06"
                )
        stop = start + first.value
        if stop > end:
            self.problem("truncated", path, start, first.value, end - start, node.requirement)
            self.o = end
            parts.append(self.field("data", path, node, start, end - start))
            return False
        data = self.b[start:stop]
        self.o = stop
        if node.terminated:
            if not data or data.find(0) != first.value - 1:
                self.problem("bad-terminator", path, start, None, None, "DATA-07")
            data = data.removesuffix(b"\0")
        whole.value = data
        parts.append(self.field("data", path, node, start, stop - start, data))
        return True

    def group(self, node: Group, path: str, end: int, scope: _Scope) -> tuple[Field, bool]:
        start, going = self.o, True
        parts: list[Field] = []
        whole = Field(node.name, path, node, self.b, start, start + self.shift, 0, None, parts)
        prefix = f"{path}." if path else ""
        for member in node.members:
            if isinstance(member, Scalar):
                name, o, size = member.name, self.o, member.size
                if member.rule is None and size == 1 and o < end and member.kind == "int" and not member.signed:
                    # Most fields are octets that may say anything.
                    part = scope[name] = Field(name, prefix + name, member, self.b, o, o + self.shift, 1, self.b[o])
                    self.o = o + 1
                else:
                    part, going = self.scalar(member, prefix + name, end, scope)
            else:
                # A chosen content goes by the label of the choice, not by the name of the member.
                here = path if isinstance(member, Region | Select) else prefix + member.name
                part, going = _VISITS[type(member)](self, member, here, end, scope)
            parts.append(part)
            if not going:
                break
        whole.length = self.o - start
        return whole, going

    def many(self, node: Many, path: str, end: int, scope: _Scope) -> tuple[Field, bool]:
        start, going = self.o, True
        parts: list[Field] = []
        whole = Field(node.name, path, node, self.b, start, start + self.shift, 0, None, parts)
        count = _resolve(scope, node.count).value if node.count else None
        while going and (self.o < end or (node.nonempty and not parts) if count is None else len(parts) < count):
            part, going = self.group(node.element, f"{path}[{len(parts)}]", end, {})
            parts.append(part)
        if going and node.agrees:
            announced = _resolve(scope, node.agrees)
            if announced.value != len(parts):
                found = len(parts)
                self.problem(
                    node.reason, announced.path, announced.offset - self.shift, announced.value, found, node.requirement
                )
        whole.length = self.o - start
        return whole, going

    def region(self, node: Region, path: str, end: int, scope: _Scope) -> tuple[Field, bool]:
        length, start = _resolve(scope, node.length), self.o
        stop, clipped = start + length.value, False
        if stop > end:
            self.problem(
                node.reason, length.path, length.offset - self.shift, length.value, end - start, node.requirement
            )
            stop, clipped = end, True
        outer, self.clipped = self.clipped, clipped
        content = node.content
        here = path if isinstance(content, Select) else f"{path}.{content.name}" if path else content.name
        part, going = self.visit(content, here, stop, scope)
        self.clipped = outer
        if going and not clipped and self.o < stop:
            self.problem("leftover", part.path, self.o, 0, stop - self.o, node.requirement)
        self.o = stop
        return part, not clipped

    def exact(self, node: Exact, path: str, end: int, scope: _Scope) -> tuple[Field, bool]:  # noqa: ARG002 - as all
        wrong = end - self.o != node.size
        # What is there is still shown, but the one mistake is reported once, which may be that the region is cut off.
        if wrong and not self.clipped:
            self.problem(node.reason, path, self.o, node.size, end - self.o, node.requirement)
        self.quiet += wrong
        part, _ = self.group(node.content, path, end, {})
        self.quiet -= wrong
        self.o = end
        return part, True

    def select(self, node: Select, path: str, end: int, scope: _Scope) -> tuple[Field, bool]:
        key = _resolve(scope, node.key)
        case = node.cases.get(key.value, node.default)
        if case is None:
            self.problem(node.reason, key.path, key.offset - self.shift, None, key.value, node.requirement)
            start, self.o = self.o, end
            here = f"{path}.data" if path else "data"
            return self.field("data", here, Rest("data"), start, end - start, self.b[start:end]), False
        return self.visit(case, f"{path}.{case.name}" if path else case.name, end, scope)

    def fill(self, node: Fill, path: str, end: int, scope: _Scope) -> tuple[Field, bool]:
        used, start = _resolve(scope, node.used), self.o
        if used.value > node.total:
            self.problem(node.reason, used.path, used.offset - self.shift, used.value, node.total, node.requirement)
            # Where the next block would be is not known: what is left belongs to the area that is none.
            self.o = end
            return self.field(node.name, path, node, start, end - start), False
        stop = start + node.total - used.value
        if stop > end:
            self.problem("truncated", path, start, stop - start, end - start, node.requirement)
            self.o = end
            return self.field(node.name, path, node, start, end - start), False
        self.o = stop
        return self.field(node.name, path, node, start, stop - start, self.b[start:stop]), True


_VISITS: Final[dict[type, Callable[..., tuple[Field, bool]]]] = {
    Scalar: _Walker.scalar,
    Text: _Walker.text,
    Group: _Walker.record,
    Many: _Walker.many,
    Region: _Walker.region,
    Exact: _Walker.exact,
    Select: _Walker.select,
    Rest: _Walker.rest,
    Fill: _Walker.fill,
}


def dissect(plan: Node, octets: bytes, *, start: int = 0, base: int = 0) -> Dissection:
    """Take ``octets[start:]`` apart by ``plan``. ``base`` is what the first octet's offset is called. Never raises."""
    walker = _Walker(octets, start, base)
    name = plan.name
    root, going = walker.visit(plan, name, len(octets), {})
    # Octets behind a message that could not be read to its end are not known to be padding.
    end = walker.o if going else len(octets)
    return Dissection(root, walker.problems, end + walker.shift, octets[end:])
