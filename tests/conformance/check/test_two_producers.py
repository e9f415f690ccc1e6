"""Two nodes produce variables with the same identifier, and the recording does not show the create of one of them."""

from __future__ import annotations

import pytest

from dcp_codec.values import VarSumm, VarUpdate

from ..air import MS, Script, findings, judged

A, B, C = 1, 2, 3


@pytest.mark.parametrize("profile", ["dcp-1.3", "dcp-2.0"])
@pytest.mark.parametrize("says", [A, C])
@pytest.mark.parametrize("consumer", [False, True])
def test_a_node_with_a_newer_number_than_the_known_producer_may_be_a_producer(
    profile: str, says: int, consumer: bool
) -> None:
    """Node B stores all updates of variable 100, and does not answer older numbers of variable 7.

    ``says``: the node that sends both. ``consumer``: a create of B shows that A produces what B holds, so
    that B breaks the rule.
    """
    air = Script(profile, 100 * MS)
    create, own = air.create(7, A), air.create(100, A)
    for who in (A, C, B):
        known = () if who == B and not consumer else (create,)
        air.say(who, own, *known, VarSumm(7, 0))
    air.say(B, VarSumm(7, 5), VarUpdate(7, 5, b"own"))
    for number in range(1, 31):
        news = (VarSumm(100, number), VarUpdate(100, number, b"v"))
        for place in range(3):
            for who in (A, C):
                if who == says:
                    air.say(who, VarSumm(7, 0), *(news if not place else news[:1]))
                else:
                    air.say(who, *((VarSumm(7, 0),) if place == 1 else (VarSumm(50, 0),)))
            air.say(B, VarSumm(7, 5), *(news if not place else (VarSumm(100, number),)))
    found = [each for each in findings(judged(air.frames, profile)) if "VD_TEACH" in each]
    assert bool(found) is consumer, found
