"""The order of the cells of a matrix, and the estimate before it begins."""

from __future__ import annotations

from dcp_lab.interop.definition import all_tests, select_tests
from dcp_lab.interop.implementations import resolve
from dcp_lab.interop.matrix import applicable, cells_of, forecast, in_order

PAIR = resolve(["node:dcp-2.0"], {})


def test_the_short_selection_comes_first_and_long_cells_before_short_ones() -> None:
    cells = cells_of(PAIR, select_tests(()), world="real")
    tests = [all_tests()[cells[place].test] for place in in_order(cells, range(len(cells)))]
    assert [each.short for each in tests] == sorted((each.short for each in tests), reverse=True)
    for group in (True, False):
        longest = [each.longest_s for each in tests if each.short is group]
        assert longest == sorted(longest, reverse=True)
        assert longest


def test_the_estimate_has_the_time_of_the_short_selection() -> None:
    cells = cells_of(PAIR, select_tests(()), world="real")
    tests = [all_tests()[each.test] for each in applicable(cells)]
    seconds = sum(each.longest_s for each in tests)
    short = sum(each.longest_s for each in tests if each.short)
    assert forecast(cells, 1) == (
        f"{len(tests)} cells, about {seconds:.0f} s at most; first the short selection (--short), "
        f"{sum(each.short for each in tests)} cells in about {short:.0f} s"
    )
    # The longest cell cannot be divided.
    assert f"about {max(each.longest_s for each in tests):.0f} s at most" in forecast(cells, 1000)
    only_short = cells_of(PAIR, select_tests((), short=True), world="real")
    assert "short selection" not in forecast(only_short, 1)
    assert forecast(cells_of(PAIR, select_tests(()), world="virtual")) == ""
