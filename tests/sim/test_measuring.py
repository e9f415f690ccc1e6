"""Measurements of a simulation: delays, shares, distances, consistency. Each file for which a reviewer found a wrong
number is a test here."""

from __future__ import annotations

import json
import statistics
from itertools import pairwise

import pytest
from dcp_lab.sim.measuring.consistency import Consistency
from dcp_lab.sim.scenario.definition import (
    Create,
    Down,
    Heal,
    LinkBetween,
    LinkQuality,
    Partition,
    Restart,
    Scenario,
    SetLink,
    Topology,
    Update,
)
from dcp_lab.sim.scenario.loading import load_scenario, parse_topology
from dcp_lab.sim.scenario.report import lines
from dcp_lab.sim.virtual.player import Simulation, simulate
from hypothesis import given, settings
from hypothesis import strategies as st

from dcp_stack.effects import VariableChanged

from ..chance import examples

SECOND = 1_000_000_000


def updates(node: int, variable: int, *, start: float, every: float, times: int | None = None) -> tuple[Create, Update]:
    """A variable and its updates, each of which has octets of its own."""
    return (
        Create(at_s=start, node=node, variable=variable, text=f"{variable} created"),
        Update(at_s=start + every, every_s=every, times=times, node=node, variable=variable, text=f"{variable}: {{n}}"),
    )


class Oracle:
    """Follows values by their octets, which no two values share: independent of sequence numbers."""

    def __init__(self, scenario: Scenario) -> None:
        self.simulation = Simulation(scenario)
        self.born: dict[bytes, tuple[int, int]] = {}
        self.taken: dict[tuple[bytes, int], int] = {}
        self.simulation.network.listen(VariableChanged, self._changed)
        self.report = self.simulation.run()

    def _changed(self, now: int, node: int, effect: VariableChanged) -> None:
        if effect.event == "deleted":
            return
        producer = self.simulation.network.stations[node].config.node_id == effect.prod_id
        if producer and effect.value not in self.born:
            self.born[effect.value] = now, node
        elif not producer:
            self.taken.setdefault((effect.value, node), now)

    @property
    def delays_ms(self) -> list[float]:
        return [(now - self.born[value][0]) / 1e6 for (value, _), now in self.taken.items()]


def mean(report, kind: str = "update") -> float:
    (row,) = [row for row in report.delays if row.kind == kind]
    return row.mean_ms


class TestFormerErrors:
    @pytest.mark.part("suite")
    def test_a_link_of_60_s_is_not_one_of_9_s(self):
        """followed.toml: 256 updates later the sequence number is the same again."""
        events = [event for variable in range(10) for event in updates(0, variable, start=1, every=0.1)]
        found = Oracle(
            Scenario(nodes=2, duration_s=100, srp=False, link=LinkQuality(delay_ms=60_000), events=tuple(events))
        )
        rows = [row for row in found.report.delays if row.received]
        assert all(row.mean_ms > 60_000 for row in rows)
        assert sum(row.received for row in rows) == len(found.taken) > 1000
        assert mean(found.report) == pytest.approx(60_100, abs=150)
        assert found.report.values.wrapped == 30
        assert any("sequence numbers wrapped 30 times" in note for note in found.report.values.notes)

    @pytest.mark.part("suite")
    def test_many_concurrent_values_are_all_followed(self):
        """followed3.toml: more values are under way than were followed."""
        events = [event for variable in range(50) for event in updates(0, variable, start=1, every=0.2)]
        found = Oracle(
            Scenario(nodes=2, duration_s=45, srp=False, link=LinkQuality(delay_ms=20_000), events=tuple(events))
        )
        assert found.report.values.received == len(found.taken) > 4096
        assert found.report.values.unidentified == 0
        assert mean(found.report) > 20_000

    def test_a_link_that_loses_everything_does_not_count_as_a_hop(self):
        """oneway.toml: a full mesh of three in which 0 and 2 do not hear each other."""
        cut = LinkBetween(sender=0, receiver=2, quality=LinkQuality(loss=1))
        found = simulate(
            Scenario(nodes=3, duration_s=60, links=(cut,), events=updates(0, 1, start=1, every=1, times=50))
        )
        by_hops = {row.hops: row for row in found.delays if row.kind == "update"}
        assert [*by_hops] == [1, 2]
        assert by_hops[1].due == by_hops[2].due == 50
        assert by_hops[2].mean_ms > by_hops[1].mean_ms

    def test_a_link_cut_in_one_direction_works_in_the_other(self):
        cut = LinkBetween(sender=0, receiver=2, both_ways=False, quality=LinkQuality(loss=1))
        for producer, distances in ((0, {1, 2}), (2, {1})):
            found = simulate(
                Scenario(nodes=3, duration_s=9, links=(cut,), events=updates(producer, 1, start=1, every=1, times=5))
            )
            assert {row.hops for row in found.delays} == distances

    @pytest.mark.part("suite")
    def test_consistency_under_continuous_updates(self):
        """grid5-l2.toml: a lossless grid of 25 in which each node updates a variable every two seconds."""
        events = [event for node in range(25) for event in updates(node, node, start=1 + node * 2 / 25, every=2)]
        scenario = Scenario(nodes=25, duration_s=20, warm_up_s=4, topology=Topology(kind="grid"), events=tuple(events))
        found = simulate(scenario)
        agreed = sum(each.took is not None for each in found.convergences)
        assert agreed < len(found.convergences) / 2
        assert len(found.consistency) == 25
        assert all(0.5 < each.newest_share < 1 for each in found.consistency)
        assert all(each.complete_share < each.newest_share for each in found.consistency)
        assert all(each.seconds == pytest.approx(16) for each in found.consistency)
        # The share of time without the newest is the mean delay in proportion to the time between updates.
        late = statistics.mean(1 - each.newest_share for each in found.consistency)
        rows = [row for row in found.delays if row.kind == "update"]
        delay = sum(row.mean_ms * row.received for row in rows) / sum(row.received for row in rows)
        assert late == pytest.approx(delay / 2000, rel=0.08)


