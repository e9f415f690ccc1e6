"""Read the columns of one recording that a report needs, in a compact form."""

from __future__ import annotations

import shlex
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
from dcp_spec.constants import ICType
from dcp_spec.profile.definition import SafetyField

from dcp_codec.analysis.entry import DELETED, UNKNOWN
from dcp_codec.analysis.vantage_point import is_of_medium
from dcp_codec.codec import Codec
from dcp_codec.common.printable import plain
from dcp_tables.table.decoding import Batch
from dcp_tables.table.input.sources import Recording
from dcp_tables.table.job import Advance, Outcome, batches, decoder_for, resolve, tell_others

Column = npt.NDArray[Any]

#: Maximum length in octets of a value that is also read as a number.
NUMBER_OCTETS = 8
#: Name of an unknown sender.
NOBODY = "unknown"
#: Maximum number of rows of one recording: about four for each beacon, with some 55 octets each while it is read.
MOST_ROWS = 20_000_000
#: Tables of records that show which version of a variable a node holds, with the type of their records; see
#: dcp_codec.analysis.ledger.
HOLDING = {
    "creates": ICType.CREATE_VARIABLES,
    "updates": ICType.UPDATES,
    "summaries": ICType.SUMMARIES,
    "deletes": ICType.DELETE_VARIABLES,
    "req_updates": ICType.REQUEST_VARUPDATES,
    "req_creates": ICType.REQUEST_VARCREATES,
}
#: States that records without sequence number stand for.
_INSTEAD = {"deletes": DELETED, "req_creates": UNKNOWN}
#: Columns with the place of a record in its frame.
_PLACE = ("payload", "container", "record")
_SECOND = 1_000_000_000
#: Maximum length of a description in characters.
_DESCRIPTION = 120


@dataclass
class Variable:
    """The last records about a variable. ``producer`` is an index of ``Recorded.nodes``, -1 without a VarCreate."""

    producer: int = -1
    description: str = ""
    value: bytes = b""


class Texts:
    """Numbers texts in the order of their first occurrence."""

    def __init__(self) -> None:
        self.texts: list[str] = []
        self._numbers: dict[str, int] = {}

    def number(self, text: str | None) -> int:
        """Return the number of a text; a new text gets the next number."""
        known = NOBODY if text is None else text
        if known not in self._numbers:
            self._numbers[known] = len(self.texts)
            self.texts.append(known)
        return self._numbers[known]

    def numbers(self, column: pa.Array) -> Column:
        """Return the numbers of a dictionary column of texts."""
        many = len(column.dictionary)
        # The last element is for null.
        known = np.array([self.number(text) for text in column.dictionary.to_pylist()] + [-1], np.int32)
        indices = _array(column.indices, many).astype(np.int64)
        if known.size and (indices == many).any():
            known[many] = self.number(None)
        found: Column = known[indices]
        return found


@dataclass
class Recorded:
    """The compact columns of a recording. Times are ns since 1970, nodes are indices of ``nodes``."""

    outcome: Outcome
    codec: Codec
    nodes: list[str]
    reasons: list[str]
    contents: list[str]
    #: Columns by table: beacons, payloads, containers, srp, values (of records), held (held numbers), errors.
    tables: dict[str, dict[str, Column]]
    variables: dict[int, Variable]
    requirements: dict[str, str]
    #: Units by role (``position.x``, ...), for a profile whose safety data has these roles.
    units: dict[str, str]
    #: The moduli of the sequence numbers of beacons and of variables; 0 for a profile without sequence numbers.
    modulus: int
    number_modulus: int
    #: Options of dcp-codec with which this recording was decoded.
    options: str = ""
    #: Whether the recording has each transmission once, independent of receptions: then losses are unknown.
    transmissions_only: bool = False

    @property
    def tells_losses(self) -> bool:
        """Whether gaps in the sequence numbers of beacons are losses."""
        return bool(self.modulus) and not self.transmissions_only

    def column(self, table: str, name: str) -> Column:
        """Return one column; empty if the profile does not have the table."""
        return self.tables[table][name]


