"""``report.html``: one page that needs nothing else."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime
from itertools import groupby
from typing import Any

from dcp_spec.readings import readings, told
from dcp_spec.reasons import REASONS
from dcp_spec.requirements import requirements
from jinja2 import Environment, PackageLoader, StrictUndefined

from dcp_codec.capture.frame import Frame
from dcp_codec.codec import Codec
from dcp_codec.dissect import Field
from dcp_codec.frames import DissectedFrame
from dcp_codec.framing import Framing
from dcp_codec.plan import Group
from dcp_codec.texts import payload_line, value_text
from dcp_conformance.results import CaseResult, Check, EventRecord, Mark, RunResult
from dcp_conformance.verdict import Verdict

#: Lines of a timeline that the page shows at its beginning and at its end; recordings have all of them.
_LINES = 60
#: Beacons that say the same before the others are told together, if there are more of these than that.
_REPEATED = 2
#: Findings that are open when the page is.
_OPEN = 10
#: Frames of a check that the page takes apart.
_FRAMES = 3
_ORDER = (
    Verdict.FAIL,
    Verdict.ERROR,
    Verdict.INCONCLUSIVE,
    Verdict.PASS,
    Verdict.INFO,
    Verdict.NOT_APPLICABLE,
)


def environment() -> Environment:
    """The templates of this package; everything in them is escaped."""
    return Environment(
        loader=PackageLoader("dcp_conformance.reporting"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def render(run: RunResult, codec: Codec | None) -> str:
    """The page of one run."""
    apart = _Apart(codec)
    known = requirements()
    cases = [_case(case, number, apart) for number, case in enumerate(run.cases)]
    return (
        environment()
        .get_template("report.html")
        .render(
            run=run,
            title=" ".join(filter(None, (run.sut.name, run.sut.version))) or "An implementation of DCP",
            tables=[table for table in ("conformance", "robustness") if any(run.summary.get(table, {}).values())],
            order=[str(verdict) for verdict in _ORDER],
            sections=_sections(run),
            open_findings=_OPEN,
            findings=[case for case in cases if case["verdict"] in ("fail", "error")],
            cases=cases,
            matrix=list(_matrix(run, cases)),
            failing=_failing(cases),
            requirement_counts=_counts(run),
            readings=[
                {"id": key, "title": readings()[key].title, "observed": [told(key, each) for each in names]}
                for key, names in run.readings.items()
                if key in readings()
            ],
            known=known,
        )
    )


def _counts(run: RunResult) -> dict[str, int]:
    counts = {str(verdict): 0 for verdict in _ORDER}
    for verdict in run.requirements.values():
        counts[str(verdict)] += 1
    return {name: count for name, count in counts.items() if count}


def _sections(run: RunResult) -> list[dict[str, Any]]:
    found: dict[tuple[str, str], dict[str, int]] = {}
    for case in run.cases:
        counts = found.setdefault((case.table, case.section), {str(verdict): 0 for verdict in _ORDER})
        counts[str(case.verdict)] += 1
    return [
        {"table": table, "name": section, "counts": counts, "total": sum(counts.values())}
        for (table, section), counts in sorted(found.items())
    ]


def _matrix(run: RunResult, cases: list[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """A row for each requirement that any case or check is about, in the order of the catalogue."""
    named = [
        {*case["requirements"], *(each for check in case["checks"] for each in check["requirements"])} for case in cases
    ]
    for identifier, entry in requirements().items():
        deciding = [case for case, names in zip(cases, named, strict=True) if identifier in names]
        if deciding:
            verdict = run.requirements.get(identifier)
            yield {
                "id": identifier,
                "statement": entry.statement,
                "section": entry.section,
                "level": entry.level,
                "verdict": str(verdict) if verdict is not None else "inconclusive",
                "cases": deciding,
            }


def _failing(cases: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The requirements that fail, with the cases in which they do; those with the most cases first."""
    found: dict[str, list[dict[str, Any]]] = {}
    for case in cases:
        failed = [check["requirements"] for check in case["checks"] if check["verdict"] == "fail"]
        for identifier in dict.fromkeys(each for names in failed for each in names):
            found.setdefault(identifier, []).append(case)
    known = requirements()
    rows = sorted(found.items(), key=lambda row: -len(row[1]))
    return [{"id": name, "entry": known[name], "cases": deciding} for name, deciding in rows if name in known]


def _case(case: CaseResult, number: int, apart: _Apart) -> dict[str, Any]:
    events = {event.frame: event for event in case.evidence if event.frame}
    return {
        "key": f"c{number}",
        "id": case.id if case.attempt == 1 else f"{case.id} (attempt {case.attempt})",
        "verdict": str(case.verdict),
        "purpose": case.purpose,
        "section": case.section,
        "table": case.table,
        "kind": {"BV": "valid", "BI": "invalid", "BO": "inopportune", "TI": "timer"}.get(case.kind, case.kind),
        "requirements": case.requirements,
        "stimulus": case.stimulus,
        "expectation": case.expectation,
        "window": case.window,
        "reason": case.reason,
        "explained": any(check.verdict is case.verdict and check.observed for check in case.checks),
        "duration": case.duration,
        "checks": [_check(check, events, apart, case) for check in case.checks],
        "timeline": _told_together(list(_timeline(case, apart)), case),
        "left_out": case.left_out,
        "recording": case.recording,
        "rerun": case.rerun,
        "killed": case.killed,
        "detail": case.error_detail,
        "search": f"{case.id} {case.purpose} {' '.join(case.requirements)} {case.section}".lower(),
    }


