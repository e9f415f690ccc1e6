"""Result of a dissection: a tree of fields and every problem found. No code here judges or raises.

The function that :mod:`dcp_codec.views.dissector` generates from a plan builds the tree and the problems.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import msgspec

from dcp_codec.errors import Problem
from dcp_codec.plan.tree import Node, Scalar

Place = tuple[Any, str | int] | None
"""The place of a part: the place of the record around it, and its name or index there. None: outermost."""


def path_of(place: Place, name: str = "") -> str:
    """Return the path of the member ``name`` of the part at ``place``: ``payloads[1].vardis[0].icType``."""
    path = f".{name}" if name else ""
    while place is not None:
        place, step = place
        path = f".{step}{path}" if isinstance(step, str) else f"[{step}]{path}"
    return path.removeprefix(".")


class Field(msgspec.Struct, eq=False, gc=False):
    """A part of the octets.

    ``name`` is the specification's ("" for the message and for the elements of lists), ``layout`` the node of the plan
    that describes it, ``length`` the number of its octets that are present, ``value`` its value (None for a record, a
    list, or a field that is cut off), ``children`` its parts.

    A message has dozens of fields, and their construction dominates the time of a dissection. Therefore the class is a
    struct without references that could form a cycle, and rarely used attributes are computed on demand.
    """

    name: str
    layout: Node
    _place: Place
    _source: tuple[bytes, int]
    _start: int
    length: int
    value: Any = None
    children: Sequence[Field] = ()

    @property
    def path(self) -> str:
        """Return the field path with indices (``payloads[1].vardis[0].records[3].seqno``)."""
        return path_of(self._place, self.name)

    @property
    def offset(self) -> int:
        """Return the offset of the first octet, counted from the base that the caller of the dissector gave."""
        return self._start + self._source[1]

    @property
    def raw(self) -> bytes:
        """Return the octets of the field."""
        return self._source[0][self._start : self._start + self.length]

    @property
    def label(self) -> str | None:
        """Return the name of an enumerated value (``"SUMMARIES"``), if it has one."""
        layout = self.layout
        if isinstance(layout, Scalar) and layout.names is not None:
            return layout.names.get(self.value)
        return None

    def child(self, name: str) -> Field | None:
        """Return the direct part of that name."""
        for child in self.children:
            if child.name == name:
                return child
        return None

    def walk(self) -> Iterator[Field]:
        """Yield this field and all its parts, in wire order."""
        waiting = [self]
        while waiting:
            field = waiting.pop()
            yield field
            if field.children:
                waiting.extend(reversed(field.children))

    def find(self, path: str) -> Field | None:
        """Return the field with that full path."""
        return next((each for each in self.walk() if path.endswith(each.name) and each.path == path), None)

    def __repr__(self) -> str:
        return f"<{self.path or self.name} at {self.offset}+{self.length} = {self.value!r}>"


@dataclass(slots=True, eq=False)
class Dissection:
    """Result of a dissection: ``root``, ``problems`` in the order of the layout, and ``padding`` after the message.

    ``end`` is the offset after the message. ``doubtful`` lists the records that may break a rule beyond the layout, for
    :mod:`dcp_codec.views.lint`.
    """

    root: Field
    problems: list[Problem]
    end: int
    padding: bytes
    doubtful: list[Field]

    @property
    def errors(self) -> list[Problem]:
        """Return the problems because of which the octets are not a message of the profile."""
        return [problem for problem in self.problems if problem.severity == "error"]

    @property
    def warnings(self) -> list[Problem]:
        """Return the problems of well-formed parts that break a rule."""
        return [problem for problem in self.problems if problem.severity == "warning"]
