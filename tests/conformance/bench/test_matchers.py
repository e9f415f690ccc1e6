"""Matchers: the form of a statement decides whether a failure is shown, or something is missing."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
from dcp_conformance.definitions.results import Check
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.errors import StopCase
from dcp_conformance.test_system.judgement.matchers import Matchers, part_of
from dcp_spec.constants import ICType
from hypothesis import given
from hypothesis import strategies as st

from dcp_codec.values import VarDelete, VarSumm

from .parts import PERIOD, Parts

Statement = Callable[[Matchers], object]

HOLD: dict[str, Statement] = {
    "some": lambda m: m.some([1], "one"),
    "required": lambda m: m.required(1, "one"),
    "complete": lambda m: m.complete([], "all"),
    "none": lambda m: m.none([], "none"),
    "every": lambda m: m.every([1, 2], lambda each: each > 0, "positive"),
    "every value": lambda m: m.every([], 1, "1"),
    "answered": lambda m: m.answered(1, 1, "number"),
    "fields": lambda m: m.fields({"a": 1, "b": 2}, a=1, b=2),
    "proved": lambda m: m.proved(True, "so"),
    "equal": lambda m: m.equal(0, 0, "number"),
    "only": lambda m: m.only("ba", "ab", "a and b"),
    "in order": lambda m: m.in_order("ab", "ab", "a, b"),
    "repeated": lambda m: m.repeated([1, 1], 2, "times"),
    "repeated up to": lambda m: m.repeated(3, 2, "times", most=3),
    "repeated at least": lambda m: m.repeated(9, 2, "times", most=math.inf),
    "within": lambda m: m.within(2, 1, 3, "number", late="either"),
}
SHOWN: dict[str, Statement] = {
    "none": lambda m: m.none([1], "none"),
    "every": lambda m: m.every([1, -1], lambda each: each > 0, "positive"),
    "every value": lambda m: m.every([1, 2], 1, "the number"),
    "answered": lambda m: m.answered(2, 1, "number"),
    "answered without": lambda m: m.answered(None, 1, "number"),
    "fields": lambda m: m.fields({"a": 1}, a=1, b=2),
    "proved": lambda m: m.proved(False, "so", "not so"),
    "equal": lambda m: m.equal(2, 1, "number"),
    "only another": lambda m: m.only("abc", "ab", "a and b"),
    "only twice": lambda m: m.only("aab", "ab", "a and b"),
    "in order": lambda m: m.in_order("ba", "ab", "a, b"),
    "in order twice": lambda m: m.in_order("abb", "ab", "a, b"),
    "repeated": lambda m: m.repeated([1, 1], 1, "times"),
    "repeated up to": lambda m: m.repeated(4, 2, "times", most=3),
    "within, early": lambda m: m.within(0, 1, 3, "number", late="above"),
    "within, above": lambda m: m.within(4, 1, 3, "number", late="below"),
    "within, neither": lambda m: m.within(4, 1, 3, "number", late="neither"),
}
MISSING: dict[str, Statement] = {
    "some": lambda m: m.some([], "one"),
    "complete": lambda m: m.complete([1], "all"),
    "none, not received": lambda m: m.none([1], "none", given=[]),
    "every, not received": lambda m: m.every([1], 2, "two", given=None),
    "equal": lambda m: m.equal(None, 1, "number"),
    "equal, not received": lambda m: m.equal(2, 1, "number", given=()),
    "only": lambda m: m.only("a", "ab", "a and b"),
    "in order": lambda m: m.in_order("b", "ab", "a, b"),
    "repeated": lambda m: m.repeated([], 1, "times"),
    "within, late": lambda m: m.within(4, 1, 3, "number", late="above"),
    "within, either": lambda m: m.within(0, 1, 3, "number", late="either"),
}


def check_of(statement: Statement, parts: Parts | None = None) -> Check:
    parts = parts or Parts()
    statement(Matchers(parts.verdicts))
    return parts.verdicts.checks[-1]


def test_a_statement_that_holds_passes():
    assert {name: check_of(each).verdict for name, each in HOLD.items()} == dict.fromkeys(HOLD, Verdict.PASS)


def test_received_data_show_a_fault_even_after_losses():
    for name, each in SHOWN.items():
        assert check_of(each).shown, name
        parts = Parts()
        parts.link.dropped = 1
        assert check_of(each, parts).verdict is Verdict.FAIL, name


def test_losses_excuse_what_is_missing():
    for name, each in MISSING.items():
        check = check_of(each)
        assert (check.verdict, check.shown) == (Verdict.FAIL, False), name
        parts = Parts()
        parts.link.dropped = 1
        assert check_of(each, parts).verdict is Verdict.INCONCLUSIVE, name


def test_after_a_delay_too_many_are_not_shown():
    parts = Parts()
    parts.steps.held(2 * PERIOD)
    assert not check_of(lambda m: m.repeated(3, 2, "times"), parts).shown
    assert check_of(lambda m: m.none([1], "none"), parts).shown


@pytest.mark.parametrize(
    "statement",
    [
        lambda m: m.required(None, "one"),
        lambda m: m.required([], "one"),
        lambda m: m.present(None, "one"),
        lambda m: m.missing("one"),
        lambda m: m.wrong("one", "two"),
        lambda m: m.none([1], "none", stop=True),
        lambda m: m.answered(2, 1, "number", stop=True),
        lambda m: m.proved(False, "so", stop=True),
        lambda m: m.equal(None, 1, "number", stop=True),
    ],
)
def test_statements_that_stop_the_case(statement: Statement):
    parts = Parts()
    with pytest.raises(StopCase):
        statement(Matchers(parts.verdicts))
    assert parts.verdicts.verdict() is Verdict.FAIL


def test_required_data_are_returned():
    matchers = Matchers(Parts().verdicts)
    assert matchers.required([1], "one") == matchers.present([1], "one") == [1]


def test_the_words_are_uniform():
    def words(statement: Statement) -> str:
        check = check_of(statement)
        return f"{check.expected} | {check.observed}"

    assert words(lambda m: m.some(None, "a beacon")) == "a beacon | none in time"
    assert words(lambda m: m.complete([3, 4], "all variables")) == "all variables | missing: 3, 4"
    assert words(lambda m: m.answered(b"\x01", b"\x02", "value")) == "value: 02 | 01"
    assert words(lambda m: m.every([1, 2, 3], 1, "the number")) == "the number: 1 | 2 (2, 3)"
    assert words(lambda m: m.repeated(1, 3, "beacons with the record")) == "beacons with the record: 3 | 1"
    assert words(lambda m: m.repeated(5, 1, "beacons", most=3)) == "beacons: 1 to 3 | 5"
    assert words(lambda m: m.within(9e6, 2e6, 5e6, "time", late="above", unit="ms")) == "time: 2 to 5 ms | 9 ms"
    assert words(lambda m: m.within(1, 2, math.inf, "size", late="neither")) == "size: at least 2 | 1"
    long = words(lambda m: m.answered(bytes(100), b"", "value"))
    assert long.endswith(f"| 100 octets, {'00' * 64}...")


def test_records_are_counted_by_kind_and_are_the_evidence():
    parts = Parts()
    parts.hear(parts.beacon(1, VarSumm(3, 1), VarSumm(4, 1), VarDelete(5)))
    [heard] = parts.heard
    check = check_of(lambda m: m.none(heard.instructions(), "no record"), parts)
    assert check.observed == "2 VarSumms, 1 VarDelete"
    assert len(check.frames) == 3
    assert check_of(lambda m: m.none(parts.heard, "silence"), parts).observed == "1 beacon"
    check = check_of(lambda m: m.one_each(heard.instructions(ICType.SUMMARIES), "one in each"), parts)
    assert (check.observed, check.shown) == ("2 VarSumms in 1 beacon", True)
    check = check_of(lambda m: m.every(heard.instructions(ICType.SUMMARIES), VarSumm(3, 1), "unchanged"), parts)
    assert "var_id=4" in check.observed


@pytest.mark.parametrize(("after", "verdict"), [(8, Verdict.PASS), (9, Verdict.FAIL)])
def test_a_gap_does_not_excuse_wrong_sequence_numbers(after: int, verdict: Verdict):
    parts = Parts()
    parts.hear(parts.beacon(7))
    parts.hear(parts.beacon(after))
    assert check_of(lambda m: m.successive(*parts.heard), parts).verdict is verdict


@given(st.lists(st.integers(0, 3)), st.lists(st.booleans(), min_size=20, max_size=20))
def test_losses_leave_a_part(whole: list[int], kept: list[bool]):
    assert part_of([each for each, keep in zip(whole, kept, strict=False) if keep], whole[:20])
