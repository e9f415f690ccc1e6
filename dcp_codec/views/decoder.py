"""Generate the strict decoder of a plan.

The generated function reads ``b[o:e]`` and returns ``(value, end)``. It reads neighbouring scalars with one ``struct``
call, and a list of small fixed records with one bulk conversion. Octets that are not a message raise
:class:`DecodeError` with the problem that the dissector reports first.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from itertools import starmap
from typing import Any, NamedTuple, NoReturn

from dcp_codec.errors import DecodeError, Problem
from dcp_codec.plan.layout import (
    ValueTypes,
    broken,
    joins,
    packing,
    read_run,
    read_scalar,
    references,
    scalars_of,
    walk,
)
from dcp_codec.plan.source import Source
from dcp_codec.plan.tree import Exact, Fill, Group, Many, Node, Region, Rest, Scalar, Select, Text

Decode = Callable[[bytes, int, int], tuple[Any, int]]
#: Number of lists of small records that a decoder remembers, for each type of record.
_LISTS = 256


class _Path(NamedTuple):
    """A field path: a template and the expressions of its indices."""

    template: str = ""
    args: tuple[str, ...] = ()

    def field(self, name: str) -> _Path:
        if not name:
            return self
        return _Path(f"{self.template}.{name}" if self.template else name, self.args)

    def item(self, index: str) -> _Path:
        return _Path(f"{self.template}[%d]", (*self.args, index))

    @property
    def indices(self) -> str:
        return "(" + "".join(f"{arg}, " for arg in self.args) + ")"


class _Ref(NamedTuple):
    """A decoded scalar that other members refer to: its variable, its start, and its path."""

    variable: str
    offset: str
    path: _Path


_Scope = dict[str, Any]


def _resolve(scope: _Scope, reference: str) -> _Ref:
    found: Any = scope
    for part in reference.split("."):
        found = found[part]
    assert isinstance(found, _Ref)
    return found


def short_run(
    run: tuple[tuple[Scalar, str], ...], b: bytes, o: int, e: int, args: tuple[int, ...], partial: Any
) -> NoReturn:
    """Raise the first problem of a run of scalars that does not fit into ``b[o:e]``."""
    for scalar, template in run:
        if o + scalar.size > e:
            problem = Problem("truncated", template % args, o, scalar.size, e - o, scalar.requirement)
            raise DecodeError(problem, partial, args)
        value = read_scalar(scalar, b[o : o + scalar.size])
        if broken(scalar, value):
            rule = scalar.rule
            assert rule is not None
            needed = 1 if rule.value is None else rule.value
            problem = Problem(rule.reason, template % args, o, needed, value, rule.requirement)
            raise DecodeError(problem, partial, args)
        o += scalar.size
    raise AssertionError("a run that fits is not short")


def _fail(
    template: str, reason: str, requirement: str | None
) -> Callable[[int, int | None, int | None, tuple[int, ...], Any], DecodeError]:
    def error(
        offset: int, needed: int | None, available: int | None, args: tuple[int, ...], partial: Any
    ) -> DecodeError:
        return DecodeError(Problem(reason, template % args, offset, needed, available, requirement), partial, args)

    return error


def branches(source: Source, key: str, node: Select) -> Iterator[Node | None]:
    """Emit the branches of a choice by the variable ``key``; yield the content of each while its block is open.

    The last one is for all other numbers: None if the choice has no content for them.
    """
    keyword = "if"
    for number, case in node.cases.items():
        with source.block(f"{keyword} {key} == {number}:"):
            yield case
        keyword = "elif"
    with source.block("else:" if node.cases else "if True:"):
        yield node.default


class _Generator:
    def __init__(self, plan: Node, types: ValueTypes) -> None:
        self.types = types
        self.referenced = references(plan)
        # The only length of a value has a header's name, but no later error refers to it.
        self.prefixes = {
            id(prefix)
            for node in walk(plan)
            if isinstance(node, Text) and len(node.prefixes) == 1
            for prefix in node.prefixes
        }
        self.source = Source("decode(b, o, e)")
        self.source.namespace.update(short_run=short_run)
        # The result to attach to an error: the outermost list built so far (see DecodeError.partial).
        self.partial = "None"
        self.partial_root: Callable[[str], str] | None = None

    # -- errors ---------------------------------------------------------------------------------------------

    def fail(self, reason: str, requirement: str | None, path: _Path, offset: str, needed: str, available: str) -> None:
        maker = self.source.constant(
            "fail", _fail(path.template, reason, requirement), (path.template, reason, requirement)
        )
        self.source.add(f"raise {maker}({offset}, {needed}, {available}, {path.indices}, {self.partial})")

    def fail_of(self, ref: _Ref, reason: str, requirement: str | None, needed: str, available: str) -> None:
        """Emit the report of a problem of a field that another member refers to."""
        self.fail(reason, requirement, ref.path, ref.offset, needed, available)

    def short(self, run: list[tuple[Scalar, _Path]], start: str, end: str) -> None:
        table = self.source.constant("run", tuple((scalar, path.template) for scalar, path in run))
        self.source.add(f"short_run({table}, b, {start}, {end}, {run[0][1].indices}, {self.partial})")

    # -- scalars --------------------------------------------------------------------------------------------

    def flush(self, run: list[tuple[Scalar, _Path, str, _Scope]], end: str, *, fits: bool) -> None:
        """Generate the code that reads a run of neighbouring scalars and then moves the offset ``o`` past them.

        Each scalar is read into its variable. ``fits``: the octets up to ``end`` are known to be enough.
        """
        if not run:
            return
        source, size = self.source, sum(scalar.size for scalar, *_ in run)
        if not fits:
            with source.block(f"if o + {size} > {end}:"):
                self.short([(scalar, path) for scalar, path, *_ in run], "o", end)
        # The start of the run is only kept for fields that a later error may refer to.
        base = (
            source.fresh("s") if any(s.name in self.referenced and id(s) not in self.prefixes for s, *_ in run) else ""
        )
        if base:
            source.add(f"{base} = o")
        scalars = [scalar for scalar, *_ in run]
        variables = [variable for _, _, variable, _ in run]
        read_run(source, scalars, variables)
        relative = 0
        for scalar, path, variable, scope in run:
            offset = f"o + {relative}" if relative else "o"
            if scalar.rule is not None:
                wrong = f"not {variable}" if scalar.rule.value is None else f"{variable} != {scalar.rule.value}"
                with source.block(f"if {wrong}:"):
                    needed = "1" if scalar.rule.value is None else str(scalar.rule.value)
                    self.fail(scalar.rule.reason, scalar.rule.requirement, path, offset, needed, variable)
            scope[scalar.name] = _Ref(variable, f"{base} + {relative}" if base else "o", path)
            relative += scalar.size
        source.add(f"o += {size}")
        run.clear()

    def text(self, text: Text, lengths: list[_Ref], path: _Path, end: str) -> str:
        """Emit the reading of the octets after the lengths (already read) of ``text``."""
        source, variable = self.source, self.source.fresh()
        if not lengths:
            stop = source.fresh("p")
            source.add(f"{stop} = b.find(0, o, {end})")
            with source.block(f"if {stop} < 0:"):
                self.fail("truncated", text.requirement, path, end, "1", "0")
            source.add(f"{variable} = b[o:{stop}]")
            source.add(f"o = {stop} + 1")
            return variable
        first = lengths[0]
        for other in lengths[1:]:
            with source.block(f"if {other.variable} != {first.variable}:"):
                self.fail_of(other, "length-mismatch", "DATA-06", first.variable, other.variable)
        stop = source.fresh("p")
        source.add(f"{stop} = o + {first.variable}")
        with source.block(f"if {stop} > {end}:"):
            self.fail("truncated", text.requirement, path.field("data"), "o", first.variable, f"{end} - o")
        source.add(f"{variable} = b[o:{stop}]")
        if text.terminated:
            with source.block(f"if not {first.variable} or {variable}.find(0) != {first.variable} - 1:"):
                self.fail("bad-terminator", "DATA-07", path.field("data"), "o", "None", "None")
            source.add(f"{variable} = {variable}[:-1]")
        source.add(f"o = {stop}")
        return variable

    # -- records --------------------------------------------------------------------------------------------

    def group(self, group: Group, path: _Path, end: str, *, fits: bool = False) -> str:
        """Emit the reading of a record; return the expression of its value."""
        run: list[tuple[Scalar, _Path, str, _Scope]] = []
        return self._members(group, path, end, {}, run, last=True, fits=fits)

    def _members(
        self,
        group: Group,
        path: _Path,
        end: str,
        scope: _Scope,
        run: list[tuple[Scalar, _Path, str, _Scope]],
        *,
        last: bool,
        fits: bool,
    ) -> str:
        values: dict[str, str] = {}
        for member in group.members:
            here = path.field(member.name)
            match member:
                case Scalar():
                    if not joins([scalar for scalar, *_ in run], member):
                        self.flush(run, end, fits=fits)
                    values[member.name] = self.source.fresh()
                    run.append((member, here, values[member.name], scope))
                case Group():
                    scope[member.name] = {}
                    values[member.name] = self._members(
                        member, here, end, scope[member.name], run, last=False, fits=fits
                    )
                case Text():
                    inner: _Scope = {}
                    for prefix in member.prefixes:
                        run.append((prefix, here.field(prefix.name), self.source.fresh(), inner))
                    self.flush(run, end, fits=fits)
                    lengths = [inner[prefix.name] for prefix in member.prefixes]
                    values[member.name] = self.text(member, lengths, here, end)
                case _:
                    self.flush(run, end, fits=fits)
                    if not path.template and self.partial_root is None:
                        name, known = member.name, dict(values)
                        self.partial_root = lambda items, n=name, k=known: self._value(group, {**k, n: items})
                    values[member.name] = self.node(member, path, end, scope)
        if last:
            self.flush(run, end, fits=fits)
        return self._value(group, values)

    def _value(self, group: Group, values: dict[str, str]) -> str:
        """Return the expression that constructs the value of ``group`` from the expressions of its members."""
        cls = self.types[group.type_name]
        names, foreign = self.types.slots(group)
        by_attribute = {
            attribute: values[member.name]
            for member in group.members
            if member.name in values and (attribute := self.types.attribute(group, member)) is not None
        }
        if foreign:
            by_attribute["extra"] = (
                "(" + "".join(f"{values[member.name]}, " for member in foreign if member.name in values) + ")"
            )
        args: list[str] = []
        for name in names:
            args.append(by_attribute.get(name, "None" if name != "extra" else "()"))
        # Trailing defaults need not be passed to the constructor.
        while (
            args and names[len(args) - 1] not in by_attribute and len(args) > len(names) - len(cls.__struct_defaults__)
        ):
            args.pop()
        return f"{self.source.constant('T', cls, group.type_name)}({', '.join(args)})"

    # -- structure ------------------------------------------------------------------------------------------

    def node(self, node: Node, path: _Path, end: str, scope: _Scope) -> str:
        """Emit the reading of any node; ``path`` is that of the record around it. Return the expression of its
        value.
        """
        match node:
            case Group():
                return self.group(node, path.field(node.name), end)
            case Exact():
                return self.exact(node, path.field(node.name), end)
            case Many():
                return self.many(node, path.field(node.name), end, scope)
            case Region():
                return self.region(node, path, end, scope)
            case Select():
                return self.select(node, path, end, scope)
            case Rest():
                return self.rest(end)
            case Fill():
                return self.fill(node, path.field(node.name), end, scope)
            case _:
                raise TypeError(f"{type(node).__name__} stands outside a record")

    def rest(self, end: str) -> str:
        variable = self.source.fresh()
        self.source.add(f"{variable} = b[o:{end}]")
        self.source.add(f"o = {end}")
        return variable

    def fill(self, node: Fill, path: _Path, end: str, scope: _Scope) -> str:
        source, used = self.source, _resolve(scope, node.used)
        with source.block(f"if {used.variable} > {node.total}:"):
            self.fail_of(used, node.reason, node.requirement, used.variable, str(node.total))
        variable, stop = source.fresh(), source.fresh("p")
        source.add(f"{stop} = o + {node.total} - {used.variable}")
        with source.block(f"if {stop} > {end}:"):
            self.fail("truncated", node.requirement, path, "o", f"{stop} - o", f"{end} - o")
        source.add(f"{variable} = b[o:{stop}]")
        source.add(f"o = {stop}")
        return variable

    def exact(self, node: Exact, path: _Path, end: str) -> str:
        with self.source.block(f"if {end} - o != {node.size}:"):
            self.fail(node.reason, node.requirement, path, "o", str(node.size), f"{end} - o")
        return self.group(node.content, path, end, fits=True)

    def region(self, node: Region, path: _Path, end: str, scope: _Scope) -> str:
        source, length, stop = self.source, _resolve(scope, node.length), self.source.fresh("r")
        source.add(f"{stop} = o + {length.variable}")
        with source.block(f"if {stop} > {end}:"):
            self.fail_of(length, node.reason, node.requirement, length.variable, f"{end} - o")
        if isinstance(node.content, Select):
            return self.select(node.content, path, stop, scope, filling=node)
        return self.filling(node, node.content, path, stop, scope)

    def filling(self, region: Region, content: Node, path: _Path, stop: str, scope: _Scope) -> str:
        """Emit the reading of a content that must end where its region ends."""
        value = self.node(content, path, stop, scope)
        if _fills(content):
            return value
        kept = self.source.fresh()
        self.source.add(f"{kept} = {value}")
        with self.source.block(f"if o != {stop}:"):
            self.fail("leftover", region.requirement, path.field(content.name), "o", "0", f"{stop} - o")
        return kept

    def select(self, node: Select, path: _Path, end: str, scope: _Scope, *, filling: Region | None = None) -> str:
        def read(case: Node) -> str:
            return self.filling(filling, case, path, end, scope) if filling else self.node(case, path, end, scope)

        source, key, variable = self.source, _resolve(scope, node.key), self.source.fresh()
        for case in branches(source, key.variable, node):
            if case is None:
                self.fail_of(key, node.reason, node.requirement, "None", key.variable)
            else:
                source.add(f"{variable} = {read(case)}")
        return variable

    def many(self, node: Many, path: _Path, end: str, scope: _Scope) -> str:
        source = self.source
        count = _resolve(scope, node.count).variable if node.count else None
        bulk = self.bulk(node, path, end, count)
        if bulk is not None:
            return bulk
        items = source.fresh("l")
        source.add(f"{items} = []")
        if self.partial == "None":
            self.partial = self.partial_root(f"tuple({items})") if self.partial_root else f"tuple({items})"
        append = source.fresh("a")
        source.add(f"{append} = {items}.append")
        more = f"o < {end} or not {items}" if node.nonempty else f"o < {end}"
        loop = f"for _ in range({count}):" if count else f"while {more}:"
        with source.block(loop):
            source.add(f"{append}({self.group(node.element, path.item(f'len({items})'), end)})")
        if node.agrees:
            announced = _resolve(scope, node.agrees)
            with source.block(f"if {announced.variable} != len({items}):"):
                self.fail_of(announced, node.reason, node.requirement, announced.variable, f"len({items})")
        return f"tuple({items})"

    def bulk(self, node: Many, path: _Path, end: str, count: str | None) -> str | None:
        """Return the bulk conversion of a counted list of flat records of fixed size; None where that is impossible."""
        element, scalars = node.element, scalars_of(node.element)
        if count is None or scalars is None or len(scalars) != len(element.members):
            return None
        attributes = [self.types.attribute(element, member) for member in element.members]
        if attributes != list(self.types[element.type_name].__struct_fields__) or any(s.rule for s in scalars):
            return None
        packed = packing(scalars)
        if any(packed.swapped):
            return None
        source, stop, variable, size = self.source, self.source.fresh("p"), self.source.fresh(), element.size
        cls = self.types[element.type_name]
        source.add(f"{stop} = o + {count} * {size}")
        with source.block(f"if {stop} > {end}:"):
            whole = f"(({end} - o) // {size})"
            run = [(scalar, path.item(whole).field(scalar.name)) for scalar in scalars]
            self.short(run, f"o + {whole} * {size}", end)
        octet_each = all(scalar.size == 1 and scalar.kind == "int" and not scalar.signed for scalar in scalars)
        unpack = None if octet_each else packed.struct.iter_unpack
        convert = _records(cls, len(scalars), unpack)
        records = source.constant("records", convert, (element.type_name, packed.struct.format))
        source.add(f"{variable} = {records}(b[o:{stop}])")
        source.add(f"o = {stop}")
        return variable


def _records(
    cls: type, fields: int, unpack: Callable[[bytes], Iterator[tuple[Any, ...]]] | None
) -> Callable[[bytes], tuple[Any, ...]]:
    """Return the conversion of octets to records of fixed size; ``unpack`` is None if each of ``fields`` is one octet.

    Equal octets give the same records: most nodes repeat summaries that have not changed.
    """

    @functools.lru_cache(maxsize=_LISTS)
    def records(octets: bytes) -> tuple[Any, ...]:
        if unpack is not None:
            return tuple(starmap(cls, unpack(octets)))
        # Every n-th octet is a column; iterating over bytes gives integers.
        return tuple(map(cls, *[octets[first::fields] for first in range(fields)]))

    return records


def _fills(node: Node) -> bool:
    """Return whether reading ``node`` without an error always ends at the end of its region."""
    match node:
        case Rest() | Exact():
            return True
        case Many():
            return node.count is None
        case _:
            return False


def generate_decoder(plan: Node, types: ValueTypes, title: str) -> Decode:
    """Return the decoder of ``plan``: ``decode(b, o, e) -> (value, end)`` for ``bytes`` ``b``; raises DecodeError."""
    generator = _Generator(plan, types)
    value = generator.node(plan, _Path(), "e", {})
    generator.source.add(f"return {value}, o")
    decode: Decode = generator.source.compile(f"decoder {title}")
    return decode
