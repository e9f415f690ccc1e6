"""Scenario files: how they are played, and messages about invalid ones."""

from __future__ import annotations

from pathlib import Path

import pytest
from dcp_lab.sim.scenario.definition import BeaconRate, Converged, Scenario, ScenarioError, Topology
from dcp_lab.sim.scenario.expectations import judge_all
from dcp_lab.sim.scenario.loading import load_scenario, parse_topology
from dcp_lab.sim.scenario.report import NodeTraffic, Report, lines
from dcp_lab.sim.virtual.player import Simulation, simulate

LINE = 'nodes = 5\nduration_s = 20\ntopology = "line"\n'


@pytest.fixture
def written(tmp_path):
    def write(text: str, name: str = "scenario.toml") -> Path:
        path = tmp_path / name
        path.write_text(text)
        return path

    return write


def event(do: str, at: float, **keys) -> str:
    return f'[[events]]\ndo = "{do}"\nat_s = {at}\n' + "".join(
        f"{key} = {value!r}\n".replace("True", "true").replace("False", "false") for key, value in keys.items()
    )


def expect(that: str, **keys) -> str:
    return f'[[expect]]\nthat = "{that}"\n' + "".join(f"{key} = {value!r}\n" for key, value in keys.items())


AGREE = expect("converged", within_s=2, after="each")


class TestPlaying:
    @pytest.fixture
    def play(self, written):
        def run(text: str) -> Report:
            report = simulate(load_scenario(written(text)))
            assert report.met, "\n".join(lines(report))
            return report

        return run

    def test_a_line_agrees_after_create_update_delete_and_create_again(self, play):
        report = play(
            LINE
            + event("create", 1, node=0, variable=7, text="one")
            + event("update", 4, node=0, variable=7, text="two")
            + event("delete", 7, node=0, variable=7)
            + event("create", 10, node=0, variable=7, text="three")
            + AGREE
            + expect("variable", node=4, variable=7, text="one", at_s=3.9)
            + expect("variable", node=4, variable=7, text="two", at_s=6.9)
            + expect("variable", node=4, variable=7, state="deleted", at_s=9.9)
            + expect("variable", node=4, variable=7, text="three")
        )
        # Nothing takes more than two beacon periods a hop.
        assert all(0 < each.took < 4 * 220_000_000 for each in report.convergences)
        assert [(each.kind, each.hops) for each in report.delays] == [
            (kind, hops) for kind in ("creation", "update") for hops in (1, 2, 3, 4)
        ]

    def test_a_node_that_starts_late_catches_up(self, play):
        play(
            LINE
            + "down_at_start = [4]\n"
            + event("create", 1, node=0, variable=1, text="x")
            + event("update", 2, node=0, variable=1, text="y")
            + event("up", 8, node=4)
            + AGREE
            + expect("variable", node=4, variable=1, state="off", at_s=7)
            + expect("variable", node=4, variable=1, state="unknown", at_s=8.001)
            + expect("variable", node=4, variable=1, text="y")
        )

    def test_a_healed_partition_catches_up(self, play):
        report = play(
            LINE
            + event("create", 1, node=0, variable=1, text="x")
            + event("partition", 5, groups=[[0, 1]])
            + event("update", 6, node=0, variable=1, text="y")
            + event("heal", 12)
            + expect("converged", within_s=2)
            + expect("variable", node=1, variable=1, text="y", at_s=11)
            + expect("variable", node=2, variable=1, text="x", at_s=11)
        )
        assert report.convergences[2].took > 6_000_000_000

    def test_a_restarted_node_learns_again_what_it_knew(self, play):
        play(
            LINE
            + event("create", 1, node=0, variable=1, text="x")
            + event("restart", 8, node=2)
            + AGREE
            + expect("variable", node=2, variable=1, state="unknown", at_s=8.001)
            + expect("variable", node=2, variable=1, text="x")
        )

    def test_a_restarted_producer_takes_its_variable_over_by_creating_it_again(self, play):
        play(
            LINE
            + event("create", 1, node=0, variable=1, text="x")
            + event("restart", 8, node=0)
            + event("create", 9, node=0, variable=1, text="again")
            + expect("converged", within_s=2)
            + expect("variable", node=4, variable=1, text="again")
        )

    def test_deactivated_nodes_are_not_asked_and_catch_up(self, play):
        play(
            LINE
            + event("create", 1, node=0, variable=1, text="x")
            + event("deactivate", 3, node=4)
            + event("update", 4, node=0, variable=1, text="y")
            + event("activate", 8, node=4)
            + event("deactivate", 12, node=2, layer="bp")
            + event("update", 13, node=0, variable=1, text="z")
            + event("activate", 16, node=2, layer="bp")
            + expect("converged", within_s=2)
            + expect("variable", node=4, variable=1, text="z")
        )

    def test_values_repeat_and_rates_hold(self, play):
        report = play(
            LINE
            + '[[tracks]]\nsource = "track:circle,rate=20"\n'
            + event("create", 1, node=0, variable=1, text="n0")
            + event("update", 2, node=0, variable=1, text="n{n}", every_s=0.5, times=5)
            + expect("variable", node=4, variable=1, text="n4")
            + expect("neighbours", node=1, are=[0, 2])
            + expect("beacon-rate", per_s=10, tolerance=0.03)
        )
        assert [each.time / 1e9 for each in report.convergences] == [1, 2, 2.5, 3, 3.5, 4]

    def test_links_can_be_one_way_and_change(self, play):
        play(
            "nodes = 2\nduration_s = 9\n[[links]]\nfrom = 0\nto = 1\nboth_ways = false\nquality = { loss = 1 }\n"
            + '[[tracks]]\nsource = "track:line"\n'
            + expect("neighbours", node=0, are=[1], at_s=2)
            + expect("neighbours", node=1, are=[], at_s=2)
            + event("link", 3, quality={"loss": 1.0}).replace("{'loss': 1.0}", "{ loss = 1.0 }")
            + "[[events]]\ndo = 'link'\nat_s = 3\nfrom = 0\nto = 1\nboth_ways = false\nquality = {}\n"
            + expect("neighbours", node=0, are=[])
            + expect("neighbours", node=1, are=[0])
        )

    def test_timed_out_variables_go_everywhere(self, play):
        play(
            LINE
            + event("create", 1, node=0, variable=1, text="x", timeout_ms=3000)
            + expect("variable", node=4, variable=1, at_s=3)
            + expect("variable", node=4, variable=1, state="deleted", at_s=9)
        )

    def test_safety_data_by_hand(self, play):
        play(
            LINE
            + '[[events]]\ndo = "safety-data"\nat_s = 1\nnode = 0\ndata = { x = 1, y = 2.5, z = 0 }\n'
            + expect("neighbours", node=1, are=[0], at_s=2)
            + expect("neighbours", node=1, are=[])
        )


