"""``--jobs N`` with an implementation of the user: copies of it, each in namespaces of its own."""

from __future__ import annotations

import json
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

BIN = Path(sys.executable).parent
#: A node that prints what the copies would get in each other's way with: a file in /tmp, a segment of shared memory,
#: and its address.
NODE = """
import subprocess, sys
from pathlib import Path
private, segment, shared, socket = map(Path, sys.argv[1:])
assert not private.exists(), private
assert not segment.exists(), segment
private.write_text("mine")
segment.write_text("mine")
print(shared.read_text(), Path("/sys/class/net/far/address").read_text(), flush=True)
node = Path(sys.executable).parent / "dcp-node"
sys.exit(subprocess.call([node, "run", "--interface", "far", "--beacon-period", "25", "--control", socket]))
"""
CASES = ("VD-UPD-01", "BP-HDR-0*", "SRP-RX-06")


def run(namespace, tmp_path: Path, *options: str, folder: str = "report") -> subprocess.CompletedProcess[str]:
    command = [BIN / "dcp-conformance", "run", "--beacon-period", "25", "--report-dir", tmp_path / folder]
    return subprocess.run(
        ["ip", "netns", "exec", namespace.name, *command, *options, *CASES],
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
    )


def verdicts(folder: Path) -> dict[str, str]:
    return {each["id"]: each["verdict"] for each in json.loads((folder / "results.json").read_text())["cases"]}


def test_copies_have_the_verdicts_of_one_node(namespace, tmp_path):
    (tmp_path / "node.py").write_text(NODE)
    (tmp_path / "shared").write_text("everybody's")
    # The socket and the file have the same path for all of them.
    socket, private = tmp_path / "ut", tmp_path / "private"
    # Other programs of this machine use shared memory, too: the name is of this namespace.
    segment = Path("/dev/shm") / namespace.name
    command = [sys.executable, tmp_path / "node.py", private, segment, tmp_path / "shared", socket]
    start = shlex.join(map(str, command))
    options = ("--interface", "near", "--start", start, "--ut", f"unix:{socket}")
    address = namespace.links()["far"]["address"]

    several = run(namespace, tmp_path, *options, "--jobs", "3")
    assert several.returncode == 0, several.stdout + several.stderr
    assert "3 nodes were tested side by side" in " ".join(several.stdout.split())
    outputs = [each.read_text().split() for each in (tmp_path / "report").glob("output-*.txt")]
    assert [each[:2] for each in outputs] == [["everybody's", address]] * 3
    assert not private.exists()
    assert not segment.exists()
    assert namespace.links().keys() >= {"near", "far"}

    try:
        one = run(namespace, tmp_path, *options, folder="one")
        assert one.returncode == 0, one.stdout + one.stderr
        assert private.exists()
        assert segment.exists()
    finally:
        segment.unlink(missing_ok=True)
    assert verdicts(tmp_path / "report") == verdicts(tmp_path / "one")
    assert len(verdicts(tmp_path / "one")) > 12


@pytest.mark.parametrize(
    ("options", "why"),
    [
        (("--interface", "near"), "only an implementation that --start starts at --interface can run several times"),
        (("--link", "udp", "--start", "true"), "only an implementation that --start starts at --interface"),
        (("--interface", "lo", "--start", "true"), "lo is not one of two virtual interfaces in this namespace"),
        (("--interface", "nothing", "--start", "true"), "ip -json -details link show dev nothing"),
    ],
)
def test_an_implementation_that_cannot_be_copied_is_refused(namespace, tmp_path, options, why):
    done = run(namespace, tmp_path, *options, "--jobs", "2")
    assert done.returncode == 2
    assert why in " ".join((done.stdout + done.stderr).split())
    assert "Traceback" not in done.stderr
