"""Nodes that take in known beacons cheaply are, but for the time it takes, plain nodes."""

from __future__ import annotations

from dcp_lab.sim.scenario.definition import (
    Activate,
    Clock,
    Create,
    Deactivate,
    Delete,
    Down,
    Heal,
    LinkQuality,
    Partition,
    Restart,
    Scenario,
    Tracks,
    Up,
    Update,
)
from dcp_lab.sim.scenario.loading import parse_topology
from dcp_lab.sim.virtual.hearing import MOST_WAITING, HearingComposer, HearingNode
from dcp_lab.sim.virtual.player import Simulation
from hypothesis import given, settings
from hypothesis import strategies as st

from dcp_codec.codec import get_codec
from dcp_codec.values import VarSpec
from dcp_stack.config import NodeConfig, SRPConfig, VardisConfig
from dcp_stack.effects import NeighbourSeen
from dcp_stack.vardis.compose import Composer
from dcp_stack.vardis.core import Core

from ..chance import examples

SECOND = 1_000_000_000

TROUBLE = (
    Create(at_s=1, node=0, variable=1, text="one", repetitions=2, timeout_ms=4000),
    Create(at_s=1.2, node=2, variable=2, text="two"),
    Update(at_s=2, every_s=0.13, times=20, node=2, variable=2, text="{n}"),
    Partition(at_s=3, groups=((0, 1),)),
    Deactivate(at_s=4, node=1),
    Activate(at_s=5, node=1),
    Deactivate(at_s=5, node=3, layer="bp"),
    Heal(at_s=6),
    Activate(at_s=6.5, node=3, layer="bp"),
    Delete(at_s=7, node=2, variable=2),
    Create(at_s=8, node=2, variable=2, text="again"),
    Restart(at_s=9, node=0),
    Create(at_s=9.3, node=0, variable=1, text="back"),
    Clock(at_s=9.5, node=4, step_s=3.0),
    Down(at_s=10, node=1),
    Up(at_s=14, node=1),
)


def states(simulation: Simulation) -> list[object]:
    """All that the nodes know and have counted."""
    return [each.node and each.node.snapshot() for each in simulation.network.stations]


def played(scenario: Scenario, looks: tuple[float, ...], *, shared: bool) -> list[object]:
    """State of nodes at the end and at some moments before, and the results."""
    simulation = Simulation(scenario, share_decoding=shared)
    seen: list[object] = []
    for at in looks:
        simulation.network.at(round(at * SECOND), lambda: seen.append(states(simulation)))
    report = simulation.run()
    assert (simulation.network.stations[2].hearing is not None) == shared
    return [seen, states(simulation), report.digest, report.convergences, report.delays, report.traffic]


def both(scenario: Scenario, looks: tuple[float, ...] = ()) -> tuple[list[object], list[object]]:
    """The same of cheap and of plain nodes."""
    return played(scenario, looks, shared=True), played(scenario, looks, shared=False)


@settings(max_examples=examples(12))
@given(
    st.integers(0, 2**32),
    st.sampled_from([0.0, 0.1, 0.5]),
    st.sampled_from(["full", "line"]),
    st.sampled_from(["dcp-1.0", "dcp-1.3", "dcp-2.0", "cpp-2.0"]),
    st.booleans(),
    st.sampled_from(
        [{}, {"X54": "after-the-beacon", "X26": "producer-only"}, {"X17": "purge-first", "X37": "are-dropped"}]
    ),
    st.lists(st.floats(0, 20), max_size=3),
)
def test_all_states_are_those_of_plain_nodes(seed, loss, shape, profile, tracked, readings, looks):
    events = tuple(each for each in TROUBLE if not (profile == "dcp-1.0" and isinstance(each, Activate | Deactivate)))
    scenario = Scenario(
        nodes=5,
        duration_s=20,
        seed=seed,
        profile=profile,
        topology=parse_topology(shape),
        link=LinkQuality(loss=loss, duplicate=loss / 10, jitter_ms=loss * 50),
        srp=SRPConfig(neighbour_table_timeout_ms=700),
        tracks=(Tracks(source="track:walk"),) if tracked else (),
        readings=readings,
        events=events,
    )
    cheap, plain = both(scenario, tuple(looks))
    assert cheap == plain


