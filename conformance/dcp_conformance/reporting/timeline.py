"""The timeline of a case, as the page shows it."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby
from typing import Any

from dcp_conformance.model.results import CaseResult

from .frames import ARROWS, Frames

#: Lines of a timeline that the page shows at its beginning and at its end; recordings have all of them.
_LINES = 60
#: Beacons that say the same before the others are told together, if there are more of these than that.
_REPEATED = 2
#: Frames of a check that the page takes apart.
MOST_FRAMES = 3


def begin_of(case: CaseResult) -> int:
    """The time that a case's timeline counts from, ns since 1970."""
    return case.evidence[0].time if case.evidence else 0


def timeline_of(case: CaseResult, apart: Frames) -> Iterator[dict[str, Any]]:
    begin, events = begin_of(case), case.evidence
    skipped = len(events) - 2 * _LINES
    for index, event in enumerate(events):
        if skipped > 0 and _LINES <= index < len(events) - _LINES:
            if index == _LINES:
                yield {
                    "time": "",
                    "arrow": "",
                    "who": "",
                    "frame": 0,
                    "text": f"... {skipped} lines ...",
                    "kind": "note",
                }
            continue
        yield {
            "time": f"{(event.time - begin) / 1e6:.1f}",
            "arrow": ARROWS.get(event.direction, ""),
            "who": event.who,
            "frame": event.frame,
            "text": apart.line(event) if event.octets else event.text,
            "kind": event.direction,
        }


def told_together(lines: list[dict[str, Any]], case: CaseResult) -> list[dict[str, Any]]:
    """A timeline in which beacons that only say again what the last one said are one line.

    Frames that the page takes apart have their line, and so has everything in stretches that are short.
    """
    frames = (dict.fromkeys(mark.frame for mark in check.frames) for check in case.checks)
    apart = {number for each in frames for number in [*each][:MOST_FRAMES]}

    def what(line: dict[str, Any]) -> tuple[Any, ...]:
        return line["kind"], line["who"], _without_number(line), line["frame"] in apart and line["frame"]

    shown: list[dict[str, Any]] = []
    for _, group in groupby(lines, key=what):
        alike = list(group)
        repeated = alike[_REPEATED:]
        if alike[0]["kind"] != "heard" or len(repeated) <= _REPEATED:
            shown += alike
            continue
        text = f"... {len(repeated)} more like this, until {alike[-1]['time']} ms"
        shown += alike[:_REPEATED]
        shown.append({"time": "", "arrow": "", "who": "", "frame": 0, "text": text, "kind": "note"})
    return shown


def _without_number(line: dict[str, Any]) -> str:
    """What a beacon says, without its sequence number."""
    text: str = line["text"]
    return text.partition(" ")[2] if line["kind"] == "heard" else text