class TestUnmet:
    def test_unmet_expectations_report_the_actual_value(self, written):
        report = simulate(
            load_scenario(
                written(
                    LINE
                    + event("create", 1, node=0, variable=1, text="x")
                    + event("partition", 2, groups=[[0]])
                    + event("update", 3, node=0, variable=1, text="y")
                    + event("update", 4, node=1, variable=1, text="stolen")
                    + expect("converged", within_s=1)
                    + expect("variable", node=1, variable=1, text="y")
                    + expect("neighbours", node=0, are=[1])
                    + expect("beacon-rate", per_s=20)
                )
            )
        )
        text = "\n".join(lines(report))
        assert not report.met
        assert "NOT MET  the databases agree 1 s after the last event: no agreement after 'node 1 updates" in text
        assert "NOT MET  node 1 has variable 1 alive at the end with 'y': it is alive with 'x'" in text
        assert "NOT MET  the neighbours of node 0 are [1] at the end: found []" in text
        assert "has the largest deviation with" in text
        assert "node 1 updates variable 1: VARDIS-STATUS-NOT-PRODUCER" in text
        assert report.plain()["met"] is False

    def test_the_influence_of_a_busy_machine_is_reported(self):
        normal, busy = NodeTraffic(0, 200, 0, 0, 10.0), NodeTraffic(1, 181, 0, 0, 9.05, left_out_per_s=0.95)
        (finding,) = judge_all([BeaconRate(per_s=10)], [], [normal, busy])
        assert not finding.met
        assert finding.found == (
            "node 1 has the largest deviation with 9.050; it left out 0.950 because the machine was too busy"
        )
        report = simulate(Scenario(nodes=2, duration_s=1))
        assert (report.late_s, report.slowest_start_s) == (0, 0)
        assert "machine" not in "\n".join(lines(report))
        report.late_s = 1.25
        assert "1.2 s late at most, starting a node took 0.0 s: it is too busy" in "\n".join(lines(report))

    def test_a_node_without_the_protocol(self, written):
        text = LINE + "srp = false\n" + event("create", 1, node=0, variable=1, text="x")
        assert simulate(load_scenario(written(text + expect("variable", node=4, variable=1, text="x")))).met
        unmet = simulate(load_scenario(written(text + expect("neighbours", node=4, are=[]))))
        assert not unmet.met

    def test_events_at_a_node_that_is_off_cannot_happen(self, written):
        scenario = load_scenario(
            written(LINE + "down_at_start = [0]\n" + event("create", 1, node=0, variable=1, text="x"))
        )
        report = simulate(scenario)
        assert "node 0 is switched off" in "\n".join(lines(report))
        assert not report.met


