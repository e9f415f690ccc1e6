"""Geometry of points that move in straight lines. Units are m, m/s and ns; axes are those of the safety data."""

from __future__ import annotations

import math

import msgspec

Vector = tuple[float, float, float]
"""x, y, z in m or m/s."""

NS_PER_S = 1_000_000_000
ZERO: Vector = (0.0, 0.0, 0.0)


class Motion(msgspec.Struct, frozen=True, gc=False):
    """A point and its velocity at the monotonic time ``at`` (ns).

    ``velocity``: None if unknown; the point is then assumed not to move. ``estimated``: the velocity was computed from
    two positions instead of being reported.
    """

    position: Vector
    velocity: Vector | None
    at: int
    estimated: bool = False

    def position_at(self, time: int) -> Vector:
        """Return the position at another monotonic time (ns), earlier or later, at constant velocity."""
        if self.velocity is None:
            return self.position
        return moved(self.position, self.velocity, (time - self.at) / NS_PER_S)


class Approach(msgspec.Struct, frozen=True, gc=False):
    """The closest approach of two moving points: ``time`` in ns from now, ``distance`` and positions then in m."""

    time: int
    distance: float
    own_position: Vector
    other_position: Vector


def moved(point: Vector, velocity: Vector, seconds: float) -> Vector:
    """Return the position of ``point`` after ``seconds`` at a constant velocity."""
    x, y, z = point
    vx, vy, vz = velocity
    return (x + vx * seconds, y + vy * seconds, z + vz * seconds)


def distance(a: Vector, b: Vector) -> float:
    """Return the distance between two points in m; infinite if it exceeds the range of floats."""
    return math.dist(a, b)


def velocity_between(start: Vector, end: Vector, elapsed: int) -> Vector | None:
    """Return the mean velocity (m/s) from ``start`` to ``end`` within ``elapsed`` ns.

    Returns None if ``elapsed`` is not positive or the velocity is not finite.
    """
    if elapsed <= 0:
        return None
    x, y, z = ((b - a) / elapsed * NS_PER_S for a, b in zip(start, end, strict=True))
    return (x, y, z) if math.isfinite(x) and math.isfinite(y) and math.isfinite(z) else None


def closest_approach(own: Motion, other: Motion, *, now: int, horizon: int) -> Approach:
    """Return the closest approach of two motions within ``horizon`` ns (>= 0) from the monotonic time ``now``.

    Both motions are first extrapolated to ``now``. With the relative position p and the relative velocity v the
    distance |p + v t| is least at t = -p.v / v.v, which is limited to the interval from now to the horizon. Without
    relative motion the result is for now. Raises ValueError for a negative horizon.
    """
    if horizon < 0:
        raise ValueError(f"a horizon must be at least 0 ns, not {horizon}")
    mine, theirs = own.position_at(now), other.position_at(now)
    v_own, v_other = own.velocity or ZERO, other.velocity or ZERO
    p = tuple(b - a for a, b in zip(mine, theirs, strict=True))
    v = tuple(b - a for a, b in zip(v_own, v_other, strict=True))
    # Scaled by the largest component: squares of very large or small numbers would exceed the range of floats.
    scale = max(map(abs, v))
    ns = 0.0
    if 0 < scale < math.inf and all(map(math.isfinite, p)):
        unit = tuple(component / scale for component in v)
        along = sum(a * b for a, b in zip(p, unit, strict=True))
        ns = -along / sum(a * a for a in unit) / scale * NS_PER_S
    # NaN (positions beyond the range of floats) compares false, so the result is for now.
    time = round(ns) if 0 < ns < horizon else (horizon if ns > 0 else 0)
    mine, theirs = own.position_at(now + time), other.position_at(now + time)
    return Approach(time, distance(mine, theirs), mine, theirs)
