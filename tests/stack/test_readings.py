"""The typed readings of the node agree with the catalogue, and mypy finds misspelt alternatives."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import get_args, get_type_hints

import msgspec
import pytest
from dcp_spec.catalogue.readings import readings

from dcp_stack.readings import Readings

ROOT = Path(__file__).parents[2]
MISSPELT = """\
from dcp_stack.readings import Readings

readings = Readings()
readings.exact_timeout == "at-least"
readings.exact_timeout == "at-leest"
readings.half_range != "half-range-nether"
readings.exact_timout == "at-least"
Readings(exact_timeout="at-leest")
"""


def test_fields_are_the_readings_of_the_catalogue_with_alternatives():
    types = get_type_hints(Readings)
    fields = {each.encode_name: get_args(types[each.name]) for each in msgspec.structs.fields(Readings)}
    catalogue = {each.id: tuple(one.name for one in each.alternatives) for each in readings().values()}
    assert fields == {name: alternatives for name, alternatives in catalogue.items() if alternatives}


def test_the_first_alternative_is_the_default():
    defaults = {each.id: each.default.name for each in readings().values() if each.default is not None}
    assert msgspec.to_builtins(Readings()) == defaults


def test_readings_cannot_be_changed():
    with pytest.raises(AttributeError):
        Readings().packet_size = "blocks-only"
    assert not hasattr(Readings(), "__dict__")


@pytest.mark.part("tools")
def test_mypy_finds_misspelt_alternatives(tmp_path: Path):
    pytest.importorskip("mypy")
    path = tmp_path / "misspelt.py"
    path.write_text(MISSPELT, encoding="utf-8")
    command = [sys.executable, "-m", "mypy", "--config-file", "", "--strict", "--follow-imports", "silent"]
    command += ["--cache-dir", str(tmp_path / "cache"), str(path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    found = re.findall(r"misspelt\.py:(\d+): error: .*\[([a-z-]+)\]", done.stdout)
    assert found == [
        ("5", "comparison-overlap"),
        ("6", "comparison-overlap"),
        ("7", "attr-defined"),
        ("8", "arg-type"),
    ], done.stdout + done.stderr
