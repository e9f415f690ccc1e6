"""dcp-codec table: the same rows in every format, by every engine, and everything or nothing in its place."""

from __future__ import annotations

import contextlib
import csv
import importlib
import io
import os
import pty
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import duckdb
import pyarrow as pa
import pytest
from dcp_tables import TABLES, open_table
from dcp_tables.table.archive import Order, make
from dcp_tables.table.job import TableError
from pyarrow import parquet

from dcp_codec import get_codec
from dcp_codec.capture import convert
from dcp_codec.cli import main

pytestmark = pytest.mark.part("tables")

ROOT = Path(__file__).resolve().parents[2]
CAPTURES = ROOT / "captures"
C_LATEJOIN = CAPTURES / "c_latejoin.mcap"


class Result(NamedTuple):
    status: int
    out: str
    err: str


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Callable[..., Result]:
    def call(*args: object) -> Result:
        capsys.readouterr()
        with pytest.raises(SystemExit) as stop:
            main(["table", *map(str, args)])
        captured = capsys.readouterr()
        assert "Traceback" not in captured.err
        return Result(int(stop.value.code or 0), captured.out, captured.err)

    return call


@pytest.fixture(scope="module")
def expected(reference, frames_of) -> dict[str, list[dict[str, Any]]]:
    return reference(get_codec("cpp-2.0"), frames_of(C_LATEJOIN))


def nothing_else(folder: Path, *names: str) -> None:
    """No half-written things beside what was asked for."""
    assert sorted(entry.name for entry in folder.iterdir()) == sorted(names)


def damaged(folder: Path) -> Path:
    """c_latejoin as pcap, the container type of frame 5 set to 9, and the last record cut off."""
    convert(C_LATEJOIN, folder / "flight.pcap")
    data = bytearray((folder / "flight.pcap").read_bytes())
    position = 24
    for _ in range(4):
        position += 16 + int.from_bytes(data[position + 8 : position + 12], "little")
    data[position + 16 + 36] = 9
    (folder / "flight.pcap").write_bytes(data[:-5])
    return folder / "flight.pcap"


# -- formats ------------------------------------------------------------------------------------------------------


def test_parquet(run, tmp_path, expected, rows, differ):
    result = run(C_LATEJOIN, "--out", tmp_path / "tables")
    assert result.status == 0
    assert result.out == ""
    assert "profile cpp-2.0" in result.err
    assert "beacons 270" in result.err
    found = {name: rows(parquet.read_table(tmp_path / "tables" / f"{name}.parquet")) for name in TABLES}
    assert differ(found, {name: expected[name] for name in TABLES}) == []
    nothing_else(tmp_path, "tables")
    nothing_else(tmp_path / "tables", *(f"{name}.parquet" for name in TABLES))


def test_parquet_marks_required_columns(run, tmp_path):
    """Columns that cannot have nulls are required, others are not; and identifiers have no statistics to prove it."""
    assert run(C_LATEJOIN, "--out", tmp_path / "tables").status == 0
    beacons = parquet.ParquetFile(tmp_path / "tables" / "beacons.parquet")
    assert not any(field.nullable for field in beacons.schema_arrow)
    assert {beacons.schema.column(index).max_definition_level for index in range(len(beacons.schema))} == {0}
    payloads, creates, errors = (
        parquet.read_schema(tmp_path / "tables" / f"{name}.parquet") for name in ("payloads", "creates", "errors")
    )
    assert [field.name for field in payloads if field.nullable] == ["data"]
    assert [field.name for field in creates if field.nullable] == ["descr", "descrHex"]
    assert all(field.nullable for field in errors)


def test_csv(run, tmp_path, expected):
    assert run(C_LATEJOIN, "--out", tmp_path / "tables", "--format", "csv").status == 0
    for name in TABLES:
        with (tmp_path / "tables" / f"{name}.csv").open(newline="") as file:
            found = list(csv.DictReader(file))
        assert len(found) == len(expected[name])
        for ours, theirs in zip(found, expected[name], strict=True):
            day, clock = ours.pop("time").split(" ")
            time_ns = theirs["time"]
            assert (day, int(clock.split(".")[1])) == ("2026-11-21", time_ns % 10**9)
            wanted = {key: value for key, value in theirs.items() if key != "time"}
            assert ours.keys() - wanted.keys() <= {"descrHex"}
            for key, value in wanted.items():
                if isinstance(value, float):
                    assert float(ours[key]) == value
                else:
                    assert ours[key] == ("" if value is None else str(value))


