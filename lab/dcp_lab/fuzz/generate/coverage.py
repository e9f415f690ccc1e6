"""Coverage of a campaign: fields by class of value."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable

import msgspec

from dcp_lab.testing.mutation import FIELD_CLASSES

#: Count by row and column of a table.
Cells = dict[tuple[str, str], int]
_ELEMENTS = ("twice", "drop", "reorder", "splice")
_VALUES = (*FIELD_CLASSES, "cut")
#: Names of the classes of values in the tables.
_WORDS = {
    "0": "zero", "1": "one", "max-1": "below top", "max": "top", "+1": "plus one", "-1": "minus one",
    "swapped": "bytes swapped", "bit": "bit flip", "cut": "cut off",
    "twice": "repeated", "drop": "left out", "reorder": "moved", "splice": "from another",
    "trail": "octets added", "bomb": "all counts raised",
}  # fmt: skip


class Pair(msgspec.Struct, frozen=True):
    """A cell of the table: field (``what``), class of values (``how``), and count."""

    what: str
    how: str
    count: int


class Coverage(msgspec.Struct):
    """The table. ``possible``: number of pairs of field and class that the pool of messages allows."""

    fields: list[Pair] = []
    possible: int = 0
    missing: list[str] = []
    """Pairs of field and class that were not reached."""
    lines: int = 0
    """Number of executed lines of the target; 0 if they were not counted."""


def tables(
    fields: Counter[tuple[str, str]],
    possible: Collection[tuple[str, str]],
    lines: int = 0,
) -> Coverage:
    """Return the table of these counters."""
    return Coverage(
        [Pair(what, how, count) for (what, how), count in sorted(fields.items()) if count],
        len(possible),
        sorted(f"{what or 'message'} {how}" for what, how in possible if not fields[what, how]),
        lines,
    )


def counter_of(pairs: Iterable[Pair]) -> Counter[tuple[str, str]]:
    """Return the counter from which the table was made."""
    return Counter({(pair.what, pair.how): pair.count for pair in pairs})


def shown(coverage: Coverage) -> list[str]:
    """Return the table as lines of at most 80 columns. A 0 means not reached, a blank cell an impossible pair."""
    lines: list[str] = []
    if coverage.possible:
        reached = coverage.possible - len(coverage.missing)
        lines.append(f"field x what was done to it: {reached} of {coverage.possible} pairs; how often each")
        cells = {(each.what, each.how): each.count for each in coverage.fields}
        cells |= {
            (what.removeprefix("message"), how): 0
            for what, _, how in (each.rpartition(" ") for each in coverage.missing)
        }
        lines += _fields(cells)
    if coverage.lines:
        lines.append(f"lines of the target: {coverage.lines}")
    return lines


def _fields(cells: Cells) -> list[str]:
    """Return a table for fields by structure, one for list elements, and a line for the whole message."""
    groups: dict[str, Cells] = {}
    for (path, how), count in cells.items():
        if how in _VALUES:
            structure, dot, name = path.rpartition("[].")
            groups.setdefault(structure + dot[:-1], {})[name, how] = count
    first = max((2 + len(name) for group in groups.values() for name, _ in group), default=0)
    lines = _heading(_VALUES, first)
    for structure, own in sorted(groups.items()):
        lines += [f"  {structure}"] if structure else []
        lines += [f"  {line}" for line in _rows(own, _VALUES, first - 2)]
    elements = {at: count for at, count in cells.items() if at[1] in _ELEMENTS}
    if elements:
        first = max(first, *(len(path) for path, _ in elements))
        lines += [*_heading(_ELEMENTS, first), *_rows(elements, _ELEMENTS, first)]
    whole = sorted((how, count) for (path, how), count in cells.items() if not path)
    if whole:
        lines.append(f"  whole message: {', '.join(f'{_worded(how)} {_short(count)}' for how, count in whole)}")
    return lines


def _heading(columns: tuple[str, ...], first: int) -> list[str]:
    """Return the heading of a table; names of two words take two lines."""
    words = [(_worded(column).rpartition(" "), _width(column)) for column in columns]
    upper = " " * (first + 2) + "".join(word.rjust(wide) for (word, _, _), wide in words)
    lower = " " * (first + 2) + "".join(word.rjust(wide) for (_, _, word), wide in words)
    return [upper, lower] if upper.strip() else [lower]


def _rows(cells: Cells, columns: tuple[str, ...], first: int) -> list[str]:
    lines = []
    for row in sorted({row for row, _ in cells}):
        counts = (
            _short(cells[row, each]).rjust(_width(each)) if (row, each) in cells else " " * _width(each)
            for each in columns
        )
        lines.append(f"  {row.ljust(first)}{''.join(counts)}".rstrip())
    return lines


def _width(column: str) -> int:
    return 1 + max(4, *map(len, _worded(column).split()))


def _worded(how: str) -> str:
    return _WORDS.get(how, how)


def _short(count: int) -> str:
    """Format a count in at most four characters."""
    for unit, size in (("", 1), ("k", 1_000), ("M", 1_000_000)):
        if count < 1000 * size or (not unit and count < 10_000):
            return f"{count // size}{unit}"
    return "999M"
