"""Exploration of small networks: what it finds, that it is sound, and that its sequences replay."""

from __future__ import annotations

import random
from typing import Any

import msgspec
import pytest
from dcp_lab.explore.cores import SILENCE, VARIABLE, Bearer, Cores
from dcp_lab.explore.hazards import hazard_of
from dcp_lab.explore.properties import Judge
from dcp_lab.explore.proposals import PROPOSALS, ProposedVardis
from dcp_lab.explore.replay import scenario_text
from dcp_lab.explore.search import Search, Step
from dcp_lab.explore.space import Space, SpaceError, check, load_space
from dcp_lab.explore.trace import chart, table, trace
from dcp_lab.sim.scenario.loading import load_scenario
from dcp_lab.sim.virtual.player import Simulation
from dcp_spec.catalogue.readings import readings
from dcp_spec.status import VardisStatus

from dcp_stack.config import NodeConfig, VardisConfig
from dcp_stack.vardis.entity import Vardis, VardisState

WRAPPING = VardisConfig(seqno_modulus=4)
#: Small spaces, with the hazards in them for 2.0 and 1.3.
SPACES = (
    (Space(nodes=3, creations=2, updates=1), "H7 H8", ""),
    (Space(nodes=3, creations=2, updates=1, deletions=1), "H1 H7 H8 H10 H11", "H1 H7 H8 H10 H11"),
    (Space(nodes=3, creations=2, deletions=1, repetitions=2), "H1 H7 H10 H11", "H1 H7 H10 H11 H13"),
    (Space(nodes=3, updates=1, deletions=1), "H1 H10 H11", "H1 H10 H11"),
    (Space(nodes=2, creations=2, updates=1, restarts=1), "H1 H2 H7", "H1 H2 H6"),
    (Space(nodes=2, updates=3, vardis=WRAPPING), "H9", "H9"),
    (Space(nodes=3, producers=2, creations=2, deletions=1), "H1 H3 H4 H7 H10 H11 H12", "H1 H7 H10 H11 H12"),
    (Space(nodes=2, creations=2, restarts=1, clock_steps=2), "H1 H2 H5 H7", "H1 H2 H6"),
    (Space(nodes=2, updates=1, silences=2), "H3", ""),
    (Space(nodes=3, losses=0, partitions=1, deletions=1), "H1 H10", "H1 H10 H11"),
)


def of(space: Space, **changes: Any) -> Space:
    return msgspec.structs.replace(space, **changes)


def explored(space: Space) -> tuple[Search, dict[str, set[str]]]:
    """The search of a space, and the violated properties by hazard."""
    search = Search(space)
    result = search.run()
    assert result.complete
    found: dict[str, set[str]] = {}
    for each in result.violations:
        name = hazard_of(each, search.cores.codec.profile.spec_version)
        found.setdefault(name or f"new: {each.name} {sorted(each.kinds)}", set()).add(each.name)
    return search, found


@pytest.mark.req("VD-CRE-03", "VD-PC-01", "VD-PC-03", "VD-PD-03", "VD-PD-04", "VD-PS-02", "VD-PS-03")
@pytest.mark.req("VD-PU-03", "VD-PU-06", "VD-PU-07", "VD-RC-01")
def test_each_hazard_is_found_in_its_versions_and_nothing_else():
    seen: dict[str, set[str]] = {"2.0": set(), "1.3": set()}
    for space, latest, before in SPACES:
        for version, expected in (("2.0", latest), ("1.3", before)):
            if version == "2.0" or not space.silences:  # 1.3 has no timeouts
                _, found = explored(of(space, profile=f"dcp-{version}"))
                assert set(found) == set(expected.split()), (space.bounds, version, found)
                seen[version] |= set(found)
    for version, found in seen.items():
        hazards = {each.id: each for each in readings().values() if each.kind == "hazard"}
        assert found == {
            name
            for name, each in hazards.items()
            if each.since <= version and not (each.until and each.until < version)
        }


def test_the_first_sequence_is_the_shortest():
    search, _ = explored(SPACES[0][0])
    missed, older = search.violations()
    assert missed.steps == (
        Step("create", 0),
        Step("beacon", 0, (1, 2)),
        Step("create", 0),
        Step("beacon", 0, ()),
    )
    assert (older.name, len(older.steps), older.kinds) == ("older-value", 7, {"create", "again", "update", "loss"})
    assert not explored(Space(nodes=2, losses=0))[1]


