"""The tables of a profile with their columns, derived from the plan of its layout.

Every record type of the plan is a table. Nested records are flattened into the enclosing table, and every table starts
with the keys that join it to the others. Column names are the field names of the specification, as in JSON and
Wireshark. Fields with a fixed value (version, magic number) have no column. Lengths and counts have columns, because
they are needed to compute overhead.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

from dcp_spec.profile.definition import Profile

from dcp_codec.plan.tree import Exact, Fill, Group, Many, Node, Region, Rest, Scalar, Select, Text, snake

#: Names of tables by record type of the schema, in the order in which tables are listed.
TABLE_NAMES = {
    "Beacon": "beacons",
    "Payload": "payloads",
    "ExtendedSafetyData": "srp",
    "Container": "containers",
    "VarCreate": "creates",
    "VarUpdate": "updates",
    "VarDelete": "deletes",
    "VarSumm": "summaries",
    "VarReqUpdate": "req_updates",
    "VarReqCreate": "req_creates",
}
#: The table of frames that are not valid beacons of the profile; it has the same columns for every profile.
ERRORS = "errors"
#: The table of the states of variables at nodes, from the ledger.
HOLDINGS = "holdings"
TABLES = (*TABLE_NAMES.values(), ERRORS)


def table_name(type_name: str) -> str:
    """Return the name of the table of a record type; that of a profile's own type ``GeoFence`` is ``geo_fence``."""
    return TABLE_NAMES.get(type_name) or snake(type_name)


def table_names(profile: Profile) -> tuple[str, ...]:
    """Return the tables that recordings of a profile can have: the usual ones, and those of its own record types."""
    own = [table_name(container.type_name) for container in profile.vardis.own_containers]
    report = ["own_report"] if profile.srp.record and not profile.srp.is_report else []
    return (*TABLE_NAMES.values(), *report, *own, ERRORS)


#: Additional column with the size of records that have no length field.
OCTETS = "octets"

#: Size in octets of the index of lists without a count field.
_FREE_INDEX = 4

Kind = Literal["int", "float", "octets", "address", "node", "varying", "text", "label", "time"]


@dataclass(frozen=True, slots=True)
class Column:
    """One column. ``size`` is the size of a value in memory in octets (1, 2, 4 or 8; for ``octets`` any size).

    ``address`` and ``node`` are link-layer addresses and node identifiers, stored as numbers in a pool. ``varying``
    are octets of variable length, ``text`` the same as UTF-8. ``label`` is an index of ``labels``. ``only`` is the
    number of a label column and an index: only rows with that index have a value, others are null.
    """

    name: str
    kind: Kind
    size: int
    number: int
    signed: bool = False
    labels: tuple[str, ...] = ()
    only: tuple[int, int] | None = None
    unit: str = ""
    doc: str = ""


@dataclass(slots=True)
class Table:
    """One table. ``number`` is its index in the shape; its keys are the first of its ``columns``."""

    name: str
    type_name: str
    number: int
    columns: list[Column] = field(default_factory=list)

    def column(self, name: str) -> Column:
        """Return the column of that name. Raise KeyError if it does not exist."""
        for column in self.columns:
            if column.name == name:
                return column
        raise KeyError(name)


