"""Long series made short without losing extremes, wrapping numbers unwrapped, and numbers in words."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

Column = npt.NDArray[Any]


def extremes(x: Column, y: Column, bins: int) -> Column:
    """The rows to draw of a series: the first, last, least and greatest of each of ``bins`` equal pieces of ``x``.

    ``x`` ascends. Few rows come back whole. Every row that comes back is a real one, so that values shown under the
    pointer are true. NaN in ``y`` is no extreme.
    """
    if x.size <= 4 * bins:
        return np.arange(x.size)
    span = float(x[-1] - x[0]) or 1.0
    piece = np.minimum(((x - x[0]) * (bins / span)).astype(np.int64), bins - 1)
    starts = np.flatnonzero(np.diff(piece, prepend=-1))
    order = np.lexsort((y, piece))
    # NaN is sorted last: the greatest is before them.
    numbers = np.add.reduceat((~np.isnan(y)).astype(np.int64), starts)
    ends = np.append(starts[1:], x.size)
    kept: Column = np.unique(
        np.concatenate([starts, ends - 1, order[starts], order[starts + np.maximum(numbers - 1, 0)]])
    )
    return kept


def unwrapped(numbers: Column, modulus: int, restarts: Column | None = None) -> Column:
    """Numbers that count modulo ``modulus`` as numbers that go on; half of them are ahead, as in the protocol.

    Where ``restarts`` is true the count begins again with the number itself.
    """
    if not numbers.size or not modulus:
        return numbers.astype(np.int64)
    step: Column = np.diff(numbers.astype(np.int64))
    step = step % modulus
    step = np.where(step >= modulus // 2, step - modulus, step)
    found = np.concatenate([[0], np.cumsum(step)]) + int(numbers[0])
    if restarts is not None and restarts.any():
        # Each count starts from its first number.
        first = np.maximum.accumulate(np.where(restarts, np.arange(numbers.size), 0))
        found = found - found[first] + numbers[first]
    return found


def runs(there: Column) -> list[tuple[int, int]]:
    """Where truth begins and ends, as half-open ranges."""
    turns = np.flatnonzero(np.diff(np.concatenate([[0], there.astype(np.int8), [0]])))
    return [(int(a), int(b)) for a, b in zip(turns[::2], turns[1::2], strict=True)]


def usual_interval(seconds: Column) -> float:
    """The median time between two, 0 for less than two."""
    return float(np.median(np.diff(np.sort(seconds)))) if seconds.size > 1 else 0.0


def short(number: float, digits: int = 3) -> str:
    """A number with so many digits that matter, or all of its whole part: never "1e+02"."""
    text = f"{number:.{digits}g}"
    return f"{number:,.0f}" if "e+" in text else text


def seconds_text(seconds: float) -> str:
    """A duration for people: "0.35 s", "12 s", "4 min 10 s"."""
    if abs(seconds) < 1:
        return f"{short(seconds * 1000)} ms"
    if abs(seconds) < 100:
        return f"{short(seconds)} s"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {rest} s"


def ordinal(number: int) -> str:
    """ "1st", "2nd", "11th"."""
    ending = {1: "st", 2: "nd", 3: "rd"}.get(number % 10, "th") if number % 100 not in (11, 12, 13) else "th"
    return f"{number}{ending}"


def in_unit(unit: str | None) -> str:
    """ " (m)", or nothing for a unit that the profile does not know."""
    return f" ({unit})" if unit else ""
