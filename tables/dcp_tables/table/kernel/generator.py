"""Generate the columnar decoder of a plan: Python source that Numba compiles.

The function reads frames in one buffer, finds the bearer payload of each, and appends the decoded values to the columns
of the tables (:mod:`dcp_tables.table.kernel.shape`). It only distinguishes valid frames from others. It removes the
values of an invalid frame and stores the number of the frame, and the strict decoder reports the error. So only the
strict decoder reports violations of the layout.

Like that of the strict decoder, the source is generated from the plan with numbered names, and contains no text from
outside. It is also plain Python, so that tests can run it for profiles that are not worth compiling.
"""

from __future__ import annotations

from dcp_codec.plan.tree import Exact, Fill, Group, Many, Node, Region, Rest, Scalar, Select, Text
from dcp_codec.views.decoder import branches

from .lines import DONE, FULL, POOL_FULL, KernelLines
from .row_buffer import ITEMS, item, places
from .shape import OCTETS, Column, Shape, Table

#: The parameters of the function before the columns, in this order.
PARAMETERS = (
    "b",  # the octets
    "starts", "stops", "numbers", "times", "lengths", "interfaces",  # of each frame
    "first", "count",  # which of them
    "udp", "kind",  # whether beacons are in UDP, and the port or EtherType
    "room", "space",  # number of rows after which a batch ends, octets of each column of variable length
    "high", "moved",  # capacity of the stage in rows, and number of rows after which those of a table are moved
    *ITEMS, "moves",  # the stage and its columns, see row_buffer.Stage
    "a_slots", "a_keys", "a_many",  # pool of addresses
    "n_slots", "n_keys", "n_ends", "n_arena", "n_many",  # pool of node identifiers
    "rows",  # for results: rows of each table, then the pools' sizes, malformed, other traffic, octets of each column
    "bad",  # for results: indices of the invalid frames
)  # fmt: skip


#: The variables of scalars that other members refer to, by their names.
_Scope = dict[str, "str | _Scope"]


def _resolve(scope: _Scope, reference: str) -> str:
    found: str | _Scope = scope
    for part in reference.split("."):
        assert isinstance(found, dict)
        found = found[part]
    assert isinstance(found, str)
    return found


