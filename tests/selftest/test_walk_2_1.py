"""A new version of the specification takes two files in the wire layer, and no change of the codec and the suite.

`walk_2_1.py` holds the whole change. Each test runs one part of it in a process whose `dcp_spec` has the new version.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import dcp_spec
import pytest

from .walk_2_1 import patched

WALK = Path(__file__).with_name("walk_2_1.py")
Walk = Any


@pytest.fixture
def walk(tmp_path: Path) -> Walk:
    """``walk(part)``: what a part of the walk finds with version 2.1."""
    patched(Path(dcp_spec.__file__).parent, tmp_path)

    def run(part: str) -> dict[str, Any]:
        done = subprocess.run(
            [sys.executable, WALK, part, tmp_path],
            env={**os.environ, "PYTHONPATH": str(tmp_path)},
            capture_output=True,
            text=True,
            timeout=600,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
        return found

    return run


def test_codec_dissector_json_and_exports_follow_the_profile(walk: Walk) -> None:
    found = walk("codec")
    assert found["same"]
    assert found["priority"] == 9
    assert list(found["fields"].values()) == [9, 9]
    assert (found["json"], found["lua"], found["schema"]) == (True, True, True)


def test_nodes_exchange_the_new_field_and_the_new_container(walk: Walk) -> None:
    found = walk("node")
    assert found["created"] == [9, 9, 9]
    # The third node has no instruction for the container and ignores it.
    assert found["changed"] == [3, 3, 9]
    assert "unhandled-container" in found["dropped"]
    assert "priority" in found["wrong"]


def test_a_scenario_gives_the_new_field(walk: Walk) -> None:
    found = walk("simulator")
    assert found["priorities"] == [5, 5, 5]
    assert not found["failed"]


@pytest.mark.part("suite")
def test_every_case_for_the_latest_version_applies_and_passes(walk: Walk) -> None:
    found = walk("suite")
    assert found["not fine"] == []
    assert set(found["excluded"]) <= set(found["excluded in 2.0"])
    assert found["verdicts"]["pass"] > 600
