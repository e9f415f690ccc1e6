"""The neighbour table of SRP (dcp-srp.md, "The Neighbour Table"); times are ns.

An entry has the position of its node at the time of the report. Without common clocks the age of a report at its
reception is unknown: motions start at the reception, and positions are late by the delay of the bearer
(:meth:`NeighbourTable.delay`).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final, Literal

import msgspec
from dcp_spec.constants import SRP_SEQNO_MODULUS
from dcp_spec.profile.definition import Profile

from dcp_codec.values import ExtendedSafetyData
from dcp_stack.positions.fields import SafetyFields
from dcp_stack.positions.geometry import Motion
from dcp_stack.timestamps import StampClock

from .motion import motion_of

RESTART_GAP: Final = 1 << 16
"""A step of the sequence number by this or more, or backwards, counts as a restart of the node, not as loss.

An entry lives for seconds after a report, and no node makes 65536 reports in that time.
"""
EWMA_ALPHA: Final = 0.95
"""Weight of the past in the two averages, the default of the C++ implementation (gapSizeEWMAAlpha)."""
#: The times and statistics of an entry that are shown unchanged.
_SHOWN: Final = (
    *("reception_time", "received_at", "first_seen", "received", "repeated", "lost", "restarts"),
    *("mean_gap", "mean_interval"),
)


class NeighbourTableEntry(msgspec.Struct, frozen=True, gc=False):
    """``NeighbourTableEntry``: the last report of a neighbour, and statistics of its reports.

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
    """Sender of the beacon; differs from ``node_id`` in a forwarded or forged report (SRP-RX-05)."""
    first_seen: int
    """Wall time in ns of the first report."""
    fresh_at: int
    """Time of the first reception of this sequence number (monotonic ns); repetitions do not change it."""
    received: int = 1
    """Number of reports without repetitions."""
    repeated: int = 0
    """Number of reports with the sequence number of the one before, as in mode REPEAT."""
    lost: int = 0
    """Number of missing sequence numbers: reports lost in transmission, or replaced by their node before."""
    restarts: int = 0
    """Number of steps of the sequence number backwards or by :data:`RESTART_GAP` or more."""
    mean_gap: float = 1.0
    """EWMA of the steps of the sequence number; 1 without loss."""
    mean_interval: float | None = None
    """EWMA of the time between two different reports, in ns; None before the second."""
    before: ExtendedSafetyData | None = None
    """The report before ``ext_sd`` by the same run of the node, None after a restart."""
    before_at: int = 0
    """``fresh_at`` of ``before``."""

    def age(self, now: int) -> int:
        """Return the time in ns since ``ext_sd`` was received, at the monotonic time ``now``."""
        return now - self.received_at


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
        # Nodes with a single report, the oldest first: replaced first, since a flood of forged identifiers has such.
        self._once: dict[bytes, None] = {}
        self.displaced: bytes | None = None
        """The node that :meth:`record` replaced last; the caller resets it."""

    def __len__(self) -> int:
        return len(self._entries)

    def __iter__(self) -> Iterator[NeighbourTableEntry]:
        return iter(tuple(self._entries.values()))

    def __contains__(self, node_id: object) -> bool:
        return node_id in self._entries

    # -- the operations of the specification ------------------------------------------------------------------

    ##= SRP-NT-01
    def lookup(self, node_id: bytes) -> NeighbourTableEntry | None:
        """``ntLookup``: return the entry of a node, or None."""
        return self._entries.get(node_id)

    ##= SRP-NT-02
    def list_all_node_ids(self) -> list[bytes]:
        """``ntListAllNodeIds``: return the nodes in the table, in no guaranteed order."""
        return [*self._entries]

    # -- further queries --------------------------------------------------------------------------------------

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
        return motion_of(self.fields, entry.ext_sd.s_data, earlier, elapsed)

    def delay(self, entry: NeighbourTableEntry) -> int | None:
        """Return the ns from the stamp of a report to its reception: delay of BP and bearer if clocks agree.

        None where the epoch of stamps is not comparable (simulation, boot).
        """
        if not self.stamps.comparable:
            return None
        return entry.reception_time - self.stamps.wall(entry.ext_sd.t_stamp, near=entry.reception_time)

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

    # -- maintenance, for SRP itself --------------------------------------------------------------------------

    def record(
        self, report: ExtendedSafetyData, sender_id: bytes, *, now: int, wall: int
    ) -> Literal["new", "replaced", "full"]:
        """Insert a report or replace the entry of its node.

        A full table replaces an entry: the oldest of those with a single report, otherwise the one that was silent for
        longest; ``displaced`` names it.
        """
        ##= SRP-RX-05
        node_id = report.node_id
        old = self._entries.get(node_id)
        if old is None:
            if len(self._entries) >= self.capacity:
                self.displaced = self._least_useful()
                self._remove(self.displaced)
            self._once[node_id] = None
        else:
            self._once.pop(node_id, None)
        ##= SRP-RX-03 SRP-RX-04
        # Also when its sequence number is lower: the node may have restarted.
        self._entries[node_id] = (
            NeighbourTableEntry(node_id, report, wall, now, sender_id, wall, now)
            if old is None
            else _succeed(old, report, sender_id, now, wall, self._modulus)
        )
        return "new" if old is None else "replaced"

    def expire(self, now: int, timeout: int) -> list[bytes]:
        """Remove entries received more than ``timeout`` ns before ``now``; return their nodes."""
        ##= SRP-RUN-02
        gone = [node_id for node_id, entry in self._entries.items() if now - entry.received_at > timeout]
        for node_id in gone:
            self._remove(node_id)
        return gone

    def expire_at(self, wall: int, timeout: int) -> list[bytes]:
        """As :meth:`expire` by the system time, in ns since 1970 (X50 ``system-time``)."""
        gone = [node_id for node_id, entry in self._entries.items() if wall - entry.reception_time > timeout]
        for node_id in gone:
            self._remove(node_id)
        return gone

    def clear(self) -> None:
        """Remove all entries."""
        self._entries.clear()
        self._once.clear()

    def _least_useful(self) -> bytes:
        if self._once:
            return next(iter(self._once))
        return min(self._entries.values(), key=lambda entry: entry.received_at).node_id

    def _remove(self, node_id: bytes) -> None:
        del self._entries[node_id]
        self._once.pop(node_id, None)


def seqno_modulus(profile: Profile) -> int:
    """Return the modulus of sequence numbers: 2^32, or less if the profile has fewer octets for them."""
    return min(SRP_SEQNO_MODULUS, 1 << (8 * profile.types.srp_seqno.width))


##= SRP-NT-04
def _succeed(
    old: NeighbourTableEntry, report: ExtendedSafetyData, sender_id: bytes, now: int, wall: int, modulus: int
) -> NeighbourTableEntry:
    """Return the entry that replaces ``old`` and continues its statistics."""
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