class _Generator(KernelLines):
    def __init__(self, shape: Shape) -> None:
        varying = "".join(f", d{column.number}" for column in _varying(shape))
        targets = ", ".join(f"t{table.number}" for table in shape.tables)
        super().__init__(f"decode({', '.join(PARAMETERS)}, {targets}{varying})")
        self.shape = shape
        #: Names of the variables of the index columns, outermost first.
        self.indices: list[str] = []

    # -- records --------------------------------------------------------------------------------------------

    def table(self, group: Group, end: str, *, fits: bool = False) -> None:
        """Generate the decoding of a record that is a row of its own table. ``fits``: its size is already checked."""
        table = self.shape.table_of(group)
        row = f"r{table.number}"
        self.keys(table, row)
        begin = self.fresh("o")
        self.add(f"{begin} = o")
        self.group(group, row, end, {}, fits=fits)
        for column in table.columns:
            if column.name == OCTETS and self.shape.own(column):
                self.put(column, row, f"o - {begin}")
        self.add(f"{row} += 1")

    def keys(self, table: Table, row: str) -> None:
        columns = iter(table.columns)
        for value in ("number", "time", "sender"):
            column = next(columns)
            # The sender of a beacon is only known when its header was read.
            if not (value == "sender" and table.number == 0 and self.shape.sender is not None):
                self.put(column, row, value)
        for value in self.indices:
            self.put(next(columns), row, value)

    def group(self, group: Group, row: str, end: str, scope: _Scope, *, fits: bool) -> None:
        run: list[tuple[Scalar, _Scope]] = []
        self.members(group, row, end, scope, run, fits=fits)
        self.flush(run, row, end, fits=fits)

    def members(
        self, group: Group, row: str, end: str, scope: _Scope, run: list[tuple[Scalar, _Scope]], *, fits: bool
    ) -> None:
        for member in group.members:
            match member:
                case Scalar():
                    run.append((member, scope))
                case Group():
                    inner: _Scope = {}
                    scope[member.name] = inner
                    self.members(member, row, end, inner, run, fits=fits)
                case Text():
                    lengths: _Scope = {}
                    run.extend((prefix, lengths) for prefix in member.prefixes)
                    self.flush(run, row, end, fits=fits)
                    self.text(member, [_resolve(lengths, prefix.name) for prefix in member.prefixes], row, end)
                case _:
                    self.flush(run, row, end, fits=fits)
                    self.node(member, row, end, scope)

    def flush(self, run: list[tuple[Scalar, _Scope]], row: str, end: str, *, fits: bool) -> None:
        """Generate the decoding of adjacent scalars, with a single check of their size, and advance ``o``."""
        if not run:
            return
        size = sum(scalar.size for scalar, _ in run)
        if not fits:
            self.fail_if(f"{end} - o < {size}")
        at = 0
        for scalar, scope in run:
            self.scalar(scalar, scope, row, at)
            at += scalar.size
        self.add(f"o += {size}")
        run.clear()

    def scalar(self, scalar: Scalar, scope: _Scope, row: str, at: int) -> None:
        column = self.shape.of(scalar)
        place = f"o + {at}" if at else "o"
        if scalar.kind == "bytes":
            if scalar is self.shape.sender:
                self.node_id(place, scalar.size, "sender")
                self.put(self.shape.tables[0].columns[2], row, "sender")
            elif column is not None and column.kind == "node":
                code = self.fresh()
                self.node_id(place, scalar.size, code)
                self.put(column, row, code)
            elif column is not None:
                self.put_octets(column, row, place, scalar.size)
            return
        variable = self.fresh()
        self.add(f"{variable} = {self.number(scalar, 'o', at)}")
        if scalar.rule is not None:
            wanted = scalar.rule.value
            self.fail_if(f"{variable} == 0" if wanted is None else f"{variable} != {_pattern(wanted, scalar)}")
        scope[scalar.name] = variable
        self.put(column, row, variable)

    def text(self, text: Text, lengths: list[str], row: str, end: str) -> None:
        """Generate the decoding of the octets of ``text``, whose lengths are in the variables ``lengths``."""
        column, size = self.shape.of(text), self.fresh("s")
        assert column is not None
        if not lengths:
            self.add(f"{size} = 0")
            with self.block(f"while o + {size} < {end} and b[U64(o + {size})] != 0:"):
                self.add(f"{size} += 1")
            self.fail_if(f"o + {size} >= {end}")
        else:
            for other in lengths[1:]:
                self.fail_if(f"{other} != {lengths[0]}")
            self.fail_if(f"{lengths[0]} < 0 or {lengths[0]} > {end} - o")
            if not text.terminated:
                self.add(f"{size} = {lengths[0]}")
            else:
                self.fail_if(f"{lengths[0]} == 0")
                self.add(f"{size} = 0")
                with self.block(f"while {size} < {lengths[0]} and b[U64(o + {size})] != 0:"):
                    self.add(f"{size} += 1")
                self.fail_if(f"{size} != {lengths[0]} - 1")
        if column.kind == "node":
            code = self.fresh()
            self.intern_any("o", size, code)
            self.put(column, row, code)
        else:
            self.put_varying(column, row, "o", size)
        self.add(f"o += {size}{' + 1' if text.terminated else ''}")

    # -- structure ------------------------------------------------------------------------------------------

    def node(self, node: Node, row: str, end: str, scope: _Scope) -> None:
        match node:
            case Group():
                self.table(node, end)
            case Exact():
                self.fail_if(f"{end} - o != {node.size}")
                self.table(node.content, end, fits=True)
            case Many():
                self.many(node, end, scope)
            case Region():
                length, stop = _resolve(scope, node.length), self.fresh("e")
                self.fail_if(f"{length} < 0 or {length} > {end} - o")
                self.add(f"{stop} = o + {length}")
                self.node(node.content, row, stop, scope)
                self.fail_if(f"o != {stop}")
            case Select():
                self.select(node, row, end, scope)
            case Rest():
                column = self.shape.of(node)
                assert column is not None
                self.put_varying(column, row, "o", f"({end} - o)")
                self.add(f"o = {end}")
            case Fill():
                self.fill(node, row, end, scope)
            case _:
                raise TypeError(f"{type(node).__name__} is outside of a record")

    def fill(self, node: Fill, row: str, end: str, scope: _Scope) -> None:
        column, used, size = self.shape.of(node), _resolve(scope, node.used), self.fresh("s")
        assert column is not None
        self.fail_if(f"{used} < 0 or {used} > {node.total}")
        self.add(f"{size} = {node.total} - {used}")
        self.fail_if(f"{size} > {end} - o")
        self.put_varying(column, row, "o", size)
        self.add(f"o += {size}")

    def select(self, node: Select, row: str, end: str, scope: _Scope) -> None:
        key, column = _resolve(scope, node.key), self.shape.of(node)
        cases = [*node.cases.values(), *([node.default] if node.default is not None else [])]
        # Columns of variable length that only one case has: rows of the other cases have the length 0.
        own = [self.shape.of(case) if isinstance(case, Rest | Fill) else None for case in cases]
        # A case may fail, which is a `break`: this needs a loop.
        with self.loop("for _once in range(1):"):
            for index, case in enumerate(branches(self, key, node)):
                if case is None:
                    self.add("break")
                else:
                    self.case(case, index, column, own, row, end, scope)

    def case(
        self,
        case: Node,
        index: int,
        column: Column | None,
        own: list[Column | None],
        row: str,
        end: str,
        scope: _Scope,
    ) -> None:
        self.put(column, row, str(index))
        for other, absent in enumerate(own):
            if absent is not None and other != index:
                self.put(absent, row, f"m{absent.number}")
        self.node(case, row, end, scope)

    def many(self, node: Many, end: str, scope: _Scope) -> None:
        count = _resolve(scope, node.count) if node.count else None
        index, element = self.fresh("x"), node.element
        fits = count is not None and element.size is not None
        if fits:
            self.fail_if(f"{count} < 0 or {count} > ({end} - o) // {element.size}")
        self.add(f"{index} = 0")
        more = f"o < {end} or {index} == 0" if node.nonempty else f"o < {end}"
        with self.loop(f"while {index} < {count}:" if count else f"while {more}:"):
            self.indices.append(index)
            self.table(element, end, fits=fits)
            self.indices.pop()
            self.add(f"{index} += 1")
        if node.agrees:
            self.fail_if(f"{index} != {_resolve(scope, node.agrees)}")


