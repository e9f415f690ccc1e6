"""Inference of links if the recorder misses beacons: a beacon that it missed may be the cause of a reaction."""

from __future__ import annotations

import pytest
from dcp_conformance.check.reception.unrecorded import Unrecorded, silent_senders

from dcp_codec.values import VarReqCreate, VarSumm, VarUpdate

from ..air import Script, findings, judged

A, B, C = 1, 2, 3


def line(*, missed: bool) -> Script:
    """A recording in which node C never answers the requests of node A, and stores each value that A sends.

    ``missed``: between both, node B forwards the values, and the recorder misses its beacons. Otherwise B does not know
    the variable, so that C must have received the values from A.
    """
    air = Script()
    create, own = air.create(7, C), air.create(100, A)
    air.say(A, own)
    air.say(B, *([own] if missed else []), VarSumm(50, 0))
    air.say(C, create, own)
    for number in range(1, 21):
        values = (VarSumm(100, number - 1),)
        for place in range(4):
            if place == 2:
                values = (VarUpdate(100, number, b"v"),)
            air.say(A, *values, VarReqCreate(7))
            air.say(B, *(values if missed else []), VarSumm(50, 0))
            if missed and place == 2:
                air.frames.pop()
            if place == 2:
                values = (VarSumm(100, number),)
            air.say(C, *values, VarSumm(7, 0))
    return air


@pytest.mark.parametrize("missed", [True, False])
def test_a_reaction_that_a_missed_beacon_may_have_caused_does_not_prove_a_link(missed: bool) -> None:
    run = judged(line(missed=missed).frames, "dcp-2.0")
    found = [each for each in findings(run) if "VD_ANSWER_CREATE" in each]
    assert bool(found) is not missed, found


MS, NODE, OTHER = 1_000_000, 1, 2


def test_a_gap_counts_from_the_beacon_before_it_to_the_one_after_it() -> None:
    missed = Unrecorded()
    missed.gap(NODE, 1000 * MS, 1300 * MS)
    missed.gap(OTHER, 1200 * MS, 1500 * MS)
    timeline = missed.timeline([])
    assert silent_senders(timeline, 0, 1000 * MS) == 0
    assert silent_senders(timeline, 900 * MS, 1100 * MS) == NODE
    assert silent_senders(timeline, 1100 * MS, 1400 * MS) == NODE | OTHER
    assert silent_senders(timeline, 1300 * MS, 1400 * MS) == OTHER
    assert silent_senders(timeline, 1500 * MS, 9000 * MS) == 0


def test_a_node_that_is_off_sends_nothing() -> None:
    """It stops after its beacon at 1000 ms, and its first recorded beacon after the restart has another before it."""
    missed = Unrecorded()
    missed.restart(NODE, 1000 * MS, 900 * MS, 1, 5000 * MS)
    timeline = missed.timeline([])
    assert silent_senders(timeline, 1050 * MS, 1100 * MS) == NODE
    assert silent_senders(timeline, 1200 * MS, 4000 * MS) == 0
    assert silent_senders(timeline, 4000 * MS, 4500 * MS) == NODE


def test_the_next_beacon_may_be_missed_until_it_is_recorded() -> None:
    timeline = Unrecorded().timeline([(NODE, 1000 * MS, 900 * MS), (OTHER, 1000 * MS, 1000 * MS)])
    assert silent_senders(timeline, 1000 * MS, 1100 * MS) == NODE
    assert silent_senders(timeline, 1200 * MS, 1300 * MS) == 0


def test_gaps_that_ended_are_forgotten_and_adjacent_ones_are_one() -> None:
    missed = Unrecorded()
    for begin in range(10):
        missed.gap(NODE, begin * MS, (begin + 1) * MS)
    assert missed.timeline([]) == ([0, 10 * MS], [NODE, 0])
    missed.forget(11 * MS)
    assert missed.timeline([]) == ([0], [0])
