"""Simulated tracks. Axes are east (x), north (y), up (z); metres, m/s, degrees clockwise from north, seconds."""

from __future__ import annotations

import math
import random
from itertools import pairwise
from typing import Final, Protocol

from .base import Sample, Source
from .fields import SafetyFields
from .geometry import NS_PER_S, Vector, distance, moved

RATE: Final = 20.0
"""Samples per s where nobody says otherwise: two for each beacon at the usual 10 per s. With one, jitter decides
whether a beacon finds a fresh one, and every few beacons go without a state report."""
State = tuple[Vector, Vector]
"""Place (m) and velocity (m/s)."""


class Path(Protocol):
    """A track as a function of the seconds since its start, which never decrease from call to call."""

    def at(self, seconds: float) -> State:
        """Place and velocity."""
        ...


class Line:
    """From ``start`` in direction ``course``; with ``length`` (m) back and forth over it."""

    def __init__(
        self, start: Vector, *, course: float, speed: float, climb: float = 0.0, length: float | None = None
    ) -> None:
        """``climb`` is the upward part of the velocity in m/s and not part of ``speed``. ValueError if length <= 0."""
        if length is not None and not length > 0:
            raise ValueError(f"length must be greater than 0 m, not {length:g}")
        angle = math.radians(course)
        self.start, self.velocity = start, (speed * math.sin(angle), speed * math.cos(angle), climb)
        pace = math.hypot(speed, climb)
        self.leg = length / pace if length is not None and pace > 0 else math.inf

    def at(self, seconds: float) -> State:
        """Place and velocity."""
        if self.leg == math.inf:
            return moved(self.start, self.velocity, seconds), self.velocity
        legs, rest = divmod(seconds, self.leg)
        if legs % 2 == 0:
            return moved(self.start, self.velocity, rest), self.velocity
        vx, vy, vz = self.velocity
        return moved(self.start, self.velocity, self.leg - rest), (-vx, -vy, -vz)


class Circle:
    """Around ``center`` at its height, from ``phase`` (degrees from north) on; clockwise for a positive speed."""

    def __init__(self, center: Vector, *, radius: float, speed: float, phase: float = 0.0) -> None:
        """Raises ValueError for a radius that is not greater than 0."""
        if not radius > 0:
            raise ValueError(f"radius must be greater than 0 m, not {radius:g}")
        self.center, self.radius, self.speed, self.phase = center, radius, speed, math.radians(phase)

    def at(self, seconds: float) -> State:
        """Place and velocity."""
        angle = self.phase + self.speed / self.radius * seconds
        east, north = math.sin(angle), math.cos(angle)
        x, y, z = self.center
        return (x + self.radius * east, y + self.radius * north, z), (self.speed * north, -self.speed * east, 0.0)


class Waypoints:
    """From point to point in straight lines; round and round, or until the last point with ``loop`` false."""

    def __init__(self, points: list[Vector], *, speed: float, loop: bool = True) -> None:
        """Raises ValueError without two different points or for a speed that is not greater than 0."""
        if not speed > 0:
            raise ValueError(f"speed must be greater than 0 m/s, not {speed:g}")
        stops = [*points, points[0]] if loop and points else points
        self.legs = [(a, b, distance(a, b) / speed) for a, b in pairwise(stops) if a != b]
        if not self.legs:
            raise ValueError("at least two different points are needed")
        self.speed, self.loop = speed, loop
        self.duration = math.fsum(duration for *_, duration in self.legs)

    def at(self, seconds: float) -> State:
        """Place and velocity; standing at the last point when that is reached for good."""
        if self.loop:
            seconds %= self.duration
        for a, b, duration in self.legs:
            if seconds < duration:
                x, y, z = ((after - before) / duration for before, after in zip(a, b, strict=True))
                return moved(a, (x, y, z), seconds), (x, y, z)
            seconds -= duration
        return self.legs[-1][1], (0.0, 0.0, 0.0)


class RandomWalk:
    """At constant speed and height with a wandering course, inside a square of ``extent`` m around ``start``.

    The course changes every ``STEP`` seconds, whenever it is asked for: the track depends on the generator alone.
    """

    STEP = 0.1

    def __init__(self, start: Vector, *, speed: float, extent: float, turn: float, rng: random.Random) -> None:
        """``turn`` is the standard deviation of the course after one second (degrees). ValueError if extent <= 0."""
        if not extent > 0:
            raise ValueError(f"extent must be greater than 0 m, not {extent:g}")
        self.start, self.extent, self.rng = start, extent, rng
        # Longer steps than the square is wide could not be reflected into it.
        self.speed = math.copysign(min(abs(speed), extent / self.STEP / 2), speed)
        self.turn = math.radians(turn) * math.sqrt(self.STEP)
        self.course = rng.uniform(0, math.tau)
        self.steps = 0
        self.place = start
        self.velocity = self._velocity()

    def at(self, seconds: float) -> State:
        """Place and velocity."""
        while (self.steps + 1) * self.STEP <= seconds:
            self._step()
        return moved(self.place, self.velocity, seconds - self.steps * self.STEP), self.velocity

    def _velocity(self) -> Vector:
        return (self.speed * math.sin(self.course), self.speed * math.cos(self.course), 0.0)

    def _step(self) -> None:
        self.place = moved(self.place, self.velocity, self.STEP)
        self.steps += 1
        self.course += self.rng.gauss(0, self.turn)
        self.velocity = self._velocity()
        # Turn back inside where the next step would leave the square.
        x, y, _ = moved(self.place, self.velocity, self.STEP)
        half = self.extent / 2
        if abs(x - self.start[0]) > half:
            self.course = -self.course
            self.velocity = self._velocity()
        if abs(y - self.start[1]) > half:
            self.course = math.pi - self.course
            self.velocity = self._velocity()


class Track(Source):
    """A path, sampled ``rate`` times a second. A poll that comes late gives one sample, that of now."""

    def __init__(self, name: str, path: Path, fields: SafetyFields, *, rate: float = RATE) -> None:
        """Raises ValueError for a rate outside 0.001..1000 per second, FieldError if the fields cannot hold it."""
        super().__init__(name)
        if not 0.001 <= rate <= 1000:
            raise ValueError(f"rate must be 0.001 to 1000 samples per second, not {rate:g}")
        self._path, self._fields = path, fields
        self._period = round(NS_PER_S / rate)
        self._start: int | None = None
        self._due = 0

    def poll(self, now: int, wall: int) -> list[Sample]:  # noqa: ARG002 - the same call for every source
        """The sample of now, if one is due."""
        if self._start is None:
            self._start = self._due = now
        if now < self._due:
            return []
        self._due += (1 + (now - self._due) // self._period) * self._period
        try:
            return [self._fields.from_motion(*self._path.at((now - self._start) / NS_PER_S))]
        except (ValueError, ArithmeticError) as error:
            # Beside values that do not fit: tracks of lengths and speeds where the numbers end.
            self.complain("out-of-range", str(error))
            return []

    def poll_timeout(self) -> int | None:
        """When the next sample is due; at once before the first."""
        return self._due


def as_sample(position: Vector, velocity: Vector | None) -> dict[str, float]:
    """Roles and values of a place and a velocity."""
    found = dict(zip(("position.x", "position.y", "position.z"), position, strict=True))
    if velocity is not None:
        found |= zip(("velocity.x", "velocity.y", "velocity.z"), velocity, strict=True)
    return found
