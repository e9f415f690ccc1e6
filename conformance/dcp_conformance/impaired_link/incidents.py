"""Descriptions of the incidents of an impaired link."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final

from dcp_conformance.lower_tester import Incident

_DONE: Final = {
    "lost": "lost",
    "down": "lost while the link was down",
    "corrupted": "corrupted",
    "duplicated": "duplicated",
    "reordered": "held back",
    "late": "delayed more than usual",
}
#: Maximum number of frames that are named.
_MOST: Final = 3


def incidents_text(incidents: Iterable[Incident], numbers: Sequence[int]) -> str:
    """Describe incidents in one line: ``lost on the impaired link: frame 12, 2 beacons of the implementation``.

    ``numbers`` has for each incident the number of the frame in the recording of the case; 0 if it was not recorded.
    """
    kinds: dict[str, list[tuple[Incident, int]]] = {}
    for incident, number in zip(incidents, numbers, strict=True):
        kinds.setdefault(incident.what, []).append((incident, number))
    return "; ".join(f"{_DONE[what]} on the impaired link: {_frames(found)}" for what, found in kinds.items())


def _frames(found: Sequence[tuple[Incident, int]]) -> str:
    to = [number for incident, number in found if incident.to]
    named = sorted({number for number in to if number})
    parts = []
    if named:
        more = f" and {len(named) - _MOST} more" if len(named) > _MOST else ""
        word = "frame" if len(named) == 1 else "frames"
        parts.append(f"{word} {', '.join(map(str, named[:_MOST]))}{more} to the implementation")
    if unnamed := len(to) - sum(1 for number in to if number):
        parts.append(f"{_count(unnamed, 'frame')} of an earlier case")
    if heard := len(found) - len(to):
        parts.append(f"{_count(heard, 'beacon')} of the implementation")
    return ", ".join(parts)


def _count(number: int, what: str) -> str:
    return f"{number} {what}" if number == 1 else f"{number} {what}s"
