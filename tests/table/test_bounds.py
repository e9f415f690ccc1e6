"""Machine code checks no bounds: the same source, run as plain Python, never leaves the memory of a column.

The frames are the worst possible: as many rows of a table as octets allow, of all sizes at which the stage is just
large enough or just too small.
"""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from dcp_conformance.frames.builder import FrameBuilder
from dcp_spec.constants import ICType
from dcp_tables import ColumnDecoder
from dcp_tables.table.input.sources import packed
from dcp_tables.table.kernel.compiled import PLAIN, function_of
from dcp_tables.table.kernel.generator import kernel_source
from dcp_tables.table.kernel.row_buffer import MOVED, OF_A_FRAME

from dcp_codec import Codec
from dcp_codec.plan.layout import walk
from dcp_codec.plan.tree import Group, Many, Scalar, Text
from dcp_codec.values import VarReqCreate

from .test_decoding import framed

pytestmark = pytest.mark.part("tables")

#: Profiles with records of one octet and payloads without an area of their own, which would leave less room for them.
PROFILES = ("cpp-2.0", "dcp-1.0", "sim-2.0", "odd-texts")


class Watch:
    """Records which parts of the memory were used."""

    def __init__(self, decoder: ColumnDecoder) -> None:
        self._decoder = decoder
        self.row = self.moved = 0
        """The last row of a stage and of a column that was filled, at most."""
        source, found = re.subn(
            r"(\bat\d+ \+ )(\(r\d+ - 1\)|r\d+)", r"\1inside(\2, high)", kernel_source(decoder.shape)
        )
        # Each column is filled in one place at least.
        assert found >= len(decoder.shape.columns)
        decoder._decode = function_of(source, {**PLAIN, "inside": self.inside, "move": self.move})

    def inside(self, row: Any, high: int) -> Any:
        assert 0 <= row < high
        self.row = max(self.row, int(row))
        return row

    def move(self, stage: Any, rows: int, target: Any, done: int, moves: Any, begin: int, end: int) -> None:
        """As :func:`native.move`, at once."""
        rows, done = int(rows), int(done)
        self.moved = max(self.moved, done + rows)
        starts = [*(start for _, start, _ in moves[begin:end].tolist()), target.size]
        for (at, to, size), following in zip(moves[begin:end].tolist(), starts[1:], strict=True):
            # The end offsets of variable-length octets have one row more.
            assert to + (done + rows) * size <= following
            assert at + rows * size <= stage.size
            target[to + done * size : to + (done + rows) * size] = stage[at : at + rows * size]


def beacon_of_requests(codec: Codec, octets: int, after: bytes = b"") -> bytes:
    """A beacon of at most ``octets`` octets, with as many VarReqCreates as fit; ``after`` follows them."""
    builder = FrameBuilder(codec)
    record = VarReqCreate(1)
    sender = b"\2" * (codec.profile.types.node_id.width or 1)

    def beacon(number: int) -> bytes:
        full, rest = divmod(number, 255)
        containers = [builder.container(*[record] * 255)] * full + (
            [builder.container(*[record] * rest)] if rest else []
        )
        return builder.beacon(sender, 1, [builder.vardis(*containers, after)])

    # Lists of 255 have a header of at least two octets.
    fewest, most = 1, octets * 255 // 257
    while most - fewest > 1:
        middle = (fewest + most) // 2
        fewest, most = (middle, most) if len(beacon(middle)) <= octets else (fewest, middle)
    return beacon(fewest)


def decoded_rows(decoder: ColumnDecoder, beacons: list[bytes]) -> dict[str, int]:
    """Decode frames with these beacons; how many rows that gives, by the table."""
    frames = [framed(decoder.codec, beacon, number) for number, beacon in enumerate(beacons, start=1)]
    found: dict[str, int] = {}
    with np.errstate(over="ignore"):
        for batch in decoder.batches(packed(frames, 0)):
            for name, rows in batch.tables.items():
                found[name] = found.get(name, 0) + rows.num_rows
    return found


@pytest.fixture(params=PROFILES)
def watched(request: pytest.FixtureRequest, odd_codec: Any) -> tuple[ColumnDecoder, Watch]:
    decoder = ColumnDecoder(odd_codec(request.param), interpret=True)
    return decoder, Watch(decoder)


def least(group: Group) -> int:
    """Octets that a record has in any case."""
    sizes = {Scalar: lambda member: member.size, Group: least, Text: lambda member: len(member.prefixes) or 1}
    return sum(sizes[type(member)](member) for member in group.members if type(member) in sizes)


def test_every_record_of_a_list_has_octets(any_profile, odd_codec):
    """Or a frame could have any number of rows, and no stage were large enough."""
    lists = [node for node in walk(odd_codec(any_profile).beacon_plan) if isinstance(node, Many)]
    assert len(lists) >= 8
    assert [node.name for node in lists if not least(node.element)] == []


def test_rows_stay_in_the_stage(watched):
    """The same beacon in frames of all sizes that matter, and beacons of these sizes."""
    decoder, watch = watched
    high = decoder._stage.rows
    sizes = [size for most in (high - MOVED, high) for size in (most - 1, most, most + 1)]
    least_beacon = beacon_of_requests(decoder.codec, sizes[0])
    beacons = [least_beacon.ljust(size, b"\xff") for size in sizes]
    beacons += [beacon_of_requests(decoder.codec, size) for size in sizes]
    found = decoded_rows(decoder, beacons)
    assert (found["beacons"], found["errors"]) == (len(beacons), 0)
    assert found["req_creates"] > len(beacons) * OF_A_FRAME * 0.95
    # The stage was used to its end, not by far enough for nothing to show.
    assert watch.row > high * 0.97


def test_records_that_are_cut_off_stay_in_the_stage(watched):
    """Of a record that is not there the keys are written before that is seen."""
    decoder, watch = watched
    high = decoder._stage.rows
    builder = FrameBuilder(decoder.codec)
    missing = builder.empty_container(builder.ic_type(ICType.UPDATES), 1)
    beacons = [beacon_of_requests(decoder.codec, size, missing) for size in (high - MOVED, high)]
    found = decoded_rows(decoder, beacons)
    # The machine code takes all of it back; what is sound has its rows from another decoder.
    assert (found["beacons"], found["errors"]) == (len(beacons), len(beacons))
    assert watch.row > high * 0.97


@pytest.mark.parametrize("room", [1, 7, OF_A_FRAME, OF_A_FRAME + MOVED])
def test_rows_stay_in_the_columns(room, odd_codec):
    """However full a batch is when the largest frame comes that its stage has room for."""
    decoder = ColumnDecoder(odd_codec("cpp-2.0"), interpret=True, room=room)
    watch = Watch(decoder)
    high = decoder._stage.rows
    few, many = (beacon_of_requests(decoder.codec, size) for size in (100, high))
    beacons = [*[few] * 3, many, few, many, many, *[few] * 40, many]
    found = decoded_rows(decoder, beacons)
    assert (found["beacons"], found["errors"]) == (len(beacons), 0)
    assert room <= watch.moved <= decoder._stage.capacity


def test_the_largest_datagram(odd_codec):
    """It is given a stage of its own."""
    decoder = ColumnDecoder(odd_codec("cpp-2.0"), interpret=True)
    watch = Watch(decoder)
    beacon = beacon_of_requests(decoder.codec, 65_530)
    found = decoded_rows(decoder, [beacon])
    assert found["errors"] == 0
    assert found["req_creates"] == watch.row + 1 > 64_900
