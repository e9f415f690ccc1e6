"""Edit parts of a frame without changing anything else, including wrong lengths and counts.

Lengths and counts around a changed part change by the same difference: a correct length stays correct, and a length
that was too high by 494 stays too high by 494. This works on the octets and their dissection, for any profile, and for
damaged frames as far as the dissector can read them.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from typing import Literal, NamedTuple

from dcp_codec.codec import Codec
from dcp_codec.plan.tree import Fill, Group, Many, Scalar, Text
from dcp_codec.views.fields import Dissection, Field


class Edit(NamedTuple):
    """Replace the octets from ``start`` to ``stop`` by ``new``; the field ``within`` gains ``elements`` elements."""

    start: int
    stop: int
    new: bytes
    within: Field
    elements: int = 0


class Announced(NamedTuple):
    """A field that announces the size (octets) or the number of elements of another one."""

    field: Field
    of: Field
    kind: Literal["size", "count"]

    @property
    def truth(self) -> int:
        """The correct value of the field."""
        return self.of.length if self.kind == "size" else len(self.of.children)


class Anatomy:
    """The octets of a frame, their dissection, and operations that edit them."""

    def __init__(self, codec: Codec, octets: bytes) -> None:
        self.octets = octets
        self.dissection: Dissection = codec.dissect(octets)
        self.root = self.dissection.root

    @functools.cached_property
    def _parents(self) -> dict[int, Field]:
        return {id(child): field for field in self.root.walk() for child in field.children}

    @functools.cached_property
    def _fields(self) -> dict[str, Field]:
        return {field.path: field for field in self.root.walk()}

    @functools.cached_property
    def announced(self) -> list[Announced]:
        """The length and count fields, in wire order."""
        return [each for field in self.root.walk() for each in self._announced_in(field)]

    # -- navigation ----------------------------------------------------------------------------------------------

    def at(self, path: str) -> Field | None:
        """Return the field with this path, or None."""
        return self._fields.get(path)

    def nearest(self, path: str) -> Field:
        """Return the innermost existing field on a path; the whole message if there is no other."""
        while path:
            field = self._fields.get(path)
            if field is not None:
                return field
            path = path.rpartition("[" if path.endswith("]") else ".")[0]
        return self.root

    def around(self, field: Field) -> Iterator[Field]:
        """Yield the field and its ancestors up to the message."""
        at: Field | None = field
        while at is not None:
            yield at
            at = self._parents.get(id(at))

    def parent(self, field: Field) -> Field | None:
        """Return the parent of a field; None for the message."""
        return self._parents.get(id(field))

    def lists(self) -> list[Field]:
        """Return the lists of a message, outer ones first: blocks, then containers, then records."""
        found = [field for field in self.root.walk() if isinstance(field.layout, Many)]
        return sorted(found, key=lambda field: field.path.count("."))

    def announcement(self, field: Field) -> Announced | None:
        """Return the size or count that a field announces; None for other fields."""
        return next((each for each in self.announced if each.field is field), None)

    # -- editing -------------------------------------------------------------------------------------------------

    def without(self, elements: Sequence[Field]) -> bytes:
        """Return the frame without these list elements, none of which may contain another."""
        edits = []
        for each in elements:
            inside = self._parents[id(each)]
            edits.append(Edit(each.offset, each.offset + each.length, b"", inside, -1))
        return self.edited(edits)

    def replaced(self, field: Field, octets: bytes) -> bytes:
        """Return the frame with a field replaced by other octets."""
        return self.edited([Edit(field.offset, field.offset + field.length, octets, field)])

    def set_right(self, announced: Announced) -> bytes:
        """Return the frame with a length or a count corrected."""
        field = announced.field
        return self.replaced(field, _number(field, announced.truth))

    def edited(self, edits: Sequence[Edit]) -> bytes:
        """Return the frame after these edits, which must not overlap."""
        sizes: dict[int, int] = {}
        counts: dict[int, int] = {}
        for edit in edits:
            counts[id(edit.within)] = counts.get(id(edit.within), 0) + edit.elements
            for field in self.around(edit.within):
                sizes[id(field)] = sizes.get(id(field), 0) + len(edit.new) - (edit.stop - edit.start)
        changes = [*edits]
        for announced in self.announced:
            field, of = announced.field, announced.of
            change = sizes.get(id(of), 0) if announced.kind == "size" else counts.get(id(of), 0)
            if not change or any(edit.start <= field.offset < edit.stop for edit in edits):
                continue
            fill = self._fill_beside(announced) if announced.kind == "size" else None
            if fill is not None:
                changes.append(_refilled(fill, -change))
            changes.append(Edit(field.offset, field.offset + field.length, _number(field, field.value + change), field))
        octets = self.octets
        for edit in sorted(changes, key=lambda each: (each.start, each.stop), reverse=True):
            octets = octets[: edit.start] + edit.new + octets[edit.stop :]
        return octets

    def _fill_beside(self, announced: Announced) -> Field | None:
        """Return the padding of an area of fixed size, which shrinks when the contents grow; None if there is none."""
        group = self._parents.get(id(announced.field))
        for child in group.children if group is not None else ():
            if isinstance(child.layout, Fill) and child.layout.used == announced.field.name:
                return child
        return None

    def _announced_in(self, group: Field) -> Iterator[Announced]:
        if isinstance(group.layout, Text):
            data = group.child("data")
            for child in group.children:
                if data is not None and child.name.startswith("length") and isinstance(child.value, int):
                    yield Announced(child, data, "size")
            return
        if not isinstance(group.layout, Group):
            return
        for child in group.children:
            layout = child.layout
            if isinstance(layout, Scalar) and layout.derived is not None and isinstance(child.value, int):
                of = self._named(group, layout.derived.of)
                if of is not None and (layout.derived.kind == "size" or isinstance(of.layout, Many)):
                    yield Announced(child, of, layout.derived.kind)

    def _named(self, group: Field, name: str) -> Field | None:
        """Return the field from which a derived field is computed, or None.

        Contents with several alternatives have different names; they are the last field of their group.
        """
        if name.startswith("_."):
            outer = self._parents.get(id(group))
            return None if outer is None else outer.child(name[2:])
        if (found := group.child(name)) is not None:
            return found
        others = [child for child in group.children if not isinstance(child.layout, Fill)]
        last = others[-1] if others else None
        return None if last is None or isinstance(last.layout, Scalar) else last


def _number(field: Field, value: int) -> bytes:
    """Return a number encoded as a field, limited to the range of the field."""
    assert isinstance(field.layout, Scalar)
    size = field.layout.size
    return max(0, min(value, (1 << (8 * size)) - 1)).to_bytes(size, field.layout.order)


def _refilled(fill: Field, change: int) -> Edit:
    stop = fill.offset + fill.length
    return (
        Edit(stop, stop, bytes(change), fill) if change > 0 else Edit(max(fill.offset, stop + change), stop, b"", fill)
    )
