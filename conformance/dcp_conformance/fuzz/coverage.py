"""What a campaign has reached: fields by class of value, and states of variables by kind of message."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable

import msgspec

#: States of a variable and the messages that are told apart in each.
STATES = ("unknown", "alive own", "alive foreign", "deleted own", "deleted foreign")


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
    lines: int = 0
    """Lines of the target that were run, if they were counted."""


def tables(
    fields: Counter[tuple[str, str]],
    states: Counter[tuple[str, str]],
    possible: Collection[tuple[str, str]],
    lines: int = 0,
) -> Coverage:
    """The tables of counters."""
    return Coverage(
        list(_pairs(fields)),
        list(_pairs(states)),
        len(possible),
        sorted(f"{what or 'message'} {how}" for what, how in possible if not fields[what, how]),
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
        if coverage.missing:
            more = f" and {len(coverage.missing) - 8} more" if len(coverage.missing) > 8 else ""
            lines.append(f"  not reached: {', '.join(coverage.missing[:8])}{more}")
    if coverage.states:
        lines.append(f"state of a variable x message: {len(coverage.states)} pairs")
        lines += _grouped(coverage.states, most)
    if coverage.lines:
        lines.append(f"lines of the target: {coverage.lines}")
    return lines


def _grouped(pairs: Iterable[Pair], most: int) -> list[str]:
    rows: dict[str, list[str]] = {}
    for pair in pairs:
        rows.setdefault(pair.what or "(message)", []).append(f"{pair.how} {pair.count}")
    lines = [f"  {what}: {', '.join(classes)}" for what, classes in rows.items()]
    return lines if len(lines) <= most else [*lines[:most], f"  ... and {len(lines) - most} more"]
