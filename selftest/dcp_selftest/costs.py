"""Cases that take most of the processor time of a whole suite in virtual time."""

from __future__ import annotations

from typing import Final

COUNTING: Final = frozenset({"TC_BP_HDR_TI_01", "TC_SRP_SEQ_TI_01"})
"""Cases that wait for 65,536 beacons: two thirds of the time."""
