"""Reduction of long series without loss of extremes, unwrapping of sequence numbers, and texts of numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

Column = npt.NDArray[Any]


def extremes(x: Column, y: Column, bins: int) -> Column:
    """Return the rows of a series to draw: first, last, minimum and maximum of each of ``bins`` intervals of ``x``.

    ``x`` must ascend. A short series is returned completely. Points are selected, not averaged, so that tooltips show
    real values. NaN in ``y`` is neither minimum nor maximum.
    """
    if x.size <= 4 * bins:
        return np.arange(x.size)
    span = float(x[-1] - x[0]) or 1.0
    piece = np.minimum(((x - x[0]) * (bins / span)).astype(np.int64), bins - 1)
    starts = np.flatnonzero(np.diff(piece, prepend=-1))
    order = np.lexsort((y, piece))
    # NaN is sorted last: the maximum is before the first NaN.
    numbers = np.add.reduceat((~np.isnan(y)).astype(np.int64), starts)
    ends = np.append(starts[1:], x.size)
    kept: Column = np.unique(
        np.concatenate([starts, ends - 1, order[starts], order[starts + np.maximum(numbers - 1, 0)]])
    )
    return kept


def unwrapped(numbers: Column, modulus: int, restarts: Column | None = None) -> Column:
    """Unwrap numbers that count modulo ``modulus``; a step of less than half of it is forward, as in the protocol.

    Where ``restarts`` is true, the result restarts with the number itself.
    """
    if not numbers.size or not modulus:
        return numbers.astype(np.int64)
    step: Column = np.diff(numbers.astype(np.int64))
    step = step % modulus
    step = np.where(step >= modulus // 2, step - modulus, step)
    found = np.concatenate([[0], np.cumsum(step)]) + int(numbers[0])
    if restarts is not None and restarts.any():
        # Each count starts with its first number.
        first = np.maximum.accumulate(np.where(restarts, np.arange(numbers.size), 0))
        found = found - found[first] + numbers[first]
    return found


def runs(there: Column) -> list[tuple[int, int]]:
    """Return the ranges of indices (first, last + 1) in which ``there`` is true."""
    turns = np.flatnonzero(np.diff(np.concatenate([[0], there.astype(np.int8), [0]])))
    return [(int(a), int(b)) for a, b in zip(turns[::2], turns[1::2], strict=True)]


def usual_interval(seconds: Column) -> float:
    """Return the median interval between the times; 0 for fewer than two."""
    return float(np.median(np.diff(np.sort(seconds)))) if seconds.size > 1 else 0.0


def short(number: float, digits: int = 3) -> str:
    """Return a number with ``digits`` significant digits, or its whole integer part: never "1e+02"."""
    text = f"{number:.{digits}g}"
    return f"{number:,.0f}" if "e+" in text else text


def seconds_text(seconds: float) -> str:
    """Return a duration as text: "350 ms", "12 s", "4 min 10 s"."""
    if abs(seconds) < 1:
        return f"{short(seconds * 1000)} ms"
    if abs(seconds) < 100:
        return f"{short(seconds)} s"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {rest} s"


def ordinal(number: int) -> str:
    """Return an ordinal number: "1st", "2nd", "11th"."""
    ending = {1: "st", 2: "nd", 3: "rd"}.get(number % 10, "th") if number % 100 not in (11, 12, 13) else "th"
    return f"{number}{ending}"


def in_unit(unit: str | None) -> str:
    """Return a unit for a label, such as " (m)"; empty without a unit."""
    return f" ({unit})" if unit else ""
