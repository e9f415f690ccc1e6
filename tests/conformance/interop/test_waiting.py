"""How long cells wait: long enough for a busy machine, and once for a station that never gets there."""

from __future__ import annotations

import pytest
from dcp_conformance.definitions.verdict import Verdict
from dcp_lab.interop import cell as cells
from dcp_lab.interop.bounds import cycle_time, expected_time, spreading_time, time_through_outages
from dcp_lab.interop.cell import Cell, run_cell
from dcp_lab.interop.definition import all_tests
from dcp_lab.interop.implementations import built_in, virtual_setup
from dcp_lab.interop.nodes.real import RealWorld
from dcp_lab.interop.nodes.virtual import VirtualWorld
from dcp_lab.interop.world import Limits

from ...parts import every

NODE = built_in("node:dcp-2.0")
#: Seconds that a two-node cell may wait for a station that never gets there.
LONGEST = 150.0


class Unreachable(VirtualWorld):
    """Places that never hear each other, with the patience of the world in real time."""

    patience = RealWorld.patience
    most_backlog = RealWorld.most_backlog

    def __init__(self, *arguments) -> None:
        super().__init__(*arguments)
        super().partition([[place.number] for place in self.places])

    def partition(self, groups) -> None:
        """Nothing changes."""


def unreachable(cell: Cell, test) -> VirtualWorld:
    setups = [("node", *virtual_setup(NODE, "dcp-2.0")) for _ in test.shape.roles]
    return Unreachable(setups, test.shape, cell.seed)


@pytest.mark.parametrize("name", every(9, [name for name, test in all_tests().items() if test.shape.name == "pair"]))
def test_an_unreachable_station_costs_one_bounded_wait(name: str, monkeypatch) -> None:
    monkeypatch.setattr(cells, "_world", unreachable)
    result = run_cell(Cell(a="a", b="b", test=name, implementations=(NODE, NODE)), all_tests()[name])
    assert result.verdict is Verdict.FAIL, result.reason
    waits = [each for each in result.spreads if each.took is None]
    assert len(waits) == 1
    assert waits[0].limit < LONGEST
    assert result.duration_s < LONGEST


@pytest.mark.parametrize("loss", [0.0, 0.1, 0.3, 0.5, 0.75])
def test_the_average_is_below_the_bound_and_equal_to_it_without_loss(loss: float) -> None:
    limits = Limits()
    bound, expected = spreading_time(2, loss, 4, limits), expected_time(2, loss, 4, limits)
    assert expected <= bound
    assert (expected == bound) is (loss == 0)


@pytest.mark.parametrize(("period", "check"), [(100, 50), (500, 50), (50, 500), (20, 10)])
def test_a_link_with_outages_is_up_for_an_attempt(period: float, check: float) -> None:
    limits = Limits(beacon_period_ms=period, buffer_check_ms=check)
    up, down = cycle_time(limits)
    assert up * 1000 >= 8 * period + 2 * check
    bound, expected = time_through_outages(1, limits)
    assert bound - 1 == pytest.approx(4 * (up + down))
    assert expected < bound
