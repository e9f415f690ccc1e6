"""Simulated networks: the same seed gives the same, and what nodes know is compared correctly."""

from __future__ import annotations

import msgspec
import pytest
from dcp_lab.sim.scenario.agreement import Agreement, ConvergenceClock, Known
from dcp_lab.sim.scenario.defaults import default_scenario
from dcp_lab.sim.scenario.definition import LinkQuality, Scenario, Topology, Tracks
from dcp_lab.sim.scenario.loading import parse_topology
from dcp_lab.sim.virtual.network import Network
from dcp_lab.sim.virtual.player import Simulation, simulate
from hypothesis import given, settings
from hypothesis import strategies as st

from dcp_codec.capture import open_capture
from dcp_codec.codec import get_codec
from dcp_stack.config import SRPConfig, VardisConfig
from dcp_stack.control.client import ServiceError
from dcp_stack.node import Node
from dcp_stack.virtual.topology import Line
from dcp_stack.virtual.world import node_id

from ..chance import examples

SECOND = 1_000_000_000


def grid(nodes: int, **changes) -> Scenario:
    return default_scenario(nodes, topology=Topology(kind="grid"), duration_s=8.0, **changes)


def network(count: int = 3, seed: int = 1) -> Network:
    made = Network(count, get_codec("dcp-2.0"), seed=seed, topology=Line(), srp=SRPConfig(), vardis=VardisConfig())
    for index in range(count):
        made.start(index)
    return made


class TestSeeds:
    def test_the_same_seed_gives_the_same_trace(self):
        first, second = simulate(grid(16)), simulate(grid(16))
        assert first.digest == second.digest
        assert first.traffic == second.traffic
        assert first.convergences == second.convergences
        assert first.met

    def test_another_seed_gives_another_trace(self):
        assert simulate(grid(9)).digest != simulate(grid(9, seed=2)).digest

    def test_sharing_what_was_decoded_changes_nothing(self):
        apart = simulate(grid(16), share_decoding=False)
        together = simulate(grid(16))
        assert apart.digest == together.digest
        assert apart.convergences == together.convergences

    def test_recording_changes_nothing(self, tmp_path):
        recorded = simulate(grid(4), record=tmp_path, record_medium=tmp_path / "medium.mcap")
        assert recorded.digest == simulate(grid(4)).digest
        sent = sum(each.beacons_sent for each in recorded.traffic)
        with open_capture(tmp_path / "medium.mcap") as capture:
            assert sum(1 for _ in capture) == sent
        own = recorded.traffic[3]
        with open_capture(tmp_path / "node-3.mcap") as capture:
            assert sum(1 for _ in capture) == own.beacons_sent + own.beacons_received

    @settings(max_examples=examples(10))
    @given(st.integers(0, 2**64), st.floats(0, 0.6), st.sampled_from(["full", "line", "grid"]))
    def test_lossy_networks_agree_in_the_end_without_exceptions(self, seed, loss, shape):
        scenario = default_scenario(5, topology=parse_topology(shape), duration_s=30.0, seed=seed)
        # Two events, and then time for repetitions by request: nothing else brings back what was lost.
        scenario = Scenario(
            nodes=5,
            duration_s=30.0,
            topology=scenario.topology,
            seed=seed,
            link=LinkQuality(loss=loss, duplicate=0.1, reorder=0.1, jitter_ms=5),
            tracks=(Tracks(source="track:walk"),),
            events=scenario.events[:2],
        )
        simulation = Simulation(scenario)
        report = simulation.run()
        assert report.met, report.findings
        assert simulation.agreement.reached

    def test_bursts_and_corruption_are_harmless_and_reported(self):
        def play() -> tuple[str, dict]:
            scenario = default_scenario(5, topology=parse_topology("line"), duration_s=40.0, seed=3)
            link = LinkQuality(loss=0.3, burst=5, corrupt=0.0005, corrupt_frames=0.05, flips=3)
            simulation = Simulation(msgspec.structs.replace(scenario, link=link, events=scenario.events[:2]))
            report = simulation.run().plain()
            assert all(each["met"] for each in report["findings"] if "raises" in each["what"]), report["findings"]
            return report["digest"], report["shares"]

        digest, shares = play()
        assert shares["lost"] == pytest.approx(0.3, abs=0.05)
        assert shares["corrupted"] > 0.03
        assert play() == (digest, shares)


