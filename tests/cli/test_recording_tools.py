"""filter, merge, track, wireshark, and CSV that spreadsheets can open safely."""

from __future__ import annotations

import csv
import io
import json
import os
import signal
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from dcp_codec import Beacon, BPHeader, Container, Payload, VarCreate, VarSpec, VarUpdate, get_codec
from dcp_codec.analysis.tracks import Position, Reference, degrees
from dcp_codec.capture import Frame, create_capture, open_capture
from dcp_codec.common.spreadsheet import safe_cell

CAPTURES = Path(__file__).resolve().parents[2] / "captures"
CRUD, BUS = CAPTURES / "b_crud.mcap", CAPTURES / "a_bus3.mcap"


def contents(path: Path) -> list[tuple[int, bytes]]:
    with open_capture(path) as reader:
        return [(frame.time_ns, frame.data) for frame in reader]


def test_filter_copies_octet_for_octet(run, tmp_path):
    out = tmp_path / "deletes.pcap.gz"
    done = run("filter", CRUD, out, "-w", "vardis.icType == 6")
    assert done.status == 0
    shown = run("decode", CRUD, "--where", 'icName == "DELETE-VARIABLES"', "--format", "jsonl").out.splitlines()
    wanted = {json.loads(line)["time_ns"] for line in shown}
    assert contents(out) == [each for each in contents(CRUD) if each[0] in wanted]
    assert f"{len(wanted)} of {len(contents(CRUD))} frames" in done.err


def test_filter_cuts_by_time_and_number(run, tmp_path):
    whole = contents(CRUD)
    assert run("filter", CRUD, tmp_path / "a.pcap", "--from", "+1", "--to", "+2").status == 0
    assert contents(tmp_path / "a.pcap") == [
        each for each in whole if whole[0][0] + 10**9 <= each[0] <= whole[0][0] + 2 * 10**9
    ]
    assert run("filter", CRUD, tmp_path / "b.pcapng", "--frames", "5-9").status == 0
    assert contents(tmp_path / "b.pcapng") == whole[4:9]


def test_filter_refuses_wrong_conditions_and_leaves_no_file(run, tmp_path):
    done = run("filter", CRUD, tmp_path / "a.pcap", "-w", "bp.sequence == 1")
    assert done.status == 2
    assert "'bp.sequence' is not the name of a field" in done.err
    assert list(tmp_path.iterdir()) == []
    assert "bp.senderId" in run("filter", "--fields").out.splitlines()


@pytest.mark.parametrize(
    ("arguments", "hint"),
    [
        (("filter", CRUD, "a.pcap", "vardis.icType == 6"), "give a condition with --where 'vardis.icType == 6'"),
        (("convert", CRUD, "a.bin"), "--format"),
        (("merge", CRUD, CRUD, "-o", "a.pcap"), "--lossy"),
    ],
)
def test_refusals_name_the_option_that_helps(run, tmp_path, monkeypatch, arguments, hint):
    monkeypatch.chdir(tmp_path)
    done = run(*arguments)
    assert done.status == 2
    assert hint in done.err
    assert list(tmp_path.iterdir()) == []


def test_merge_orders_by_time(run, tmp_path):
    run("filter", CRUD, tmp_path / "a.pcapng", "-w", "bp.senderId == 02:00:00:00:00:01")
    run("filter", CRUD, tmp_path / "b.pcap", "-w", "bp.senderId != 02:00:00:00:00:01")
    assert run("merge", tmp_path / "a.pcapng", tmp_path / "b.pcap", "-o", tmp_path / "c.mcap").status == 0
    assert sorted(contents(tmp_path / "c.mcap")) == sorted(contents(CRUD))
    times = [time for time, _ in contents(tmp_path / "c.mcap")]
    assert times == sorted(times)
    with open_capture(tmp_path / "c.mcap") as reader:
        assert {frame.interface for frame in reader} == {0, 1}
    assert run("merge", tmp_path / "b.pcap", "-o", tmp_path / "b.pcap").status == 2
    assert contents(tmp_path / "b.pcap")


def test_track_writes_csv_gpx_and_kml(run, tmp_path):
    reference = ("--reference", "-43.52,172.58,20")
    assert run("track", BUS, "-o", tmp_path / "t.csv", *reference).status == 0
    rows = list(csv.DictReader(io.StringIO((tmp_path / "t.csv").read_text())))
    assert (len(rows) == run("stats", BUS, "--format", "json").out and False) or len(rows) > 100
    assert {row["node"] for row in rows} == {f"02:00:00:00:00:0{n}" for n in (1, 2, 3)}
    assert run("track", BUS, "-o", tmp_path / "t.gpx", *reference).status == 0
    points = ET.parse(tmp_path / "t.gpx").findall(".//{*}trkpt")
    assert len(points) == len(rows)
    by_time = {(row["latitude"], row["longitude"]) for row in rows}
    assert (f"{float(points[0].get('lat')):.9f}".rstrip("0"), points[0].get("lon").rstrip("0")) in {
        (lat.rstrip("0"), lon.rstrip("0")) for lat, lon in by_time
    }
    assert run("track", BUS, "-o", tmp_path / "t.kml", *reference, "--every", "5").status == 0
    lines = ET.parse(tmp_path / "t.kml").findall(".//{*}Track")
    assert len(lines) == 3
    assert all(len(line.findall("{*}when")) == len(line.findall("{*}coord")) for line in lines)
    done = run("track", BUS, "-o", tmp_path / "u.gpx")
    assert (done.status, "--reference" in done.err, (tmp_path / "u.gpx").exists()) == (2, True, False)
    assert run("track", BUS, "-o", tmp_path / "u.txt").status == 2
    assert "no state report" in run("track", CRUD, "-o", tmp_path / "u.csv").err
    assert "not LAT,LON" in run("track", BUS, "-o", tmp_path / "u.gpx", "--reference", "north").err


