"""Small recordings wait for no compiler; compiling is announced, and missing packages are reported before it."""

from __future__ import annotations

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from dcp_tables.table.archive import Order, make
from dcp_tables.table.decoding import LITTLE, worth_compiling
from dcp_tables.table.kernel.jit import COMPILING
from pyarrow import parquet

from dcp_codec.capture import convert, create_capture, open_capture

pytestmark = pytest.mark.part("tables")

CAPTURES = Path(__file__).resolve().parents[2] / "captures"
A_BUS = CAPTURES / "a_bus3.mcap"

_WITHOUT = """
import sys
class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {refused!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Refuse())
from dcp_codec.cli import main
main()
"""


def without(refused: set[str], cache: Path, *arguments: Any) -> subprocess.CompletedProcess[str]:
    """Run dcp-codec where these packages cannot be imported."""
    return subprocess.run(
        [sys.executable, "-c", _WITHOUT.format(refused=refused), *map(str, arguments)],
        env={**os.environ, "XDG_CACHE_HOME": str(cache), "NUMBA_CACHE_DIR": str(cache / "numba")},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.fixture(scope="module")
def long_recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording that is worth compiling for."""
    path: Path = tmp_path_factory.mktemp("long") / "long.pcap"
    with open_capture(A_BUS) as reader:
        frames = list(reader)
    with create_capture(path, lossy=True) as writer:
        while writer.position <= 2 * LITTLE:
            for frame in frames:
                writer.write(frame)
    return path


def test_a_small_recording_needs_no_machine_code(tmp_path):
    small = tmp_path / "small.pcap"
    convert(A_BUS, small, lossy=True)
    assert not worth_compiling(small.stat().st_size)
    for number, path in enumerate((small, A_BUS)):
        done = without({"numba", "llvmlite"}, tmp_path / "cache", "table", path, "--out", tmp_path / str(number))
        assert (done.returncode, COMPILING in done.stderr) == (0, False), done.stderr
        assert parquet.read_metadata(tmp_path / str(number) / "beacons.parquet").num_rows > 800


def test_the_tables_are_the_same(tmp_path, monkeypatch):
    orders = [Order((str(A_BUS),), tmp_path / name, "parquet") for name in ("plain", "compiled")]
    (plain,) = make(orders[0])
    monkeypatch.setattr("dcp_tables.table.decoding.LITTLE", 0)
    (compiled,) = make(orders[1])
    assert plain.rows == compiled.rows
    for name in plain.rows:
        one, other = (parquet.read_table(order.out / f"{name}.parquet") for order in orders)
        assert one.equals(other), name


def test_one_of_two_concurrent_commands_compiles(tmp_path, long_recording):
    """The other waits for it; a later one finds the machine code."""

    def run(number: int) -> subprocess.CompletedProcess[str]:
        return without(set(), tmp_path / "cache", "table", long_recording, "--out", tmp_path / str(number))

    with ThreadPoolExecutor(2) as pool:
        runs = [*pool.map(run, (1, 2)), run(3)]
    assert [done.returncode for done in runs] == [0, 0, 0]
    assert sorted(done.stderr.count(COMPILING) for done in runs) == [0, 0, 1]
    assert COMPILING not in runs[2].stderr


def test_compiling_in_processes_is_announced_once(tmp_path, long_recording):
    both = [tmp_path / "one.pcap", tmp_path / "other.pcap"]
    for path in both:
        path.symlink_to(long_recording)
    done = without(set(), tmp_path / "cache", "table", *both, "--jobs", 2, "--out", tmp_path / "out")
    assert (done.returncode, done.stderr.count(COMPILING)) == (0, 1), done.stderr


def test_a_missing_duckdb_is_reported_before_decoding(tmp_path, long_recording):
    done = without({"duckdb", "numba"}, tmp_path / "cache", "table", long_recording, "--out", tmp_path / "a.duckdb")
    assert done.returncode == 2
    assert "duckdb is not installed: pip install 'dcp-conformance-tables[duckdb]'" in done.stderr
    assert list(tmp_path.iterdir()) == []


_IMPORTED = """
import sys
from dcp_codec.cli import main
try:
    main()
finally:
    print(*sorted({"pandas", "numba"} & sys.modules.keys()))
"""


@pytest.mark.parametrize(("command", "out"), [("table", "tables"), ("report", "page.html")])
def test_nothing_heavy_is_imported_for_a_small_recording(tmp_path, command, out):
    """Arrow imports pandas, where that is installed, to find out what a list is: 0.2 s. So it gets no lists."""
    done = subprocess.run(
        [sys.executable, "-c", _IMPORTED, command, A_BUS, "--out", tmp_path / out],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == "\n"
    assert (tmp_path / out).exists()
