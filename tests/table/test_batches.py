"""Batches of any size hold the same rows, and stay what they are while others are made."""

from __future__ import annotations

import fcntl
import os
import re
import stat
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from dcp_tables import ColumnDecoder, Recording
from dcp_tables.table.input.sources import packed
from dcp_tables.table.kernel.compiled import cache_folder, compiled
from dcp_tables.table.kernel.jit import machine, options_of
from dcp_tables.table.kernel.pools import Pool
from dcp_tables.table.kernel.row_buffer import MOVED, OF_A_FRAME
from dcp_tables.table.kernel.shape import Shape
from dcp_tables.table.parquet_output import ParquetTable
from numba import njit
from pyarrow import parquet

from dcp_codec import get_codec
from dcp_codec.capture import Frame, convert
from dcp_codec.common.atomic_write import write_whole

pytestmark = pytest.mark.part("tables")


def tables(batches: Any) -> dict[str, pa.Table]:
    kept: dict[str, list[pa.RecordBatch]] = {}
    for batch in batches:
        for name, rows in batch.tables.items():
            kept.setdefault(name, []).append(rows)
    return {name: pa.Table.from_batches(rows).unify_dictionaries() for name, rows in kept.items()}


C_LATEJOIN = Path(__file__).resolve().parents[2] / "captures" / "c_latejoin.mcap"


@pytest.mark.parametrize(("room", "frames"), [(1, 7), (80, 7), (200, 100_000), (5000, 1), (5000, 7), (5000, 100_000)])
def test_small_rooms(room, frames, frames_of, reference, rows, differ):
    """All batches are compared after the last one was made: none may use memory that was used again."""
    path, codec = C_LATEJOIN, get_codec("cpp-2.0")
    decoder = ColumnDecoder(codec, room=room, space=room)
    with Recording(path, frames=frames, walk=True) as source:
        found = tables(batch for block in source.blocks() for batch in decoder.batches(block))
    expected = reference(codec, frames_of(path))
    assert differ({name: rows(table) for name, table in found.items()}, expected) == []


def test_memory_is_used_again():
    """Memory of earlier batches is reused if the caller does not keep them."""
    path, decoder = C_LATEJOIN, ColumnDecoder(get_codec("cpp-2.0"))
    addresses = set()
    with Recording(path, frames=10, walk=True) as source:
        for block in source.blocks():
            for batch in decoder.batches(block):
                addresses.add(batch.tables["beacons"].column("frame").buffers()[1].address)
    assert len(addresses) == 2


def senders(many: int) -> list[Frame]:
    """A beacon of each of many senders."""
    codec = get_codec("cpp-2.0")
    frames = []
    for number in range(1, many + 1):
        sender = (0x020000000000 + number).to_bytes(6, "big")
        beacon = b"\x01\x49\x7e" + sender + b"\x11\x11\0\x05\x01" + number.to_bytes(4, "big") + b"\0\x09\0\x01x"
        codec.decode(beacon)
        data = b"\xff" * 6 + sender + b"\x49\x53" + beacon
        frames.append(Frame(number, number, data, len(data)))
    return frames


def test_more_senders_than_a_pool_holds(reference, rows, differ):
    codec = get_codec("cpp-2.0")
    decoder = ColumnDecoder(codec)
    decoder._addresses = Pool(6, decoder._addresses._write, 3)
    decoder._nodes = Pool(6, decoder._nodes._write, 5)
    frames = senders(50)
    batches = list(decoder.batches(packed(frames, 0)))
    assert len(batches) > 9
    found = {name: rows(table) for name, table in tables(batches).items()}
    assert differ(found, reference(codec, frames)) == []


def test_a_frame_with_more_identifiers_than_a_pool_holds(reference, rows, differ):
    """The pool grows until the frame fits."""
    codec = get_codec("cpp-2.0")
    decoder = ColumnDecoder(codec)
    decoder._nodes = Pool(6, decoder._nodes._write, 2)
    creates = b"".join(
        bytes([n]) + bytes([2, 0, 0, 0, 0, n]) + b"\1" + bytes(8) + b"\0\0" + b"\1d" + bytes([n]) + b"\0\1v"
        for n in range(40)
    )
    payload = b"\x05\x28" + creates
    block = b"\0\x02" + len(payload).to_bytes(2, "big") + payload
    beacon = b"\x01\x49\x7e\2\0\0\0\0\x63\x11\x11" + len(block).to_bytes(2, "big") + b"\1\0\0\0\0" + block
    data = bytes(12) + b"\x49\x53" + beacon
    frames = [*senders(3), Frame(4, 4, data, len(data)), *senders(2)]
    found = tables(decoder.batches(packed(frames, 0)))
    assert found["creates"].num_rows == 40
    assert differ({name: rows(table) for name, table in found.items()}, reference(codec, frames)) == []


