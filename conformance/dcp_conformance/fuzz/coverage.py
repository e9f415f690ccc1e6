"""What a campaign has reached: fields by class of value, and states of variables by kind of message."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable

import msgspec


class Pair(msgspec.Struct, frozen=True):
    """A row of a table: what, in which class, how often."""

    what: str
    how: str
    count: int


class Coverage(msgspec.Struct):
    """Both tables. ``possible``: how many pairs of field and class the pool allows."""

    fields: list[Pair] = []
    states: list[Pair] = []
    possible: int = 0
    missing: list[str] = []
    """Those that were not reached."""
    possible_states: int = 0
    """How many pairs of state and message there are; 0 if they were not counted."""
    missing_states: list[str] = []
    lines: int = 0
    """Lines of the target that were run, if they were counted."""


def tables(
    fields: Counter[tuple[str, str]],
    states: Counter[tuple[str, str]],
    possible: Collection[tuple[str, str]],
    lines: int = 0,
    possible_states: Collection[tuple[str, str]] = (),
) -> Coverage:
    """The tables of counters."""
    return Coverage(
        list(_pairs(fields)),
        list(_pairs(states)),
        len(possible),
        sorted(f"{what or 'message'} {how}" for what, how in possible if not fields[what, how]),
        len(possible_states),
        sorted(f"{what}: {how}" for what, how in possible_states if not states[what, how]),
        lines,
    )


def _pairs(counter: Counter[tuple[str, str]]) -> Iterable[Pair]:
    for (what, how), count in sorted(counter.items()):
        if count:
            yield Pair(what, how, count)


def shown(coverage: Coverage, *, most: int = 40) -> list[str]:
    """The tables as lines of text: each field with the classes that it had, each state with its messages."""
    lines: list[str] = []
    if coverage.possible:
        reached = coverage.possible - len(coverage.missing)
        lines.append(f"field x class of value: {reached} of {coverage.possible} pairs")
        lines += _grouped(coverage.fields, most)
        lines += _not_reached(coverage.missing)
    if coverage.possible_states:
        reached = coverage.possible_states - len(coverage.missing_states)
        lines.append(f"state of a variable x message: {reached} of {coverage.possible_states} pairs")
        lines += _grouped(coverage.states, most)
        lines += _not_reached(coverage.missing_states)
    if coverage.lines:
        lines.append(f"lines of the target: {coverage.lines}")
    return lines


def _not_reached(missing: list[str]) -> list[str]:
    more = f" and {len(missing) - 8} more" if len(missing) > 8 else ""
    return [f"  not reached: {', '.join(missing[:8])}{more}"] if missing else []


def _grouped(pairs: Iterable[Pair], most: int) -> list[str]:
    rows: dict[str, list[str]] = {}
    for pair in pairs:
        rows.setdefault(pair.what or "(message)", []).append(f"{pair.how} {pair.count}")
    lines = [f"  {what}: {', '.join(classes)}" for what, classes in rows.items()]
    return lines if len(lines) <= most else [*lines[:most], f"  ... and {len(lines) - most} more"]