def test_other_parameters_of_one_node_are_respected():
    scenario = Scenario(nodes=4, duration_s=10, tracks=(Tracks(source="track:walk"),), events=TROUBLE[1:2])
    found = []
    for shared in (True, False):
        simulation = Simulation(scenario, share_decoding=shared)

        def set_network(simulation=simulation) -> None:
            simulation.network.call(1, lambda node, now, wall: node.bp.set_parameter("BPPAR_NETWORK_ID", 7))

        def drop_client(simulation=simulation) -> None:
            simulation.network.call(3, lambda node, now, wall: node.bp.deregister(0x0001))

        simulation.network.at(3 * SECOND, set_network)
        simulation.network.at(4 * SECOND, drop_client)
        report = simulation.run()
        assert report.met, report.findings
        found.append((states(simulation), report.digest))
    assert found[0] == found[1]
    assert found[0][0][1]["bp"]["counters"]["drops/foreign-network"] > 100


def test_a_full_neighbour_table():
    scenario = Scenario(
        nodes=6,
        duration_s=8,
        srp=SRPConfig(max_neighbours=3, neighbour_table_timeout_ms=700),
        tracks=(Tracks(source="track:walk"),),
        events=TROUBLE[1:4],
    )
    cheap, plain = both(scenario, (2.5, 5))
    assert cheap == plain


def test_most_beacons_take_the_fast_path(monkeypatch):
    """The purpose of the shortcut: the ordinary path is for beacons with new contents only."""
    handled = 0
    original = HearingNode.handle_frame

    def count(node, *arguments, **times):
        nonlocal handled
        handled += 1
        original(node, *arguments, **times)

    monkeypatch.setattr(HearingNode, "handle_frame", count)
    scenario = Scenario(nodes=20, duration_s=12, tracks=(Tracks(source="track:walk"),), events=TROUBLE[1:2])
    simulation = Simulation(scenario)
    report = simulation.run()
    received = sum(each.beacons_received for each in report.traffic)
    assert received > 40_000
    assert handled < received / 50
    # And they are in no list for ever.
    lists = [heard for each in simulation.network.stations for heard in each.hearing.waiting.values()]
    assert max(map(len, lists)) < MOST_WAITING


def test_a_listener_to_such_effects_hears_all_of_them():
    scenario = Scenario(nodes=3, duration_s=5, tracks=(Tracks(source="track:walk"),))
    simulation = Simulation(scenario)
    seen = []
    simulation.network.listen(NeighbourSeen, lambda now, node, effect: seen.append((now, node, effect)))
    report = simulation.run()
    assert len(seen) == sum(each.beacons_received for each in report.traffic)


def test_tracks_are_sampled_for_each_beacon():
    """A report is as old as its beacon: no number is left out in between, and no beacon goes without."""
    simulation = Simulation(Scenario(nodes=2, duration_s=5, tracks=(Tracks(source="track:circle,radius=50"),)))
    report = simulation.run()
    node, other = simulation.network.node(0), simulation.network.node(1)
    entry = node.srp.neighbours.lookup(other.config.node_id)
    assert (entry.lost, entry.received) == (0, report.traffic[1].beacons_sent)
    # The stamp of the report is the moment of the beacon; there is no delay on this medium.
    assert node.srp.neighbours.delay(entry) == 0


@settings(max_examples=examples(60))
@given(st.integers(0, 300), st.integers(0, 300), st.lists(st.integers(-5, 1300), min_size=1, max_size=4))
def test_payloads_are_those_of_a_plain_composer(variables, most, rooms):
    """Also where the room, the limit of summaries or a full container ends them, and which ones come next."""
    found = []
    for kind in (Composer, HearingComposer):
        limits = VardisConfig(max_summaries=min(most, 255))
        core = Core(NodeConfig(node_id=bytes(6), codec=get_codec("dcp-2.0"), vardis=limits), lambda _effect: None)
        for var_id in range(min(variables, 256)):
            spec = VarSpec(var_id, bytes(6), 1, b"d", 0, 0)
            core.database.insert(spec, b"v", var_id % 7, now=0, wall=0)
            if var_id % 50:
                core.database.create_q.remove(var_id)
        composer = kind(core)
        found.append([[composer.compose(room) for room in rooms], core.database.snapshot()])
    assert found[0] == found[1]
