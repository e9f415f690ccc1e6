"""Inference of links if the recorder misses beacons: a beacon that it missed may be the cause of a reaction."""

from __future__ import annotations

import pytest

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
def test_a_reaction_proves_no_link_if_a_missed_beacon_may_be_its_cause(missed: bool) -> None:
    run = judged(line(missed=missed).frames, "dcp-2.0")
    found = [each for each in findings(run) if "VD_ANSWER_CREATE" in each]
    assert bool(found) is not missed, found
