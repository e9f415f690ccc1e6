"""A new version of the specification takes two files in the wire layer, three in the node, and none in the tester.

`walk_2_1.py` holds the whole change. Each test runs one part of it in a process with the changed copy.
"""

from __future__ import annotations

import filecmp
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import dcp_spec
import pytest

import dcp_stack

from .walk_2_1 import patched

WALK = Path(__file__).with_name("walk_2_1.py")
Walk = Any


PACKAGES = [Path(each.__file__).parent for each in (dcp_spec, dcp_stack)]


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The copy with version 2.1."""
    folder = tmp_path_factory.mktemp("tree")
    patched(PACKAGES, folder)
    return folder


@pytest.fixture
def walk(tree: Path, tmp_path: Path) -> Walk:
    """``walk(part)``: what a part of the walk finds with version 2.1."""

    def run(part: str) -> dict[str, Any]:
        done = subprocess.run(
            [sys.executable, WALK, part, tmp_path],
            env={**os.environ, "PYTHONPATH": str(tree)},
            capture_output=True,
            text=True,
            timeout=600,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
        return found

    return run


def test_the_version_takes_five_files(tree: Path) -> None:
    originals = {package.name: package for package in PACKAGES}
    files = [each.relative_to(tree) for each in tree.rglob("*") if each.suffix in (".py", ".toml")]
    different = []
    for each in files:
        before = originals[each.parts[0]].joinpath(*each.parts[1:])
        if not before.exists() or not filecmp.cmp(before, tree / each, shallow=False):
            different.append(str(each))
    print("files of the walk:", *sorted(different), sep="\n  ")
    assert sorted(different) == [
        "dcp_spec/constants.py",
        "dcp_spec/profiles/dcp-2.1.toml",
        "dcp_stack/own_fields.py",
        "dcp_stack/vardis/known_instructions.py",
        "dcp_stack/vardis/set_priority.py",
    ]


def test_codec_dissector_json_and_exports_follow_the_profile(walk: Walk) -> None:
    found = walk("codec")
    assert found["same"]
    assert found["priority"] == 9
    assert list(found["fields"].values()) == [9, 4, 9]
    assert (found["json"], found["lua"], found["schema"]) == (True, True, True)


def test_nodes_exchange_the_new_fields_and_the_new_container(walk: Walk) -> None:
    found = walk("node")
    # The ttl is that of the rule.
    assert found["created"] == [[9, 200]] * 3
    # The third node has no instruction for the container and ignores it.
    assert found["changed"] == [[3, 2], [3, 2], [9, 2]]
    assert "unhandled-container" in found["dropped"]
    assert "priority" in found["wrong"]


def test_a_scenario_gives_the_new_fields(walk: Walk) -> None:
    found = walk("simulator")
    assert found["fields"] == [[5, 3]] * 3
    assert not found["failed"]


def test_check_judges_recordings_with_the_new_fields_and_the_new_container(walk: Walk) -> None:
    found = walk("check")
    assert found["containers"] == [1, 2, 5, 7]
    assert found["right"] == {}
    assert list(found["wrong"]) == ["CK_VD_VALUE"]
    assert "variable 7, seqno 1: ttl 3 -> 200 at 02:" in found["wrong"]["CK_VD_VALUE"]


def test_the_fuzzer_draws_the_new_fields_and_the_new_container(walk: Walk) -> None:
    found = walk("fuzz")
    assert found["sent"]
    assert found["ttl"] > 10
    assert (found["cases"], found["findings"]) == (200, [])


def test_cases_notice_fields_that_are_not_forwarded(walk: Walk) -> None:
    found = walk("cases")
    assert {each.split(":")[0] for each in found["right"].values()} == {"pass"}
    assert [name for name, each in found["wrong"].items() if each.startswith("fail")] == [
        "TC_NET_HOP_BV_01-2",
        "TC_NET_JOIN_BV_02",
        "TC_NET_JOIN_BV_03",
        "TC_NET_JOIN_BV_05-update",
        "TC_DCP_MODEL_BV_01-own-variable-01",
    ]
    assert "the added fields ttl 1 for number 0: ttl 200" in found["wrong"]["TC_DCP_MODEL_BV_01-own-variable-01"]


@pytest.mark.part("suite")
def test_every_case_for_the_latest_version_applies_and_passes(walk: Walk) -> None:
    found = walk("suite")
    assert found["not fine"] == []
    assert set(found["excluded"]) <= set(found["excluded in 2.0"])
    assert found["passed"] > 1200
