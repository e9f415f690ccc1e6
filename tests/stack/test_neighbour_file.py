"""The neighbour table as a file: layout, lifetime, and that no snapshot is ever torn."""

from __future__ import annotations

import math
import multiprocessing
import os
import re
import shutil
import stat
import struct
import subprocess
import sys
import time
from pathlib import Path

import pytest

from dcp_codec.codec import get_codec
from dcp_codec.values import ExtendedSafetyData
from dcp_stack.neighbour_file import NeighbourFileError, NeighbourFileReader, NeighbourFileWriter
from dcp_stack.srp.neighbour_table import NeighbourTable

from ..waiting import PATIENCE

#: Each reader has to read so often, and see so many different tables, while tables are written.
READS, TABLES = 500, 50
DOCS = Path(__file__).parents[2] / "docs" / "neighbour-file.md"
OWN = bytes.fromhex("020000000001")
S = 10**9


def table_of(codec, reports, *, now=5 * S, wall=1_700_000_000 * S, capacity=4096):
    table = NeighbourTable(codec.profile, capacity=capacity)
    for number, (values, seqno) in enumerate(reports):
        report = ExtendedSafetyData(
            codec.safety_data_type(*values), bytes([2, 0, 0, 0, 1, number % 256]), wall - 20_000_000, seqno
        )
        table.record(report, b"", now=now, wall=wall)
    return table


@pytest.fixture
def path(tmp_path):
    return tmp_path / "neighbours"


def writer_for(path, codec, **options):
    return NeighbourFileWriter(path, codec.profile, OWN, now=1, wall=2, **options)


@pytest.mark.parametrize("name", ["cpp-2.0", "sim-2.0", "dcp-2.0", "student-2024", "sim-1.0"])
def test_a_snapshot_is_the_table(path, name):
    codec = get_codec(name)
    fields = [field.name for field in codec.profile.srp.safety_data]
    reports = [([10 * node + axis for axis in range(len(fields))], 7 + node) for node in range(3)] if fields else []
    table = table_of(codec, reports)
    with writer_for(path, codec) as writer, NeighbourFileReader(path) as reader:
        writer.publish(table, now=6 * S, wall=9 * S)
        found = reader.snapshot()
        assert (found.profile, found.node_id, found.generation) == (name, OWN, 1)
        assert (found.published_mono, found.published_wall, found.omitted) == (6 * S, 9 * S, 0)
        assert len(found.entries) == len(reports)
        for entry in found.entries:
            original = table.lookup(entry.node_id)
            motion = table.motion(original)
            assert entry.position == (None if motion is None else motion.position)
            assert entry.values == {field: getattr(original.ext_sd.s_data, field) for field in fields}
            assert (entry.seqno, entry.received) == (original.ext_sd.seqno, 1)
            assert (entry.reception_mono, entry.reception_wall) == (original.received_at, original.reception_time)
            assert entry.mean_interval is None


def test_velocities_and_stamps(path):
    codec = get_codec("cpp-2.0")
    table = NeighbourTable(codec.profile, capacity=4)
    for number in range(2):
        report = ExtendedSafetyData(codec.safety_data_type(3.0 * number, 0.0, 1.0), b"\2" * 6, number * S, number)
        table.record(report, b"", now=number * S, wall=number * S + 5)
    with writer_for(path, codec) as writer, NeighbourFileReader(path) as reader:
        writer.publish(table, now=2 * S, wall=2 * S)
        (entry,) = reader.snapshot().entries
    assert entry.velocity == (3.0, 0.0, 0.0)
    assert entry.velocity_estimated
    assert entry.stamp_wall == S
    assert entry.mean_interval == S


def test_an_unknown_position_and_a_stamp_without_a_calendar(path):
    codec = get_codec("sim-2.0")
    table = table_of(codec, [([math.nan, 0, 0, 0, 0, 0], 1)])
    with writer_for(path, codec) as writer, NeighbourFileReader(path) as reader:
        writer.publish(table, now=1, wall=1)
        (entry,) = reader.snapshot().entries
    assert entry.position is None
    assert entry.velocity is None
    assert entry.stamp_wall is None


def test_before_the_first_table(path):
    with writer_for(path, get_codec("dcp-2.0")), NeighbourFileReader(path) as reader:
        found = reader.snapshot()
        assert (found.generation, found.entries, found.closed) == (0, (), False)


