"""Factories of mutants: a row changes one method or property of a part, and keeps what other rows have changed."""

from __future__ import annotations

import pytest
from dcp_selftest.mutants.family import after, around, assign, attributes, before, crashes, instead, skips, then


class Counter:
    step = 1

    def __init__(self) -> None:
        self.total = 0
        self.seen: list[int] = []

    @property
    def limit(self) -> int:
        return 10

    def add(self, number: int) -> int:
        self.total += number * self.step
        return self.total

    def note(self, number: int) -> None:
        self.seen.append(number)


@pytest.mark.parametrize(
    ("part", "returned", "total"),
    [
        (instead(Counter, Counter.add).part(lambda self, number: 7), 7, 0),
        (after(Counter, Counter.add).part(lambda self, result, number: result + number), 10, 5),
        (around(Counter, Counter.add).part(lambda self, proceed, number: proceed(number + 1)), 6, 6),
        (before(Counter, Counter.add).part(lambda self, number: assign(self, total=100)), 105, 105),
        (then(Counter, Counter.add).part(lambda self, result, number: assign(self, total=0)), 5, 0),
        (crashes(Counter, Counter.add, IndexError()).part(lambda self, number: number > 5), 5, 5),
        (attributes(Counter, __name__).part(step=2), 10, 10),
    ],
)
def test_a_row_changes_a_method(part: type[Counter], returned: int, total: int):
    made = part()
    assert (made.add(5), made.total) == (returned, total)


def test_a_row_can_skip_a_call_crash_or_change_a_property():
    made = skips(Counter, Counter.note).part(lambda self, number: number % 2 == 0)()
    for number in range(4):
        made.note(number)
    assert made.seen == [1, 3]
    with pytest.raises(IndexError, match="past the end"):
        crashes(Counter, Counter.add, IndexError("past the end")).part(lambda self, number: True)().add(1)
    assert after(Counter, Counter.limit).part(lambda self, limit: limit * 2)().limit == 20
    assert instead(Counter, Counter.limit).part(lambda self: 3)().limit == 3


def test_rows_of_one_part_can_be_combined():
    more = after(Counter, Counter.add).part(lambda self, result, number: result + 1)
    twice = around(Counter, Counter.add).part(lambda self, proceed, number: proceed(2 * number))
    assert type("Both", (more, twice), {})().add(5) == 11
