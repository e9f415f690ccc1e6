"""The example node in C, built with sanitizers, passes the smoke plan over virtual Ethernet."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from .test_conformance_live import ethernet_or_skip

EXAMPLE = Path(__file__).resolve().parent.parent.parent / "examples" / "c-node"
BIN = Path(sys.executable).parent
RUN = """
ip link add sut type veth peer name tester
ip link set lo up; ip link set sut up; ip link set tester up
exec "$0" run --interface tester --pics c-node.pics.toml --ut unix:ut.sock \\
    --start './c-node -i sut -c ut.sock' --plan smoke --report-dir report
"""


def test_c_node_passes_the_smoke_plan(tmp_path: Path) -> None:
    ethernet_or_skip()
    if shutil.which("make") is None or shutil.which("cc") is None:
        pytest.skip("needs make and cc")
    for name in ("Makefile", "node.c", "node.h", "upper_tester.c", "upper_tester.h", "main.c", "c-node.pics.toml"):
        shutil.copy(EXAMPLE / name, tmp_path)
    built = subprocess.run(
        ["make", "sanitize", f"DCP={BIN / 'dcp-codec'}"], cwd=tmp_path, capture_output=True, text=True
    )
    assert not built.returncode, built.stderr
    assert "warning" not in built.stderr
    command = ["unshare", "--net", "sh", "-c", RUN, str(BIN / "dcp-conformance")]
    run = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    results = json.loads((tmp_path / "report" / "results.json").read_text())
    verdicts = {each["id"]: each["verdict"] for each in results["cases"]}
    assert not run.returncode, run.stdout + run.stderr
    assert len(verdicts) > 150
