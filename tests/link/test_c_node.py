"""The example node in C passes the smoke plan over virtual Ethernet; `make test-c-node` is the whole suite."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest

from ..ccodec.suite import build, command
from .test_conformance_live import ethernet_or_skip


@pytest.mark.tool("make")
@pytest.mark.tool("gcc")
def test_c_node_passes_the_smoke_plan(tmp_path: Path) -> None:
    ethernet_or_skip()
    assert "warning" not in build(tmp_path, "c-node")
    run = subprocess.run(command(["--plan", "smoke"]), cwd=tmp_path, capture_output=True, text=True)
    results = json.loads((tmp_path / "report" / "results.json").read_text())
    verdicts = {each["id"]: each["verdict"] for each in results["cases"]}
    assert not run.returncode, run.stdout + run.stderr
    assert len(verdicts) > 150
