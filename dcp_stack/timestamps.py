"""Time stamps on the wire and wall time in ns, for the ``TimeStampT`` of a profile (DATA-05).

Wall time is an int in ns since 1970-01-01T00:00:00Z, as ``time.time_ns`` gives it; leap seconds are not counted, in no
epoch: a ``gps`` stamp counts from 1980-01-06T00:00:00Z as the rest of this code base shows it. A stamp is the integer
in the record: units of the profile since its epoch, wrapped to its width.
"""

from __future__ import annotations

from typing import Final

from dcp_spec.profile.definition import TimestampType

_PS_PER_SECOND: Final = 10**12
_PS_PER_NS: Final = 1_000


class StampClock:
    """Converts between wall time and the stamps of one profile.

    ``origin`` is the wall time (ns) of the profile's epoch where that is no calendar date (``simulation``, ``boot``):
    a node takes the time it was created. Stamps of other nodes with such an epoch cannot be related to wall time
    unless their origin is the same; :attr:`comparable` says whether they can be.
    """

    def __init__(self, layout: TimestampType, *, origin: int = 0) -> None:
        self.layout = layout
        self.comparable = layout.epoch_ns is not None
        self._origin = origin if layout.epoch_ns is None else layout.epoch_ns
        self._unit = _PS_PER_SECOND // layout.per_second
        self._modulus = 1 << (8 * layout.width)
        self._lowest = -(self._modulus >> 1) if layout.signed else 0

    @property
    def period_ns(self) -> int:
        """After how many ns stamps start again, rounded down."""
        return self._modulus * self._unit // _PS_PER_NS

    def stamp(self, wall: int) -> int:
        """The stamp for a wall time: rounded down to the unit, wrapped into the range of the type. Never raises."""
        units = (wall - self._origin) * _PS_PER_NS // self._unit
        return (units - self._lowest) % self._modulus + self._lowest

    def wall(self, stamp: int, *, near: int) -> int:
        """The wall time (ns, rounded down) of ``stamp``: of all that it can stand for, the nearest to ``near``."""
        units = (near - self._origin) * _PS_PER_NS // self._unit
        half = self._modulus >> 1
        ahead = (stamp - units + half) % self._modulus - half
        return self._origin + (units + ahead) * self._unit // _PS_PER_NS

    def between(self, earlier: int, later: int) -> int:
        """The ns (rounded down) from one stamp of a node to another; negative if ``later`` is the earlier one."""
        half = self._modulus >> 1
        units = (later - earlier + half) % self._modulus - half
        return units * self._unit // _PS_PER_NS
