"""Variants whose clock is wrong, or is set during the test."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from dcp_conformance.definitions.pics import Testing
from dcp_conformance.reference.surroundings import Setup

from .variant import Variant, setup

_S: Final = 1_000_000_000
_HOUR: Final = 3600 * _S
_WHY = "dcp-data-types.md: TimeStampT is the system time, which is not required to be correct or monotonic"


def _clock(offset: Callable[[int], int], tolerance_ms: float | None = None) -> Callable[[str], Setup]:
    def build(profile: str) -> Setup:
        pixit = Testing() if tolerance_ms is None else Testing(clock_tolerance_ms=tolerance_ms)
        return setup(profile, clock=offset, pixit=pixit)

    return build


def _back_and_forth(now: int) -> int:
    """Return an offset in ns that changes by 0.5 s every 7 s and stays within the default tolerance of 1 s."""
    return (0, _S // 2, 0, -_S // 2)[now // (7 * _S) % 4]


def _hours(now: int) -> int:
    """Return an offset in ns that changes by one or two hours every 11 s."""
    return (0, -_HOUR, _HOUR)[now // (11 * _S) % 3]


def _set_back(now: int) -> int:
    """Return an offset in ns that alternates between 1 s and -0.5 s every 2 s, so that services fall on both sides."""
    return _S if now // (2 * _S) % 2 else -_S // 2


#: The clock tolerance that steps of two hours need, in ms.
_TWO_HOURS_MS: Final = 7_300_000.0
#: The clock was set between two readings.
_SET: Final = r"^TC_BP_PTI_TI_0[12]: a clock that is not set during the case"

VARIANTS = (
    Variant("V-CLOCK-fast", "has a clock that gains 200 ppm", _WHY, _clock(lambda now: now // 5000)),
    Variant("V-CLOCK-slow", "has a clock that loses 200 ppm", _WHY, _clock(lambda now: -now // 5000)),
    Variant("V-CLOCK-ahead", "has a clock that is 0.9 s ahead", _WHY, _clock(lambda now: 9 * _S // 10 + 0 * now)),
    Variant("V-CLOCK-day-behind", "has a clock that is a day late, and the PIXIT allows it", _WHY,
        _clock(lambda now: -24 * _HOUR + 0 * now, 25 * 3_600_000.0)),
    Variant("V-CLOCK-steps", "has a clock that is set by 0.5 s every 7 s", _WHY, _clock(_back_and_forth),
        explains=(_SET,)),
    Variant("V-CLOCK-hours", "has a clock that is set by one or two hours every 11 s, and the PIXIT allows it", _WHY,
        _clock(_hours, _TWO_HOURS_MS), explains=(_SET,)),
    Variant("V-CLOCK-set-back", "has a clock that is set back by 1.5 s every 4 s, and the PIXIT allows it", _WHY,
        _clock(_set_back, 3000.0), explains=(_SET,)),
)  # fmt: skip
