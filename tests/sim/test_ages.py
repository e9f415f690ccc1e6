"""The age of state reports in simulations."""

from __future__ import annotations

import json

import pytest
from dcp_lab.sim.measuring.ages import AgeRow, Ages
from dcp_lab.sim.scenario.definition import Down, LinkQuality, Scenario, Topology, Tracks
from dcp_lab.sim.virtual.player import Simulation

from .test_command import LINE, run  # noqa: F401 - a fixture

MS = 1_000_000


def test_ages_by_hand():
    """Received at 10, 30 and 40 ms with ages of 0, 5 and 0 ms, lost at 50 ms, and received at 90 ms until 100 ms."""
    ages = Ages(warm_up=20 * MS)
    for at, age in ((10, 0), (30, 5), (40, 0)):
        ages.heard(at * MS, 1, 2, age * MS)
    ages.lost(50 * MS, 1)
    ages.lost(60 * MS, 1, 2)
    ages.heard(90 * MS, 1, 2, 0)
    ages.lost(95 * MS, 2, 1)
    # Ages from 10 to 20, 5 to 15, 0 to 10 and 0 to 10 ms, for 10 ms each.
    assert ages.found(100 * MS) == [AgeRow(1, 2, 0.04, pytest.approx(8.75))]
    assert Ages(0).found(100) == []


@pytest.mark.parametrize("loss", [0.0, 0.5])
def test_the_age_of_reports_is_that_of_theory(loss):
    """The time since the last beacon of a renewal process, and a period for each one before it that was lost."""
    scenario = Scenario(
        nodes=2,
        duration_s=200,
        warm_up_s=2,
        vardis=False,
        topology=Topology(kind="line"),
        link=LinkQuality(loss=loss),
        tracks=(Tracks(source="track:circle"),),
    )
    simulation = Simulation(scenario)
    simulation.measure_ages()
    ages = simulation.run().ages
    assert [(each.node, each.neighbour) for each in ages] == [(0, 1), (1, 0)]
    for each in ages:
        assert each.seconds == pytest.approx(198, abs=3)
        assert each.mean_ms == pytest.approx(50.17 + 100 * loss / (1 - loss), rel=0.1)


def test_a_node_that_is_off_has_no_reports():
    scenario = Scenario(nodes=2, duration_s=10, tracks=(Tracks(source="track:circle"),), events=(Down(at_s=5, node=1),))
    simulation = Simulation(scenario)
    simulation.measure_ages()
    first, second = simulation.run().ages
    # Node 0 has the last report until it expires, 3 to 4 s later.
    assert (first.node, second.node) == (0, 1)
    assert 7.9 < first.seconds < 9.1
    assert second.seconds == pytest.approx(5, abs=0.3)


def test_the_option(run):  # noqa: F811
    _, output, _ = run("simulate", LINE, "--ages")
    assert "reports    mean age " in output
    assert " ms at 8 pairs of node and neighbour" in output
    found = json.loads(run("simulate", LINE, "--ages", "--json")[1])
    assert len(found["ages"]) == 8
    assert set(found["ages"][0]) == {"node", "neighbour", "seconds", "mean_ms"}
    # The measurement changes nothing.
    assert found["digest"] == json.loads(run("simulate", LINE, "--json")[1])["digest"]
