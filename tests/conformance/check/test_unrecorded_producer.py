"""The rule of repetitions, if a node that may have asked for instructions is not in the recording."""

from __future__ import annotations

import pytest
from dcp_conformance.definitions.verdict import Verdict

from dcp_codec.values import VarSumm

from ..air import Script, case_of, judged

PRODUCER, RELAY = 1, 2


def repeating(*, heard: bool) -> Script:
    """A recording in which a relay sends the creates of another node's variables in six beacons each.

    ``heard``: whether the recording has a beacon of the producer.
    """
    air = Script()
    if heard:
        air.say(PRODUCER, VarSumm(99, 0))
    for number in range(8):
        create = air.create(20 + number, PRODUCER)
        for _ in range(6):
            air.say(RELAY, create)
        air.say(RELAY, VarSumm(20 + number, 0))
    for _ in range(30):
        air.say(RELAY, VarSumm(20, 0))
    return air


@pytest.mark.parametrize("heard", [True, False])
def test_a_producer_without_a_beacon_may_have_asked(heard: bool) -> None:
    air = repeating(heard=heard)
    case = case_of(judged(air.frames, air.codec.profile.name), "CK_VD_REPEAT")
    assert case.verdict is (Verdict.FAIL if heard else Verdict.INCONCLUSIVE)
