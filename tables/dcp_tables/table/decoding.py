"""Decode blocks of frames to Arrow record batches with the compiled decoder."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pyarrow as pa
from dcp_spec.profile.definition import Link

from dcp_codec.codec import Codec
from dcp_codec.framing.locate import mac
from dcp_codec.jsonform import node_id_text

from .columns import IDENTIFIER, TIME, Memory, Storage, arrow_arrays, schema_of
from .input.damaged import DamagedFrames, merged
from .kernel.compiled import compiled, interpreted
from .kernel.generator import result_names
from .kernel.lines import DONE, FULL, POOL_FULL
from .kernel.pools import Pool
from .kernel.row_buffer import MOVED, OF_A_FRAME, StagingRows
from .kernel.shape import ERRORS, Shape

Integers = npt.NDArray[np.int64]

#: Maximum size of a recording, in octets, for decoding with plain Python. That takes less than a second (25 µs for a
#: frame of 90 octets). Numba takes as long to load code that it compiled earlier, and ten seconds to compile it.
LITTLE = 1 << 20
#: Maximum number of rows of a table, and of octets of a column of variable length, in a batch. A single frame may have
#: more.
ROOM, SPACE = 1 << 19, 1 << 22

ERRORS_SCHEMA = pa.schema(
    [
        pa.field("frame", pa.int64(), metadata={"doc": "number of the frame in the recording, from 1"}),
        pa.field("time", TIME, metadata={"doc": "time of capture, UTC", "unit": "ns"}),
        pa.field("sender", IDENTIFIER, metadata={"doc": "sender of the beacon; null if it cannot be read"}),
        pa.field("payload", pa.uint32(), metadata={"doc": "index of the invalid payload block; null for the header"}),
        pa.field("reason", IDENTIFIER, metadata={"doc": "kind of the error, a fixed identifier"}),
        pa.field("path", pa.string(), metadata={"doc": "path of the field, with indices"}),
        pa.field("offset", pa.int64(), metadata={"doc": "start of the field, in octets from the start of the frame"}),
        pa.field("needed", pa.int64(), metadata={"doc": "required octets, or the correct number"}),
        pa.field("available", pa.int64(), metadata={"doc": "available octets, or the number found"}),
        pa.field("requirement", IDENTIFIER, metadata={"doc": "identifier of the violated requirement"}),
    ]
)


class Block(NamedTuple):
    """Frames in one buffer: frame ``i`` is ``buffer[starts[i]:stops[i]]``.

    ``lengths`` are octets on the wire, ``times`` ns since 1970. ``position`` is the number of octets of the file that
    were read up to the end of this block. ``buffer`` is read-only.
    """

    buffer: npt.NDArray[np.uint8]
    starts: Integers
    stops: Integers
    numbers: Integers
    times: Integers
    lengths: Integers
    interfaces: Integers
    frames: int
    position: int


class Batch(NamedTuple):
    """The rows of ``frames`` frames: record batches by the name of the table.

    ``malformed`` frames have rows in ``errors``, and rows of their valid parts. ``other`` frames are not DCP.
    """

    tables: dict[str, pa.RecordBatch]
    frames: int
    malformed: int
    other: int


def worth_compiling(octets: int | None) -> bool:
    """Return whether machine code saves time for a recording of this size in octets (None: unknown)."""
    return octets is None or octets > LITTLE


class ColumnDecoder:
    """Decodes frames to columns with one codec. ``link`` replaces the link of the profile.

    ``interpret`` runs the generated source as plain Python, which is slow but needs no compilation; the rows are the
    same. Use :func:`worth_compiling` to choose. ``room`` and ``space`` limit a batch (see ``ROOM`` and ``SPACE``). A
    decoder must not be used by several threads at a time.
    """

    def __init__(
        self, codec: Codec, link: Link | None = None, *, interpret: bool = False, room: int = ROOM, space: int = SPACE
    ) -> None:
        self.codec = codec
        self.link = link or codec.profile.link
        self.shape = Shape(codec.beacon_plan)
        self.schemas = {table.name: schema_of(table) for table in self.shape.tables} | {ERRORS: ERRORS_SCHEMA}
        self._none = {
            name: pa.RecordBatch.from_arrays([pa.nulls(0, field.type) for field in schema], schema=schema)
            for name, schema in self.schemas.items()
        }
        self._decode = interpreted(self.shape) if interpret else compiled(self.shape)
        self._room, self._space = room, space
        self._moved = min(MOVED, room)
        self._stage = self._staging_rows(OF_A_FRAME)
        self._storage = Storage(self.shape.tables)
        self._results = np.zeros(len(result_names(self.shape)), np.int64)
        self._addresses = Pool(6, mac)
        types = codec.profile.types
        width = 0 if types.node_id.length is not None else types.node_id.width
        self._nodes = Pool(width, self._node_text)

    def batches(self, block: Block) -> Iterator[Batch]:
        """Decode a block and yield its batches. The buffer of the block is not used after the end of the iteration."""
        first, space, stage, fresh = 0, self._space, self._stage, False
        while first < block.frames:
            memory = self._storage.take(stage.capacity, space)
            bad = np.empty(block.frames - first, np.int64)
            after, status = self._call(block, first, space, stage, memory, bad)
            moved = after > first
            if moved:
                made = self._batch(block, first, after, memory, bad)
                # Drop our reference, so that Storage can detect when the caller has released the batch.
                del memory
                yield made
                del made
                first = after
                space, stage = self._space, self._stage
            elif status == FULL:
                # A single frame does not fit: decode it with a larger stage, and the next ones with the usual one.
                size = int(block.stops[first] - block.starts[first])
                space, stage = max(space, size), self._staging_rows(size)
            if status == POOL_FULL:
                # Use empty pools, or larger ones if not even one frame fits into empty pools.
                times = 2 if fresh and not moved else 1
                self._addresses, self._nodes = self._addresses.fresh(times=times), self._nodes.fresh(times=times)
            else:
                assert status in (DONE, FULL)
            fresh = status == POOL_FULL

    def _staging_rows(self, octets: int) -> StagingRows:
        """Return a stage for frames of up to ``octets`` octets."""
        return StagingRows(self.shape, max(octets, OF_A_FRAME), self._moved, self._room)

    def _call(
        self, block: Block, first: int, space: int, stage: StagingRows, memory: Memory, bad: Integers
    ) -> tuple[int, int]:
        addresses, nodes, link = self._addresses, self._nodes, self.link
        udp = link.transport == "udp"
        kind = link.udp_port if udp else link.ether_type
        result = self._decode(
            block.buffer,
            block.starts,
            block.stops,
            block.numbers,
            block.times,
            block.lengths,
            block.interfaces,
            first,
            block.frames,
            udp,
            -1 if kind is None else kind,
            self._room,
            space,
            stage.rows,
            stage.moved,
            *stage.items,
            stage.moves,
            addresses.slots,
            addresses.keys,
            addresses.many,
            nodes.slots,
            nodes.keys,
            nodes.ends,
            nodes.arena,
            nodes.many,
            self._results,
            bad,
            *memory.tables,
            *memory.octets.values(),
        )
        tables = len(self.shape.tables)
        addresses.many, nodes.many = int(self._results[tables]), int(self._results[tables + 1])
        return result

    def _batch(self, block: Block, first: int, after: int, memory: Memory, bad: Integers) -> Batch:
        shape, results = self.shape, self._results.tolist()
        octets, columns = memory.octets, memory.columns
        used = dict(zip(octets, results[len(shape.tables) + 4 :], strict=True))
        malformed, other = results[len(shape.tables) + 2 : len(shape.tables) + 4]
        tables = dict(self._none)
        for table in shape.tables:
            rows = results[table.number]
            if not rows:
                continue
            arrays: list[pa.Array] = []
            for column in table.columns:
                pool = {"address": self._addresses, "node": self._nodes}.get(column.kind)
                number = column.number
                arrays += arrow_arrays(column, rows, columns, octets.get(number), used.get(number, 0), pool)
            tables[table.name] = pa.RecordBatch.from_arrays(arrays, schema=self.schemas[table.name])
        if malformed:
            for name, more in self._damaged(block, bad[:malformed]).items():
                tables[name] = merged(tables[name], more)
        return Batch(tables, after - first, malformed, other)

    def _damaged(self, block: Block, bad: Integers) -> dict[str, pa.RecordBatch]:
        """Return the rows of the frames that the compiled decoder has rejected, by table."""
        frames = DamagedFrames(self.codec, self.link, self.shape, self.schemas, self._node_text)
        for index in bad.tolist():
            frames.add(
                block.buffer[block.starts[index] : block.stops[index]].tobytes(),
                int(block.numbers[index]),
                int(block.times[index]),
                int(block.lengths[index]),
                int(block.interfaces[index]),
            )
        return frames.tables()

    def _node_text(self, octets: bytes) -> str:
        return node_id_text(octets, self.codec.profile.types.node_id.representation)
