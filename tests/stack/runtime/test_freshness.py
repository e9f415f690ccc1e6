"""How long a value takes per hop: half a beacon period, whatever else is in the beacons (X54)."""

from __future__ import annotations

import random

import pytest
from dcp_lab.sim.virtual.network import Network

from dcp_codec.codec import get_codec
from dcp_stack.config import BPConfig, VardisConfig
from dcp_stack.effects import VariableChanged
from dcp_stack.virtual.topology import Line

SECOND = 1_000_000_000
PERIOD = SECOND // 10
HOPS = 6


def mean_delay(jitter: float, summaries: int, *, lines: int = 14, updates: int = 3, lead_ms: float = 0.0) -> float:
    """The mean time in beacon periods per hop that updates take over a line without losses."""
    delays: list[int] = []
    for seed in range(lines):
        vardis = VardisConfig(max_summaries=summaries, max_repetitions=1, compose_lead_ms=lead_ms)
        net = Network(
            HOPS + 1,
            get_codec("dcp-2.0"),
            seed=seed,
            topology=Line(),
            bp=BPConfig(jitter=jitter),
            vardis=vardis,
        )
        rng = random.Random(seed)
        for index in range(HOPS + 1):
            net.at(rng.randrange(PERIOD), lambda net=net, index=index: net.start(index))
        net.run_until(2 * PERIOD)
        net.call(0, lambda node, now, wall: node.vardis.create(1, None, 1, b"value", b"0", now=now, wall=wall))
        net.run_until(2 * SECOND)
        born: dict[bytes, int] = {}

        def changed(time: int, index: int, effect: VariableChanged, born: dict[bytes, int] = born) -> None:
            if effect.event == "updated" and index == HOPS:
                delays.append(time - born[effect.value])

        net.listen(VariableChanged, changed)
        for number in range(updates):
            net.run_until(net.now + SECOND + rng.randrange(PERIOD))
            value = str(number).encode()
            born[value] = net.now
            net.call(0, lambda node, now, wall, value=value: node.vardis.update(1, value, now=now, wall=wall))
        net.run_until(net.now + SECOND)
    assert len(delays) == lines * updates
    return sum(delays) / len(delays) / PERIOD / HOPS


@pytest.mark.part("suite")
@pytest.mark.req("VD-RUN-01")
@pytest.mark.req("VD-RUN-02")
@pytest.mark.parametrize("jitter", [0.0, 0.1])
@pytest.mark.parametrize("summaries", [0, 20])
def test_a_value_takes_half_a_beacon_period_per_hop(jitter: float, summaries: int) -> None:
    assert mean_delay(jitter, summaries) == pytest.approx(0.5, abs=0.05)


@pytest.mark.req("VD-RUN-01")
def test_a_lead_costs_its_share_of_the_period() -> None:
    # Composed 30 ms ahead, a third of the values that arrive wait for another beacon.
    assert mean_delay(0.1, 20, lead_ms=30.0) == pytest.approx(0.8, abs=0.06)
