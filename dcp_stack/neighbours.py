"""The neighbour table of SRP and the questions people ask it (dcp-srp.md, "The Neighbour Table").

Positions are in m and velocities in m/s, along the axes that the nodes agreed on; times are ns. An entry says where its
node was when the report was made; how long it was under way is not known without common clocks, so motions count from
its reception, and a place is late by the delay of the bearer (see :meth:`NeighbourTable.delay`).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final, Literal

import msgspec
from dcp_spec.constants import SRP_SEQNO_MODULUS
from dcp_spec.profile import Profile

from dcp_codec.values import ExtendedSafetyData

from .positions.fields import SafetyFields
from .positions.geometry import Approach, Motion, Vector, closest_approach, distance, velocity_between
from .timestamps import StampClock

RESTART_GAP: Final = 1 << 16
"""A step of the sequence number by this or more, or backwards, is a restart of the node and no loss.

An entry lives for seconds after a report, and no node makes 65536 reports in that time.
"""
EWMA_ALPHA: Final = 0.95
"""Weight of the past in the two averages, the default of the C++ implementation (gapSizeEWMAAlpha)."""


class NeighbourTableEntry(msgspec.Struct, frozen=True, gc=False):
    """``NeighbourTableEntry``: the last report of a neighbour, and what its reports had in common.

    The specification leaves further fields free (SRP-NT-04); those below ``sender_id`` are ours. Counters count since
    the entry was inserted.
    """

    node_id: bytes
    ext_sd: ExtendedSafetyData
    reception_time: int
    """Wall time in ns at which ``ext_sd`` was received."""
    received_at: int
    """The same moment by the monotonic clock, in ns."""
    sender_id: bytes
    """Sender of the beacon; another node than ``node_id`` if somebody forwards or forges (SRP-RX-05)."""
    first_seen: int
    """Wall time in ns of the first report."""
    fresh_at: int
    """When this sequence number was first received (monotonic ns); later than that come repetitions."""
    received: int = 1
    """Reports, repetitions not counted."""
    repeated: int = 0
    """Reports with the sequence number of the one before, as in mode REPEAT."""
    lost: int = 0
    """Sequence numbers that were left out: reports lost on the air, or replaced by their node before sending."""
    restarts: int = 0
    """Sequence numbers that went backwards or too far ahead (:data:`RESTART_GAP`)."""
    mean_gap: float = 1.0
    """EWMA of the steps of the sequence number; 1 when nothing is lost."""
    mean_interval: float | None = None
    """EWMA of the time between two different reports, in ns; None before the second."""
    before: ExtendedSafetyData | None = None
    """The report before ``ext_sd`` by the same run of the node, None after a restart."""
    before_at: int = 0
    """``fresh_at`` of ``before``."""

    @property
    def loss_rate(self) -> float:
        """Lost reports in proportion to all that were made, 0..1."""
        return self.lost / (self.lost + self.received)

    def age(self, now: int) -> int:
        """Time in ns since ``ext_sd`` was received, at the monotonic time ``now``."""
        return now - self.received_at


class Near(msgspec.Struct, frozen=True, gc=False):
    """A neighbour and its distance in m, from where it last reported to be."""

    node_id: bytes
    distance: float
    position: Vector


class NeighbourApproach(msgspec.Struct, frozen=True, gc=False):
    """The closest point of approach of one neighbour (see :class:`~dcp_stack.positions.geometry.Approach`)."""

    node_id: bytes
    approach: Approach
    velocity: Literal["reported", "estimated", "unknown"]
    """What is known of the neighbour's velocity; ``unknown`` counts as standing."""


