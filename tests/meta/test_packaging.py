"""Contents of an installed kit."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> list[str]:
    target = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(target)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    (found,) = target.glob("*.whl")
    with zipfile.ZipFile(found) as archive:
        return archive.namelist()


def test_the_wheel_holds_exactly_four_packages(wheel):
    top = {name.split("/")[0] for name in wheel if ".dist-info/" not in name}
    assert top == {"dcp_spec", "dcp_codec", "dcp_stack", "dcp_conformance"}


def test_the_wheel_holds_the_data_that_the_tools_need(wheel):
    for needed in (
        "dcp_spec/data/requirements.toml",
        "dcp_spec/data/readings.toml",
        "dcp_spec/profiles/cpp-2.0.toml",
        "dcp_spec/py.typed",
        "dcp_codec/export/lua_walk.lua",
    ):
        assert needed in wheel


def test_every_built_in_profile_has_its_file(wheel):
    from dcp_spec.profile.loading import profile_names

    files = {Path(name).stem for name in wheel if name.startswith("dcp_spec/profiles/")}
    assert files == set(profile_names())
