"""Who speaks in a recording, and what of it the recorder may have missed.

A recorder loses frames, and nodes are restarted. Whatever is concluded from a node's *not* having said something, or
from its having said something before, holds only while nothing of it was missed.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from dcp_spec.constants import BP_SEQNO_MODULUS

#: More than so many beacons of a sender that are not in the recording can hide a restart.
_LONG_GAP = 20
#: For senders without numbers: a pause of so many ns can hide anything.
_PAUSE = 2_000_000_000
#: Gaps that are remembered.
_GAPS = 256


@dataclass(slots=True)
class Sender:
    """One node, as far as the recording shows it. Times are ns since 1970."""

    first: int
    time: int
    seqno: int | None
    life: int = 0
    """Counts restarts, also possible ones."""
    unbroken: int = 0
    """Since when none of its beacons is missing."""
    beacons: int = 0
    in_life: int = 1
    """Beacons since the last restart, or possible one."""


class Senders:
    """All senders of a recording."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._known: dict[bytes, Sender] = {}
        self._gaps: deque[tuple[int, int]] = deque(maxlen=_GAPS)
        self._restarted: set[bytes] = set()

    def restarted(self, who: bytes) -> None:
        """Somebody has restarted a node: its next beacon begins a new life, whatever its number."""
        if who in self._known:
            self._restarted.add(who)

    def feed(self, who: bytes, seqno: int | None, time: int) -> None:
        """A beacon; ``seqno`` None where beacons are not numbered, or this one is none."""
        sender = self._known.get(who)
        if sender is None:
            if len(self._known) < self._most:
                self._known[who] = Sender(time, time, seqno, unbroken=time, beacons=1)
            return
        sender.beacons += 1
        missed = 0
        if seqno is not None and sender.seqno is not None:
            step = (seqno - sender.seqno) % BP_SEQNO_MODULUS
            # Twice the number of its first beacon: a restart after a single beacon, or a copy of that beacon.
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
        """A sender, None for one that is not followed."""
        return self._known.get(who)

    def life(self, who: bytes) -> int:
        """Changes when a sender was restarted, or may have been."""
        sender = self._known.get(who)
        return 0 if sender is None else sender.life

    def unbroken(self, who: bytes, since: int) -> bool:
        """Whether no beacon of a sender is missing from ``since``, or its first one, to its last one."""
        sender = self._known.get(who)
        return sender is not None and sender.unbroken <= max(since, sender.first)

    def complete(self, begin: int, end: int) -> bool:
        """Whether no beacon of anybody is known to be missing between two times."""
        if self._gaps and len(self._gaps) == _GAPS and self._gaps[0][0] > begin:
            return False
        return not any(first <= end and last >= begin for first, last in self._gaps)