class Shape:
    """The tables of a plan, and the columns of its nodes.

    ``columns`` are all columns by number. ``of(node)`` returns the column of a node, which must be an object of this
    plan.
    """

    def __init__(self, plan: Node) -> None:
        assert isinstance(plan, Group)
        self.tables: list[Table] = []
        self.columns: list[Column] = []
        #: Columns by the identity of nodes, because equal scalars in two records have different columns. The reference
        #: to the plan keeps the identities valid.
        self._places: dict[int, Column] = {}
        self.plan = plan
        self.sender = _sender_of(plan)
        #: Type of the sender: the node identifier in the beacon, or the source address if beacons have none.
        self.sender_kind: Literal["node", "address"] = "address" if self.sender is None else "node"
        table = self._table(plan, [])
        for name, size, doc in (
            ("interface", 4, "interface of the recording, from 0"),
            ("frameLength", 4, "octets of the frame on the wire"),
            (OCTETS, 4, "octets of the bearer payload without padding"),
            ("padding", 4, "octets after the bearer payload"),
        ):
            self._add(table, Column(name, "int", size, 0, unit="octets" if name != "interface" else "", doc=doc))
        for name, doc in (("src", "source address of the frame"), ("dst", "destination address of the frame")):
            self._add(table, Column(name, "address", 4, 0, doc=doc))
        self._group(table, plan, [])

    def named(self, name: str) -> Table:
        """Return the table of that name. Raise KeyError if the profile does not have it."""
        for table in self.tables:
            if table.name == name:
                return table
        raise KeyError(name)

    def of(self, node: Node) -> Column | None:
        """Return the column of ``node``; None without a column."""
        return self._places.get(id(node))

    def own(self, column: Column) -> bool:
        """Return whether a column is an additional one, not a field of the profile."""
        return all(other is not column for other in self._places.values())

    def table_of(self, group: Group) -> Table:
        """Return the table of a record. Raise KeyError if the record is flattened into another table."""
        return self.named(table_name(group.type_name))

    # -- building -------------------------------------------------------------------------------------------

    def _table(self, group: Group, indices: list[tuple[str, int]]) -> Table:
        table = Table(table_name(group.type_name), group.type_name, len(self.tables))
        self.tables.append(table)
        self._add(table, Column("frame", "int", 8, 0, signed=True, doc="number of the frame in the recording, from 1"))
        self._add(table, Column("time", "time", 8, 0, unit="ns", doc="time of capture, UTC"))
        self._add(table, Column("sender", self.sender_kind, 4, 0, doc="sender of the beacon"))
        for name, size in indices:
            self._add(table, Column(name, "int", size, 0, doc=f"index of the {name}, from 0"))
        if group.type_name == "Container":
            self._add(table, Column(OCTETS, "int", 4, 0, unit="octets", doc="octets with the header"))
        return table

    def _add(self, table: Table, column: Column, node: Node | None = None, group: str = "") -> Column:
        name = column.name
        taken = {other.name for other in table.columns}
        if name in taken:
            # Elements of lists have no name.
            name = f"{group or table.type_name.lower()}_{name}"
        while name in taken:
            name += "_"
        made = replace(column, name=name, number=len(self.columns))
        table.columns.append(made)
        self.columns.append(made)
        if node is not None:
            self._places[id(node)] = made
        return made

    def _group(self, table: Table, group: Group, indices: list[tuple[str, int]]) -> None:
        scope: dict[str, Scalar] = {}
        _scalars(group, "", scope)
        for member in group.members:
            match member:
                case Scalar():
                    if member is not self.sender and (member.rule is None or member.rule.value is None):
                        self._add(table, _scalar(member), member, group.name)
                case Text():
                    self._add(table, _text(member), member, group.name)
                case Group():
                    self._group(table, member, indices)
                case _:
                    self._node(table, member, indices, scope, None)

    def _node(
        self,
        table: Table,
        node: Node,
        indices: list[tuple[str, int]],
        scope: dict[str, Scalar],
        only: tuple[int, int] | None,
    ) -> None:
        match node:
            case Fill() | Rest():
                self._add(table, Column(node.name, "varying", 4, 0, only=only, doc=node.doc), node)
            case Region():
                self._node(table, node.content, indices, scope, only)
            case Exact():
                self._group(self._table(node.content, indices), node.content, indices)
            case Group():
                self._group(self._table(node, indices), node, indices)
            case Many():
                counter = scope.get(node.count or node.agrees or "")
                index = (_INDEX_OF.get(node.element.type_name, "record"), _width(counter))
                deeper = [*indices, index]
                self._group(self._table(node.element, deeper), node.element, deeper)
            case Select():
                key = scope[node.key]
                cases = [*node.cases.items(), *([(None, node.default)] if node.default is not None else [])]
                names = key.names or {}
                labels = tuple(str(names.get(number, case.name)) for number, case in cases)  # type: ignore[arg-type]
                name = key.name_field or "content"
                chosen = self._add(
                    table, Column(name, "label", 1, 0, labels=labels, doc=f"meaning of {node.key}"), node
                )
                for number, (_, case) in enumerate(cases):
                    self._node(table, case, indices, scope, (chosen.number, number))
            case _:
                raise TypeError(f"{type(node).__name__} has no place in a table")


_INDEX_OF = {"Payload": "payload", "Container": "container"}


def _sender_of(plan: Group) -> Scalar | None:
    """Return the field of the header with the sender of the beacon; None if there is none."""
    for member in plan.members:
        if isinstance(member, Group):
            for inner in member.members:
                if isinstance(inner, Scalar) and inner.role == "node-id":
                    return inner
    return None


def _scalars(group: Group, prefix: str, found: dict[str, Scalar]) -> None:
    """Add the scalars of a record to ``found``, by the names with which its members refer to them."""
    for member in group.members:
        if isinstance(member, Scalar):
            found[prefix + member.name] = member
        elif isinstance(member, Group):
            _scalars(member, f"{prefix}{member.name}.", found)


def _width(counter: Scalar | None) -> int:
    """Return the size in octets of an index for the counts of ``counter``."""
    return held(min(counter.size, _FREE_INDEX)) if counter is not None else _FREE_INDEX


def held(size: int) -> int:
    """Return the size in memory, in octets, of an integer of ``size`` octets."""
    return 1 if size == 1 else 2 if size == 2 else 4 if size <= 4 else 8


def _scalar(scalar: Scalar) -> Column:
    if scalar.kind == "bytes":
        if scalar.role == "node-id":
            return Column(scalar.name, "node", 4, 0, doc=scalar.doc)
        return Column(scalar.name, "octets", scalar.size, 0, doc=scalar.doc)
    kind: Kind = "float" if scalar.kind == "float" else "int"
    return Column(scalar.name, kind, held(scalar.size), 0, scalar.signed, unit=scalar.unit or "", doc=scalar.doc)


def _text(text: Text) -> Column:
    if text.role == "node-id":
        return Column(text.name, "node", 4, 0, doc=text.doc)
    return Column(text.name, "text" if text.human else "varying", 4, 0, unit=text.unit or "", doc=text.doc)