class Walker:
    """Nodes that are never restored execute the steps of an exploration, in time that passes."""

    def __init__(self, search: Search) -> None:
        self.search, self.space = search, search.space
        self.now = self.creations = 0
        self.bearers = [Bearer(search.cores.ids[role]) for role in search.roles]
        self.nodes = [self.fresh(node) for node in range(self.space.nodes)]
        self.ahead = [False] * self.space.nodes

    def fresh(self, node: int) -> Vardis:
        cores = self.search.cores
        config = NodeConfig(
            node_id=cores.ids[self.search.roles[node]],
            codec=cores.codec,
            srp=None,
            vardis=cores.proposal.settings(self.space.vardis),
            readings=cores.proposal.readings,
        )
        made = cores.proposal.core(config, self.bearers[node])
        made.start(self.now, 0)
        return made

    def take(self, step: Step) -> bool:
        """Execute a step; returns whether the node accepts it."""
        node, wall = self.nodes[step.node], self.search.cores.wall(self.creations, self.ahead[step.node])
        entry = node.entry(VARIABLE)
        match step.kind:
            case "create":
                self.creations += 1
                wall = self.search.cores.wall(self.creations, self.ahead[step.node])
                value = f"{self.creations}.0".encode()
                rep_cnt, timeout = self.space.repetitions, self.space.timeout_ms
                served = node.create(VARIABLE, None, rep_cnt, b"v", value, timeout, now=self.now, wall=wall)
                self.creations -= not served.status.is_ok
                return served.status is VardisStatus.OK
            case "update":
                creation, _, number = b"0.0".partition(b".") if entry is None else entry.value.partition(b".")
                value = b"%s.%d" % (creation, int(number) + 1)
                return node.update(VARIABLE, value, now=self.now, wall=wall).status is VardisStatus.OK
            case "delete":
                return node.delete(VARIABLE, now=self.now, wall=wall).status is VardisStatus.OK
            case "restart":
                self.nodes[step.node] = self.fresh(step.node)
            case "clock":
                self.ahead[step.node] ^= True
            case "silence":
                self.now += round(SILENCE * self.space.timeout_ms * 1_000_000)
                for each in self.nodes:
                    each.handle_timeout(self.now, wall)
            case "beacon":
                self.bearers[step.node].payload = None
                node.payload_transmitted(self.now, wall)
                payload = self.bearers[step.node].payload
                for hearer in step.hearers if payload else ():
                    wall = self.search.cores.wall(self.creations, self.ahead[hearer])
                    self.nodes[hearer].handle_payload(payload, now=self.now, wall=wall)
        return True

    def contents(self) -> tuple[int, ...]:
        return tuple(self.search.cores.number(each.save(), self.now) for each in self.nodes)


def test_nodes_that_were_never_restored_take_the_same_transitions():
    rng = random.Random(7)
    steps = 0
    spaces = [space for space, _, _ in SPACES]
    spaces += [of(space, profile="dcp-1.3") for space in spaces if not space.silences]
    spaces += [of(SPACES[place][0], proposal="all") for place in (0, 4, 7)]
    for space in spaces:
        search, _ = explored(space)
        visited = set(search.states)
        for _ in range(6):
            walker, state = Walker(search), search.states[0]
            for _ in range(20):
                step = rng.choice(list(search.possible(state)))
                found = search.after(state, step)
                accepted = walker.take(step)
                assert accepted or found is None, step
                if found is not None:
                    state = found[0]
                    assert search.ordered(state)[0] in visited
                assert walker.contents() == state.contents, (space.bounds, step)
                steps += 1
    # As in docs/hazards.md.
    assert steps == 6 * 20 * len(spaces) == 2640


class Unordered(Search):
    """A search without the reduction of exchangeable nodes."""

    def ordered(self, state):
        return state, list(range(self.space.nodes))


def test_exchangeable_nodes_reduce_the_states_and_not_the_violations():
    space = Space(nodes=4, deletions=1)
    reduced, whole = Search(space), Unordered(space)
    first, second = reduced.run(), whole.run()
    assert first.states < second.states / 3
    assert {reduced.ordered(each)[0].contents for each in reduced.states} == {each.contents for each in reduced.states}
    assert len({reduced.ordered(each)[0].used for each in whole.states}) == len({each.used for each in reduced.states})
    assert [(each.name, each.kinds, len(each.steps)) for each in first.violations] == [
        (each.name, each.kinds, len(each.steps)) for each in second.violations
    ]


def comparable(state: VardisState) -> Any:
    """A content with creation times replaced by their order, and without the place of the values in time."""
    times = sorted(
        {each[0].creation_time or 0 for each in state.database[0]} | {time for _, time in state.delivery.created}
    )
    entries = tuple(
        (msgspec.structs.replace(spec, creation_time=times.index(spec.creation_time or 0)), *rest)
        for spec, *rest in state.database[0]
    )
    return entries, state.database[1], [(name, times.index(time)) for name, time in state.delivery.created]


