"""Dissect the frames of results for the page: octets, fields, problems."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from dcp_spec.reasons import REASONS

from dcp_codec.capture.frame import Frame
from dcp_codec.codec import Codec
from dcp_codec.framing.frames import DissectedFrame
from dcp_codec.framing.locate import Framing
from dcp_codec.plan.tree import Group
from dcp_codec.texts import payload_line, value_text
from dcp_codec.views.dissect import Field
from dcp_conformance.definitions.results import EventRecord, Mark

ARROWS = {
    "sent": "\u2192 SUT",
    "heard": "SUT \u2192",
    "other": "other",
    "call": "call",
    "answer": "answer",
    "notified": "notified",
    "note": "",
}


def octets_of(event: EventRecord) -> bytes:
    """Return the frame of an event; empty if the results do not contain hexadecimal digits there."""
    try:
        return bytes.fromhex(event.octets)
    except ValueError:
        return b""


def _start(event: EventRecord) -> int:
    """Return the offset of the bearer payload, limited to the frame: results are untrusted."""
    return min(max(event.start, 0), len(event.octets) // 2)


class Frames:
    """Formatter of frames. Without a codec it shows octets only."""

    def __init__(self, codec: Codec | None) -> None:
        self._codec = codec

    def _dissected(self, event: EventRecord) -> DissectedFrame | None:
        if self._codec is None:
            return None
        octets, start = octets_of(event), _start(event)
        found = self._codec.dissect(octets, start=start, base=start)
        frame = Frame(event.frame, event.time, octets, len(octets))
        return DissectedFrame(self._codec, frame, Framing(start, len(octets)), found)

    def line(self, event: EventRecord) -> str:
        """Return a frame in one line: sequence number, payloads, errors; its length if there is no codec."""
        apart = self._dissected(event)
        if apart is None:
            return f"{len(octets_of(event))} octets"
        seqno = apart.header.child("seqno") if apart.header is not None else None
        number = f"#{seqno.value}" if seqno is not None and seqno.value is not None else "#?"
        what = "  ".join(payload_line(payload) for payload in apart.payloads)
        errors = "; ".join(f"{problem.reason} at {problem.offset}" for problem in apart.dissection.errors)
        return f"{number} {what}" + (f"  [{errors}]" if errors else "")

    def frame(self, event: EventRecord, marks: list[Mark], begin: int) -> dict[str, Any]:
        """Return the octets, fields and problems of a frame for the template, with the marked octets and fields.

        ``begin`` is the time that counts as 0, in ns since 1970.
        """
        octets = octets_of(event)
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
            "direction": ARROWS.get(event.direction, ""),
            "rows": list(_dump(octets, _start(event), spans)),
            "fields": [] if apart is None or self._codec is None else list(_fields(self._codec, apart, paths)),
            "problems": problems,
        }


def _dump(octets: bytes, start: int, spans: list[tuple[int, int]]) -> Iterator[dict[str, Any]]:
    """Yield the rows of a hex dump; ``spans`` are the ranges (first, end) of marked octets."""
    for row in range(0, len(octets), 16):
        cells = []
        for offset in range(row, min(row + 16, len(octets))):
            marked = any(first <= offset < last for first, last in spans)
            kind = "bad" if marked else "link" if offset < start else ""
            cells.append((f"{octets[offset]:02x}", kind))
        text = "".join(chr(octet) if 0x20 <= octet < 0x7F else "." for octet in octets[row : row + 16])
        yield {"offset": f"{row:04x}", "cells": cells, "text": text}


def _fields(codec: Codec, apart: DissectedFrame, marked: set[str]) -> Iterator[dict[str, Any]]:
    """Yield the fields of a frame in order, with their depth in the tree; ``marked`` are paths of fields."""

    def walk(field: Field, depth: int) -> Iterator[dict[str, Any]]:
        inside = isinstance(field.layout, Group) and field.layout.type_name == "Payload"
        yield {
            "depth": depth,
            "name": field.name or field.path.rpartition(".")[2],
            "offset": field.offset,
            "value": payload_line(field) if inside else value_text(codec.profile, field),
            "bad": field.path in marked,
        }
        for child in field.children:
            yield from walk(child, depth + 1)

    for child in apart.dissection.root.children:
        yield from walk(child, 0)