def test_duckdb(run, tmp_path, expected, rows, differ):
    assert run(C_LATEJOIN, "--out", tmp_path / "flight.duckdb").status == 0
    nothing_else(tmp_path, "flight.duckdb")
    found = {}
    with duckdb.connect(str(tmp_path / "flight.duckdb"), read_only=True) as database:
        for name in TABLES:
            result = database.execute(f'SELECT * REPLACE (epoch_ns(time) AS time) FROM "{name}"')
            names = [column[0] for column in result.description]
            listed = [dict(zip(names, row, strict=True)) for row in result.fetchall()]
            for row in listed:
                row.pop("descrHex", None)
                row |= {key: value.hex() for key, value in row.items() if isinstance(value, bytes)}
            found[name] = listed
    assert differ(found, {name: expected[name] for name in TABLES}) == []


@pytest.mark.parametrize("suffix", ["parquet", "csv"])
def test_one_table_in_one_file(run, tmp_path, suffix, expected):
    out = tmp_path / f"updates.{suffix}"
    assert run(C_LATEJOIN, "-o", out, "--tables", "updates").status == 0
    nothing_else(tmp_path, out.name)
    if suffix == "parquet":
        assert parquet.read_table(out).num_rows == len(expected["updates"])
    else:
        assert len(out.read_text().splitlines()) == len(expected["updates"]) + 1


def test_octets_as_text_without_octets():
    from dcp_tables.table.writing import hexadecimal

    values = [b"\x00\xff", None, b"", b"abc", None]
    for array in (pa.array(values, pa.binary()), pa.array([b"x", *values], pa.binary())[1:], pa.array([], pa.binary())):
        assert hexadecimal(array).to_pylist() == [None if v is None else v.hex() for v in array.to_pylist()]


# -- several recordings -------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with recordings of two profiles in three formats."""
    folder = tmp_path_factory.mktemp("archive")
    (folder / "deeper").mkdir()
    convert(CAPTURES / "b_crud.mcap", folder / "1.pcap")
    convert(C_LATEJOIN, folder / "2.pcapng")
    convert(CAPTURES / "a_bus3_v1.3.6.mcap", folder / "deeper" / "3.mcap")
    (folder / "notes.txt").write_text("no recording")
    return folder


def contents(folder: Path) -> dict[str, pa.Table]:
    return {str(path.relative_to(folder)): parquet.read_table(path) for path in sorted(folder.rglob("*.parquet"))}


def test_a_folder(run, archive, tmp_path, reference, frames_of, rows, differ):
    assert run(archive, "--out", tmp_path / "one", "--jobs", "1").status == 0
    assert run(archive, "--out", tmp_path / "two", "--jobs", "2").status == 0
    one, two = contents(tmp_path / "one"), contents(tmp_path / "two")
    assert one.keys() == two.keys()
    assert len(one) == 3 * len(TABLES)
    assert all(one[name].equals(two[name]) for name in one)
    for number, (path, profile) in enumerate(
        (
            (archive / "1.pcap", "cpp-2.0"),
            (archive / "2.pcapng", "cpp-2.0"),
            (archive / "deeper" / "3.mcap", "cpp-1.3"),
        ),
        start=1,
    ):
        found = {name: rows(one[f"{name}/{number}-{path.stem}.parquet"]) for name in TABLES}
        for table in found.values():
            assert all(row.pop("file") == str(path) for row in table)
        assert differ(found, reference(get_codec(profile), frames_of(path))) == []


def test_processes_are_started_for_much_data_only(archive, tmp_path):
    from dcp_tables.cli.table import workers

    cores = len(os.sched_getaffinity(0))
    small = [str(archive / "1.pcap"), str(archive / "2.pcapng")]
    with (tmp_path / "large.pcap").open("wb") as file:
        file.truncate(1 << 30)  # a hole in the file system
    assert workers(small, "local") == 1
    assert workers(small, "dask") == cores
    assert workers([*small, str(tmp_path / "large.pcap")], "local") == cores
    # The size of a missing file is unknown.
    assert workers([*small, str(tmp_path / "absent")], "local") == cores


@pytest.fixture
def occupied() -> Iterator[None]:
    """Have something listen where the page of a Dask scheduler usually is."""
    with socket.socket() as taken:
        with contextlib.suppress(OSError):
            taken.bind(("", 8787))
            taken.listen()
        yield