def test_local_coordinates_become_degrees():
    at = Reference(60.0, 10.0, 100.0)
    assert degrees(Position(0, "n", 0, 0.0, 0.0, 0.0), at) == pytest.approx((60.0, 10.0, 100.0), abs=1e-9)
    # One degree of latitude is 111.4 km at 60 degrees, one of longitude half of 111.6 km (WGS 84).
    north = degrees(Position(0, "n", 0, 0.0, 1000.0, 0.0), at)
    east = degrees(Position(0, "n", 0, 1000.0, 0.0, 0.0), at)
    assert north[0] - 60 == pytest.approx(1000 / 111_412, rel=1e-3)
    assert east[1] - 10 == pytest.approx(1000 / 55_800, rel=1e-3)
    assert degrees(Position(0, "n", 0, 0.0, 0.0, 50.0), at)[2] == pytest.approx(150.0, abs=1e-6)


FORMULA = b"=HYPERLINK(1)"


@pytest.fixture
def dangerous(tmp_path) -> Path:
    codec = get_codec("dcp-2.0")
    create = VarCreate(VarSpec(7, bytes(6), 2, FORMULA, 1, 0), VarUpdate(7, 3, b"-"))
    beacon = Beacon(BPHeader(bytes(6), 1, 1), (Payload(2, (Container(5, (create,)),)),))
    octets = b"\xff" * 6 + bytes(6) + b"\x49\x53" + codec.encode(beacon)
    path = tmp_path / "d.pcap"
    with create_capture(path) as file:
        file.write(Frame(1, 10**18, octets, len(octets)))
    return path


def test_csv_cells_from_beacons_are_not_formulas(run, dangerous, tmp_path):
    rows = list(csv.DictReader(io.StringIO(run("decode", dangerous, "-p", "dcp-2.0", "--format", "csv").out)))
    assert [row["descr"] for row in rows if row["descr"]] == ["'" + FORMULA.decode()]
    assert run("table", dangerous, "-p", "dcp-2.0", "--out", tmp_path / "c.csv", "--tables", "creates").status == 0
    (row,) = csv.DictReader(io.StringIO((tmp_path / "c.csv").read_text()))
    assert row["descr"] == "'" + FORMULA.decode()


@pytest.mark.parametrize("text", ["=1", "+1", "-1", "@a", "\t=1", "\r=1"])
def test_formulas_get_an_apostrophe(text):
    assert safe_cell(text) == f"'{text}"


@pytest.mark.parametrize("value", [-5, -1.5, None, "", "pos", "a=b", "-Infinity"])
def test_other_cells_are_unchanged(value):
    assert safe_cell(value) == value


def test_a_missing_duckdb_is_reported_first(run, tmp_path, monkeypatch):
    import importlib.util

    real = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *more: None if name == "duckdb" else real(name, *more)
    )
    monkeypatch.setitem(sys.modules, "dcp_tables.table.archive", None)
    done = run("table", CRUD, "--out", tmp_path / "x.duckdb")
    assert done.status == 2
    assert "duckdb is not installed: pip install 'dcp-conformance-tables[duckdb]'" in done.err


@pytest.mark.tool("tshark")
def test_each_beacon_is_dissected_by_the_dissector_of_its_profile(run, tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("WIRESHARK_CONFIG_DIR", raising=False)
    monkeypatch.delenv("XDG_CONFIG_HOME", raising=False)
    profiles = ("cpp-2.0", "cpp-1.3", "cpp-1.2")
    options = [part for name in profiles for part in ("-p", name)]
    done = run("wireshark", "install", *options)
    assert done.status == 0
    files = [Path(line) for line in done.out.splitlines()[:3]]
    assert all(path.is_file() and tmp_path in path.parents for path in files)
    assert run("wireshark", "where").out.strip() == str(files[0].parent)
    for recording, count in ((CRUD, 563), (CAPTURES / "a_bus3_v1.3.6.mcap", 1033)):
        run("convert", recording, tmp_path / "x.pcap")
        command = ["tshark", "-n", "-r", tmp_path / "x.pcap", "-Y", "dcp.bp.seqno and not dcp.errors"]
        shown = subprocess.run(command, capture_output=True, text=True, env=dict(os.environ), check=False)
        complaints = [line for line in shown.stderr.splitlines() if "Running as user" not in line]
        assert (complaints, len(shown.stdout.splitlines())) == ([], count)
    assert run("wireshark", "remove", *options).status == 0
    assert not any(path.exists() for path in files)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_conversion_leaves_the_old_file(number, tmp_path):
    fifo, target = tmp_path / "in", tmp_path / "out.pcap"
    os.mkfifo(fifo)
    target.write_bytes(b"precious")
    code = "import sys; from dcp_codec.cli import main; main(sys.argv[1:])"
    command = [sys.executable, "-c", code, "convert", str(fifo), str(target)]
    octets = io.BytesIO()
    with create_capture(octets, format="pcap") as file:
        for _ in range(10):
            file.write(Frame(1, 10**18, bytes(60), 60))
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process, fifo.open("wb") as pipe:
        # More than the command reads at once: when all of it is taken, it is at work.
        pipe.write(octets.getvalue() + octets.getvalue()[24:] * 1000)
        pipe.flush()
        process.send_signal(number)
        told = process.communicate(timeout=60)[1]
    assert process.returncode == 130
    assert f"interrupted; {target} was not written" in told
    assert target.read_bytes() == b"precious"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["in", "out.pcap"]
