"""When beacons are prepared (dcp-bp.md#bp-transmit-path).

The specification only asks that the number of beacons in a long time T tends to T / BPPAR_BEACON_PERIOD. Here the
intervals between the *slots* of a schedule are independent, each the period times a uniform factor in
1 - jitter .. 1 + jitter (or an exponential one with the mean 1, for studies), and a slot is planned from the slot
before it, not from the time of the call that used it:

* Independent intervals rather than jitter around a fixed grid: the phases of two nodes drift apart like random walks,
  while on equal grids two nodes that collided once keep the same probability of a collision.
* A late call delays one beacon and none after it, so the mean stays the period. Slots that have passed are left
  out, and two beacons are never closer than a quarter of an interval: no bursts.
* A trigger moves the beacon of the next slot forward, at most to the slot before, and adds none. A client that answers
  each transmission with a new payload therefore cannot cause an endless sequence of beacons.
"""

from __future__ import annotations

import random
from typing import Final

from dcp_stack.config import BPConfig

SPACING: Final = 4
"""Beacons are at least 1/4 of an interval apart, late calls and triggers included."""


class BeaconSchedule:
    """The slots of one node, in monotonic ns."""

    def __init__(self, *, rng: random.Random, period: int, config: BPConfig, now: int) -> None:
        """``period`` in ns, at least 1; the jitter of ``config`` is 0 (strict) .. below 1, else ValueError."""
        jitter = config.jitter
        if not 0 <= jitter < 1:
            raise ValueError(f"jitter must be in 0..1 without 1, not {jitter!r}")
        self._rng = rng
        self._jitter = 0.0 if config.intervals == "fixed" else jitter
        self._exponential = config.intervals == "exponential"
        self._period = period
        self._sent_at: int | None = None
        self.due = 0
        """The time at which the next beacon is due, in monotonic ns."""
        self.restart(now)

    def restart(self, now: int) -> None:
        """Restart: the first slot is one interval after ``now``."""
        self._anchor = now
        self._plan()

    def set_period(self, period: int) -> None:
        """Change the period, and move the next slot as if the period had always been this."""
        ##= BP-PAR-02
        self._period = period
        self._place()

    def _plan(self) -> None:
        ##= BP-TX-02
        if self._exponential:
            self._factor = self._rng.expovariate(1.0)
        else:
            self._factor = self._rng.uniform(1 - self._jitter, 1 + self._jitter)
        self._place()

    def _place(self) -> None:
        interval = max(round(self._period * self._factor), 1)
        self._gap = max(interval // SPACING, 1)
        self._slot = self._anchor + interval
        self.due = self._slot if self._sent_at is None else max(self._slot, self._sent_at + self._gap)

    def passed(self, now: int, *, sent: bool) -> int:
        """Plan the next slot after the due one was used, or had nothing to send, at ``now``.

        Returns the number of slots that passed unused.
        """
        if sent:
            self._sent_at = now
        ##= BP-TX-01
        self._anchor = self._slot
        self._plan()
        if self._slot > now:
            return 0
        # In one step: a machine that slept for a month must not loop through the slots of a month.
        left_out = (now - self._slot) // self._period + 1
        self._anchor += left_out * self._period
        self._place()
        return left_out

    def trigger(self, now: int) -> None:
        """Move the next beacon forward to ``now``, or to the earliest later time that the rules above allow."""
        earliest = max(now, self._anchor)
        if self._sent_at is not None:
            earliest = max(earliest, self._sent_at + self._gap)
        ##= BP-TXP-07
        self.due = min(self.due, earliest)
