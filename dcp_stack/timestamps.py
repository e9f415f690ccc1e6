"""Time stamps on the wire and wall time in ns, for the ``TimeStampT`` of a profile (DATA-05).

Wall time is an int in ns since 1970-01-01T00:00:00Z, as ``time.time_ns`` gives it. No epoch counts leap
seconds: a ``gps`` stamp counts from 1980-01-06T00:00:00Z without them. A stamp is the integer
in the record: units of the profile since its epoch, wrapped to its width.
"""

from __future__ import annotations

from typing import Final

from dcp_spec.profile.definition import TimestampType

_PS_PER_SECOND: Final = 10**12
_PS_PER_NS: Final = 1_000


class StampClock:
    """Converts between wall time and the stamps of one profile.

    ``origin`` is the wall time (ns) of an epoch without calendar date (``simulation``, ``boot``): for a node the
    time of its creation. Stamps of other nodes with such an epoch cannot be related to wall time
    unless their origin is the same; :attr:`comparable` is True if they can be related.
    """

    def __init__(self, layout: TimestampType, *, origin: int = 0) -> None:
        self.comparable = layout.epoch_ns is not None
        self._origin = origin if layout.epoch_ns is None else layout.epoch_ns
        self._unit = _PS_PER_SECOND // layout.per_second
        self._modulus = 1 << (8 * layout.width)
        self._lowest = -(self._modulus >> 1) if layout.signed else 0

    def stamp(self, wall: int) -> int:
        """Return the stamp of a wall time: rounded down to the unit, modulo the range of the type. Never raises."""
        units = (wall - self._origin) * _PS_PER_NS // self._unit
        return (units - self._lowest) % self._modulus + self._lowest

    def wall(self, stamp: int, *, near: int) -> int:
        """Return the wall time of ``stamp`` that is nearest to ``near`` (ns, rounded down); stamps wrap."""
        units = (near - self._origin) * _PS_PER_NS // self._unit
        half = self._modulus >> 1
        ahead = (stamp - units + half) % self._modulus - half
        return self._origin + (units + ahead) * self._unit // _PS_PER_NS

    def between(self, earlier: int, later: int) -> int:
        """Return the ns (rounded down) between two stamps of a node; negative if ``later`` is the earlier one."""
        half = self._modulus >> 1
        units = (later - earlier + half) % self._modulus - half
        return units * self._unit // _PS_PER_NS
