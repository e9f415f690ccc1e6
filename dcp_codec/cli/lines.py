"""Frames as lines of text, rows of CSV, and JSON lines."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterator
from typing import Any

import click
import msgspec

from dcp_codec.codec import Codec
from dcp_codec.common.spreadsheet import safe_cell
from dcp_codec.errors import Problem
from dcp_codec.framing.frames import DissectedFrame
from dcp_codec.framing.locate import mac
from dcp_codec.jsonform import beacon_json
from dcp_codec.texts import payload_line, utc


class ListRenderer:
    """One line per frame: number, time, sender, sequence number, content, problems.

    ``time`` is ``utc``, ``epoch`` or ``relative``: seconds since the time that ``origin`` returns, in ns.
    """

    def __init__(self, *, width: int | None, colour: bool, time: str, origin: Callable[[], int]) -> None:
        self.width = width
        self.colour = colour
        self.time = time
        self.origin = origin

    def render(self, frame: DissectedFrame) -> str:
        """Return the line of one frame, cut at the width of the terminal; piped output is never cut."""
        time_ns = frame.frame.time_ns
        if self.time == "relative":
            when = f"{(time_ns - self.origin()) / 1e9:12.6f}"
        elif self.time == "epoch":
            when = f"{time_ns // 10**9}.{time_ns % 10**9:09d}"
        else:
            when = utc(time_ns)
        header = frame.header
        seqno = header.child("seqno") if header is not None else None
        number = f"#{seqno.value}" if seqno is not None and seqno.value is not None else "#?"
        what = "  ".join(payload_line(payload) for payload in frame.payloads)
        text = f"{frame.frame.number:>6}  {when}  {frame.sender or '?':<17}  {number:<7} {what}"
        if frame.dissection.padding:
            text += f"  +{len(frame.dissection.padding)} padding"
        errors = [f"{p.reason} at {p.offset} ({p.path or 'beacon'}) [{p.requirement}]" for p in frame.dissection.errors]
        wrong = "  ERROR " + "; ".join(errors) if errors else ""
        if self.width is not None and len(text) + len(wrong) > self.width:
            # Problems have priority over content.
            text = text[: max(self.width - len(wrong) - 1, 20)] + "…"
        return text + (click.style(wrong, fg="red") if self.colour and wrong else wrong)


_FRAME_COLUMNS = ("frame", "time_ns", "src", "senderId", "networkId", "bpSeqno")
_ITEM_COLUMNS = (
    "payload", "protocolId", "kind", "varId", "seqno", "prodId", "repCnt", "creationTime", "timeout", "descr", "value",
    "nodeId", "tStamp",
)  # fmt: skip
_ERROR_COLUMNS = ("data", "severity", "reason", "path", "offset", "needed", "available", "requirement")


class CsvRenderer:
    """One row per state report, instruction record, unknown payload and problem, under fixed columns.

    The column ``kind`` is ``srp``, the name of a container, ``data`` or ``problem``; a beacon without any of these has
    one row of the kind ``beacon``.
    """

    def __init__(self, codec: Codec) -> None:
        self.safety = tuple(field.name for field in codec.profile.srp.safety_data)
        self.columns = (*_FRAME_COLUMNS, *_ITEM_COLUMNS, *self.safety, *_ERROR_COLUMNS)
        self._buffer = io.StringIO()
        self._writer = csv.writer(self._buffer, lineterminator="\n")

    def _taken(self) -> str:
        text = self._buffer.getvalue().removesuffix("\n")
        self._buffer.seek(0)
        self._buffer.truncate()
        return text

    def heading(self) -> str:
        """Return the row of column names."""
        self._writer.writerow(self.columns)
        return self._taken()

    def render(self, frame: DissectedFrame) -> str:
        """Return the rows of one frame."""
        data, src = beacon_json(frame.codec, frame.dissection.root), frame.framing.src
        header = data.get("bp") or {}
        common = {
            "frame": frame.frame.number,
            "time_ns": frame.frame.time_ns,
            "src": mac(src) if src is not None else None,
            "senderId": header.get("senderId"),
            "networkId": header.get("networkId"),
            "bpSeqno": header.get("seqno"),
        }
        rows = [row for index, payload in enumerate(data.get("payloads", ())) for row in self._payload(payload, index)]
        for row in rows or [{"kind": "beacon"}]:
            self._write({**common, **row})
        for problem in frame.dissection.problems:
            self._write({**common, **_problem_row(problem)})
        return self._taken()

    def _write(self, row: dict[str, Any]) -> None:
        self._writer.writerow([safe_cell(row.get(column, "")) for column in self.columns])

    def _payload(self, data: dict[str, Any], index: int) -> Iterator[dict[str, Any]]:
        common = {"payload": index, "protocolId": data.get("protocolId")}
        if "srp" in data:
            report = data["srp"]
            flat = {**(report.get("sData") or {}), **{key: report.get(key) for key in ("nodeId", "tStamp", "seqno")}}
            yield {**common, "kind": "srp", **{key: flat[key] for key in flat if key in self.columns}}
        for container in data.get("vardis", ()):
            for record in container.get("records", ()):
                flat = {**record, **(record.get("spec") or {}), **(record.get("upd") or {})}
                row = {key: flat[key] for key in flat if key in self.columns}
                yield {**common, "kind": container.get("icName", container.get("icType")), **row}
        if "data" in data:
            yield {**common, "kind": "data", "data": data["data"]}


def _problem_row(problem: Problem) -> dict[str, Any]:
    return {"kind": "problem", **msgspec.structs.asdict(problem)}


_encode_json = json.JSONEncoder(separators=(",", ":")).encode


class JsonlRenderer:
    """One JSON object per frame and line."""

    def render(self, frame: DissectedFrame) -> str:
        """Return the object of one frame (``DissectedFrame.as_json``)."""
        return _encode_json(frame.as_json())