#: The columns of each table, with their types.
_KEPT: dict[str, dict[str, Any]] = {
    "beacons": {"frame": np.int64, "time": np.int64, "node": np.int32, "interface": np.uint32, "seqno": np.int64}
    | {"octets": np.uint32, "around": np.uint32},
    "payloads": {"time": np.int64, "content": np.int16, "octets": np.int64},
    "containers": {"time": np.int64, "content": np.int16, "octets": np.int64},
    "srp": {"time": np.int64, "node": np.int32, "x": np.float64, "y": np.float64, "z": np.float64},
    "values": {"frame": np.int64, "time": np.int64, "node": np.int32, "variable": np.int64, "seqno": np.int64}
    | {"creation": np.int64, "size": np.int64, "number": np.float64},
    "held": {"frame": np.int64, "time": np.int64, "node": np.int32, "variable": np.int64, "seqno": np.int64}
    | {"kind": np.int8, "creation": np.int64, "producer": np.int32},
    "errors": {"frame": np.int64, "time": np.int64, "node": np.int32, "reason": np.int32},
}


@dataclass
class _Gatherer:
    codec: Codec
    nodes: Texts = field(default_factory=Texts)
    reasons: Texts = field(default_factory=Texts)
    contents: Texts = field(default_factory=Texts)
    pieces: dict[str, dict[str, list[Column]]] = field(
        default_factory=lambda: {table: {name: [] for name in columns} for table, columns in _KEPT.items()}
    )
    variables: dict[int, Variable] = field(default_factory=dict)
    requirements: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.roles: dict[str, SafetyField] = {
            each.role: each for each in self.codec.profile.srp.safety_data if each.role
        }
        self.modulus = self.number_modulus = 0
        #: Number of rows of all tables.
        self.rows = 0

    def add(self, batch: Batch) -> None:
        """Append the required columns of a batch."""
        tables = batch.tables
        self._beacons(tables["beacons"])
        self._lengths("payloads", tables["payloads"], "content", "length")
        self._errors(tables["errors"])
        # Some profiles do not have these tables.
        if "containers" in tables:
            self._lengths("containers", tables["containers"], "icName", "octets")
        if "srp" in tables:
            self._srp(tables["srp"])
        for name in ("creates", "updates"):
            if name in tables and tables[name].num_rows:
                self._read_values(tables[name])
        self._held({name: tables[name] for name in HOLDING if name in tables and tables[name].num_rows})
        if "creates" in tables:
            self._creations(tables["creates"])

    def table(self, name: str) -> dict[str, Column]:
        """Return the columns of a table and remove its pieces, so that only one table is in memory twice."""
        pieces = self.pieces.pop(name)
        return {
            column: np.concatenate([np.empty(0, kind), *pieces.pop(column)]) for column, kind in _KEPT[name].items()
        }

    def _keep(self, table: str, **columns: Column) -> None:
        self.rows += len(next(iter(columns.values())))
        for name, values in columns.items():
            # Copy the values, because the memory of the batch is reused.
            self.pieces[table][name].append(np.array(values, _KEPT[table][name]))

    def _keys(self, rows: pa.RecordBatch) -> dict[str, Column]:
        """Return the columns of most tables: frame, time and sender."""
        return {
            "frame": _integers(rows["frame"]),
            "time": _integers(rows["time"]),
            "node": self.nodes.numbers(rows["sender"]),
        }

    def _beacons(self, rows: pa.RecordBatch) -> None:
        has_seqno = "seqno" in rows.schema.names
        if has_seqno:
            self.modulus = 1 << rows.schema.field("seqno").type.bit_width
        seqno = _integers(rows["seqno"]) if has_seqno else np.zeros(rows.num_rows, np.int64)
        octets, frames = _integers(rows["octets"]), _integers(rows["frameLength"])
        around = np.maximum(frames - octets, 0)
        interface = _integers(rows["interface"])
        self._keep("beacons", **self._keys(rows), interface=interface, seqno=seqno, octets=octets, around=around)

    def _lengths(self, table: str, rows: pa.RecordBatch, content: str, length: str) -> None:
        octets = _integers(rows[length])
        self._keep(table, time=_integers(rows["time"]), content=self.contents.numbers(rows[content]), octets=octets)

    def _srp(self, rows: pa.RecordBatch) -> None:
        places = {}
        for axis in "xyz":
            member = self.roles.get(f"position.{axis}")
            known = member is not None and member.name in rows.schema.names
            places[axis] = _array(rows[member.name]) if member is not None and known else np.full(rows.num_rows, np.nan)
        self._keep("srp", time=_integers(rows["time"]), node=self.nodes.numbers(rows["nodeId"]), **places)

    def _read_values(self, rows: pa.RecordBatch) -> None:
        variable = _integers(rows["varId"])
        size, number = _numbers(rows["value"])
        self._keep(
            "values",
            **self._keys(rows),
            variable=variable,
            seqno=_integers(rows["seqno"]),
            creation=_creation_times(rows),
            size=size,
            number=number,
        )
        for each, row in _last_rows(variable):
            self._variable(each).value = rows["value"][row].as_py() or b""

    def _held(self, tables: dict[str, pa.RecordBatch]) -> None:
        """Append the held numbers of nodes: the first and the last record of each state, and one record per second.

        The latter show the silence of a node.
        """
        if not tables:
            return
        columns: dict[str, list[Column]] = {name: [] for name in (*_PLACE, *_KEPT["held"])}
        for name, rows in tables.items():
            many = rows.num_rows
            for each in (*_PLACE, "frame", "time"):
                columns[each].append(_integers(rows[each]))
            columns["variable"].append(_integers(rows["varId"]))
            columns["node"].append(self.nodes.numbers(rows["sender"]))
            columns["kind"].append(np.full(many, HOLDING[name], np.int8))
            columns["creation"].append(_creation_times(rows))
            creates = name == "creates"
            columns["producer"].append(self.nodes.numbers(rows["prodId"]) if creates else np.full(many, -1, np.int32))
            if name in _INSTEAD:
                columns["seqno"].append(np.full(many, _INSTEAD[name], np.int64))
            else:
                self.number_modulus = 1 << rows.schema.field("seqno").type.bit_width
                columns["seqno"].append(_integers(rows["seqno"]).astype(np.int64))
        joined = {name: np.concatenate(pieces) for name, pieces in columns.items()}
        order = np.lexsort([joined[name] for name in (*_PLACE[::-1], "frame", "node", "variable")])
        found = {name: column[order] for name, column in joined.items()}
        changes = np.ones(order.size + 1, bool)
        changes[1:-1] = False
        for name in ("node", "variable", "seqno"):
            changes[1:-1] |= found[name][1:] != found[name][:-1]
        seconds = found["time"] // _SECOND
        # A create may begin another state with the same number.
        changes[:-1] |= found["producer"] >= 0
        # Also keep the last record before a silence.
        silence = np.append(np.diff(found["time"]) > _SECOND, True)
        kept = changes[:-1] | changes[1:] | silence
        kept[1:] |= seconds[1:] != seconds[:-1]
        self._keep("held", **{name: found[name][kept] for name in _KEPT["held"]})

    def _creations(self, rows: pa.RecordBatch) -> None:
        producers = self.nodes.numbers(rows["prodId"])
        variable = _integers(rows["varId"])
        for each, row in _last_rows(variable):
            known = self._variable(each)
            known.producer = int(producers[row])
            text = rows["descr"][row].as_py()
            hexed = rows["descrHex"][row].as_py()
            known.description = text[:_DESCRIPTION] if text is not None else f"0x{(hexed or '')[:_DESCRIPTION]}"

    def _variable(self, number: int) -> Variable:
        return self.variables.setdefault(number, Variable())

    def _errors(self, rows: pa.RecordBatch) -> None:
        self._keep("errors", **self._keys(rows), reason=self.reasons.numbers(rows["reason"]))
        for reason, requirement in zip(rows["reason"].to_pylist(), rows["requirement"].to_pylist(), strict=True):
            self.requirements.setdefault(reason or NOBODY, requirement or "")


