"""Points that move in straight lines. Metres, metres per second, ns; axes are those of the safety data."""

from __future__ import annotations

import math

import msgspec

Vector = tuple[float, float, float]
"""x, y, z in m or m/s."""

NS_PER_S = 1_000_000_000
ZERO: Vector = (0.0, 0.0, 0.0)


class Motion(msgspec.Struct, frozen=True, gc=False):
    """A point and its velocity at the monotonic time ``at`` (ns). ``velocity`` None: unknown, taken as standing.

    ``estimated``: the velocity was computed from two places instead of being reported.
    """

    position: Vector
    velocity: Vector | None
    at: int
    estimated: bool = False

    def position_at(self, time: int) -> Vector:
        """Where the point is at another monotonic time (ns), before or after, if it goes on as it did."""
        if self.velocity is None:
            return self.position
        return moved(self.position, self.velocity, (time - self.at) / NS_PER_S)


class Approach(msgspec.Struct, frozen=True, gc=False):
    """When two moving points are closest: ``time`` ns from now, ``distance`` in m, and where both are then (m)."""

    time: int
    distance: float
    own_position: Vector
    other_position: Vector


def moved(point: Vector, velocity: Vector, seconds: float) -> Vector:
    """``point`` after ``seconds``."""
    x, y, z = point
    vx, vy, vz = velocity
    return (x + vx * seconds, y + vy * seconds, z + vz * seconds)


def distance(a: Vector, b: Vector) -> float:
    """Metres between two points; infinite rather than an error where the numbers end."""
    return math.dist(a, b)


def velocity_between(start: Vector, end: Vector, elapsed: int) -> Vector | None:
    """The mean velocity (m/s) of what moved from ``start`` to ``end`` in ``elapsed`` ns; None if that is not > 0."""
    if elapsed <= 0:
        return None
    x, y, z = ((b - a) / elapsed * NS_PER_S for a, b in zip(start, end, strict=True))
    return (x, y, z) if math.isfinite(x) and math.isfinite(y) and math.isfinite(z) else None


def closest_approach(own: Motion, other: Motion, *, now: int, horizon: int) -> Approach:
    """Where two motions come closest within ``horizon`` ns (>= 0) from the monotonic time ``now``.

    Both are first brought to ``now``. With p the other's place and v its velocity as seen from the own node, the
    distance |p + v t| is least at t = -p.v / v.v; before now and after the horizon the nearest end counts. Of equal
    distances (no relative motion) it is the earliest: now. Raises ValueError for a negative horizon.
    """
    if horizon < 0:
        raise ValueError(f"a horizon is a number of ns from now on, not {horizon}")
    mine, theirs = own.position_at(now), other.position_at(now)
    v_own, v_other = own.velocity or ZERO, other.velocity or ZERO
    p = tuple(b - a for a, b in zip(mine, theirs, strict=True))
    v = tuple(b - a for a, b in zip(v_own, v_other, strict=True))
    # Scaled by the largest component: squares of huge or tiny numbers would leave the range of floats.
    scale = max(map(abs, v))
    ns = 0.0
    if 0 < scale < math.inf and all(map(math.isfinite, p)):
        unit = tuple(component / scale for component in v)
        along = sum(a * b for a, b in zip(p, unit, strict=True))
        ns = -along / sum(a * a for a in unit) / scale * NS_PER_S
    # A not-a-number (places beyond the range of floats) compares false and stays at now.
    time = round(ns) if 0 < ns < horizon else (horizon if ns > 0 else 0)
    mine, theirs = own.position_at(now + time), other.position_at(now + time)
    return Approach(time, distance(mine, theirs), mine, theirs)
