"""Small things for plots: fewer points, stairs, numbers in words."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

Column = npt.NDArray[Any]


def stairs(ends: Column, values: Column) -> tuple[Column, Column]:
    """A line that is level in each piece of time that ``ends`` bound."""
    return np.repeat(ends, 2)[1:-1], np.repeat(values, 2)


def thinned(rows: Column, many: int) -> Column:
    """At most ``many`` of some rows, evenly, with the first and the last."""
    if rows.size <= many:
        return rows
    kept: Column = rows[np.linspace(0, rows.size - 1, many).astype(np.int64)]
    return kept


def runs(there: Column) -> list[tuple[int, int]]:
    """Where truth begins and ends, as half-open ranges."""
    turns = np.flatnonzero(np.diff(np.concatenate([[0], there.astype(np.int8), [0]])))
    return [(int(a), int(b)) for a, b in zip(turns[::2], turns[1::2], strict=True)]


def usual_interval(seconds: Column) -> float:
    """The median time between two, 0 for less than two."""
    return float(np.median(np.diff(np.sort(seconds)))) if seconds.size > 1 else 0.0


def seconds_text(seconds: float) -> str:
    """A duration for people: "0.35 s", "12 s", "4 min 10 s"."""
    if seconds < 1:
        return f"{seconds * 1000:.3g} ms"
    if seconds < 100:
        return f"{seconds:.3g} s"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {rest} s"


def ordinal(number: int) -> str:
    """ "1st", "2nd", "11th"."""
    ending = {1: "st", 2: "nd", 3: "rd"}.get(number % 10, "th") if number % 100 not in (11, 12, 13) else "th"
    return f"{number}{ending}"


def si(value: float) -> str:
    """A number with k, M, G and so on, for ticks."""
    for letter, factor in (("E", 1e18), ("P", 1e15), ("T", 1e12), ("G", 1e9), ("M", 1e6), ("k", 1e3)):
        if abs(value) >= factor:
            return f"{value / factor:g}{letter}"
    return f"{value:g}"


def in_unit(unit: str | None) -> str:
    """ " (m)", or nothing for a unit that the profile does not know."""
    return f" ({unit})" if unit else ""