def _pattern(value: int, scalar: Scalar) -> int:
    """Return ``value`` as the int64 that the decoder reads for it."""
    if scalar.size == 8 and not scalar.signed and value >= 1 << 63:
        return value - (1 << 64)
    return value


def kernel_source(shape: Shape) -> str:
    """Return the source of ``decode(...)`` for the tables of ``shape``; see ``PARAMETERS``."""
    generator = _Generator(shape)
    add, block = generator.add, generator.block
    varying, tables = _varying(shape), shape.tables
    add("a_mask, a_most = I64(len(a_slots) - 1), I64(len(a_keys))")
    add("n_mask, n_most = I64(len(n_slots) - 1), I64(len(n_keys))")
    before = places(shape.columns)
    for column in shape.columns:
        add(f"at{column.number} = {before[column.number] // int(item(column)[1])} * high")
    # Numbers of rows in the stage, and of moved rows.
    add(f"{' = '.join(f'r{table.number}' for table in tables)} = I64(0)")
    add(f"{' = '.join(f'n{table.number}' for table in tables)} = I64(0)")
    for column in varying:
        add(f"m{column.number} = I64(0)")
    add("malformed = other = I64(0)")
    add(f"status = {DONE}")
    add("i = first")
    with block("while i < count:"):
        add("o, e, ether = locate(b, starts[i], stops[i], udp, kind)")
        generator.when("o < 0", "other += 1", "i += 1", "continue")
        _make_room(generator, varying)
        for table in tables:
            add(f"was{table.number} = r{table.number}")
        for column in varying:
            add(f"u{column.number} = m{column.number}")
        add("number, time, bad_now = numbers[i], times[i], 1")
        add("sender = I64(0)")
        with block("while True:"):
            _beacon(generator)
        with block("if bad_now != 0:"):
            for table in tables:
                add(f"r{table.number} = was{table.number}")
            for column in varying:
                add(f"m{column.number} = u{column.number}")
            generator.when(f"bad_now == {POOL_FULL}", f"status = {POOL_FULL}", "break")
            add("bad[malformed] = i")
            add("malformed += 1")
        add("i += 1")
    for table in tables:
        _move(generator, table)
    for place, value in enumerate(result_names(shape)):
        add(f"rows[{place}] = {value}")
    add("return i, status")
    return "\n".join(generator.lines) + "\n"