def _integers(column: pa.Array) -> Column:
    return _array(column.view(pa.int64()) if pa.types.is_timestamp(column.type) else column)


def _array(column: pa.Array, null: float = np.nan) -> Column:
    """Return the numbers of a column, read-only, with ``null`` for missing ones.

    ``to_numpy`` would import pandas, if installed, which takes as long as reading some thousand beacons.
    """
    if column.null_count:
        found: Column = np.nan_to_num(column.to_numpy(zero_copy_only=False), nan=null)
        return found
    return np.from_dlpack(column)


def _creation_times(rows: pa.RecordBatch) -> Column:
    """Return the creation times in the records; 0 for a VarCreate without creation time, -1 for a VarUpdate."""
    if "prodId" not in rows.schema.names:
        return np.full(rows.num_rows, -1, np.int64)
    if "creationTime" not in rows.schema.names:
        return np.zeros(rows.num_rows, np.int64)
    return _integers(rows["creationTime"]).astype(np.int64)


def _numbers(column: pa.Array) -> tuple[Column, Column]:
    """Return the length of each value, and values of 1 to 8 octets as unsigned big-endian numbers; NaN for others."""
    _, offsets, data = column.buffers()
    ends = np.frombuffer(offsets, np.int32)[column.offset : column.offset + len(column) + 1].astype(np.int64)
    octets = np.frombuffer(data, np.uint8) if data is not None and data.size else np.zeros(1, np.uint8)
    starts, size = ends[:-1], np.diff(ends)
    number = np.zeros(len(size), np.uint64)
    for place in range(NUMBER_OCTETS):
        there = place < size
        octet = octets[np.minimum(starts + place, len(octets) - 1)].astype(np.uint64)
        number = np.where(there, number << np.uint64(8) | octet, number)
    fits = (size >= 1) & (size <= NUMBER_OCTETS)
    return size, np.where(fits, number.astype(np.float64), np.nan)


