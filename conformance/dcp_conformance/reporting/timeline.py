"""Prepare the timeline of a case for the page: one line for each event, repeated beacons collapsed."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby
from typing import Any

from dcp_conformance.definitions.results import CaseResult

from .frames import ARROWS, Frames

#: Lines that the page shows at the beginning, and at the end, of a timeline. The recording contains all frames.
_LINES = 60
#: Number of equal beacons that are shown; further ones are collapsed into one line if there are more than this number.
_REPEATED = 2
#: Maximum number of frames of a check that the page dissects.
MOST_FRAMES = 3


def begin_of(case: CaseResult) -> int:
    """Return the time that counts as 0 in the timeline of a case, in ns since 1970."""
    return case.evidence[0].time if case.evidence else 0


def timeline_of(case: CaseResult, apart: Frames) -> Iterator[dict[str, Any]]:
    """Yield the lines of a timeline for the template; the middle of a long one is a single line with its length."""
    begin, events = begin_of(case), case.evidence
    skipped = len(events) - 2 * _LINES
    for index, event in enumerate(events):
        if skipped > 0 and _LINES <= index < len(events) - _LINES:
            if index == _LINES:
                yield _note(f"... {skipped} lines ...")
            continue
        yield {
            "time": f"{(event.time - begin) / 1e6:.1f}",
            "arrow": ARROWS.get(event.direction, ""),
            "who": event.who,
            "frame": event.frame,
            "text": apart.line(event) if event.octets else event.text,
            "kind": event.direction,
        }


def collapse_repeats(lines: list[dict[str, Any]], case: CaseResult) -> list[dict[str, Any]]:
    """Return a timeline in which consecutive beacons of the same content are collapsed into one line.

    Frames that the page dissects keep their own lines, and so do the beacons of short repetitions.
    """
    frames = (dict.fromkeys(mark.frame for mark in check.frames) for check in case.checks)
    apart = {number for each in frames for number in [*each][:MOST_FRAMES]}

    def content(line: dict[str, Any]) -> tuple[Any, ...]:
        # A beacon of the implementation begins with its sequence number.
        text = line["text"].partition(" ")[2] if line["kind"] == "heard" else line["text"]
        return line["kind"], line["who"], text, line["frame"] in apart and line["frame"]

    shown: list[dict[str, Any]] = []
    for _, group in groupby(lines, key=content):
        alike = list(group)
        repeated = alike[_REPEATED:]
        if alike[0]["kind"] != "heard" or len(repeated) <= _REPEATED:
            shown += alike
            continue
        note = _note(f"... {len(repeated)} more like this, until {alike[-1]['time']} ms")
        shown += [*alike[:_REPEATED], note]
    return shown


def _note(text: str) -> dict[str, Any]:
    return {"time": "", "arrow": "", "who": "", "frame": 0, "text": text, "kind": "note"}
