"""Geometry of points that move in straight lines. Units are m, m/s and ns; axes are those of the safety data."""

from __future__ import annotations

import math

import msgspec

Vector = tuple[float, float, float]
"""x, y, z in m or m/s."""

NS_PER_S = 1_000_000_000


class Motion(msgspec.Struct, frozen=True, gc=False):
    """A point and its velocity, None if unknown.

    ``estimated``: the velocity was computed from two positions instead of being reported.
    """

    position: Vector
    velocity: Vector | None
    estimated: bool = False


def moved(point: Vector, velocity: Vector, seconds: float) -> Vector:
    """Return the position of ``point`` after ``seconds`` at a constant velocity."""
    x, y, z = point
    vx, vy, vz = velocity
    return (x + vx * seconds, y + vy * seconds, z + vz * seconds)


def velocity_between(start: Vector, end: Vector, elapsed: int) -> Vector | None:
    """Return the mean velocity (m/s) from ``start`` to ``end`` within ``elapsed`` ns.

    Returns None if ``elapsed`` is not positive or the velocity is not finite.
    """
    if elapsed <= 0:
        return None
    x, y, z = ((b - a) / elapsed * NS_PER_S for a, b in zip(start, end, strict=True))
    return (x, y, z) if math.isfinite(x) and math.isfinite(y) and math.isfinite(z) else None