@pytest.mark.part("suite")
def test_sequences_replay_with_complete_nodes(tmp_path):
    """The simulator ends with the same contents, queues and counters included."""
    for space, _, _ in SPACES:
        for profile in ("dcp-2.0", "dcp-1.3"):
            if profile == "dcp-1.3" and space.silences:
                continue
            search, _ = explored(of(space, profile=profile))
            for violation in search.violations():
                path = tmp_path / "scenario.toml"
                path.write_text(scenario_text(search, violation))
                simulation = Simulation(load_scenario(path))
                report = simulation.run()
                assert report.met, (violation, [each for each in report.findings if not each.met])
                contents = [
                    search.cores.contents[search.cores.number(simulation.network.node(node).vardis.save(), 0)]
                    for node in range(space.nodes)
                ]
                expected = [search.cores.contents[each] for each in trace(search, violation).contents]
                if not space.silences:
                    assert list(map(comparable, contents)) == list(map(comparable, expected)), violation


def test_a_sequence_as_chart_and_table():
    search, _ = explored(SPACES[0][0])
    violation = search.violations()[0]
    found = trace(search, violation)
    assert "\n".join(chart(found, 3, 39)) == CHART
    assert table(found, 3) == (
        ["#", "step", "node 0", "node 1", "node 2"],
        [
            ["1", "0: create 1.0", "1.0", "-", "-"],
            ["2", "0 sends VC 1.0 VS 0 to 1, 2", "1.0", "1.0", "1.0"],
            ["3", "0: create 2.0", "2.0", "1.0", "1.0"],
            ["4", "0 sends VC 2.0 VS 0 to no node", "2.0", "1.0", "1.0"],
            ["", "lossless rounds: 2", "2.0", "1.0", "1.0"],
        ],
    )
    for width in (24, 39, 80, 200):
        assert all(len(line) <= width for line in chart(found, 3, width))


CHART = """\
    node 0       node 1       node 2
  create 1.0       |            |
      | VC 1.0 VS 0             |
      o----------->|----------->|
      |           1.0          1.0
  create 2.0       |            |
      | VC 2.0 VS 0             |
      o-----------x|-----------x|
............lossless rounds............
      | VS 0       |            |
      o----------->|----------->|
      |            | VC 1.0 VS 0
      |<-----------o----------->|
      |            |       VC 1.0 VS 0
      |<-----------|<-----------o
      | VS 0       |            |
      o----------->|----------->|
      |            | VS 0       |
      |<-----------o----------->|
      |            |            | VS 0
      |<-----------|<-----------o"""


def test_faulty_nodes_are_found(monkeypatch):
    """A node that repeats too often, and one whose values change for ever."""
    usual = Cores.send

    def often(self, role, content):
        sent = usual(self, role, content)
        return sent._replace(content=content)

    monkeypatch.setattr(Cores, "send", often)
    assert Cores(Space())._miscounts(0, 0, -1) is False
    search = Search(Space(nodes=2))
    content = search.cores.create(0, search.cores.fresh[0], (1, 0), search.cores.wall(1, False))
    assert search.cores._miscounts(content, content, usual(search.cores, 0, content).payload)
    monkeypatch.undo()
    judge = Judge(search.cores)
    one, two = (content, search.cores.fresh[1]), (content, content)
    judge._rounds |= {one: (two, False), two: (one, False)}
    assert judge.settled(one, search.states[0].intent) == ("unstable",)


def test_a_proposal_without_a_flag_has_the_normal_node():
    for each in PROPOSALS.values():
        cores = Cores(Space(proposal=each.name))
        changed = each.creation_times or each.silent_requests or each.takes_back or each.restamps or each.first_stays
        assert isinstance(cores._cores[0], ProposedVardis) == changed


def test_invalid_spaces_are_refused(tmp_path):
    for changes, problem in (
        ({"nodes": 5}, "nodes: a network has 2 to 4 nodes, not 5"),
        ({"producers": 4}, "producers: 1 to 3 nodes may create the variable, not 4"),
        ({"updates": -1}, "updates: must be at least 0, not -1"),
        ({"rounds": 0}, "rounds: must be at least 1, not 0"),
        ({"losses": -1}, "losses: must be at least 0, not -1"),
    ):
        with pytest.raises(SpaceError, match=problem):
            check(Space(**changes))
    path = tmp_path / "space.toml"
    path.write_text("nodes = 2\n[vardis]\nseqno_modulus = 4\n")
    assert load_space(path) == Space(nodes=2, vardis=WRAPPING)
    path.write_text("node = 2")
    with pytest.raises(SpaceError, match=r"space\.toml: Object contains unknown field `node`"):
        load_space(path)
    with pytest.raises(ValueError, match="unknown 'none'; the proposals are creation-times, "):
        Search(Space(proposal="none"))
    with pytest.raises(ValueError, match="the proposals change version"):
        Search(Space(profile="dcp-1.3", proposal="deletions"))
    with pytest.raises(ValueError, match=r"seqno_modulus must be in 2\.\.256, not 300"):
        Search(Space(vardis=VardisConfig(seqno_modulus=300)))