@pytest.mark.usefixtures("occupied")
def test_a_cluster_gives_the_same(archive, tmp_path):
    recordings = (str(archive / "1.pcap"), str(archive / "2.pcapng"))
    seen: list[int] = []
    for engine in ("local", "dask"):
        order = Order(recordings, tmp_path / engine, "parquet", jobs=2 if engine == "dask" else 1, engine=engine)
        outcomes = make(order, seen.append)
        assert [(outcome.path, outcome.failure) for outcome in outcomes] == [(path, None) for path in recordings]
    one, two = contents(tmp_path / "local"), contents(tmp_path / "dask")
    assert one.keys() == two.keys()
    for name in one:
        assert one[name].drop_columns("file").equals(two[name].drop_columns("file"))
        assert one[name].column("file").to_pylist() == two[name].column("file").to_pylist()
    assert sum(seen) == 2 * sum(Path(path).stat().st_size for path in recordings)


@pytest.mark.parametrize("suffix", ["parquet", "csv"])
def test_several_recordings_in_one_file(run, archive, tmp_path, suffix):
    out = tmp_path / f"creates.{suffix}"
    assert run(archive / "*.p*", archive / "deeper" / "3.mcap", "-o", out, "--tables", "creates").status == 0
    whole = open_table([archive / "1.pcap", archive / "2.pcapng", archive / "deeper" / "3.mcap"], "creates").arrow()
    if suffix == "parquet":
        found = parquet.read_table(out)
        assert found.schema.names == whole.schema.names
        assert found.to_pylist() == whole.to_pylist()
    else:
        listed = list(csv.DictReader(io.StringIO(out.read_text())))
        assert [row["varId"] for row in listed] == [str(value) for value in whole.column("varId").to_pylist()]
        # 1.3 has no timeouts.
        assert [row["timeout"] for row in listed] == [
            "" if value is None else str(value) for value in whole.column("timeout").to_pylist()
        ]
        assert "" in {row["timeout"] for row in listed}


def test_several_profiles_in_one_database(run, archive, tmp_path):
    assert run(archive, "-o", tmp_path / "all.duckdb", "--tables", "creates,beacons").status == 0
    with duckdb.connect(str(tmp_path / "all.duckdb"), read_only=True) as database:
        assert {name for (name,) in database.execute("SHOW TABLES").fetchall()} == {"beacons", "creates"}
        counts = dict(database.execute("SELECT file, count(timeout) FROM creates GROUP BY file").fetchall())
        assert counts[str(archive / "deeper" / "3.mcap")] == 0
        assert counts[str(archive / "1.pcap")] == 90


# -- what is wrong ------------------------------------------------------------------------------------------------


def test_damage_is_reported_and_the_rest_is_written(run, tmp_path, reference, frames_of, rows, differ):
    path = damaged(tmp_path)
    result = run(path, "-o", tmp_path / "tables", "-p", "cpp-2.0")
    assert result.status == 2
    assert "1 of 269 DCP frames are malformed" in result.err
    assert "269 frames before it could be read" in result.err
    found = {name: rows(parquet.read_table(tmp_path / "tables" / f"{name}.parquet")) for name in TABLES}
    expected = reference(get_codec("cpp-2.0"), frames_of(path))
    assert differ(found, {name: expected[name] for name in TABLES}) == []
    (error,) = found["errors"]
    assert (error["frame"], error["reason"], error["offset"]) == (5, "unknown-type", 36)
    assert error["sender"]
    whole = path.read_bytes() + bytes(5)
    path.write_bytes(whole)
    assert run(path, "-o", tmp_path / "tables", "-p", "cpp-2.0", "--force").status == 1