class TestCounts:
    def test_creations_and_updates_are_counted_separately(self):
        found = simulate(Scenario(nodes=3, duration_s=10, events=updates(0, 1, start=1, every=1, times=8)))
        assert [(row.kind, row.due) for row in found.delays] == [("creation", 2), ("update", 16)]

    def test_the_warm_up_is_not_counted(self):
        events = updates(0, 1, start=1, every=1, times=8)
        scenario = Scenario(nodes=3, duration_s=10.5, events=events)
        whole, later = simulate(scenario), simulate(Scenario(nodes=3, duration_s=10.5, warm_up_s=5.5, events=events))
        assert whole.digest == later.digest
        assert [(row.kind, row.due) for row in later.delays] == [("update", 2 * 4)]
        assert later.values.produced == 4
        assert later.consistency[0].seconds == pytest.approx(5)
        sent, counted = (sum(each.beacons_sent for each in found.traffic) for found in (whole, later))
        assert counted == pytest.approx(sent / 2, rel=0.1)
        assert all(each.beacons_per_s == pytest.approx(10, rel=0.05) for each in later.traffic)
        assert later.expected < whole.expected
        assert any("counted from 5.5 s on" in line for line in lines(later))

    def test_a_value_that_goes_back_is_counted(self):
        # Node 1 misses 150 updates; then the far side of the network, which has the old one, is newer to it.
        events = (
            Create(at_s=1, node=0, variable=1, text="created"),
            Update(at_s=2, every_s=0.02, times=20, node=0, variable=1, text="{n}"),
            Partition(at_s=3, groups=((0, 1), (2,))),
            Update(at_s=3.1, every_s=0.02, times=150, node=0, variable=1, text="b{n}"),
            Heal(at_s=8),
        )
        found = simulate(Scenario(nodes=3, duration_s=12, topology=Topology(kind="line"), srp=False, events=events))
        assert found.values.older_for_newer >= 1
        note = next(note for note in found.values.notes if "older one" in note)
        assert "node 1 took value 20 of variable 1 (sequence number 20) for value 170 (170)" in note
        assert f"note       {note}" in lines(found)

    def test_everything_is_in_the_result(self):
        found = simulate(Scenario(nodes=3, duration_s=6, seed=5, events=updates(0, 1, start=1, every=1)))
        made = found.plain()["provenance"]
        assert made["kit_version"]
        assert made["scenario"]["bp"]["jitter"] == 0.1
        assert made["scenario"]["link"]["loss"] == 0
        assert made["parameters"]["vardis"]["VARDISPAR_MAX_PAYLOAD_SIZE"] > 0
        json.dumps(found.plain())
        same_but_seed = simulate(Scenario(nodes=3, duration_s=6, seed=6, events=updates(0, 1, start=1, every=1)))
        other = simulate(
            Scenario(nodes=3, duration_s=6, seed=5, link=LinkQuality(loss=0.1), events=updates(0, 1, start=1, every=1))
        )
        hashes = [each.provenance.scenario_sha256 for each in (found, same_but_seed, other)]
        assert hashes[0] == hashes[1] != hashes[2]

    @settings(max_examples=examples(15))
    @given(
        st.integers(0, 2**32),
        st.floats(0, 0.7),
        st.sampled_from([0.0, 300.0, 4000.0]),
        st.sampled_from(["full", "line", "grid"]),
        st.sampled_from([0.02, 0.11, 0.7]),
        st.booleans(),
    )
    def test_the_same_as_following_values_by_their_octets(self, seed, loss, delay, shape, every, troubled):
        events: list = [event for v in range(3) for event in updates(v, v, start=1 + v / 10, every=every)]
        if troubled:
            events += [
                Partition(at_s=4, groups=((0, 1), (2, 3))),
                Restart(at_s=5, node=3),
                SetLink(at_s=5, quality=LinkQuality(loss=loss / 2, jitter_ms=40)),
                Heal(at_s=7),
                Down(at_s=9, node=3),
            ]
        scenario = Scenario(
            nodes=4,
            duration_s=12,
            seed=seed,
            srp=False,
            topology=parse_topology(shape),
            link=LinkQuality(loss=loss, delay_ms=delay, jitter_ms=30, duplicate=0.05, reorder=0.05),
            events=tuple(events),
        )
        found = Oracle(scenario)
        report = found.report
        totals = report.values
        assert totals.unidentified == 0
        assert totals.received + totals.missed == totals.due == sum(row.due for row in report.delays)
        assert all(row.received + row.missed == row.due for row in report.delays)
        assert totals.produced == len(found.born)
        if not troubled:
            assert totals.received == len(found.taken)
            assert totals.due == 3 * len(found.born)
            known = [row for row in report.delays if row.received]
            if known:
                total = sum(row.mean_ms * row.received for row in known) / totals.received
                assert total == pytest.approx(statistics.mean(found.delays_ms))
                assert max(row.max_ms for row in known) == pytest.approx(max(found.delays_ms))


