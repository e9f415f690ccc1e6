"""The generator's own draws are those of ``random.Random``: seeds of earlier campaigns keep their meaning."""

from __future__ import annotations

import random

import pytest
from dcp_lab.testing.draws import Draws

ENDS = (1, 2, 3, 4, 5, 7, 8, 9, 60, 255, 256, 257, 1 << 16, (1 << 32) - 1, 1 << 32, (1 << 64) + 1)


def test_draws_equal_those_of_random() -> None:
    rng, twin = random.Random(7), random.Random(7)
    chance = Draws(rng)
    for end in ENDS * 20:
        assert chance.below(end) == twin.randrange(end)
        members = range(min(end, 1000))
        assert chance.one_of(members) == twin.choice(members)
        # Draws from the generator itself in between are not disturbed.
        assert rng.random() == twin.random()


@pytest.mark.parametrize("end", [0, -1])
def test_an_empty_range_is_refused(end: int) -> None:
    with pytest.raises(ValueError, match="cannot draw"):
        Draws(random.Random(1)).below(end)


def test_an_empty_sequence_is_refused() -> None:
    with pytest.raises(ValueError, match="cannot choose"):
        Draws(random.Random(1)).one_of(())
