"""One frame as an aligned tree of fields with a hexdump; octets at fault are marked."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator

import click
from dcp_spec.catalogue.requirements import requirement
from dcp_spec.reasons import REASONS, WARNINGS, quantity

from dcp_codec.errors import Problem
from dcp_codec.framing.frames import DissectedFrame
from dcp_codec.framing.locate import mac
from dcp_codec.plan.tree import Group, Many, Text
from dcp_codec.texts import payload_name, utc, value_text
from dcp_codec.views.fields import Dissection, Field

_NARROW = 60
_VALUE_COLUMN = 34
# A tuple, because a union would be built again for each row.
_LISTS = (Group, Many)
#: Characters for octets in a hexdump.
_SHOWN = bytes(octet if 32 <= octet < 127 else ord(".") for octet in range(256))


class TreeRenderer:
    """Renders frames for a terminal ``width`` columns wide; ``colour`` uses ANSI colours."""

    def __init__(self, *, width: int, colour: bool, hexdump: bool) -> None:
        self.width = max(width, 40)
        self.colour = colour
        self.hexdump = hexdump

    def style(self, text: str, **styles: object) -> str:
        """Return ``text`` with ANSI styles if colour is on."""
        return click.style(text, **styles) if self.colour else text  # type: ignore[arg-type]

    def render(self, frame: DissectedFrame) -> str:
        """Return all lines of one frame."""
        return "\n".join(self._lines(frame))

    def _lines(self, frame: DissectedFrame) -> Iterator[str]:
        yield from self._heading(frame)
        rows = _rows(frame.dissection.root, 0, [])
        names = min(max((2 * depth + len(name) for name, _, depth in rows), default=0) + 1, 30)
        problems = _by_path(frame.dissection.problems)
        for name, field, depth in rows:
            yield self._row(frame, "  " * depth + name, field, names)
            if problems:
                for problem in problems.pop(field.path, []):
                    yield from self._problem(problem)
        # A problem of a field without any octets has no row.
        for left in problems.values():
            for problem in left:
                yield from self._problem(problem)
        padding = frame.dissection.padding
        if padding:
            text = f"{frame.dissection.end:>6} {len(padding):>4}  padding of the bearer, ignored (BP-RX-14)"
            yield self.style(text, dim=True)
        if self.hexdump:
            yield ""
            yield from self._dump(frame)
        yield ""

    def _heading(self, frame: DissectedFrame) -> Iterator[str]:
        framing, captured = frame.framing, frame.frame
        parts = [f"Frame {captured.number}"]
        if captured.time_ns:
            parts.append(utc(captured.time_ns))
        if framing.src is not None and framing.dst is not None:
            parts.append(f"{mac(framing.src)} > {mac(framing.dst)}")
        if framing.ether_type is not None:
            parts.append(f"0x{framing.ether_type:04x}")
        size = f"{len(captured.data)} octets"
        if captured.orig_len > len(captured.data):
            size += f" of {captured.orig_len} captured"
        parts.append(size)
        heading = "  ".join(parts)
        lines = [heading] if len(heading) <= self.width else textwrap.wrap(heading, self.width)
        yield from (self.style(line, bold=True) for line in lines)

    def _row(self, frame: DissectedFrame, name: str, field: Field, names: int) -> str:
        layout = field.layout
        value = value_text(frame.codec.profile, field)
        if isinstance(layout, Group) and layout.type_name == "Payload":
            value = payload_name(field)
        place = self.style(f"{field.offset:>6} {field.length:>4}  ", dim=True)
        record = isinstance(layout, _LISTS)
        shown = self.style(f"{name:<{names}}", fg="cyan") if record else f"{name:<{names}}"
        room = self.width - 13 - max(names, len(name)) - 1
        if len(value) > room > 8:
            value = value[: room - 1] + "…"
        hexes = ""
        leaf = not record and (isinstance(layout, Text) or not field.children)
        if self.width >= _NARROW and leaf:
            hexes = self._hexes(field, room - len(value) - 2, len(value))
        return f"{place}{shown} {value}{hexes}".rstrip()

    def _hexes(self, field: Field, room: int, used: int) -> str:
        raw = field.raw
        if room < 2 or not raw or field.length > 16:
            return ""
        text = raw.hex(" ")
        if len(text) > room:
            return ""
        # The octets have one column; on a wide terminal it is near the values, and only long values move it to the
        # right.
        return " " * (2 + max(0, min(room - len(text), _VALUE_COLUMN - used))) + self.style(text, dim=True)

    def _problem(self, problem: Problem) -> Iterator[str]:
        error = problem.severity == "error"
        text = f"{problem.reason}: {(REASONS | WARNINGS).get(problem.reason, '')}"
        if numbers := quantity(problem.reason, problem.needed, problem.available):
            text += f"; {numbers}"
        text += f"; at octet {problem.offset}, {problem.path or 'beacon'}"
        lines = textwrap.wrap(text, max(30, self.width - 15))
        if problem.requirement:
            rule = f"{problem.requirement}: {requirement(problem.requirement).statement}"
            lines += textwrap.wrap(rule, max(30, self.width - 15))
        for index, line in enumerate(lines):
            mark = ("ERROR  " if error else "note   ") if not index else "       "
            yield self.style(f"      {mark}{line}", fg="red" if error else "yellow")

    def _dump(self, frame: DissectedFrame) -> Iterator[str]:
        data = frame.frame.data
        wrong = _faulty(frame.dissection, len(data)) if frame.dissection.problems else ()
        per_line = 16 if self.width >= 74 else 8
        for start in range(0, len(data), per_line):
            chunk = data[start : start + per_line]
            octets, marks = chunk.hex(" "), ""
            if any(start <= index < start + per_line for index in wrong):
                cells = [(f"{octet:02x}", index in wrong) for index, octet in enumerate(chunk, start=start)]
                octets = " ".join(self.style(cell, fg="red", bold=True) if bad else cell for cell, bad in cells)
                marks = " ".join("^^" if bad else "  " for _, bad in cells).rstrip()
            gap = "   " * (per_line - len(chunk))
            yield f"  {start:04x}  {octets}{gap}  {chunk.translate(_SHOWN).decode()}"
            if marks and not self.colour:
                yield f"        {marks}"


_Row = tuple[str, Field, int]


def _rows(field: Field, depth: int, rows: list[_Row]) -> list[_Row]:
    """Append the rows of a field with name and depth; the root and the halves of a string have no row."""
    for child in field.children:
        if isinstance(child.layout, Many):
            for index, element in enumerate(child.children):
                rows.append((f"{child.name}[{index}]", element, depth))
                _rows(element, depth + 1, rows)
            continue
        rows.append((child.name, child, depth))
        if child.children and not isinstance(child.layout, Text):
            _rows(child, depth + 1, rows)
    return rows


def _by_path(problems: list[Problem]) -> dict[str, list[Problem]]:
    found: dict[str, list[Problem]] = {}
    for problem in problems:
        path = problem.path
        for end in (".length", ".length2", ".data"):
            # The halves of a string have no row; the string has one.
            if path.endswith(end) and path.removesuffix(end).rsplit(".", 1)[-1] in ("descr", "value", "prodId"):
                path = path.removesuffix(end)
        found.setdefault(path, []).append(problem)
    return found


def _faulty(dissection: Dissection, size: int) -> set[int]:
    """Return the octets to mark: those of the field at fault, or the last octet if octets are missing."""
    marked: set[int] = set()
    fields = {field.path: field for field in dissection.root.walk()}
    for problem in dissection.errors:
        field = fields.get(problem.path)
        if problem.reason == "leftover" and problem.available:
            marked.update(range(problem.offset, problem.offset + problem.available))
        elif field is not None and field.length:
            marked.update(range(field.offset, field.offset + field.length))
        else:
            marked.add(problem.offset)
    return {index if index < size else size - 1 for index in marked}