def test_the_heartbeat_continues_without_new_tables(path):
    codec = get_codec("dcp-2.0")
    with writer_for(path, codec) as writer, NeighbourFileReader(path) as reader:
        writer.publish(table_of(codec, []), now=10, wall=20)
        writer.heartbeat(now=30, wall=40)
        found = reader.snapshot()
        assert (found.heartbeat_mono, found.heartbeat_wall, found.published_wall) == (30, 40, 20)
        assert found.silence(45) == 5


def test_entries_without_room_are_counted(path):
    codec = get_codec("dcp-2.0")
    with writer_for(path, codec, capacity=2) as writer, NeighbourFileReader(path) as reader:
        writer.publish(table_of(codec, [((1, 2, 3), 1)] * 5), now=1, wall=1)
        found = reader.snapshot()
        assert (len(found.entries), found.omitted) == (2, 3)


def test_long_node_identifiers_are_counted(path):
    codec = get_codec("student-2024")
    table = NeighbourTable(codec.profile, capacity=4)
    for node_id in (b"02:00:00:00:00:01", b"x" * 33):
        table.record(ExtendedSafetyData(codec.safety_data_type(*range(10)), node_id, 0, 0), b"", now=0, wall=0)
    with writer_for(path, codec) as writer, NeighbourFileReader(path) as reader:
        writer.publish(table, now=1, wall=1)
        found = reader.snapshot()
    assert [entry.node_id for entry in found.entries] == [b"02:00:00:00:00:01"]
    assert found.omitted == 1


def test_the_file_exists_as_long_as_the_writer(path):
    old = os.umask(0o077)
    try:
        with writer_for(path, get_codec("dcp-2.0")):
            assert stat.S_IMODE(path.stat().st_mode) == 0o644
            assert [each.name for each in path.parent.iterdir()] == [path.name]
        assert not path.exists()
    finally:
        os.umask(old)


def test_a_reader_survives_the_restart_of_the_writer(path):
    codec = get_codec("dcp-2.0")
    first = writer_for(path, codec)
    first.publish(table_of(codec, [((1, 2, 3), 1)]), now=1, wall=1)
    with NeighbourFileReader(path) as reader:
        first.close()
        first.close()
        kept = reader.snapshot()
        assert kept.closed
        assert len(kept.entries) == 1
        with NeighbourFileWriter(path, codec.profile, OWN, capacity=7, now=5, wall=50) as second:
            assert reader.snapshot().created_wall == 50
            second.publish(table_of(codec, [((1, 2, 3), 1)] * 4), now=6, wall=60)
            found = reader.snapshot()
            assert (found.closed, len(found.entries), found.generation) == (False, 4, 1)


