"""The senders of a recording: their restarts, and the beacons that the recorder missed.

A recorder loses frames, and nodes are restarted. A conclusion from a missing record, or from an earlier record of the
same node, is valid only if no beacon of the node is missing in between.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from dcp_spec.constants import BP_SEQNO_MODULUS

#: A gap of more than this number of missing beacons can hide a restart.
_LONG_GAP = 20
#: For senders without sequence numbers: a pause of more than this (ns) is treated as a long gap.
_PAUSE = 2_000_000_000
#: Time in ns after which a gap in the recording must have shown.
GAP_SHOWS = 2_000_000_000
#: Maximum number of gaps that are remembered.
_GAPS = 256


@dataclass(slots=True)
class Sender:
    """The state of one sending node. Times are in ns since 1970."""

    first: int
    """Time of its first beacon."""
    time: int
    """Time of its last beacon."""
    seqno: int | None
    """Last sequence number; None if its beacons are not numbered."""
    life: int = 0
    """Number of restarts, including possible ones."""
    unbroken: int = 0
    """Time since which none of its beacons is missing."""
    beacons: int = 0
    """Number of beacons in the recording."""
    in_life: int = 1
    """Number of beacons since the last (possible) restart."""


class Senders:
    """All senders of a recording."""

    def __init__(self, most: int) -> None:
        """``most``: maximum number of senders to follow; further ones are ignored."""
        self._most = most
        self._known: dict[bytes, Sender] = {}
        self._gaps: deque[tuple[int, int]] = deque(maxlen=_GAPS)
        self._restarted: set[bytes] = set()

    def restarted(self, who: bytes) -> None:
        """Announce that a node was restarted: its next beacon begins a new life, whatever its sequence number is."""
        if who in self._known:
            self._restarted.add(who)

    def feed(self, who: bytes, seqno: int | None, time: int) -> None:
        """Process a beacon; ``time`` in ns since 1970, ``seqno`` None if it has no sequence number."""
        sender = self._known.get(who)
        if sender is None:
            if len(self._known) < self._most:
                self._known[who] = Sender(time, time, seqno, unbroken=time, beacons=1)
            return
        sender.beacons += 1
        missed = 0
        if seqno is not None and sender.seqno is not None:
            step = (seqno - sender.seqno) % BP_SEQNO_MODULUS
            # The number of the only beacon so far again: a restart after a single beacon, or a copy of that beacon.
            again = not step and sender.in_life == 1
            missed = _LONG_GAP + 1 if again else max(step - 1, 0)
        elif time - sender.time > _PAUSE:
            missed = _LONG_GAP + 1
        if who in self._restarted:
            self._restarted.discard(who)
            missed = _LONG_GAP + 1
        if missed:
            self._gaps.append((sender.time, time))
            sender.unbroken = time
            if missed > _LONG_GAP:
                sender.life += 1
                sender.in_life = 0
        sender.in_life += 1
        sender.time, sender.seqno = time, seqno if seqno is not None else sender.seqno

    def get(self, who: bytes) -> Sender | None:
        """Return the state of a sender; None if it is not followed."""
        return self._known.get(who)

    def life(self, who: bytes) -> int:
        """Return the number of restarts of a sender, including possible ones; 0 if it is not followed."""
        sender = self._known.get(who)
        return 0 if sender is None else sender.life

    def unbroken(self, who: bytes, since: int) -> bool:
        """Whether no beacon of a sender is missing since the time ``since`` (ns since 1970), or since its first one."""
        sender = self._known.get(who)
        return sender is not None and sender.unbroken <= max(since, sender.first)

    def complete(self, begin: int, end: int) -> bool:
        """Whether no beacon of any sender is known to be missing between two times (ns since 1970)."""
        if not self._gaps:
            return True
        if len(self._gaps) == _GAPS and self._gaps[0][0] > begin:
            return False
        return not any(first <= end and last >= begin for first, last in self._gaps)
