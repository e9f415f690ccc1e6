"""A small fixed draw of the trials of `check`: networks without a fault, and mutants in the middle of a network."""

from __future__ import annotations

from typing import Literal

import pytest
from dcp_conformance.reference.inprocess import plain_node
from dcp_selftest.mutants import all_mutants
from dcp_selftest.recordings import clean, faulty, situation
from dcp_selftest.recordings.networks import NetworkSituation, Other, identifier, record
from dcp_selftest.recordings.table import document

from ..conformance.air import case_of, findings, judged
from ..parts import also

#: Networks of the fixed draw: together all shapes, and losses, restarts, variants.
DRAW = (0, 3, 5, 6, 7, 11)


@pytest.mark.part("suite")
def test_networks_without_a_fault_have_no_findings():
    result = clean(DRAW)
    assert result.false == ()
    assert result.networks == len(DRAW)
    assert {situation(number).shape for number in range(16)} == {"bus", "line", "grid", "moving"}


def test_the_same_network_is_the_same_recording():
    case = NetworkSituation(seconds=5.0, restarts=True, clocks=True, shape="moving")
    assert record(case) == record(case)


def test_links_of_a_line_are_those_of_neighbours():
    run = judged(record(NetworkSituation(shape="line", seconds=80.0, busy=1.0, seed=3)), "dcp-2.0")
    assert findings(run) == []
    told = [each.observed for each in case_of(run, "CK_NET_HEARS").checks if " hears " in each.observed]
    names = [identifier("dcp-2.0", index).hex(":") for index in range(5)]
    for index, who in enumerate(names):
        (line,) = [each for each in told if each.startswith(f"{who} hears")]
        heard = line.partition("; too little")[0].partition(" hears ")[2]
        near = {names[other] for other in (index - 1, index + 1) if 0 <= other < 5}
        assert {each for each in names if each in heard} <= near, line
        assert near & {each for each in names if each in heard}, line


@pytest.mark.parametrize(
    ("name", "shape", "rule"),
    [
        ("M-VD-PD-04-ignored", "bus", "CK_VD_TAKES_DELETE"),
        *also("suite", ("M-VD-PU-07-ignored", "line", "CK_VD_TAKES_UPDATE")),
    ],
)
def test_a_faulty_node_in_a_network_is_found_with_its_requirement(name: str, shape: Literal["bus", "line"], rule: str):
    result = faulty([all_mutants()[name]], shapes=[shape])
    (outcome,) = result.outcomes
    assert (outcome.fate, rule in outcome.rules) == ("found", True), outcome
    text = document(result, clean(DRAW[:1]))
    assert f"| {name} |" in text
    assert "1 networks" in text


@pytest.mark.part("suite")
@pytest.mark.parametrize(
    ("name", "shape", "why"),
    [
        ("M-VD-CMP-06-no-rotation", "bus", ("check has no rule about VD-CMP-06", "beacons differ, the first, frame ")),
        *also("suite", ("M-VD-PD-02-again", "bus", ("records: ", " -> "))),
    ],
)
def test_a_faulty_node_that_is_not_found_has_its_reason(name: str, shape: Literal["bus", "line"], why: tuple[str, ...]):
    result = faulty([all_mutants()[name]], shapes=[shape])
    (outcome,) = result.outcomes
    assert outcome.fate == "missed"
    assert [each for each in why if each not in outcome.text] == [], outcome.text
    assert outcome.text in document(result, None)


def test_replacing_a_mutant_by_our_node_changes_nothing_else():
    case = NetworkSituation(seconds=4.0)
    assert record(case, {2: Other(plain_node)}) == record(case)
    assert record(case, {2: Other(all_mutants()["M-BP-FMT-01-checksum-in-length"].make)}) != record(case)


def test_an_application_continues_after_an_error_of_its_node():
    """A faulty node may answer a valid request with a JSON-RPC error."""

    def refusing(config, rng, now, wall):
        node = plain_node(config, rng, now, wall)
        real = node.vardis.update

        def update(var_id, value, **times):
            if var_id % 2:
                raise ValueError("refused by a faulty node")
            return real(var_id, value, **times)

        node.vardis.update = update
        return node

    assert record(NetworkSituation(seconds=20.0, busy=1.0, seed=3), {2: Other(refusing)})
