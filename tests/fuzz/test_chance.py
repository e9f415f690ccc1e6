"""The generator's own draws are those of ``random.Random``: seeds of earlier campaigns go on showing the same."""

from __future__ import annotations

import random

import pytest

from dcp_codec.testing.draws import Draws

ENDS = (1, 2, 3, 4, 5, 7, 8, 9, 60, 255, 256, 257, 1 << 16, (1 << 32) - 1, 1 << 32, (1 << 64) + 1)


def test_draws_what_random_draws() -> None:
    rng, twin = random.Random(7), random.Random(7)
    chance = Draws(rng)
    for end in ENDS * 20:
        assert chance.below(end) == twin.randrange(end)
        members = range(min(end, 1000))
        assert chance.one_of(members) == twin.choice(members)
        # Who draws from the generator itself in between is not disturbed.
        assert rng.random() == twin.random()


@pytest.mark.parametrize("end", [0, -1])
def test_no_number_is_refused(end: int) -> None:
    with pytest.raises(ValueError, match="cannot draw"):
        Draws(random.Random(1)).below(end)


def test_no_member_is_refused() -> None:
    with pytest.raises(ValueError, match="cannot choose"):
        Draws(random.Random(1)).one_of(())