class NeighbourTable:
    """The neighbours of one node, at most ``capacity`` of them; see the module docstring for units."""

    def __init__(
        self,
        profile: Profile,
        *,
        capacity: int,
        stamps: StampClock | None = None,
        fields: SafetyFields | None = None,
    ) -> None:
        """Raises ValueError for a capacity below 1.

        ``stamps`` relates the stamps of reports to wall time. ``fields`` are those of the profile, if they are there.
        """
        if capacity < 1:
            raise ValueError(f"a neighbour table has room for one entry at least, not {capacity}")
        self.capacity = capacity
        self.fields = fields or SafetyFields(profile)
        self._modulus = seqno_modulus(profile)
        self.stamps = stamps or StampClock(profile.types.timestamp)
        self._entries: dict[bytes, NeighbourTableEntry] = {}

    def __len__(self) -> int:
        return len(self._entries)

    def __iter__(self) -> Iterator[NeighbourTableEntry]:
        return iter(tuple(self._entries.values()))

    def __contains__(self, node_id: object) -> bool:
        return node_id in self._entries

    # -- the operations of the specification ------------------------------------------------------------------

    ##= SRP-NT-01
    def lookup(self, node_id: bytes) -> NeighbourTableEntry | None:
        """``ntLookup``: the entry of a node, None if there is none."""
        return self._entries.get(node_id)

    ##= SRP-NT-02
    def list_all_node_ids(self) -> list[bytes]:
        """``ntListAllNodeIds``: the nodes in the table, in no order that can be relied upon."""
        return [*self._entries]

    # -- maintenance, for SRP itself --------------------------------------------------------------------------

    def record(
        self, report: ExtendedSafetyData, sender_id: bytes, *, now: int, wall: int
    ) -> Literal["new", "replaced", "full"]:
        """Insert a report or replace the entry of its node; ``full``: it is of a new node and was not taken."""
        ##= SRP-RX-05
        node_id = report.node_id
        old = self._entries.get(node_id)
        if old is None and len(self._entries) >= self.capacity:
            return "full"
        ##= SRP-RX-03
        ##= SRP-RX-04
        # Also when its sequence number is lower: the node may have been started anew.
        self._entries[node_id] = (
            NeighbourTableEntry(node_id, report, wall, now, sender_id, wall, now)
            if old is None
            else _succeed(old, report, sender_id, now, wall, self._modulus)
        )
        return "new" if old is None else "replaced"

    def expire(self, now: int, timeout: int) -> list[bytes]:
        """Drop what was received more than ``timeout`` ns before ``now``; returns the nodes that are gone."""
        ##= SRP-RUN-02
        gone = [node_id for node_id, entry in self._entries.items() if now - entry.received_at > timeout]
        for node_id in gone:
            del self._entries[node_id]
        return gone

    def expire_at(self, wall: int, timeout: int) -> list[bytes]:
        """As :meth:`expire` by the system time, in ns since 1970 (X50 ``system-time``)."""
        gone = [node_id for node_id, entry in self._entries.items() if wall - entry.reception_time > timeout]
        for node_id in gone:
            del self._entries[node_id]
        return gone

    def clear(self) -> None:
        """Forget everybody."""
        self._entries.clear()

    # -- one entry --------------------------------------------------------------------------------------------

    def position(self, entry: NeighbourTableEntry) -> Vector | None:
        """Where the node reported to be (m); None if the profile has no position or a coordinate is not finite."""
        return self.fields.position(entry.ext_sd.s_data)

    def motion(self, entry: NeighbourTableEntry) -> Motion | None:
        """Place and velocity of a neighbour as of the (first) reception of its report; None without a position.

        The velocity is what the report says, or where the profile has no field for it, that between the last two
        reports of different sequence numbers by the stamps of their node.
        """
        position = self.position(entry)
        if position is None:
            return None
        if self.fields.has_velocity:
            return Motion(position, self.fields.velocity(entry.ext_sd.s_data), entry.fresh_at)
        return Motion(position, self._estimate(entry, position), entry.fresh_at, estimated=True)

    def _estimate(self, entry: NeighbourTableEntry, position: Vector) -> Vector | None:
        if entry.before is None or (start := self.fields.position(entry.before.s_data)) is None:
            return None
        # Receptions jitter by a whole beacon period, about the time between two reports; stamps do not. They only
        # have to be by one clock, which need not be ours.
        elapsed = self.stamps.between(entry.before.t_stamp, entry.ext_sd.t_stamp)
        return velocity_between(start, position, elapsed if elapsed > 0 else entry.fresh_at - entry.before_at)

    def delay(self, entry: NeighbourTableEntry) -> int | None:
        """Time in ns between the stamp of a report and its reception: delay of BP and bearer if clocks agree.

        None where the epoch of stamps is not comparable (simulation, boot).
        """
        if not self.stamps.comparable:
            return None
        return entry.reception_time - self.stamps.wall(entry.ext_sd.t_stamp, near=entry.reception_time)

    # -- all entries ------------------------------------------------------------------------------------------

    def nearest(self, point: Vector, *, limit: int | None = None) -> list[Near]:
        """Neighbours by increasing distance from ``point`` (m), the first ``limit`` of them; no position, no place."""
        found = [
            Near(entry.node_id, distance(point, position), position)
            for entry in self._entries.values()
            if (position := self.position(entry)) is not None
        ]
        found.sort(key=lambda near: near.distance)
        return found[:limit]

    def within(self, point: Vector, radius: float) -> list[Near]:
        """Neighbours at most ``radius`` m from ``point``, by increasing distance."""
        return [near for near in self.nearest(point) if near.distance <= radius]

    def older_than(self, age: int, *, now: int) -> list[NeighbourTableEntry]:
        """Entries whose report was received more than ``age`` ns before ``now``, the oldest first."""
        found = [entry for entry in self._entries.values() if entry.age(now) > age]
        found.sort(key=lambda entry: entry.received_at)
        return found

    def closest_approaches(
        self, own: Motion, *, now: int, horizon: int, limit: int | None = None
    ) -> list[NeighbourApproach]:
        """How close each neighbour comes to ``own`` within ``horizon`` ns from ``now``, the closest first.

        Everybody is taken to go on in a straight line at the last known velocity, also since the last report.
        Neighbours without a position are left out.
        """
        found = []
        for entry in self._entries.values():
            motion = self.motion(entry)
            if motion is None:
                continue
            approach = closest_approach(own, motion, now=now, horizon=horizon)
            known: Literal["reported", "estimated", "unknown"] = "estimated" if motion.estimated else "reported"
            found.append(NeighbourApproach(entry.node_id, approach, "unknown" if motion.velocity is None else known))
        found.sort(key=lambda each: (each.approach.distance, each.approach.time))
        return found[:limit]

    def snapshot(self) -> list[dict[str, Any]]:
        """The entries as plain data, by node id: octets as hex, times in ns."""
        return [self._plain(entry) for _, entry in sorted(self._entries.items())]

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
            "reception_time": entry.reception_time,
            "received_at": entry.received_at,
            "first_seen": entry.first_seen,
            "received": entry.received,
            "repeated": entry.repeated,
            "lost": entry.lost,
            "restarts": entry.restarts,
            "mean_gap": entry.mean_gap,
            "mean_interval": entry.mean_interval,
            "delay": self.delay(entry),
            "position": motion.position if motion is not None else None,
            "velocity": motion.velocity if motion is not None else None,
            "velocity_estimated": motion is not None and motion.velocity is not None and motion.estimated,
        }