def test_frames_with_more_rows_than_the_stage_has(reference, rows, differ):
    """Such a frame is given a stage of its own, wherever it stands, and what was decoded before it is not lost."""
    codec = get_codec("cpp-2.0")
    container = b"\x03\xff" + bytes(range(255)) * 2
    payload = container * 20
    block = b"\0\x02" + len(payload).to_bytes(2, "big") + payload
    beacon = b"\x01\x49\x7e\2\0\0\0\0\x63\x11\x11" + len(block).to_bytes(2, "big") + b"\1\0\0\0\0" + block
    data = bytes(12) + b"\x49\x53" + beacon
    frames = senders(7)
    for number in (3, 4, 7):
        frames[number - 1] = Frame(number, number, data, len(data))
    found = tables(ColumnDecoder(codec).batches(packed(frames, 0)))
    assert found["req_updates"].num_rows == 3 * 20 * 255 > 3 * (OF_A_FRAME + MOVED)
    assert differ({name: rows(table) for name, table in found.items()}, reference(codec, frames)) == []


def test_malformed_frames_are_judged_by_the_strict_decoder():
    """A decoder that rejects a frame that the strict one accepts would be a fault of ours, and is reported as such."""
    codec = get_codec("cpp-2.0")
    decoder = ColumnDecoder(codec)
    with pytest.raises(AssertionError, match="rejects a frame that the strict one accepts"):
        decoder._damaged(packed(senders(1), 0), np.array([0]))


_MEMORY = """
import resource, sys
from dcp_tables import ColumnDecoder, Recording
from dcp_codec import get_codec
decoder, rows = ColumnDecoder(get_codec("cpp-2.0")), 0
with Recording(sys.argv[1], walk=True) as source:
    for block in source.blocks():
        for batch in decoder.batches(block):
            rows += batch.tables["beacons"].num_rows
print(rows, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024)
"""


def test_memory_does_not_grow_with_the_file(tmp_path):
    """A file of 180 MB is decoded in hardly more memory than one of 30 MB."""
    convert(C_LATEJOIN, tmp_path / "once.pcap")
    octets = (tmp_path / "once.pcap").read_bytes()
    used = {}
    for times in (1_000, 6_000):
        with (tmp_path / "long.pcap").open("wb") as file:
            file.write(octets[:24])
            for _ in range(times):
                file.write(octets[24:])
        assert (tmp_path / "long.pcap").stat().st_size > times * 29_000
        command = [sys.executable, "-c", _MEMORY, str(tmp_path / "long.pcap")]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        rows, used[times] = map(int, done.stdout.split())
        assert rows == 270 * times
    assert used[6_000] < used[1_000] + 60


def test_waiting_rows_do_not_keep_whole_batches(tmp_path):
    """Rows that wait to be written do not hold on to the memory of whole batches."""

    def megabytes() -> int:
        (size,) = re.findall(r"VmSize:\s+(\d+) kB", Path("/proc/self/status").read_text())
        return int(size) // 1024

    decoder = ColumnDecoder(get_codec("cpp-2.0"))
    writers = {name: ParquetTable(tmp_path / name, schema) for name, schema in decoder.schemas.items()}
    before, most = megabytes(), 0
    with Recording(C_LATEJOIN, frames=1, walk=True) as source:
        for block in source.blocks():
            for batch in decoder.batches(block):
                for name, rows in batch.tables.items():
                    writers[name].write(rows)
                most = max(most, megabytes())
    assert most < before + 4_000
    for writer in writers.values():
        writer.close()
    assert parquet.read_table(tmp_path / "beacons").column("frame").to_pylist() == list(range(1, 271))


# -- the cache ----------------------------------------------------------------------------------------------------

# The layout of beacons without what is in their payloads is compiled quickly.
_PROGRAM = """
import sys
from dcp_tables import ColumnDecoder, Recording
from dcp_codec import Codec
codec = Codec("cpp-2.0")
codec.beacon_plan = codec.envelope_plan
with Recording(sys.argv[1], walk=True) as source:
    decoder = ColumnDecoder(codec)
    print(sum(batch.tables["payloads"].num_rows for block in source.blocks() for batch in decoder.batches(block)))
"""