def _last_rows(variable: Column) -> list[tuple[int, int]]:
    """Return each variable of a batch with the index of its last row."""
    found, rows = np.unique(variable[::-1], return_index=True)
    return [(int(each), len(variable) - 1 - int(row)) for each, row in zip(found, rows, strict=True)]


def gather(
    path: str,
    profile: str,
    ether_type: int | None,
    advance: Advance = lambda _octets: None,
    *,
    most: int = MOST_ROWS,
) -> Recorded:
    """Read a recording. ``advance`` is called with the number of octets read since its last call.

    Memory grows with the recording up to ``most`` rows. Later frames are not read, which is reported in
    ``outcome.problems``, like other problems of the recording. Raise :class:`~dcp_codec.capture.CaptureError` if the
    recording cannot be opened.
    """
    codec, link, note = resolve(path, profile, ether_type)
    outcome = Outcome(path, codec.profile.name, [note] if note else [])
    gatherer = _Gatherer(codec)
    with Recording(path) as recording:
        decoder = decoder_for(recording, codec, link)
        for batch in batches(recording, decoder, outcome, advance, lambda: gatherer.rows >= most):
            gatherer.add(batch)
        if gatherer.rows >= most:
            outcome.problems.append(
                f"only the first {outcome.frames:,} frames are in this report, which is as much as it keeps in "
                f"memory ({most:,} rows of tables); dcp-codec table has no such limit."
            )
        outcome.problems += [problem.message for problem in recording.problems]
    tell_others(outcome, link)
    return Recorded(
        outcome=outcome,
        codec=codec,
        tables={name: gatherer.table(name) for name in _KEPT},
        # Identifiers that are texts may have any characters.
        nodes=[plain(text) for text in gatherer.nodes.texts],
        reasons=gatherer.reasons.texts,
        contents=gatherer.contents.texts,
        variables=gatherer.variables,
        requirements=gatherer.requirements,
        units={role: member.unit for role, member in gatherer.roles.items()},
        modulus=gatherer.modulus,
        number_modulus=gatherer.number_modulus,
        transmissions_only=path != "-" and is_of_medium(path),
        options=_options(codec.profile.name if profile == "auto" else profile, ether_type),
    )


def _options(profile: str, ether_type: int | None) -> str:
    shown = f"--profile {shlex.quote(profile)}"
    return shown if ether_type is None else f"{shown} --ether-type 0x{ether_type:04x}"
