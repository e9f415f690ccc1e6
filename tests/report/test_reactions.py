"""Reactions between nodes are inferred from the values that they forward: lines, buses, losses, late composers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from dcp_tables.report import analysis, reactions, variables
from dcp_tables.report.chapter import chapter
from dcp_tables.report.recorded import Recorded, gather

from .flights import CAPTURES, OTHER, VARDIS, Container, Payload, Sent, create, gathered, name, record, update


def flight(path: Path, hears: dict[int, set[int]], *, late: int = 0, loss: float = 0.0, many: int = 80) -> Recorded:
    """Nodes that send beacons ten times a second, each time in another order, and forward records that they hear.

    Node 1 and the last one produce. ``late`` beacons are composed that long before they are sent.
    """
    chance = np.random.default_rng(7)
    nodes = sorted(hears)
    ends = {1: nodes[0], 2: nodes[-1]}
    level = {node: {1: -1, 2: -1} for node in nodes}
    composed: dict[int, list[dict[int, int]]] = {node: [{}] * late for node in nodes}
    told: dict[int, dict[int, int]] = {node: {} for node in nodes}
    sent: list[Sent] = []
    for turn in range(many * 10):
        for place, node in enumerate(chance.permutation(nodes).tolist()):
            for variable, producer in ends.items():
                if producer == node and turn % 10 == 3 * variable:
                    level[node][variable] += 1
            new = {each: number for each, number in level[node].items() if told[node].get(each, -1) != number}
            told[node] = dict(level[node])
            composed[node].append(new)
            content = composed[node].pop(0)
            records = [
                create(each, ends[each], b"a") if number == 0 else update(each, number % 256, b"a")
                for each, number in sorted(content.items(), key=lambda item: item[1] > 0)
            ]
            kinds = {payload.vardis[0].ic_type: () for payload in records}
            for payload in records:
                kinds[payload.vardis[0].ic_type] += payload.vardis[0].records
            vardis = tuple(Container(kind, found) for kind, found in kinds.items())
            sent.append(
                (turn / 10 + place * 0.1 / len(nodes), node, turn, (Payload(VARDIS, vardis),) if vardis else OTHER)
            )
            for other in nodes:
                if node in hears[other] and chance.random() >= loss:
                    for each, number in content.items():
                        level[other][each] = max(level[other][each], number)
    return gathered(record(path / "a.pcap", sent))


def shares(recorded: Recorded, nodes: list[int]) -> dict[tuple[int, int], float | None]:
    places = [recorded.nodes.index(name(node)) for node in nodes]
    found = reactions.reactions(recorded, variables.transmissions(recorded), places)
    many = range(len(nodes))
    return {(nodes[a], nodes[b]): found.share(a, b) for a in many for b in many if a != b}


LINE = {1: {2}, 2: {1, 3}, 3: {2, 4}, 4: {3, 5}, 5: {4}}


def test_a_line(tmp_path):
    found = shares(flight(tmp_path, LINE), [*LINE])
    for (node, other), share in found.items():
        if other in LINE[node]:
            assert share is None or share > 0.9
        else:
            assert not share, (node, other)
    assert sum(share is not None and share > 0.9 for share in found.values()) >= 6


def test_a_line_with_losses(tmp_path):
    """The difference to 1 is the loss between the two nodes; the others still do not react."""
    found = shares(flight(tmp_path, LINE, loss=0.3, many=300), [*LINE])
    for (node, other), share in found.items():
        if other not in LINE[node]:
            assert share is None or share <= reactions.DEAF
    assert found[2, 1] == pytest.approx(0.7, abs=0.12)


def test_nodes_that_compose_a_beacon_ahead(tmp_path):
    """Nodes react one beacon later, which does not count as a reaction to the latest sender."""
    bus = {1: {2, 3}, 2: {1, 3}, 3: {1, 2}}
    found = shares(flight(tmp_path, bus, late=1), [1, 2, 3])
    assert found[2, 1] == found[3, 1] == pytest.approx(1, abs=0.05)
    assert found[1, 3] == pytest.approx(1, abs=0.05)


def test_the_recording_of_a_bus():
    recorded = gather(str(CAPTURES / "a_bus3.mcap"), "cpp-2.0", None)
    found = shares(recorded, [1, 2, 3])
    assert found[1, 2] == found[2, 1] == 1
    assert found[3, 1] > 0.95
    assert found[3, 2] == 1
    # Node 3 produces nothing, so no node could learn anything from it alone.
    assert found[1, 3] is None
    assert found[2, 3] is None


def test_too_few_beacons(tmp_path):
    sent = [(0.0, 1, 0, (create(7, 1, b"a"),)), (0.1, 2, 0, (create(7, 1, b"a"),)), (0.2, 2, 1, (create(7, 1, b"a"),))]
    assert set(shares(gathered(record(tmp_path / "a.pcap", sent)), [1, 2]).values()) == {None}


def test_the_page_of_a_line_shows_no_impossible_neighbours(tmp_path):
    recorded = flight(tmp_path, LINE)
    section = next(each for each in chapter(recorded).sections if each.title == "Reactions between nodes")
    (matrix,) = section.tables
    heads = [cell.text for cell in matrix.heads[1:]]
    for row in matrix.rows:
        node = int(row[0].text[-1])
        for head, cell in zip(heads, row[1:], strict=True):
            if cell.text.startswith("●"):
                assert int(head[-1]) in LINE[node]
    assert "Reacts: …00:01 to …00:02; …00:02 to …00:01" in section.words[0]


def test_a_report_without_variables(tmp_path):
    recorded = gathered(record(tmp_path / "a.pcap", []))
    assert not reactions.reactions(recorded, variables.transmissions(recorded), []).trials.any()
    assert analysis.time_of(recorded).duration == 0