def test_one_of_several_cannot_be_read(run, tmp_path, archive):
    (tmp_path / "bad.pcap").write_text("this is not a recording")
    result = run(tmp_path / "bad.pcap", archive / "1.pcap", "-o", tmp_path / "tables")
    assert result.status == 2
    assert "bad.pcap: is not a pcap, pcapng or MCAP file" in result.err
    assert [path.name for path in (tmp_path / "tables" / "beacons").iterdir()] == ["2-1.parquet"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("absent.pcap", "-o", "out"), "cannot be read: No such file"),
        (("empty", "-o", "out"), "the folder has no recordings"),
        (("*.pcap", "-o", "out"), "no file matches this pattern"),
        ((C_LATEJOIN, "-o", "one.csv"), "a file holds one table"),
        ((C_LATEJOIN, "-o", "one.csv", "--tables", "beacons,updates"), "a file holds one table"),
        (
            (C_LATEJOIN, "-o", "out", "--tables", "nonsense"),
            "unknown table 'nonsense'; expected one of beacons, payloads",
        ),
        ((C_LATEJOIN, "-o", "out", "-p", "nonsense"), "nonsense"),
        ((C_LATEJOIN, "-o", "out", "--scheduler", "tcp://x:1"), "--scheduler is for --engine dask"),
        (("-", "-o", "out"), "name the --profile"),
        (("-", C_LATEJOIN, "-o", "out", "-p", "cpp-2.0"), "give - as the only FILE"),
        ((C_LATEJOIN, "-o", "taken"), "is not empty; --force"),
        ((C_LATEJOIN, "-o", "taken", "--format", "duckdb"), "a DuckDB database is a file"),
        ((C_LATEJOIN, "-o", "taken/file.duckdb"), "exists already; --force"),
        ((C_LATEJOIN, "-o", "taken/file.duckdb/below"), "taken/file.duckdb"),
        ((C_LATEJOIN, "-o", "taken/pipe", "--force"), "is neither a file nor a folder and cannot be replaced"),
        ((C_LATEJOIN, "-o", "out", "--engine", "dask", "--scheduler", "nonsense://x"), "cannot be reached"),
        (
            (C_LATEJOIN, "-o", "srp.csv", "-p", "sim-1.0", "--tables", "srp"),
            "profile sim-1.0 has no table srp, only beacons",
        ),
    ],
)
def test_wrong_usage(run, tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    Path("empty").mkdir()
    Path("taken").mkdir()
    Path("taken/file.duckdb").write_text("precious")
    os.mkfifo("taken/pipe")
    result = run(*arguments)
    assert result.status == 2
    assert message in result.err
    nothing_else(tmp_path, "empty", "taken")
    assert Path("taken/file.duckdb").read_text() == "precious"


def test_replacing(run, tmp_path):
    out = tmp_path / "tables"
    out.mkdir()
    assert run(C_LATEJOIN, "-o", out, "--tables", "srp").status == 0
    nothing_else(out, "srp.parquet")
    assert run(C_LATEJOIN, "-o", out, "--tables", "beacons", "--force").status == 0
    nothing_else(out, "beacons.parquet")
    assert run(tmp_path / "absent.pcap", "-o", out, "--force").status == 2
    nothing_else(out, "beacons.parquet")
    nothing_else(tmp_path, "tables")
    assert run(C_LATEJOIN, "-o", tmp_path / "t.csv", "--tables", "srp").status == 0
    assert run(C_LATEJOIN, "-o", tmp_path / "t.csv", "--tables", "srp").status == 2
    assert run(C_LATEJOIN, "-o", tmp_path / "t.csv", "--tables", "beacons", "--force").status == 0
    assert "numPayloads" in (tmp_path / "t.csv").read_text().splitlines()[0]


def test_no_beacons(run, tmp_path):
    result = run(C_LATEJOIN, "-o", tmp_path / "tables", "--ether-type", "0x9999", "-p", "cpp-2.0")
    assert result.status == 0
    assert "no DCP frames under EtherType 0x9999; there is: 0x4953 (270)" in result.err
    assert parquet.read_table(tmp_path / "tables" / "beacons.parquet").num_rows == 0


def test_a_full_disk_is_reported(run, tmp_path):
    result = run(C_LATEJOIN, "-o", "/proc/nowhere/tables")
    assert result.status == 2
    assert "/proc/nowhere/tables" in result.err


@pytest.mark.parametrize("package", ["numba", "pyarrow", "duckdb", "distributed"])
def test_a_missing_package_is_named(run, tmp_path, monkeypatch, package):
    for name in [name for name in sys.modules if name.startswith(("dcp_tables.table.", "dcp_tables.cli.table"))]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, package, None)
    if package == "numba":
        # Small recordings are decoded without it.
        monkeypatch.setattr(importlib.import_module("dcp_tables.table.decoding"), "LITTLE", 0)
    extra = {"duckdb": "[duckdb]", "distributed": "[dask]"}.get(package, "")
    engine = "dask" if package == "distributed" else "local"
    result = run(C_LATEJOIN, "-o", tmp_path / "x.duckdb", "--engine", engine)
    assert result.status == 2
    assert f"pip install 'dcp-conformance-tables{extra}'" in result.err
    nothing_else(tmp_path)


# -- the command --------------------------------------------------------------------------------------------------