def program(recording: Any, cache: str, text: str = _PROGRAM) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "XDG_CACHE_HOME": cache}
    return subprocess.run(
        [sys.executable, "-c", text, str(recording)], env=environment, capture_output=True, text=True, check=True
    )


def test_compiled_code_is_cached(tmp_path):
    path = C_LATEJOIN
    assert program(path, str(tmp_path)).stdout == "445\n"
    folder = tmp_path / "dcp-codec"
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    kept = {entry: entry.stat().st_mtime_ns for entry in folder.rglob("*") if entry.is_file()}
    assert any(entry.suffix == ".nbc" for entry in kept)
    assert program(path, str(tmp_path)).stdout == "445\n"
    assert {entry: entry.stat().st_mtime_ns for entry in folder.rglob("*") if entry.suffix == ".nbc"} == {
        entry: time for entry, time in kept.items() if entry.suffix == ".nbc"
    }
    # A file written by another user is not executed.
    (source,) = folder.glob("columns_*.py")
    source.write_text("raise SystemExit('executed')")
    assert program(path, str(tmp_path)).stdout == "445\n"


_SEVERAL = """
from numba.core.caching import NullCache
from numba.core.dispatcher import Dispatcher
from dcp_tables.table.input import mcap_messages as messages, walkers
from dcp_tables.table.kernel import jit
for function in (messages.walk_messages, walkers.walk_pcap, walkers.walk_pcapng):
    compiled = jit._compiled(function)
    assert isinstance(compiled, Dispatcher) and not isinstance(compiled._cache, NullCache)
    assert len(compiled.signatures) <= 1, (function, compiled.signatures)
"""


def test_compiled_code_is_cached_for_one_argument_type(tmp_path):
    """Two processes that keep the same function for different arguments at once would mix them up in Numba's files.

    Which arguments there are shows where the decoder is compiled, not where it was kept.
    """
    copies = [C_LATEJOIN, tmp_path / "copy.pcap", tmp_path / "copy.pcapng"]
    for copy in copies[1:]:
        convert(C_LATEJOIN, copy, lossy=True)
    several = [f"sys.argv[1] = {str(copy)!r}\n{_PROGRAM}" for copy in copies]
    assert program(C_LATEJOIN, str(tmp_path), "import sys\n" + "\n".join([*several, _SEVERAL])).stdout == 3 * "445\n"


def test_without_a_cache_folder():
    assert program(C_LATEJOIN, "/dev/null").stdout == "445\n"


def test_the_source_of_the_decoder_is_written_with_the_lock_held(tmp_path, monkeypatch):
    """A process that writes it again, after another one has compiled it, would make that machine code obsolete."""
    written: list[Path] = []

    def write(path: Path, octets: bytes) -> None:
        with path.with_suffix(".lock").open() as lock, pytest.raises(BlockingIOError):
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        written.append(path)
        write_whole(path, octets)

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setitem(compiled.__globals__, "write_whole", write)
    for _ in range(2):
        compiled(Shape(get_codec("dcp-2.0").beacon_plan))
    assert len(written) == 1


def test_functions_that_cannot_be_cached_are_compiled():
    namespace: dict[str, Any] = {}
    exec("def twice(x): return 2 * x", namespace)
    assert machine(namespace["twice"])(21) == 42


def test_an_unknown_option_of_numba_is_left_out(monkeypatch):
    """Numba refuses what it does not know, and one of the options is its own affair."""
    assert options_of("numba.core.registry") == {"nogil": True, "_nrt": False}
    assert options_of("numba.core.no_such_module") == {"nogil": True}
    for registry in (SimpleNamespace(), SimpleNamespace(cpu_target=SimpleNamespace(options=object()))):
        monkeypatch.setitem(sys.modules, "numba_of_tomorrow", registry)
        assert options_of("numba_of_tomorrow") == {"nogil": True}
    twice = njit(**options_of("numba_of_tomorrow"))(lambda x: 2 * x)
    assert twice(21) == 42


def test_a_folder_writable_by_other_users_is_not_used_as_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder() == tmp_path / "dcp-codec"
    (tmp_path / "dcp-codec").chmod(0o777)
    assert cache_folder() is None
    monkeypatch.setenv("XDG_CACHE_HOME", "/dev/null")
    assert cache_folder() is None


def test_blocks_are_at_most_as_large_as_requested():
    with Recording(C_LATEJOIN, frames=100, walk=True) as source:
        assert [block.frames for block in source.blocks()] == [100, 100, 70]