def seqno_modulus(profile: Profile) -> int:
    """What sequence numbers count modulo: 2^32, or less where a profile has fewer octets for them."""
    return min(SRP_SEQNO_MODULUS, 1 << (8 * profile.types.srp_seqno.width))


##= SRP-NT-04
def _succeed(
    old: NeighbourTableEntry, report: ExtendedSafetyData, sender_id: bytes, now: int, wall: int, modulus: int
) -> NeighbourTableEntry:
    """The entry that takes the place of ``old``, with its statistics carried on."""
    gap = (report.seqno - old.ext_sd.seqno) % modulus
    if gap == 0:
        return msgspec.structs.replace(
            old, ext_sd=report, reception_time=wall, received_at=now, sender_id=sender_id, repeated=old.repeated + 1
        )
    restarted = gap >= min(RESTART_GAP, modulus // 2)
    interval = float(now - old.fresh_at)
    if old.mean_interval is not None:
        interval = EWMA_ALPHA * old.mean_interval + (1 - EWMA_ALPHA) * interval
    return NeighbourTableEntry(
        old.node_id,
        report,
        wall,
        now,
        sender_id,
        old.first_seen,
        now,
        received=old.received + 1,
        repeated=old.repeated,
        lost=old.lost if restarted else old.lost + gap - 1,
        restarts=old.restarts + restarted,
        mean_gap=old.mean_gap if restarted else EWMA_ALPHA * old.mean_gap + (1 - EWMA_ALPHA) * gap,
        mean_interval=interval,
        before=None if restarted else old.ext_sd,
        before_at=old.fresh_at,
    )