def test_a_pipe(tmp_path, expected):
    convert(C_LATEJOIN, tmp_path / "flight.pcapng")
    with (tmp_path / "flight.pcapng").open("rb") as file:
        done = subprocess.run(
            ["dcp-codec", "table", "-", "-p", "cpp-2.0", "-o", str(tmp_path / "tables")],
            input=file.read(),
            capture_output=True,
            env={**os.environ, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"},
        )
    assert done.returncode == 0, done.stderr.decode()
    assert parquet.read_table(tmp_path / "tables" / "beacons.parquet").num_rows == len(expected["beacons"])


def test_one_bar_on_a_terminal(tmp_path):
    master, slave = pty.openpty()
    code = "import sys; from dcp_codec.cli import main; main(sys.argv[1:])"
    command = [sys.executable, "-c", code, "table", str(C_LATEJOIN), "-o", str(tmp_path / "tables")]
    with subprocess.Popen(command, stderr=slave, stdout=subprocess.PIPE) as process:
        os.close(slave)
        shown = b""
        while piece := _read(master):
            shown += piece
        os.close(master)
        assert process.wait() == 0
        assert b"1 recording " in shown
        assert process.stdout is not None
        assert process.stdout.read() == b""


@pytest.fixture
def waiting(tmp_path):
    """The command with two workers that wait for pipes without a writer, in a separate session."""
    names = ("1.pcap", "2.pcap")
    for name in names:
        os.mkfifo(tmp_path / name)
    code = "import sys; from dcp_codec.cli import main; main(sys.argv[1:])"
    command = [sys.executable, "-c", code, "table", *names, "-p", "cpp-2.0", "-j", "2", "-o", "tables"]
    with subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, start_new_session=True) as process:
        # Opening one side waits until a worker has opened the other.
        writers = [(tmp_path / name).open("wb") for name in names]
        yield process
        for writer in writers:
            writer.close()


def told(process: subprocess.Popen[bytes]) -> str:
    """Read the output of the command until it ends."""
    assert process.stderr is not None
    shown = process.stderr.read().decode()
    assert "Traceback" not in shown
    return shown


def test_interrupted(waiting, tmp_path):
    """Ctrl-C ends the command and its workers, and no files remain."""
    os.killpg(waiting.pid, signal.SIGINT)
    told(waiting)
    assert waiting.wait() == 130
    nothing_else(tmp_path, "1.pcap", "2.pcap")


def test_a_killed_worker(waiting, tmp_path):
    children = Path(f"/proc/{waiting.pid}/task/{waiting.pid}/children").read_text().split()
    workers = [pid for pid in children if b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes()]
    assert len(workers) == 2
    os.kill(int(workers[0]), signal.SIGKILL)
    assert "a worker process ended by itself" in told(waiting)
    assert waiting.wait() == 2
    nothing_else(tmp_path, "1.pcap", "2.pcap")


def _read(descriptor: int) -> bytes:
    try:
        return os.read(descriptor, 65536)
    except OSError:
        # The other side of a terminal is gone.
        return b""


# -- in Python ----------------------------------------------------------------------------------------------------


def test_open_table(expected, rows, differ):
    import pandas
    import polars

    for name in TABLES:
        table = open_table(C_LATEJOIN, name)
        assert table.profiles == {str(C_LATEJOIN): "cpp-2.0"}
        assert differ({name: rows(table.arrow())}, {name: expected[name]}) == []
        assert table.problems == {str(C_LATEJOIN): []}
        assert pa.table(table).equals(table.arrow())
        assert table.reader().read_all().equals(table.arrow())
        assert isinstance(table.pandas(), pandas.DataFrame)
        assert len(table.pandas()) == len(expected[name])
        assert table.polars().equals(polars.from_arrow(table.arrow()))
        assert polars.DataFrame(table).height == len(expected[name])
    assert repr(open_table(C_LATEJOIN)) == f"<beacons of {C_LATEJOIN}>"


def test_open_table_of_several_profiles(archive):
    table = open_table(archive, "creates")
    found = table.arrow()
    assert found.schema.equals(table.schema)
    assert set(found.column("file").unique().to_pylist()) == set(table.profiles)
    assert found.column("timeout").null_count == 6
    # A column that one profile lacks is nullable; a column of all profiles is not.
    assert found.schema.field("timeout").nullable
    assert not found.schema.field("varId").nullable
    assert not found.schema.field("file").nullable


def test_open_table_refuses(archive):
    with pytest.raises(ValueError, match="'nonsense' is not one of the tables beacons"):
        open_table(C_LATEJOIN, "nonsense")
    with pytest.raises(ValueError, match="has no table 'srp'"):
        open_table(C_LATEJOIN, "srp", profile="sim-1.0")
    with pytest.raises(TableError, match="no file matches"):
        open_table(archive / "*.nonsense")
