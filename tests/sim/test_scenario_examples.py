"""The examples do what they say."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
from dcp_lab.sim.scenario.loading import load_scenario
from dcp_lab.sim.scenario.report import lines
from dcp_lab.sim.sweep.plan import load_study
from dcp_lab.sim.virtual.player import simulate

EXAMPLES = Path(__file__).parents[2] / "examples"
STATION = EXAMPLES / "base-station"


@pytest.mark.parametrize(
    "path",
    sorted(path for path in EXAMPLES.glob("**/*.toml") if not path.name.endswith(".pics.toml")),
    ids=lambda path: path.parent.name + "/" + path.name,
)
def test_every_scenario_meets_its_expectations(path):
    report = simulate(load_scenario(path))
    assert report.met, "\n".join(lines(report))


def test_the_study_has_the_runs_that_it_states():
    path = EXAMPLES / "study.toml"
    study = load_study(path)
    assert f"{len(study.cells) * study.seeds} runs" in path.read_text()


def station(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(STATION / "base_station.py"), *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=600)


def test_the_output_of_the_base_station_is_that_of_its_readme():
    done = station("simulate")
    assert done.returncode == 0, done.stderr
    # The real time taken differs every time.
    shown = re.sub(r"in \d+\.\d+ s", "in N s", done.stdout)
    session = re.search(r"base_station\.py simulate\n(.*?)```", (STATION / "README.md").read_text(), re.DOTALL)
    assert session is not None
    for part in re.sub(r"in \d+\.\d+ s", "in N s", session[1]).split("...\n"):
        assert part in shown


def test_the_base_station_reports_missing_dependencies():
    done = station("monitor", "--control", "/nowhere.sock")
    assert done.returncode == 3
    assert "there is no such socket" in done.stderr
    assert station("drone").returncode == 2