def naive_share(samples: list[tuple[int, float]]) -> float:
    """The integral of a step function, divided by its length."""
    spans = list(pairwise(samples))
    return sum((end - begin) * share for (begin, share), (end, _) in spans) / (samples[-1][0] - samples[0][0])


class TestConsistency:
    def test_the_share_is_the_mean_over_time(self):
        log = Consistency(3)
        for node in range(3):
            log.enter(0, node, True)
        log.born(10, 0, 7, "a")
        log.holds(20, 1, 0, 7, "a")
        log.holds(40, 2, 0, 7, "a")
        log.born(50, 0, 7, "b")
        log.holds(70, 2, 0, 7, "b")
        log.enter(80, 1, False)
        (found,) = log.found(90)
        steps = [(10, 0.0), (20, 0.5), (40, 1.0), (50, 0.0), (70, 0.5), (80, 1.0), (90, 0.0)]
        assert found.newest_share == pytest.approx(naive_share(steps))
        assert found.complete_share == pytest.approx((10 + 10) / 80)

    def test_a_deleted_variable_counts_no_further(self):
        log = Consistency(2)
        log.enter(0, 0, True)
        log.enter(0, 1, True)
        log.born(0, 0, 7, "a")
        log.holds(10, 1, 0, 7, "a")
        log.lost(20, 0, 7)
        assert log.found(100)[0].seconds == pytest.approx(20e-9)


def test_a_scenario_says_its_warm_up(tmp_path):
    path = tmp_path / "s.toml"
    path.write_text("nodes = 2\nduration_s = 3\nwarm_up_s = 1.5\n")
    assert load_scenario(path).warm_up == 3 * SECOND // 2


class TestMovingNodes:
    def play(self, tmp_path, text: str):
        path = tmp_path / "s.toml"
        path.write_text(text)
        return simulate(load_scenario(path))

    def test_tracks_change_the_links(self, tmp_path):
        # Node 1 flies past node 0 at 10 m/s: 100 m away at first, nearest after 10 s, out of range again after 13 s.
        text = """
            nodes = 2
            duration_s = 20
            srp = { neighbour_table_timeout_ms = 500 }
            topology = { kind = "positions", range_m = 30 }
            tracks = [
                { source = "track:line,speed=0", nodes = [0] },
                { source = "track:line,x=-100,course=90,speed=10", nodes = [1] },
            ]
            expect = [
                { that = "neighbours", node = 0, are = [], at_s = 6.8 },
                { that = "neighbours", node = 0, are = [1], at_s = 7.4 },
                { that = "neighbours", node = 0, are = [1], at_s = 12.9 },
                { that = "neighbours", node = 0, are = [], at_s = 14 },
            ]
        """
        report = self.play(tmp_path, text)
        assert report.met, report.findings
        # In range for 60 m of the way, that is 6 of 20 s.
        received = sum(each.beacons_received for each in report.traffic)
        assert received == pytest.approx(2 * 60, abs=6)
        assert report.expected == received

    def test_distances_are_those_at_the_time_of_the_update(self, tmp_path):
        # In a line of three, 25 m apart with a range of 30 m, the last node flies to the first.
        text = """
            nodes = 3
            duration_s = 12
            [topology]
            kind = "positions"
            range_m = 30
            positions = [[0, 0, 0], [25, 0, 0], [50, 0, 0]]
            [[tracks]]
            source = "track:line,x=50,course=270,speed=5"
            nodes = [2]
            [[events]]
            do = "create"
            at_s = 1
            node = 0
            variable = 1
            text = "created"
            [[events]]
            do = "update"
            at_s = 9
            node = 0
            variable = 1
            text = "updated"
        """
        report = self.play(tmp_path, text)
        assert {(row.kind, row.hops): row.due for row in report.delays} == {
            ("creation", 1): 1,
            ("creation", 2): 1,
            ("update", 1): 2,
        }
