"""Contents of an installed kit."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def built(project: Path, target: Path) -> dict[str, str]:
    """The files of the wheel of a project: their names, and the entry points below their name."""
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(target)]
    subprocess.run(command, cwd=project, check=True, capture_output=True)
    (found,) = target.glob("*.whl")
    with zipfile.ZipFile(found) as archive:
        return {
            name: archive.read(name).decode() if name.endswith("entry_points.txt") else ""
            for name in archive.namelist()
        }


def packages(wheel: dict[str, str]) -> set[str]:
    """The packages that a wheel installs."""
    return {name.split("/")[0] for name in wheel if ".dist-info/" not in name}


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> dict[str, str]:
    return built(ROOT, tmp_path_factory.mktemp("wheel"))


def test_the_wheel_holds_exactly_four_packages(wheel):
    assert packages(wheel) == {"dcp_spec", "dcp_codec", "dcp_stack", "dcp_conformance"}
    assert "dcp_selftest" not in "".join(wheel.values())


@pytest.mark.parametrize(
    ("folder", "needed"),
    [
        ("lab", {"dcp_lab/py.typed", "dcp_lab/interop/reporting/templates/interop.html"}),
        ("tables", {"dcp_tables/py.typed", "dcp_tables/report/templates/report.html"}),
    ],
)
def test_laboratory_and_tables_are_wheels_of_their_own(tmp_path, folder, needed):
    wheel = built(ROOT / folder, tmp_path)
    assert packages(wheel) == {f"dcp_{folder}"}
    assert needed <= wheel.keys()


def test_the_self_test_is_a_wheel_of_its_own(tmp_path):
    wheel = built(ROOT / "selftest", tmp_path)
    assert packages(wheel) == {"dcp_selftest"}
    assert {"dcp_selftest/py.typed", "dcp_selftest/data/undecided.toml"} <= wheel.keys()
    (points,) = filter(None, wheel.values())
    for line in (
        "dcp-selftest = dcp_selftest.cli:main",
        "[dcp_conformance.nodes]",
        "mutant = dcp_selftest.nodes:mutant",
    ):
        assert line in points


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
