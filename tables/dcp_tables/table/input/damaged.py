"""Rows of damaged beacons: their header, their valid payloads, and one row of errors for each invalid payload.

The compiled decoder stores no rows of an invalid frame. Such frames are decoded here with
:meth:`dcp_codec.codec.Codec.salvage`, and get the rows of a valid frame without the content of invalid payloads. A
beacon whose blocks are inconsistent in every reading has rows in ``errors`` only.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa
from dcp_spec.profile.definition import Link

from dcp_codec.codec import Codec
from dcp_codec.errors import Problem
from dcp_codec.framing.locate import Framing, locate, mac
from dcp_codec.jsonform import problem_json
from dcp_codec.plan.layout import walk
from dcp_codec.plan.tree import Exact, Group, Many, Node, Region, Scalar, Select, Text
from dcp_codec.views.fields import Field
from dcp_codec.views.salvage import Salvaged
from dcp_tables.table.columns import HEX
from dcp_tables.table.kernel.shape import ERRORS, OCTETS, Column, Shape, Table

_Row = dict[str, Any]
#: The payload block in the path of a problem.
_BLOCK = re.compile(r"payloads\[(\d+)\]")


class DamagedFrames:
    """Collects the rows of damaged frames in the order in which they are added."""

    def __init__(
        self,
        codec: Codec,
        link: Link,
        shape: Shape,
        schemas: Mapping[str, pa.Schema],
        node_text: Callable[[bytes], str],
    ) -> None:
        """``schemas`` has the schemas of all tables; ``node_text`` converts a node identifier to text."""
        self._codec, self._link, self._shape, self._schemas = codec, link, shape, schemas
        self._node_text = node_text
        self._sender_at = _sender_offset(shape)
        self._rows: dict[str, list[_Row]] = defaultdict(list)

    def add(self, data: bytes, number: int, time: int, length: int, interface: int) -> None:
        """Add a frame that the compiled decoder rejects. ``time``: ns since 1970. ``length``: octets on the wire.

        Raise AssertionError if the strict decoder accepts the frame.
        """
        framing = locate(data, self._link)
        assert isinstance(framing, Framing)
        octets = data[framing.start : framing.end]
        found = self._codec.salvage(octets)
        if not found.problems:
            raise AssertionError(
                f"the columnar decoder of {self._codec.profile.name} rejects a frame that the strict one accepts"
            )
        keys = {"frame": number, "time": time, "sender": self._sender(octets, framing)}
        self._rows[ERRORS] += [keys | _error(each.moved(framing.start)) for each in found.faults]
        if found.beacon is None or not found.clear:
            return
        keys |= {
            "interface": interface,
            "frameLength": length,
            OCTETS: found.end,
            "padding": len(octets) - found.end,
            "src": mac(framing.src or b""),
            "dst": mac(framing.dst or b""),
        }
        tree = self._codec.salvage_tree(octets, found)
        _Beacon(self._shape, self._rows, found, self._node_text).rows(tree.root, keys)

    def tables(self) -> dict[str, pa.RecordBatch]:
        """Return the collected rows by table; tables without rows are left out."""
        return {name: batch_of(rows, self._schemas[name]) for name, rows in self._rows.items() if rows}

    def _sender(self, octets: bytes, framing: Framing) -> str | None:
        """Return the sender as :attr:`dcp_codec.framing.frames.DissectedFrame.sender` does; None if unknown."""
        sender = self._shape.sender
        if sender is None:
            return mac(framing.src) if framing.src is not None else None
        found = octets[self._sender_at : self._sender_at + sender.size]
        return self._node_text(found) if len(found) == sender.size else None


class _Beacon:
    """Creates the rows of one beacon from its dissected fields."""

    def __init__(
        self, shape: Shape, rows: dict[str, list[_Row]], found: Salvaged, node_text: Callable[[bytes], str]
    ) -> None:
        assert found.beacon is not None
        self._shape, self._rows, self._node_text = shape, rows, node_text
        self._payloads = found.beacon.payloads
        self._damaged = {each.payload for each in found.damaged}

    def rows(self, root: Field, keys: _Row) -> None:
        """Add the row of the beacon, which has all of ``keys``, and the rows of its nested records."""
        row = dict(keys)
        self._rows[self._shape.tables[0].name].append(row)
        self._keys = {name: keys[name] for name in ("frame", "time", "sender")}
        plan = self._shape.plan
        assert isinstance(plan, Group)
        self._members(plan, root, row, [])

    def _members(self, group: Group, field: Field, row: _Row, indices: list[int]) -> None:
        numbers: dict[str, Any] = {}
        for member, part in zip(group.members, field.children, strict=False):
            if isinstance(member, Scalar):
                numbers[member.name] = part.value
                self._put(row, self._shape.of(member), part)
            elif isinstance(member, Text):
                self._put(row, self._shape.of(member), part)
            elif isinstance(member, Group):
                self._members(member, part, row, indices)
            else:
                self._node(member, part, row, indices, numbers)

    def _node(self, node: Node, field: Field, row: _Row, indices: list[int], numbers: Mapping[str, Any]) -> None:
        match node:
            case Region():
                self._node(node.content, field, row, indices, numbers)
            case Select():
                self._select(node, field, row, indices, numbers)
            case Exact():
                self._record(node.content, field, indices)
            case Group():
                self._record(node, field, indices)
            case Many():
                for index, element in enumerate(field.children[: self._sound(node, field, indices)]):
                    self._record(node.element, element, [*indices, index])
            case _:
                self._put(row, self._shape.of(node), field)

    def _select(self, node: Select, field: Field, row: _Row, indices: list[int], numbers: Mapping[str, Any]) -> None:
        cases = list(node.cases)
        number = numbers[node.key]
        chosen = cases.index(number) if number in node.cases else len(cases)
        column = self._shape.of(node)
        assert column is not None
        row[column.name] = column.labels[chosen]
        case = node.cases.get(number, node.default)
        if case is not None and (isinstance(case, Many) or not self._bad(indices)):
            self._node(case, field, row, indices, numbers)

    def _bad(self, indices: Sequence[int]) -> bool:
        """Return whether these are the indices of the content of a damaged payload block."""
        return len(indices) == 1 and indices[0] in self._damaged

    def _sound(self, node: Many, field: Field, indices: Sequence[int]) -> int:
        """Return the number of valid elements at the start of a list."""
        if node.element.type_name == "Payload":
            return len(self._payloads)
        if self._bad(indices):
            containers = self._payloads[indices[0]].vardis
            return 0 if containers is None else len(containers)
        return len(field.children)

    def _record(self, group: Group, field: Field, indices: list[int]) -> None:
        table = self._shape.table_of(group)
        row = dict(self._keys)
        row.update(zip((column.name for column in table.columns[3 : 3 + len(indices)]), indices, strict=True))
        own = _octets_column(table, self._shape)
        if own is not None:
            row[own.name] = field.length
        self._rows[table.name].append(row)
        self._members(group, field, row, indices)

    def _put(self, row: _Row, column: Column | None, field: Field) -> None:
        if column is None:
            return
        value = field.value
        match column.kind:
            case "node":
                row[column.name] = self._node_text(value)
            case "text":
                name, text = _as_text(column.name, value)
                row[name] = text
            case _:
                row[column.name] = value


def _as_text(name: str, octets: bytes) -> tuple[str, str]:
    """Return column and value of a text: the text, or its hex if it is not UTF-8."""
    try:
        return name, octets.decode()
    except UnicodeDecodeError:
        return name + HEX, octets.hex()


def _octets_column(table: Table, shape: Shape) -> Column | None:
    """Return the additional column for the size of a record; None if the table does not have it."""
    return next((column for column in table.columns if column.name == OCTETS and shape.own(column)), None)


def _error(problem: Problem) -> _Row:
    block = _BLOCK.match(problem.path)
    return {
        **problem_json(problem),
        "payload": None if block is None else int(block[1]),
        "needed": _fitting(problem.needed),
        "available": _fitting(problem.available),
    }


def _fitting(number: int | None) -> int | None:
    """Return a number of a problem, limited to the range of a signed 64-bit integer."""
    return None if number is None else min(number, (1 << 63) - 1)


def batch_of(rows: Sequence[_Row], schema: pa.Schema) -> pa.RecordBatch:
    arrays = [_array([row.get(field.name) for row in rows], field.type) for field in schema]
    return pa.RecordBatch.from_arrays(arrays, schema=schema)


def _array(values: list[Any], kind: pa.DataType) -> pa.Array:
    if pa.types.is_dictionary(kind):
        return pa.array(values, kind.value_type).dictionary_encode().cast(kind)
    if pa.types.is_timestamp(kind):
        return pa.array(values, pa.int64()).cast(kind)
    return pa.array(values, kind)


def merged(good: pa.RecordBatch, more: pa.RecordBatch) -> pa.RecordBatch:
    """Return the rows of both batches, sorted by frame number."""
    if not good.num_rows:
        return more
    arrays = [pa.concat_arrays([one, other]) for one, other in zip(good.columns, more.columns, strict=True)]
    frames = np.concatenate([good.column("frame").to_numpy(), more.column("frame").to_numpy()])
    order = pa.array(np.argsort(frames, kind="stable"))
    return pa.RecordBatch.from_arrays([array.take(order) for array in arrays], schema=good.schema)


def _sender_offset(shape: Shape) -> int:
    """Return the offset of the sender's identifier in the header, in octets."""
    if shape.sender is None:
        return 0
    header = next(node for node in walk(shape.plan) if isinstance(node, Group) and shape.sender in node.members)
    at = 0
    for member in header.members:
        if member is shape.sender:
            break
        assert isinstance(member, Scalar)
        at += member.size
    return at
