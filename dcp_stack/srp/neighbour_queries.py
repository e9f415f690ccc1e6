"""Queries of the neighbour table: positions, motions and closest approaches of neighbours.

The specification has no such service; programs on the node use the queries, and the protocol does not depend on them.
Positions are in m and velocities in m/s, along the axes that the nodes agreed on; times are ns. An entry has the
position of its node at the time of the report. Without common clocks the age of a report at its reception is unknown:
motions start at the reception, and positions are late by the delay of the bearer (:meth:`NeighbourQueries.delay`).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Final, Literal

import msgspec

from dcp_codec.values import SafetyData
from dcp_stack.positions.fields import SafetyFields
from dcp_stack.positions.geometry import Approach, Motion, Vector, closest_approach, distance, velocity_between
from dcp_stack.timestamps import StampClock

if TYPE_CHECKING:
    from .neighbour_table import NeighbourTableEntry


#: The times and statistics of an entry that are shown unchanged.
_SHOWN: Final = (
    *("reception_time", "received_at", "first_seen", "received", "repeated", "lost", "restarts"),
    *("mean_gap", "mean_interval"),
)


class Near(msgspec.Struct, frozen=True, gc=False):
    """A neighbour and the distance in m to its last reported position."""

    node_id: bytes
    distance: float
    position: Vector


class NeighbourApproach(msgspec.Struct, frozen=True, gc=False):
    """The closest point of approach of one neighbour (see :class:`~dcp_stack.positions.geometry.Approach`)."""

    node_id: bytes
    approach: Approach
    velocity: Literal["reported", "estimated", "unknown"]
    """Source of the neighbour's velocity; for ``unknown`` the velocity is 0."""


class NeighbourQueries:
    """Queries of a neighbour table, as the base class of the table."""

    fields: SafetyFields
    """The safety data of the profile."""
    stamps: StampClock
    """Relates the stamps of reports to wall time."""

    def __iter__(self) -> Iterator[NeighbourTableEntry]:
        raise NotImplementedError

    # -- one entry --------------------------------------------------------------------------------------------

    def position(self, entry: NeighbourTableEntry) -> Vector | None:
        """Return the reported position (m); None if the profile has no position or a coordinate is not finite."""
        return self.fields.position(entry.ext_sd.s_data)

    def motion(self, entry: NeighbourTableEntry) -> Motion | None:
        """Return position and velocity at the (first) reception of a report; None without a position.

        The velocity is what the report says, or where the profile has no field for it, that between the last two
        reports of different sequence numbers by the stamps of their node.
        """
        before, elapsed = entry.before, 0
        if before is not None:
            # Receptions jitter by a whole beacon period, about the time between two reports; stamps do not. They only
            # have to be by one clock, which need not be ours.
            elapsed = self.stamps.between(before.t_stamp, entry.ext_sd.t_stamp)
            elapsed = elapsed if elapsed > 0 else entry.fresh_at - entry.before_at
        earlier = None if before is None else before.s_data
        return _motion(self.fields, entry.ext_sd.s_data, entry.fresh_at, earlier, elapsed)

    def delay(self, entry: NeighbourTableEntry) -> int | None:
        """Return the ns from the stamp of a report to its reception: delay of BP and bearer if clocks agree.

        None where the epoch of stamps is not comparable (simulation, boot).
        """
        if not self.stamps.comparable:
            return None
        return entry.reception_time - self.stamps.wall(entry.ext_sd.t_stamp, near=entry.reception_time)

    # -- all entries ------------------------------------------------------------------------------------------

    def nearest(self, point: Vector, *, limit: int | None = None) -> list[Near]:
        """Return the ``limit`` neighbours nearest to ``point`` (m), by distance, without those with no position."""
        found = [
            Near(entry.node_id, distance(point, position), position)
            for entry in self
            if (position := self.position(entry)) is not None
        ]
        found.sort(key=lambda near: near.distance)
        return found[:limit]

    def within(self, point: Vector, radius: float) -> list[Near]:
        """Return the neighbours at most ``radius`` m from ``point``, by increasing distance."""
        return [near for near in self.nearest(point) if near.distance <= radius]

    def older_than(self, age: int, *, now: int) -> list[NeighbourTableEntry]:
        """Return entries whose report was received more than ``age`` ns before ``now``, the oldest first."""
        found = [entry for entry in self if entry.age(now) > age]
        found.sort(key=lambda entry: entry.received_at)
        return found

    def closest_approaches(
        self, own: Motion, *, now: int, horizon: int, limit: int | None = None
    ) -> list[NeighbourApproach]:
        """Return the closest approach of each neighbour to ``own`` within ``horizon`` ns from ``now``, closest first.

        All nodes are assumed to move in a straight line at the last known velocity, also since the last report.
        Neighbours without a position are left out.
        """
        found = []
        for entry in self:
            motion = self.motion(entry)
            if motion is None:
                continue
            approach = closest_approach(own, motion, now=now, horizon=horizon)
            known: Literal["reported", "estimated", "unknown"] = "estimated" if motion.estimated else "reported"
            found.append(NeighbourApproach(entry.node_id, approach, "unknown" if motion.velocity is None else known))
        found.sort(key=lambda each: (each.approach.distance, each.approach.time))
        return found[:limit]

    def snapshot(self) -> list[dict[str, Any]]:
        """Return the entries as plain data, by node id: octets as hex, times in ns."""
        return [self._plain(entry) for entry in sorted(self, key=lambda entry: entry.node_id)]

    def _plain(self, entry: NeighbourTableEntry) -> dict[str, Any]:
        motion = self.motion(entry)
        return {
            "node_id": entry.node_id.hex(":"),
            "sender_id": entry.sender_id.hex(":"),
            "safety_data": {
                name: value.hex() if isinstance(value, bytes) else value
                for name, value in entry.ext_sd.s_data.as_dict().items()
            },
            "t_stamp": entry.ext_sd.t_stamp,
            "seqno": entry.ext_sd.seqno,
            **{name: getattr(entry, name) for name in _SHOWN},
            "delay": self.delay(entry),
            "position": motion.position if motion is not None else None,
            "velocity": motion.velocity if motion is not None else None,
            "velocity_estimated": motion is not None and motion.velocity is not None and motion.estimated,
        }


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
        return _motion(self._fields, data, at, before, at - before_at)


def _motion(fields: SafetyFields, data: SafetyData, at: int, before: SafetyData | None, elapsed: int) -> Motion | None:
    """Return the motion of a node with ``data`` at the time ``at``, and with ``before`` ``elapsed`` ns earlier."""
    position = fields.position(data)
    if position is None:
        return None
    if fields.has_velocity:
        return Motion(position, fields.velocity(data), at)
    start = None if before is None else fields.position(before)
    velocity = None if start is None else velocity_between(start, position, elapsed)
    return Motion(position, velocity, at, estimated=True)
