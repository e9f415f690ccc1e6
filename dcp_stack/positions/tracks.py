"""Simulated tracks. Axes are east (x), north (y), up (z); units are m, m/s, s, and degrees clockwise from north."""

from __future__ import annotations

import math
import random
from itertools import pairwise
from typing import Final, Protocol

from .base import PositionSource, Sample
from .fields import SafetyFields
from .geometry import NS_PER_S, Vector, moved

RATE: Final = 20.0
"""Default rate in samples per s: two for each beacon at the usual 10 per s. With one sample per beacon, jitter would
cause some beacons without a new state report."""
State = tuple[Vector, Vector]
"""Position (m) and velocity (m/s)."""


class Path(Protocol):
    """A track as a function of the time since its start in s, which must not decrease from call to call."""

    def at(self, seconds: float) -> State:
        """Return position and velocity at this time."""
        ...


class Line:
    """A straight line from ``start`` in direction ``course``; with ``length`` (m) it is flown back and forth."""

    def __init__(
        self, start: Vector, *, course: float, speed: float, climb: float = 0.0, length: float | None = None
    ) -> None:
        """``speed``: horizontal speed in m/s. ``climb``: vertical speed in m/s. Raises ValueError if length <= 0."""
        if length is not None and not length > 0:
            raise ValueError(f"length must be greater than 0 m, not {length:g}")
        angle = math.radians(course)
        self.start, self.velocity = start, (speed * math.sin(angle), speed * math.cos(angle), climb)
        pace = math.hypot(speed, climb)
        self.leg = length / pace if length is not None and pace > 0 else math.inf

    def at(self, seconds: float) -> State:
        """Return position and velocity at this time."""
        if self.leg == math.inf:
            return moved(self.start, self.velocity, seconds), self.velocity
        legs, rest = divmod(seconds, self.leg)
        if legs % 2 == 0:
            return moved(self.start, self.velocity, rest), self.velocity
        vx, vy, vz = self.velocity
        return moved(self.start, self.velocity, self.leg - rest), (-vx, -vy, -vz)


class Circle:
    """A circle around ``center`` at its height, clockwise for a positive speed.

    It starts at ``phase``, in degrees clockwise from north.
    """

    def __init__(self, center: Vector, *, radius: float, speed: float, phase: float = 0.0) -> None:
        """Raises ValueError if the radius is not greater than 0."""
        if not radius > 0:
            raise ValueError(f"radius must be greater than 0 m, not {radius:g}")
        self.center, self.radius, self.speed, self.phase = center, radius, speed, math.radians(phase)

    def at(self, seconds: float) -> State:
        """Return position and velocity at this time."""
        angle = self.phase + self.speed / self.radius * seconds
        east, north = math.sin(angle), math.cos(angle)
        x, y, z = self.center
        return (x + self.radius * east, y + self.radius * north, z), (self.speed * north, -self.speed * east, 0.0)


class Waypoints:
    """Straight lines from point to point, repeatedly, or with ``loop`` False once until the last point."""

    def __init__(self, points: list[Vector], *, speed: float, loop: bool = True) -> None:
        """Raises ValueError if all points are equal or the speed is not greater than 0."""
        if not speed > 0:
            raise ValueError(f"speed must be greater than 0 m/s, not {speed:g}")
        stops = [*points, points[0]] if loop and points else points
        self.legs = [(a, b, math.dist(a, b) / speed) for a, b in pairwise(stops) if a != b]
        if not self.legs:
            raise ValueError("at least two different points are needed")
        self.speed, self.loop = speed, loop
        self.duration = math.fsum(duration for *_, duration in self.legs)

    def at(self, seconds: float) -> State:
        """Return position and velocity at this time; without a loop the velocity is 0 after the last point."""
        if self.loop:
            seconds %= self.duration
        for a, b, duration in self.legs:
            if seconds < duration:
                x, y, z = ((after - before) / duration for before, after in zip(a, b, strict=True))
                return moved(a, (x, y, z), seconds), (x, y, z)
            seconds -= duration
        return self.legs[-1][1], (0.0, 0.0, 0.0)


