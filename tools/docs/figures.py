"""Draw the wire format of a profile as SVG: each record as rows of eight octets, made from the plan of its codec."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple
from xml.sax.saxutils import escape

from dcp_codec.codec import Codec
from dcp_codec.plan.layout import walk
from dcp_codec.plan.tree import Exact, Fill, Group, Many, Node, Region, Rest, Scalar, Select, Text

#: Octets in a row, and pixels of one octet, of a row and of the column of offsets.
_ROW, _WIDE, _HIGH, _LEFT, _TOP = 8, 94, 46, 52, 22


class Box(NamedTuple):
    """A field of a figure: ``size`` in octets, None if it varies."""

    name: str
    size: int | None
    about: str
    link: str = ""


def records(codec: Codec) -> Iterator[Group]:
    """Yield each record type once, the beacon first."""
    seen = set()
    for plan in (codec.beacon_plan, codec.report_plan, codec.containers_plan):
        for node in walk(plan) if plan is not None else ():
            if isinstance(node, Group) and node.type_name not in seen:
                seen.add(node.type_name)
                yield node


def boxes(group: Group) -> Iterator[Box]:
    """Yield the fields of a record in the order of their octets."""
    for member in group.members:
        yield from _boxes(member)


def _boxes(node: Node) -> Iterator[Box]:
    match node:
        case Scalar():
            yield Box(node.name, node.size, _kind(node))
        case Text():
            for prefix in node.prefixes:
                yield Box(f"{node.name}.{prefix.name}", prefix.size, _kind(prefix))
            kind = "text" if node.human else "octets"
            yield Box(node.name, None, kind + (" and NUL" if node.terminated else ""))
        case Group():
            yield Box(node.name, node.size, node.type_name, node.type_name)
        case Many():
            times = f"{node.count} times" if node.count else "to the end"
            yield Box(node.name, None, f"{node.element.type_name}, {times}", node.element.type_name)
        case Region():
            yield Box(node.content.name or node.name, None, f"octets: {node.length}")
        case Exact():
            yield Box(node.name, node.size, node.content.type_name, node.content.type_name)
        case Fill():
            yield Box(node.name, None, f"{node.total} octets less {node.used}")
        case Select():
            yield Box(node.name, None, f"as {node.key} says")
        case Rest():
            yield Box(node.name, None, "octets, to the end")


def _kind(scalar: Scalar) -> str:
    if scalar.kind == "bytes":
        return f"{scalar.size} octet{'s' * (scalar.size != 1)}"
    letter = "f" if scalar.kind == "float" else "i" if scalar.signed else "u"
    order = "" if scalar.size == 1 else ", big-endian" if scalar.order == "big" else ", little-endian"
    fixed = f" = 0x{scalar.rule.value:0{2 * scalar.size}X}" if scalar.rule and scalar.rule.value is not None else ""
    return f"{letter}{8 * scalar.size}{fixed}{order}"


def figure(group: Group) -> str:
    """Return one record as an SVG image that follows the colours of the page."""
    out: list[str] = []
    column, row, after = 0, 0, ""
    offset = 0
    for box in boxes(group):
        if column == 0 or box.size is None:
            if column:
                row, column = row + 1, 0
            out.append(_offset(row, after, offset))
        left = box.size if box.size is not None else _ROW
        first = True
        while left > 0:
            if column == _ROW:
                column, row = 0, row + 1
                out.append(_offset(row, after, offset))
            width = min(left, _ROW - column)
            out.append(_rectangle(row, column, width, box, first=first))
            column, left, first = column + width, left - width, False
            offset += width if box.size is not None else 0
        if box.size is None:
            row, column, after, offset = row + 1, 0, box.name, 0
        elif column == _ROW:
            row, column = row + 1, 0
    rows = row + (1 if column else 0)
    head = "".join(
        f'<text class="o" x="{_LEFT + index * _WIDE + _WIDE // 2}" y="15">{index}</text>' for index in range(_ROW)
    )
    wide, high = _LEFT + _ROW * _WIDE + 2, _TOP + max(rows, 1) * _HIGH + 2
    title = escape(f"{group.type_name}: octets and fields")
    return (
        f'<div class="wire"><svg viewBox="0 0 {wide} {high}" role="img" aria-label="{title}">'
        + head
        + "".join(out)
        + "</svg></div>"
    )


def _offset(row: int, after: str, offset: int) -> str:
    text = ("+" if after else "") + str(offset)
    return f'<text class="o e" x="{_LEFT - 8}" y="{_TOP + row * _HIGH + _HIGH // 2 + 4}">{text}</text>'


def _rectangle(row: int, column: int, width: int, box: Box, *, first: bool) -> str:
    """One row of a field; ``first``: with its type, which further rows do not repeat."""
    x, y, wide = _LEFT + column * _WIDE, _TOP + row * _HIGH, width * _WIDE
    form = f'<rect class="{"v" if box.size is None else "f"}" x="{x}" y="{y}" width="{wide}" height="{_HIGH}"/>'
    middle = x + wide // 2
    room = max(4, wide // 8)
    if not first:
        return form + f'<text class="t" x="{middle}" y="{y + 28}">{escape(_cut(box.name, room))}</text>'
    name, about = _cut(box.name, room), _cut(box.about, room + 2)
    title = f"<title>{escape(box.name)}: {escape(box.about)}</title>"
    return (
        f"<g>{title}{form}"
        f'<text class="n" x="{middle}" y="{y + 20}">{escape(name)}</text>'
        f'<text class="t" x="{middle}" y="{y + 36}">{escape(about)}</text></g>'
    )


def _cut(text: str, most: int) -> str:
    return text if len(text) <= most else text[: most - 1] + "…"


def wire_page(codec: Codec, tables: str) -> str:
    """Return the page of one profile: figures before the table of each record. ``tables``: the export ``markdown``."""
    figures = {group.type_name: figure(group) for group in records(codec)}
    out = []
    for line in tables.splitlines():
        out.append(line)
        if line.startswith("### ") and line[4:] in figures:
            out += ["", figures[line[4:]]]
    return "\n".join(out) + "\n"
