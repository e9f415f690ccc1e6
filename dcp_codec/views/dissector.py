"""Generate the dissector of a plan. It turns any octets into a tree of fields and a list of problems.

Its first error is the one that the strict decoder raises. It then continues wherever the layout allows: after a region
of known length, after a bad value. One function is generated for the message, and one for each content of a region.
They have the same arguments and results:

part(b, o, e, at, s, clipped, problems, doubtful, ...) -> (field, o, going)

They read ``b[o:e]``, whose place is ``at`` (see :data:`dcp_codec.views.fields.Place`), and return the field, the
position after it, and whether reading can continue there. ``s`` is the pair of the buffer and the number that turns a
position in it into an offset; ``clipped`` says whether the enclosing region is cut off at ``e``. The further arguments
are the fields that the content of a region refers to. If the octets end too soon, a function completes all records that
it has begun and returns.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from dcp_codec.errors import Problem
from dcp_codec.plan.layout import broken, joins, read_run, read_scalar
from dcp_codec.plan.source import Source
from dcp_codec.plan.tree import Exact, Fill, Group, Many, Node, Region, Rest, Scalar, Select, Text

from .decoder import branches
from .fields import Dissection, Field, Place, path_of

Dissect = Callable[[bytes, int, int], Dissection]


class Doubt(NamedTuple):
    """A condition under which a complete record may break a rule beyond the layout.

    ``test`` is called with the values of the named members. An incomplete record is always doubtful.
    """

    members: tuple[str, ...]
    test: Callable[..., object]


# -- what the generated functions call when something is wrong ----------------------------------------------------


def _fault(reason: str, requirement: str | None) -> Callable[..., None]:
    def report(problems: list[Problem], path: str, offset: int, needed: int | None, available: int | None) -> None:
        problems.append(Problem(reason, path, offset, needed, available, requirement))

    return report


def cut_off(
    run: tuple[Scalar, ...], o: int, e: int, at: Place, s: tuple[bytes, int], problems: list[Problem]
) -> list[Field]:
    """Return the fields of neighbouring scalars that do not all fit into ``b[o:e]``, up to the one that is cut off."""
    b, shift = s
    fields = []
    for scalar in run:
        if o + scalar.size > e:
            path = path_of(at, scalar.name)
            problems.append(Problem("truncated", path, o + shift, scalar.size, e - o, scalar.requirement))
            fields.append(Field(scalar.name, scalar, at, s, o, e - o))
            return fields
        value, rule = read_scalar(scalar, b[o : o + scalar.size]), scalar.rule
        if rule is not None and broken(scalar, value):
            needed = 1 if rule.value is None else rule.value
            problems.append(Problem(rule.reason, path_of(at, scalar.name), o + shift, needed, value, rule.requirement))
        fields.append(Field(scalar.name, scalar, at, s, o, scalar.size, value))
        o += scalar.size
    raise AssertionError("a run that fits is not cut off")


# -- the generator -------------------------------------------------------------------------------------------------


class _Ref(NamedTuple):
    """The variables of a scalar that others may refer to: for its field and for its value."""

    field: str
    value: str


_Scope = dict[str, _Ref]


class _Open(NamedTuple):
    """A record, list or text under construction: its place, its start, and the source of its parts so far."""

    layout: Group | Many | Text
    at: str
    start: str
    parts: list[str]


def _referred(node: Node) -> list[str]:
    """Return the members of the record around ``node`` that ``node`` refers to."""
    match node:
        case Region():
            return [node.length, *_referred(node.content)]
        case Select():
            cases = [*node.cases.values(), *([node.default] if node.default is not None else [])]
            return [node.key, *(name for case in cases for name in _referred(case))]
        case Many():
            return [name for name in (node.count, node.agrees) if name]
        case Fill():
            return [node.used]
        case _:
            return []


class _Part:
    """Generates one function."""

    def __init__(self, doubts: Mapping[str, Doubt], title: str, parameters: str = "") -> None:
        self.doubts = doubts
        self.title = title
        self.source = Source(f"part(b, o, e, at, s, clipped, problems, doubtful{parameters})")
        self.source.namespace.update(Field=Field, path_of=path_of, cut_off=cut_off)
        self.open: list[_Open] = []

    def function(self, node: Node, scope: _Scope | None = None) -> Any:
        """Return the generated function that reads ``node``, which may refer to the members in ``scope``."""
        self.source.add(f"return {self.node(node, 'at', scope or {})}, o, True")
        name = node.type_name if isinstance(node, Group) else node.name
        return self.source.compile(f"dissector {self.title} {name}".rstrip())

    # -- pieces of source -----------------------------------------------------------------------------------------

    def field(self, layout: Node, at: str, start: str, length: str, *more: str, name: str | None = None) -> str:
        """Return source that constructs a field, by default with the name of its layout."""
        called = self.name(layout.name if name is None else name)
        known = self.source.constant("L", layout, id(layout))
        return f"Field({', '.join((called, known, at, 's', start, length, *more))})"

    def keep(self, field: str, position: str = "o") -> str:
        """Emit the assignment of a field to a variable, continue at ``position``, and return the variable."""
        variable = self.source.fresh("f")
        self.source.add(f"{variable} = {field}")
        if position != "o":
            self.source.add(f"o = {position}")
        return variable

    def name(self, name: str) -> str:
        return self.source.constant("N", name, name)

    def inside(self, node: Node, at: str) -> str:
        """Return the variable for the place of the parts of ``node``."""
        if not node.name:
            return at
        place = self.source.fresh("at")
        self.source.add(f"{place} = ({at}, {self.name(node.name)})")
        return place

    def path(self, at: str, name: str) -> str:
        return f"path_of({at}, {self.name(name)})"

    def fault(self, reason: str, requirement: str | None, path: str, offset: str, needed: str, available: str) -> None:
        report = self.source.constant("fault", _fault(reason, requirement), (reason, requirement))
        self.source.add(f"{report}(problems, {path}, {offset}, {needed}, {available})")

    def fault_of(self, ref: _Ref, reason: str, requirement: str | None, needed: str, available: str) -> None:
        """Emit the report of a problem of a field that another member refers to."""
        self.fault(reason, requirement, f"{ref.field}.path", f"{ref.field}.offset", needed, available)

    def stop(self, part: str) -> None:
        """Emit the end of the function after ``part``, which reaches to the end: complete all open records and
        return.
        """
        for around in reversed(self.open):
            layout, length, parts = around.layout, f"e - {around.start}", ", ".join((*around.parts, part))
            part = self.keep(self.field(layout, around.at, around.start, length, "None", f"[{parts}]"))
            if isinstance(layout, Group) and layout.type_name in self.doubts:
                self.source.add(f"doubtful.append({part})")
        self.source.add(f"return {part}, e, False")

    # -- records --------------------------------------------------------------------------------------------------

    def group(self, group: Group, at: str, scope: _Scope) -> str:
        """Emit the reading of a record whose members enter ``scope``; return the variable of its field."""
        source, start = self.source, self.source.fresh("s")
        source.add(f"{start} = o")
        place = self.inside(group, at)
        self.open.append(_Open(group, at, start, []))
        run: list[Scalar] = []
        for member in group.members:
            if isinstance(member, Scalar):
                if not joins(run, member):
                    self._run(run, place, scope)
                run.append(member)
                continue
            self._run(run, place, scope)
            if isinstance(member, Group):
                inner: _Scope = {}
                part = self.group(member, place, inner)
                scope.update({f"{member.name}.{name}": ref for name, ref in inner.items()})
            else:
                part = self.node(member, place, scope)
            self.open[-1].parts.append(part)
        self._run(run, place, scope)
        parts = ", ".join(self.open.pop().parts)
        whole = self.keep(self.field(group, at, start, f"o - {start}", "None", f"[{parts}]"))
        self._doubt(group, whole, scope)
        return whole

    def _doubt(self, group: Group, whole: str, scope: _Scope) -> None:
        doubt = self.doubts.get(group.type_name)
        if doubt is None:
            return
        test = "True"
        if all(member in scope for member in doubt.members):
            values = ", ".join(scope[member].value for member in doubt.members)
            test = f"{self.source.constant('doubt', doubt.test, group.type_name)}({values})"
        self.source.when(test, f"doubtful.append({whole})")

    def _run(self, run: list[Scalar], at: str, scope: _Scope) -> None:
        """Emit the reading of neighbouring scalars of the innermost open record."""
        if not run:
            return
        source, values, relative = self.source, [self.source.fresh() for _ in run], 0
        with source.block(f"if o + {sum(scalar.size for scalar in run)} > e:"):
            self.stop(f"*cut_off({source.constant('run', tuple(run))}, o, e, {at}, s, problems)")
        read_run(source, run, values)
        for scalar, value in zip(run, values, strict=True):
            start = f"o + {relative}" if relative else "o"
            ref = scope[scalar.name] = _Ref(self.keep(self.field(scalar, at, start, str(scalar.size), value)), value)
            self.open[-1].parts.append(ref.field)
            if (rule := scalar.rule) is not None:
                with source.block(f"if not {value}:" if rule.value is None else f"if {value} != {rule.value}:"):
                    needed = "1" if rule.value is None else str(rule.value)
                    self.fault_of(ref, rule.reason, rule.requirement, needed, value)
            relative += scalar.size
        source.add(f"o += {relative}")
        run.clear()

    # -- text -----------------------------------------------------------------------------------------------------

    def text(self, text: Text, at: str, scope: _Scope) -> str:
        source, start, value = self.source, self.source.fresh("s"), self.source.fresh()
        source.add(f"{start} = o")
        if not text.prefixes:
            stop = source.fresh("p")
            source.add(f"{stop} = b.find(0, o, e)")
            with source.block(f"if {stop} < 0:"):
                self.fault("truncated", text.requirement, self.path(at, text.name), "e + s[1]", "1", "0")
                self.stop(self.field(text, at, start, f"e - {start}"))
            source.add(f"{value} = b[o:{stop}]")
            source.add(f"o = {stop} + 1")
            whole = self.keep(self.field(text, at, start, f"o - {start}", value))
        else:
            place, lengths = self.inside(text, at), _Scope()
            self.open.append(_Open(text, at, start, []))
            self._run(list(text.prefixes), place, lengths)
            self._data(text, place, list(lengths.values()), value)
            parts = ", ".join(self.open.pop().parts)
            whole = self.keep(self.field(text, at, start, f"o - {start}", value, f"[{parts}]"))
        scope[text.name] = _Ref(whole, value)
        return whole

    def _data(self, text: Text, at: str, lengths: list[_Ref], value: str) -> None:
        """Emit the reading of the octets after the lengths of ``text`` into the variable ``value``."""
        source, first, stop, name = self.source, lengths[0], self.source.fresh("p"), "data"
        for other in lengths[1:]:
            with source.block(f"if {other.value} != {first.value}:"):
                self.fault_of(other, "length-mismatch", "DATA-06", first.value, other.value)
        source.add(f"{stop} = o + {first.value}")
        with source.block(f"if {stop} > e:"):
            self.fault("truncated", text.requirement, self.path(at, name), "o + s[1]", first.value, "e - o")
            self.stop(self.field(text, at, "o", "e - o", name=name))
        source.add(f"{value} = b[o:{stop}]")
        if text.terminated:
            with source.block(f"if not {value} or {value}.find(0) != {first.value} - 1:"):
                self.fault("bad-terminator", "DATA-07", self.path(at, name), "o + s[1]", "None", "None")
            source.add(f"{value} = {value}.removesuffix(b'\\0')")
        self.open[-1].parts.append(self.keep(self.field(text, at, "o", first.value, value, name=name), stop))

    # -- structure ------------------------------------------------------------------------------------------------

    def node(self, node: Node, at: str, scope: _Scope) -> str:
        """Emit the reading of any node of the record at ``at``; return the variable of its field."""
        match node:
            case Group():
                return self.group(node, at, {})
            case Text():
                return self.text(node, at, scope)
            case Many():
                return self.many(node, at, scope)
            case Region():
                return self.region(node, at, scope)
            case Exact():
                return self.exact(node, at)
            case Select():
                return self.select(node, at, scope)
            case Rest():
                return self.keep(self.field(node, at, "o", "e - o", "b[o:e]"), "e")
            case Fill():
                return self.fill(node, at, scope)
            case Scalar():
                raise TypeError("a scalar stands outside a record")

    def many(self, node: Many, at: str, scope: _Scope) -> str:
        source, start, items, place = self.source, self.source.fresh("s"), self.source.fresh("l"), self.inside(node, at)
        source.add(f"{start} = o")
        source.add(f"{items} = []")
        more = f"o < e or not {items}" if node.nonempty else "o < e"
        self.open.append(_Open(node, at, start, [f"*{items}"]))
        with source.block(f"for _ in range({scope[node.count].value}):" if node.count else f"while {more}:"):
            here = source.fresh("at")
            source.add(f"{here} = ({place}, len({items}))")
            source.add(f"{items}.append({self.group(node.element, here, {})})")
        self.open.pop()
        if node.agrees:
            announced = scope[node.agrees]
            with source.block(f"if {announced.value} != len({items}):"):
                self.fault_of(announced, node.reason, node.requirement, announced.value, f"len({items})")
        return self.keep(self.field(node, at, start, f"o - {start}", "None", items))

    def region(self, node: Region, at: str, scope: _Scope) -> str:
        source, length = self.source, scope[node.length]
        names = list(dict.fromkeys(_referred(node.content)))
        known = {name: _Ref(f"r{index}", f"r{index}.value") for index, name in enumerate(names)}
        content = _Part(self.doubts, self.title, "".join(f", {ref.field}" for ref in known.values()))
        part = source.constant("part", content.function(node.content, known))
        stop, inner = source.fresh("p"), source.fresh("f")
        referred = "".join(f", {scope[name].field}" for name in names)
        source.add(f"{stop} = o + {length.value}")
        with source.block(f"if {stop} > e:"):
            self.fault_of(length, node.reason, node.requirement, length.value, "e - o")
            self.stop(f"{part}(b, o, e, {at}, s, True, problems, doubtful{referred})[0]")
        source.add(f"{inner}, o, going = {part}(b, o, {stop}, {at}, s, False, problems, doubtful{referred})")
        with source.block(f"if going and o < {stop}:"):
            self.fault("leftover", node.requirement, f"{inner}.path", "o + s[1]", "0", f"{stop} - o")
        source.add(f"o = {stop}")
        return inner

    def exact(self, node: Exact, at: str) -> str:
        source, inner = self.source, self.source.fresh("f")
        part = source.constant("part", _Part(self.doubts, self.title).function(node.content))
        source.add(f"wrong = e - o != {node.size}")
        # The content is still shown. The mistake is reported once; it may be the cut-off region.
        with source.block("if wrong and not clipped:"):
            self.fault(node.reason, node.requirement, self.path(at, node.name), "o + s[1]", str(node.size), "e - o")
        source.add(
            f"{inner} = {part}(b, o, e, {at}, s, clipped, [] if wrong else problems, [] if wrong else doubtful)[0]"
        )
        source.add("o = e")
        return inner

    def select(self, node: Select, at: str, scope: _Scope) -> str:
        source, key, chosen = self.source, scope[node.key], self.source.fresh("f")
        for case in branches(source, key.value, node):
            if case is None:
                self.fault_of(key, node.reason, node.requirement, "None", key.value)
                self.stop(self.field(Rest("data"), at, "o", "e - o", "b[o:e]"))
            else:
                source.add(f"{chosen} = {self.node(case, at, scope)}")
        return chosen

    def fill(self, node: Fill, at: str, scope: _Scope) -> str:
        source, used, stop = self.source, scope[node.used], self.source.fresh("p")
        with source.block(f"if {used.value} > {node.total}:"):
            self.fault_of(used, node.reason, node.requirement, used.value, str(node.total))
            # The position of the next block is unknown; the rest belongs to the impossible area.
            self.stop(self.field(node, at, "o", "e - o"))
        source.add(f"{stop} = o + {node.total} - {used.value}")
        with source.block(f"if {stop} > e:"):
            self.fault("truncated", node.requirement, self.path(at, node.name), "o + s[1]", f"{stop} - o", "e - o")
            self.stop(self.field(node, at, "o", "e - o"))
        return self.keep(self.field(node, at, "o", f"{stop} - o", f"b[o:{stop}]"), stop)


def generate_dissector(plan: Node, title: str, doubts: Mapping[str, Doubt] | None = None) -> Dissect:
    """Return the dissector of ``plan``: ``dissect(octets, start, base)`` dissects ``octets[start:]`` and never raises.

    ``base`` is the offset that the result gives the first octet. ``doubts``, by the type names of records, selects the
    records that are listed in :attr:`~dcp_codec.views.fields.Dissection.doubtful`.
    """
    part = _Part(doubts or {}, title).function(plan)

    def dissect(octets: bytes, start: int = 0, base: int = 0) -> Dissection:
        problems: list[Problem] = []
        doubtful: list[Field] = []
        shift = base - start
        root, end, going = part(octets, start, len(octets), None, (octets, shift), False, problems, doubtful)
        if not going:
            # Octets after a message that could not be read to its end need not be padding.
            end = len(octets)
        return Dissection(root, problems, end + shift, octets[end:], doubtful)

    return dissect