def _varying(shape: Shape) -> list[Column]:
    """Return the columns of variable length."""
    return [column for column in shape.columns if column.kind in ("varying", "text")]


def result_names(shape: Shape) -> list[str]:
    """Return the names of the variables whose values are in ``rows`` when the function returns."""
    varying = [f"m{column.number}" for column in _varying(shape)]
    return [*(f"n{table.number}" for table in shape.tables), "a_many", "n_many", "malformed", "other", *varying]


def _make_room(generator: _Generator, varying: list[Column]) -> None:
    """Generate the code that makes room for a frame in the stage, and ends the loop over frames if a batch is full."""
    add, block, tables = generator.add, generator.block, generator.shape.tables
    # The remaining octets are an upper bound of the numbers of records and of octets of values.
    add("most = e - o")
    # The OR of all row counts is an upper bound, so that one comparison covers every table.
    any_rows = " | ".join(f"r{table.number}" for table in tables)
    over = [f"m{column.number} + most > space" for column in varying]
    with block(f"if {' or '.join([f'({any_rows}) >= moved', 'most > high - moved', *over])}:"):
        generator.when(" or ".join(["most > high", *over]), f"status = {FULL}", "break")
        add("least = 1 if most > high - moved else moved")
        for table in tables:
            with block(f"if r{table.number} >= least:"):
                _move(generator, table)
        generator.when(" or ".join(f"n{table.number} >= room" for table in tables), f"status = {FULL}", "break")


def _move(generator: _Generator, table: Table) -> None:
    """Generate the code that moves the rows of a table from the stage to its columns."""
    number = table.number
    begin = sum(len(other.columns) for other in generator.shape.tables[:number])
    end = begin + len(table.columns)
    # I64, so that all calls have the same types: otherwise Numba would compile the function for each table.
    generator.add(f"move(u1, r{number}, t{number}, n{number}, moves, I64({begin}), I64({end}))")
    generator.add(f"n{number} += r{number}")
    generator.add(f"r{number} = 0")


def _beacon(generator: _Generator) -> None:
    """Generate the decoding of one frame: the additional columns, then the record of the plan."""
    add, shape = generator.add, generator.shape
    beacons = shape.tables[0]
    row = "r0"
    frame = "starts[i]"
    for name, at in (("dst", frame), ("src", f"{frame} + 6")):
        place = generator.fresh("p")
        add(f"{place} = {at}")
        generator.intern("a", place, 6, name)
        generator.put(beacons.column(name), row, name)
    if shape.sender is None:
        add("sender = src")
    generator.put(beacons.column("interface"), row, "interfaces[i]")
    generator.put(beacons.column("frameLength"), row, "lengths[i]")
    generator.table(shape.plan, "e")
    generator.put(beacons.column("padding"), f"({row} - 1)", "e - o")
    add("bad_now = 0")
    add("break")
