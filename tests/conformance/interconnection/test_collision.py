"""Two nodes with one identifier show by their sequence numbers; one node does not, whatever it is like."""

from __future__ import annotations

import pytest
from dcp_conformance.interconnection.collision import interleaved

MODULUS = 1 << 32


@pytest.mark.parametrize(
    "numbers",
    [
        [5, 80, 6, 81, 7, 82],
        [80, 5, 6, 81, 82, 7, 83, 8],
        [0, 0, 1, 1, 2, 2],
        [5, 80, 7, 83, 9, 84],
        [MODULUS - 2, 80, MODULUS - 1, 81, 0, 82],
    ],
    ids=["alternating", "in any order", "begun together", "with losses", "wrapping"],
)
def test_two_nodes(numbers):
    assert interleaved(numbers, MODULUS)


@pytest.mark.parametrize(
    "numbers",
    [
        [5, 6, 7, 9, 10, 14],
        [70, 71, 72, 0, 1, 2, 3],
        [1, 2, 3, 0, 1, 2, 3, 4],
        [1, 2, 3, 0, 1, 2, 4, 5, 6],
        [7, 7, 7, 7, 7, 7],
        [9, 8, 7, 6, 5, 4],
        [17, 4, 99, 3, 58, 21, 33],
        [5, 80, 6, 81],
    ],
    ids=[
        "with losses",
        "restarted",
        "old numbers reached",
        "and passed",
        "constant",
        "descending",
        "random",
        "too few",
    ],
)
def test_one_node(numbers):
    assert not interleaved(numbers, MODULUS)