BAD = [
    ("nodes = 5\n", "missing key `duration_s`"),
    ('nodes = "5"\nduration_s = 1\n', "nodes: Expected `int`, got `str`"),
    ("nodes = 0\nduration_s = 1\n", "nodes: a network has 1 to"),
    ("nodes = 5\nduration_s = 0\n", "duration_s: 0 is not within"),
    (LINE + "sed = 1\n", "unknown key `sed`; did you mean seed?"),
    (LINE + "[bp]\nbeacon_period = 1\n", "bp: unknown key `beacon_period`; did you mean beacon_period_ms?"),
    (LINE + event("crate", 1), "events[0].do: Invalid value 'crate'"),
    (LINE + event("create", 1, node=0, varable=1), "events[0]: unknown key `varable`; did you mean variable?"),
    (LINE + event("create", 1, node=0, variable=1), "events[0].value: either text or value"),
    (LINE + event("create", 1, node=0, variable=1, value="0g"), "events[0].value: non-hexadecimal"),
    (LINE + event("create", 21, node=0, variable=1, text="x"), "events[0].at_s: 21 is not within the 20 s"),
    (LINE + event("create", 1, node=5, variable=1, text="x"), "events[0].node: there is no node 5; the nodes are 0..4"),
    (LINE + event("create", 1, node=0, variable=1, text="x", times=2), "events[0].times"),
    (LINE + event("create", 1, node=0, variable=1, text="x", every_s=1e-6), "more than 1000000 events"),
    (LINE + event("partition", 1, groups=[[0, 1], [1]]), "events[0].groups: node 1 is in two groups"),
    (LINE + "[link]\nloss = 2\n", "link: loss 2.0 is not within 0..1"),
    (LINE + "[[links]]\nfrom = 0\nto = 9\n", "links[0].to: there is no node 9"),
    (LINE + '[[tracks]]\nsource = "track:line"\nnodes = [7]\n', "tracks[0].nodes: there is no node 7"),
    (LINE + '[[tracks]]\nsource = "stdin"\n', "tracks[0].source: stdin cannot be a source of a scenario"),
    (LINE + expect("variable", node=9, variable=1), "expect[0].node: there is no node 9"),
    (LINE + expect("convergd", within_s=1), "expect[0].that: Invalid value 'convergd'"),
    (LINE + 'profile = "dcp-3.0"\n', "profile: unknown profile 'dcp-3.0'"),
    ("nodes = 5\nduration_s = 1\n[topology]\nkind = 'ring'\n", "topology.kind: Invalid enum value 'ring'"),
    ("nodes = 5\nduration_s = 1\ntopology = 'ring'\n", "unknown topology 'ring'; expected one of full"),
    ("nodes = 2\nduration_s = 1\n[topology]\nkind = 'positions'\npositions = [[0,0,0]]\nrange_m = 1\n", "as nodes: 2"),
    ("nodes = 2\nduration_s = 1\n[topology]\nkind = 'neighbours'\nneighbours = [[1],[2]]\n", "topology.neighbours[1]"),
    ("nodes = \n", "not a valid TOML file"),
]


class TestBadFiles:
    @pytest.mark.parametrize(("text", "complaint"), BAD, ids=[complaint[:30] for _, complaint in BAD])
    def test_file_and_key_are_named(self, written, text, complaint):
        path = written(text)
        with pytest.raises(ScenarioError) as caught:
            load_scenario(path)
        assert complaint in str(caught.value)
        assert str(path) in str(caught.value) or "ring" in text

    def test_no_such_file(self, tmp_path):
        with pytest.raises(ScenarioError, match="cannot be read: No such file"):
            load_scenario(tmp_path / "none.toml")

    @pytest.mark.parametrize(
        ("keys", "complaint"),
        [
            ("[bp]\nbeacon_period_ms = 0\n", "BPPAR_BEACON_PERIOD"),
            ('[[tracks]]\nsource = "track:spiral"\n', "no track 'spiral'"),
            ('[readings]\nX54 = "never"\n', "before-the-beacon, after-the-beacon"),
            ('[readings]\nX99 = "never"\n', "X99"),
        ],
    )
    def test_settings_that_nodes_refuse(self, written, keys, complaint):
        with pytest.raises(ScenarioError, match=complaint):
            Simulation(load_scenario(written(LINE + keys)))


class TestTopologies:
    def test_by_name(self):
        assert parse_topology("bus") == Topology(kind="full")
        assert parse_topology("grid:3").pairs(5) == [(0, 1), (0, 3), (1, 2), (1, 4), (3, 4)]
        assert parse_topology("line").pairs(3) == [(0, 1), (1, 2)]
        assert len(parse_topology("full").pairs(5)) == 10
        for bad in ("grid:0", "grid:x", "line:3"):
            with pytest.raises(ScenarioError):
                parse_topology(bad)

    def test_from_a_file_beside_the_scenario(self, written):
        written("kind = 'positions'\nrange_m = 10\npositions = [[0,0,0],[9,0,0],[18,0,0]]\n", "place.toml")
        found = load_scenario(written("nodes = 3\nduration_s = 1\ntopology = 'place.toml'\n"))
        assert found.topology.pairs(3) == [(0, 1), (1, 2)]

    def test_naming_one_end_of_a_link_is_enough(self):
        shape = Topology(kind="neighbours", neighbours=((2,), (2,), ()))
        assert shape.pairs(3) == [(0, 2), (1, 2)]

    def test_the_timeline_is_in_order(self):
        scenario = Scenario(nodes=1, duration_s=1.0, expect=(Converged(within_s=1.0),))
        assert scenario.timeline() == []