class TestServices:
    def test_a_node_answers_as_at_its_control_socket(self):
        net = network()
        created = net.request(0, "RTDB-Create", varId=1, repCnt=1, descr="d", value="0102")
        assert created == {"status": "VARDIS-STATUS-OK"}
        net.run_until(SECOND)
        read = net.request(2, "RTDB-Read", varId=1)
        assert read["value"] == "0102"
        assert net.request(0, "UT-Hello")["nodeId"] == "02:00:00:00:00:00"

    def test_errors_are_those_of_the_control_client(self):
        net = network()
        with pytest.raises(ServiceError, match=r"no method .RTDB-Crate.; UT-Hello lists"):
            net.request(0, "RTDB-Crate")
        with pytest.raises(ServiceError, match="varId"):
            net.request(0, "RTDB-Read")
        net.stop(1)
        with pytest.raises(LookupError, match="node 1 is switched off"):
            net.request(1, "UT-Hello")

    def test_a_node_that_raises_is_a_finding_and_the_others_continue(self, monkeypatch):
        simulation = Simulation(grid(4))
        broken = simulation.network.stations[2].config.node_id
        original = Node.handle_timeout

        def fall(node, now, wall):
            if node.config.node_id == broken:
                raise RuntimeError("broken")
            original(node, now, wall)

        simulation.network.at(2 * SECOND, lambda: monkeypatch.setattr(Node, "handle_timeout", fall))
        report = simulation.run()
        (finding,) = [each for each in report.findings if "raises" in each.what]
        assert not finding.met
        assert "node 2" in finding.found
        assert "RuntimeError: broken" in finding.found
        assert report.traffic[3].beacons_sent > 60

    def test_a_node_that_lets_time_stand_still_is_a_finding(self, monkeypatch):
        net = network()
        monkeypatch.setattr(Node, "handle_timeout", lambda *_: None)
        net.run_until(SECOND)
        assert all("timeouts were handled" in each.failure for each in net.stations)

    def test_stopping_early(self):
        net = network()
        net.request(0, "RTDB-Create", varId=1, repCnt=1, descr="d", value="01")
        assert net.run_until(9 * SECOND, stop=lambda: net.stations[0].beacons_sent == 3)
        assert net.now < SECOND

    @pytest.mark.parametrize("profile", ["dcp-1.0", "dcp-1.1", "dcp-1.2", "dcp-1.3", "dcp-2.0", "cpp-2.0", "sim-2.0"])
    def test_every_version_disseminates(self, profile):
        scenario = default_scenario(5, topology=Topology(kind="line"), profile=profile, duration_s=10.0)
        report = simulate(scenario)
        assert report.met, report.findings

    def test_identifiers_are_of_the_width_of_the_profile(self):
        assert node_id(get_codec("dcp-2.0").profile, 258) == bytes.fromhex("020000000102")
        assert node_id(get_codec("student-2024").profile, 1) == b"02:00:00:00:00:01"


def naive(present: list[bool], known: list[dict[int, Known]]) -> bool:
    asked = [known[node] for node in range(len(known)) if present[node]]
    return all(each == asked[0] for each in asked)


STATES = st.one_of(st.none(), st.builds(Known, st.just(b"p"), st.just(1), st.integers(0, 2), st.just(b"v")))
STEPS = st.one_of(
    st.tuples(st.just("learn"), st.integers(0, 2), st.integers(0, 2), STATES),
    st.tuples(st.just("enter"), st.integers(0, 2), st.booleans()),
    st.tuples(st.just("forget"), st.integers(0, 2)),
    st.tuples(st.just("replace"), st.integers(0, 2), st.dictionaries(st.integers(0, 2), STATES.filter(bool))),
)


class TestAgreement:
    @given(st.lists(STEPS, max_size=40))
    def test_agreement_equals_a_comparison_of_everything(self, steps):
        agreement = Agreement(3)
        present, known = [False] * 3, [{}, {}, {}]
        for name, node, *rest in steps:
            getattr(agreement, name)(node, *rest)
            if name == "learn":
                known[node].pop(rest[0], None)
                if rest[1] is not None:
                    known[node][rest[0]] = rest[1]
            elif name == "enter":
                present[node] = rest[0]
            else:
                known[node] = dict(rest[0]) if rest else {}
            assert agreement.reached == naive(present, known)
            assert dict(agreement.known(node)) == known[node]

    def test_the_clock_stops_for_all_events_that_came_to_an_end_together(self):
        agreement, clock = Agreement(2), ConvergenceClock()
        agreement.enter(0, True)
        agreement.enter(1, True)
        value = Known(b"p", 1, 0, b"v")
        clock.event(10, "first")
        agreement.learn(0, 7, value)
        clock.look(10, agreement)
        clock.event(20, "second")
        agreement.learn(1, 7, value)
        clock.look(25, agreement)
        assert [each.took for each in clock.events] == [15, 5]