def _check(check: Check, events: dict[int, EventRecord], apart: _Apart, case: CaseResult) -> dict[str, Any]:
    notable = check.verdict.rank > Verdict.PASS.rank or (check.verdict is Verdict.INFO and bool(check.frames))
    marks: dict[int, list[Mark]] = {}
    for mark in check.frames:
        marks.setdefault(mark.frame, []).append(mark)
    shown = [events[number] for number in marks if number in events][:_FRAMES] if notable else []
    return {
        "verdict": str(check.verdict),
        "requirements": check.requirements,
        "expected": check.expected,
        "observed": check.observed,
        "frames": [apart.frame(event, marks[event.frame], _begin(case)) for event in shown],
        "more": len(marks) - len(shown) if notable else 0,
    }


def _begin(case: CaseResult) -> int:
    return case.evidence[0].time if case.evidence else 0


def _timeline(case: CaseResult, apart: _Apart) -> Iterator[dict[str, Any]]:
    begin, events = _begin(case), case.evidence
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
            "arrow": _ARROWS.get(event.direction, ""),
            "who": event.who,
            "frame": event.frame,
            "text": apart.line(event) if event.octets else event.text,
            "kind": event.direction,
        }


def _told_together(lines: list[dict[str, Any]], case: CaseResult) -> list[dict[str, Any]]:
    """A timeline in which beacons that only say again what the last one said are one line.

    Frames that the page takes apart have their line, and so has everything in stretches that are short.
    """
    frames = (dict.fromkeys(mark.frame for mark in check.frames) for check in case.checks)
    apart = {number for each in frames for number in [*each][:_FRAMES]}

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


_ARROWS = {
    "sent": "\u2192 SUT",
    "heard": "SUT \u2192",
    "other": "other",
    "call": "call",
    "answer": "answer",
    "notified": "notified",
    "note": "",
}


class _Apart:
    """Frames taken apart, as far as there is a codec."""

    def __init__(self, codec: Codec | None) -> None:
        self._codec = codec

    def _dissected(self, event: EventRecord) -> DissectedFrame | None:
        if self._codec is None:
            return None
        octets = bytes.fromhex(event.octets)
        found = self._codec.dissect(octets, start=event.start, base=event.start)
        frame = Frame(event.frame, event.time, octets, len(octets))
        return DissectedFrame(self._codec, frame, Framing(event.start, len(octets)), found)

    def line(self, event: EventRecord) -> str:
        """A frame in one line."""
        apart = self._dissected(event)
        if apart is None:
            return f"{len(event.octets) // 2} octets"
        seqno = apart.header.child("seqno") if apart.header is not None else None
        number = f"#{seqno.value}" if seqno is not None and seqno.value is not None else "#?"
        what = "  ".join(payload_line(payload) for payload in apart.payloads)
        errors = "; ".join(f"{problem.reason} at {problem.offset}" for problem in apart.dissection.errors)
        return f"{number} {what}" + (f"  [{errors}]" if errors else "")

    def frame(self, event: EventRecord, marks: list[Mark], begin: int) -> dict[str, Any]:
        """A frame with its octets, those of the marks marked, and its fields."""
        octets = bytes.fromhex(event.octets)
        apart = self._dissected(event)
        spans = [(mark.offset, mark.offset + mark.length) for mark in marks if mark.length]
        problems: list[str] = []
        if apart is not None:
            for problem in apart.dissection.errors:
                problems.append(
                    f"octet {problem.offset}: {problem.path}: {REASONS.get(problem.reason, problem.reason)}"
                )
                spans.append((problem.offset, problem.offset + 1))
        paths = {mark.path for mark in marks if mark.path}
        return {
            "number": event.frame,
            "time": f"{(event.time - begin) / 1e6:.1f}",
            "who": event.who,
            "direction": _ARROWS.get(event.direction, ""),
            "rows": list(_dump(octets, event.start, spans)),
            "fields": [] if apart is None or self._codec is None else list(_fields(self._codec, apart, paths)),
            "problems": problems,
        }


def _dump(octets: bytes, start: int, spans: list[tuple[int, int]]) -> Iterator[dict[str, Any]]:
    for row in range(0, len(octets), 16):
        cells = []
        for offset in range(row, min(row + 16, len(octets))):
            marked = any(first <= offset < last for first, last in spans)
            kind = "bad" if marked else "link" if offset < start else ""
            cells.append((f"{octets[offset]:02x}", kind))
        text = "".join(chr(octet) if 0x20 <= octet < 0x7F else "." for octet in octets[row : row + 16])
        yield {"offset": f"{row:04x}", "cells": cells, "text": text}


def _fields(codec: Codec, apart: DissectedFrame, marked: set[str]) -> Iterator[dict[str, Any]]:
    def walk(field: Field, depth: int) -> Iterator[dict[str, Any]]:
        text = value_text(codec.profile, field)
        bad = field.path in marked
        inside = isinstance(field.layout, Group) and field.layout.type_name == "Payload"
        yield {
            "depth": depth,
            "name": field.name or field.path.rpartition(".")[2],
            "offset": field.offset,
            "length": field.length,
            "value": payload_line(field) if inside else text,
            "bad": bad,
        }
        for child in field.children:
            yield from walk(child, depth + 1)

    for child in apart.dissection.root.children:
        yield from walk(child, 0)


def moment(text: str) -> str:
    """``2026-11-21T12:00:00Z`` for people."""
    try:
        return f"{datetime.fromisoformat(text).astimezone(UTC):%Y-%m-%d %H:%M UTC}"
    except ValueError:
        return text
