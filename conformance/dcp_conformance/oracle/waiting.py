"""Payloads that were left out of a beacon (dcp-bp.md: Transmit Path): what they say is older than usual."""

from __future__ import annotations


class Waiting:
    """Estimate from the beacons of one node how long its VarDis payloads waited for room."""

    def __init__(self, period: int, most: int) -> None:
        """``period``: of beacons, ns; ``most``: octets of the largest beacon."""
        # An interval may be 10 % longer than the period.
        self._interval = period * 11 // 10
        self._most = most
        self._before: int | None = None

    def of(self, octets: int, *, vardis: bool) -> int:
        """Note a beacon of this size in octets. Return how much longer the payload may have waited.

        In ns; more than 0 if the beacon before had none, and no room for this one.
        """
        before, self._before = self._before, None if vardis else octets
        return self._interval if vardis and before is not None and before + octets > self._most else 0
