"""Motions by safety data: of this node, and the rule that holds for neighbours, too.

Positions are in m and velocities in m/s, along the axes that the nodes agreed on; times are ns.
"""

from __future__ import annotations

from dcp_codec.values import SafetyData
from dcp_stack.positions.fields import SafetyFields
from dcp_stack.positions.geometry import Motion, velocity_between


class OwnMotion:
    """The last two safety data that an application submitted, with the monotonic times."""

    def __init__(self, fields: SafetyFields) -> None:
        self._fields = fields
        self._last: tuple[SafetyData, int] | None = None
        self._before: tuple[SafetyData, int] | None = None

    @property
    def data(self) -> SafetyData | None:
        """The safety data that were submitted last, or None."""
        return None if self._last is None else self._last[0]

    def note(self, data: SafetyData, now: int) -> None:
        """Record safety data that were submitted at the monotonic time ``now``."""
        self._before, self._last = self._last, (data, now)

    def clear(self) -> None:
        """Remove the recorded safety data."""
        self._last = self._before = None

    def motion(self) -> Motion | None:
        """Return position and velocity; None without safety data, or if the profile has no position.

        Where the profile has no velocity it is that between the last two submissions.
        """
        if self._last is None:
            return None
        data, at = self._last
        before, before_at = self._before or (None, at)
        return motion_of(self._fields, data, before, at - before_at)


def motion_of(fields: SafetyFields, data: SafetyData, before: SafetyData | None, elapsed: int) -> Motion | None:
    """Return the motion of a node with ``data``, and ``before`` ``elapsed`` ns earlier; None without a position."""
    position = fields.position(data)
    if position is None:
        return None
    if fields.has_velocity:
        return Motion(position, fields.velocity(data))
    start = None if before is None else fields.position(before)
    velocity = None if start is None else velocity_between(start, position, elapsed)
    return Motion(position, velocity, estimated=True)