def test_a_killed_writer_leaves_a_table_and_can_be_followed(path):
    code = (
        "import os, sys, signal\n"
        "from dcp_codec.codec import get_codec\n"
        "from dcp_stack.neighbour_file import NeighbourFileWriter\n"
        "from dcp_stack.srp.neighbour_table import NeighbourTable\n"
        "codec = get_codec('dcp-2.0')\n"
        "writer = NeighbourFileWriter(sys.argv[1], codec.profile, b'abcdef', now=1, wall=2)\n"
        "writer.publish(NeighbourTable(codec.profile, capacity=1), now=3, wall=4)\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    assert subprocess.run([sys.executable, "-c", code, str(path)]).returncode == -9
    with NeighbourFileReader(path) as reader:
        found = reader.snapshot()
        assert (found.generation, found.closed, found.silence(1_000_000)) == (1, False, 999_996)
        with writer_for(path, get_codec("cpp-2.0")):
            assert reader.snapshot().profile == "cpp-2.0"


def test_a_writer_killed_while_copying_leaves_a_readable_file(path):
    codec = get_codec("dcp-2.0")
    with writer_for(path, codec, capacity=4) as writer, NeighbourFileReader(path) as reader:
        writer.publish(table_of(codec, [((1, 2, 3), 1)]), now=1, wall=1)
        slots, slot_size = struct.unpack_from("<II", path.read_bytes(), 12)
        with path.open("r+b") as file:
            # Generation 2 would go to slot 0; its lock is held for ever and half of it is there.
            file.seek(slots)
            file.write(struct.pack("<QQ", 3, 2) + b"\xff" * (slot_size // 2))
        assert [entry.position for entry in reader.snapshot().entries] == [(1, 2, 3)]


def test_damage_is_found_by_the_checksum(path):
    codec = get_codec("dcp-2.0")
    with writer_for(path, codec, capacity=4) as writer, NeighbourFileReader(path) as reader:
        writer.publish(table_of(codec, [((1, 2, 3), 1)]), now=1, wall=1)
        slots, slot_size = struct.unpack_from("<II", path.read_bytes(), 12)
        with path.open("r+b") as file:
            file.seek(slots + slot_size + 64 + 40)
            file.write(b"\x01")
        with pytest.raises(NeighbourFileError, match="checksum"):
            reader.snapshot()


def test_two_writers_are_refused(path):
    with writer_for(path, get_codec("dcp-2.0")), pytest.raises(NeighbourFileError, match="another node"):
        writer_for(path, get_codec("dcp-2.0"))


def test_the_successor_keeps_its_file_when_the_old_writer_closes(path):
    codec = get_codec("dcp-2.0")
    first = writer_for(path, codec)
    path.unlink()
    with writer_for(path, codec):
        first.close()
        assert path.exists()


def test_other_files_are_not_replaced(path):
    path.write_text("precious")
    with pytest.raises(NeighbourFileError, match="not replaced"):
        writer_for(path, get_codec("dcp-2.0"))
    assert path.read_text() == "precious"
    with pytest.raises(NeighbourFileError, match="not a neighbour table"):
        NeighbourFileReader(path)
    path.unlink()
    path.mkdir()
    with pytest.raises(NeighbourFileError, match="not a regular file"):
        writer_for(path, get_codec("dcp-2.0"))


def test_errors_give_a_remedy(path):
    with pytest.raises(NeighbourFileError, match=r"No such file.*is the node running"):
        NeighbourFileReader(path)
    path.touch()
    with pytest.raises(NeighbourFileError, match="empty"):
        NeighbourFileReader(path)
    with pytest.raises(NeighbourFileError, match="cannot be created"):
        writer_for(path.parent / "no" / "such", get_codec("dcp-2.0"))
    with pytest.raises(NeighbourFileError, match="capacity"):
        writer_for(path, get_codec("dcp-2.0"), capacity=0)


def test_sizes_that_contradict_are_refused(path, tmp_path):
    with writer_for(path, get_codec("dcp-2.0"), capacity=4):
        octets = bytearray(path.read_bytes())
    for offset in (12, 16, 20, 24, 28, 32):
        changed = octets[:]
        changed[offset] ^= 1
        bad = tmp_path / "bad"
        bad.write_bytes(changed)
        with pytest.raises(NeighbourFileError, match="contradict"):
            NeighbourFileReader(bad)
    for other in (octets[:-1], octets + b"\0"):
        bad.write_bytes(other)
        with pytest.raises(NeighbourFileError, match="contradict"):
            NeighbourFileReader(bad)


# -- C ------------------------------------------------------------------------------------------------------------

_TORN = r"""
#define _POSIX_C_SOURCE 200809L
#include <stdio.h>
#include <stdlib.h>
#include "dcp_neighbours.h"

/* Read argv[2] times at least, and argv[3] different tables; fail for one whose values do not agree. */
int main(int argc, char **argv) {
    struct dcp_neighbours file;
    if (argc != 4 || dcp_open(&file, argv[1]) != 0) return 2;
    void *copy = aligned_alloc(64, dcp_header(&file)->slot_size);
    long reads = 0, generations = 0;
    uint64_t last = 0;
    while (reads < atol(argv[2]) || generations < atol(argv[3])) {
        if (!dcp_read(&file, copy)) continue;
        const struct dcp_slot *slot = copy;
        uint32_t key = (uint32_t)slot->published_mono;
        if (slot->generation < last) return 3;
        generations += slot->generation != last;
        last = slot->generation;
        if (slot->count != 1 + key % 50) return 4;
        for (uint32_t number = 0; number < slot->count; number++) {
            const struct dcp_entry *entry = dcp_entry(&file, copy, number);
            if (entry->seqno != key || entry->position[0] != key || entry->position[2] != -(double)key) return 5;
            if (entry->values[1] != 2.0 * key) return 6;
        }
        reads++;
    }
    return 0;
}
"""


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    """The folder with the header and the program of the documentation, compiled, and a program for races."""
    folder = tmp_path_factory.mktemp("c")
    for block in re.findall(r"```c\n(.*?)```", DOCS.read_text(), re.S):
        name = re.match(r"/\* (\S+) \*/", block)
        assert name is not None
        (folder / name[1]).write_text(block)
    (folder / "torn.c").write_text(_TORN)
    if shutil.which("gcc") is not None:
        for program in ("neighbours", "torn"):
            command = ["gcc", "-std=c11", "-O2", "-Wall", "-Wextra", "-Werror", "-o", program, f"{program}.c"]
            subprocess.run(command, cwd=folder, check=True)
    return folder


@pytest.mark.tool("gcc")
@pytest.mark.parametrize("name", ["cpp-2.0", "sim-2.0", "student-2024"])
def test_the_c_example_reads_the_same(compiled, path, name):
    codec = get_codec(name)
    fields = codec.profile.srp.safety_data
    table = table_of(codec, [([1 + node + axis for axis in range(len(fields))], node) for node in range(4)])
    with writer_for(path, codec) as writer, NeighbourFileReader(path) as reader:
        # In an hour: the program, however late the machine lets it look, has no reason to think that the node is gone.
        writer.publish(table, now=time.monotonic_ns() + 3600 * S, wall=time.time_ns())
        shown = subprocess.run([compiled / "neighbours", path], capture_output=True, text=True, check=True)
        found = reader.snapshot()
    expected = [f"generation 1 profile {name}"]
    for entry in found.entries:
        flags = 1 | 2 * (entry.velocity is not None)
        line = f"{entry.node_id.hex(':')} seqno {entry.seqno} flags {flags} at "
        line += " ".join(f"{value:.17g}" for value in entry.position)
        if entry.velocity is not None:
            line += " moving " + " ".join(f"{value:.17g}" for value in entry.velocity)
        line += f" received {entry.reception_wall} lost {entry.lost} values "
        expected.append(line + " ".join(f"{value:.17g}" for value in entry.values.values()))
    assert shown.stdout.splitlines() == expected
    assert shown.stderr == ""


@pytest.mark.tool("gcc")
def test_the_c_example_reports_a_silent_writer(compiled, path):
    codec = get_codec("cpp-2.0")
    with writer_for(path, codec) as writer:
        writer.publish(table_of(codec, []), now=1, wall=1)
        shown = subprocess.run([compiled / "neighbours", path], capture_output=True, text=True, check=True)
    assert "the node is not running" in shown.stderr
    assert subprocess.run([compiled / "neighbours", path], capture_output=True).returncode == 2


# -- races --------------------------------------------------------------------------------------------------------


def _write_at_full_speed(path, ready, stop, published):
    codec = get_codec("dcp-2.0")
    tables = []
    for key in range(1, 120):
        table = NeighbourTable(codec.profile, capacity=64)
        for node in range(1 + key % 50):
            data = codec.safety_data_type(float(key), 2.0 * key, -float(key))
            table.record(ExtendedSafetyData(data, node.to_bytes(6, "big"), 0, key), b"", now=0, wall=key)
        tables.append((key, table))
    with NeighbourFileWriter(path, codec.profile, OWN, capacity=64, now=0, wall=0) as writer:
        writer.publish(tables[0][1], now=1, wall=1)
        ready.set()
        while not stop.is_set():
            for key, table in tables:
                writer.publish(table, now=key, wall=key)
        published.value = writer._generation


def _read_at_full_speed(path):
    reads = generations = last = 0
    with NeighbourFileReader(path) as reader:
        while reads < READS or generations < TABLES:
            found = reader.snapshot()
            assert found.generation >= last
            generations += found.generation != last
            last = found.generation
            key = found.published_mono
            assert len(found.entries) == 1 + key % 50
            for entry in found.entries:
                assert entry.position == (key, 2 * key, -key)
                assert entry.seqno == key
                assert entry.reception_wall == key
            reads += 1


@pytest.mark.part("tools")
@pytest.mark.tool("gcc")
def test_no_snapshot_is_torn(compiled, path):
    context = multiprocessing.get_context("spawn")
    ready, stop, published = context.Event(), context.Event(), context.Value("Q", 0)
    writer = context.Process(target=_write_at_full_speed, args=(str(path), ready, stop, published), daemon=True)
    writer.start()
    assert ready.wait(PATIENCE)
    readers = [context.Process(target=_read_at_full_speed, args=(str(path),), daemon=True) for _ in range(3)]
    for reader in readers:
        reader.start()
    # All readers race until they have seen enough, however long that takes on this machine.
    done = subprocess.run([compiled / "torn", path, str(10 * READS), str(TABLES)], timeout=PATIENCE)
    for process in readers:
        process.join(PATIENCE)
        assert process.exitcode == 0
    stop.set()
    writer.join(PATIENCE)
    assert writer.exitcode == 0
    assert done.returncode == 0
    assert published.value > TABLES