class RandomWalk:
    """A track at constant speed and height with a random course, inside a square of ``extent`` m around ``start``.

    The course changes every ``STEP`` s, independently of the times of the calls. The track depends only on the
    generator.
    """

    STEP = 0.1

    def __init__(self, start: Vector, *, speed: float, extent: float, turn: float, rng: random.Random) -> None:
        """``turn``: standard deviation of the course after 1 s, in degrees. Raises ValueError if extent <= 0."""
        if not extent > 0:
            raise ValueError(f"extent must be greater than 0 m, not {extent:g}")
        self.start, self.extent, self.rng = start, extent, rng
        # A step longer than half the square could not be reflected into it.
        self.speed = math.copysign(min(abs(speed), extent / self.STEP / 2), speed)
        self.turn = math.radians(turn) * math.sqrt(self.STEP)
        self.course = rng.uniform(0, math.tau)
        self.steps = 0
        self.place = start
        self.velocity = self._velocity()

    def at(self, seconds: float) -> State:
        """Return position and velocity at this time."""
        while (self.steps + 1) * self.STEP <= seconds:
            self._step()
        return moved(self.place, self.velocity, seconds - self.steps * self.STEP), self.velocity

    def _velocity(self) -> Vector:
        """Return the velocity for the current course."""
        return (self.speed * math.sin(self.course), self.speed * math.cos(self.course), 0.0)

    def _step(self) -> None:
        """Move by one step, and change the course."""
        self.place = moved(self.place, self.velocity, self.STEP)
        self.steps += 1
        self.course += self.rng.gauss(0, self.turn)
        self.velocity = self._velocity()
        # Reflect the course if the next step would leave the square.
        x, y, _ = moved(self.place, self.velocity, self.STEP)
        half = self.extent / 2
        if abs(x - self.start[0]) > half:
            self.course = -self.course
            self.velocity = self._velocity()
        if abs(y - self.start[1]) > half:
            self.course = math.pi - self.course
            self.velocity = self._velocity()


class Track(PositionSource):
    """Provides ``rate`` samples of a path per s. A late poll returns one sample, for the current time."""

    def __init__(self, name: str, path: Path, fields: SafetyFields, *, rate: float = RATE) -> None:
        """Raises ValueError for a rate outside 0.001..1000 per s."""
        super().__init__(name)
        if not 0.001 <= rate <= 1000:
            raise ValueError(f"rate must be 0.001 to 1000 samples per second, not {rate:g}")
        self._path, self._fields = path, fields
        self._period = round(NS_PER_S / rate)
        self._start: int | None = None
        self._due = 0

    def poll(self, now: int, wall: int) -> list[Sample]:  # noqa: ARG002 - the same call for every source
        """Return the sample for the current time, if one is due."""
        if self._start is None:
            self._start = self._due = now
        if now < self._due:
            return []
        self._due += (1 + (now - self._due) // self._period) * self._period
        try:
            return [self._fields.from_motion(*self._path.at((now - self._start) / NS_PER_S))]
        except (ValueError, ArithmeticError) as error:
            # Values that do not fit their fields, or lengths and speeds beyond the range of floats.
            self.complain("out-of-range", str(error))
            return []

    def poll_timeout(self) -> int | None:
        """Return when the next sample is due (monotonic ns); 0 before the first."""
        return self._due


def as_sample(position: Vector, velocity: Vector | None) -> dict[str, float]:
    """Return a sample, by roles, for a position (m) and a velocity (m/s)."""
    found = dict(zip(("position.x", "position.y", "position.z"), position, strict=True))
    if velocity is not None:
        found |= zip(("velocity.x", "velocity.y", "velocity.z"), velocity, strict=True)
    return found
