"""Octets taken apart for people: a tree of what is there and every problem found. Nothing is judged, nothing raises.

The tree and the problems are made by the function that :mod:`dcp_codec.views.dissector` generates from a plan.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import msgspec

from dcp_codec.errors import Problem
from dcp_codec.plan.tree import Node, Scalar

Place = tuple[Any, str | int] | None
"""Where parts of a record lie: the place of the record around it, and its name or its index there. None: outermost."""


def path_of(place: Place, name: str = "") -> str:
    """``payloads[1].vardis[0].icType``: the path of the member ``name`` of what lies at ``place``."""
    path = f".{name}" if name else ""
    while place is not None:
        place, step = place
        path = f".{step}{path}" if isinstance(step, str) else f"[{step}]{path}"
    return path.removeprefix(".")


class Field(msgspec.Struct, eq=False, gc=False):
    """A part of the octets.

    ``name`` is the specification's ("" for the message and for the elements of lists), ``layout`` the node of the plan
    that describes it, ``length`` how many octets of it are there, ``value`` what it says (None for a record, a list, or
    a field that is cut off), ``children`` its parts.

    A message has dozens of them, and making them is most of taking it apart: hence the struct, which holds no
    references that could form a cycle, and what few ask for is worked out when it is asked for.
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
        """The field path with indices (``payloads[1].vardis[0].records[3].seqno``)."""
        return path_of(self._place, self.name)

    @property
    def offset(self) -> int:
        """The octet where it starts, counted as the caller of the dissector does."""
        return self._start + self._source[1]

    @property
    def raw(self) -> bytes:
        """The octets themselves."""
        return self._source[0][self._start : self._start + self.length]

    @property
    def label(self) -> str | None:
        """The name of an enumerated value (``"SUMMARIES"``), if it has one."""
        layout = self.layout
        if isinstance(layout, Scalar) and layout.names is not None:
            return layout.names.get(self.value)
        return None

    def child(self, name: str) -> Field | None:
        """The direct part of that name."""
        for child in self.children:
            if child.name == name:
                return child
        return None

    def walk(self) -> Iterator[Field]:
        """This field and all its parts, in wire order."""
        waiting = [self]
        while waiting:
            field = waiting.pop()
            yield field
            if field.children:
                waiting.extend(reversed(field.children))

    def find(self, path: str) -> Field | None:
        """The field of that full path."""
        return next((each for each in self.walk() if path.endswith(each.name) and each.path == path), None)

    def __repr__(self) -> str:
        return f"<{self.path or self.name} at {self.offset}+{self.length} = {self.value!r}>"


class Dissection:
    """What was found: ``root``, ``problems`` in the order of the layout, and ``padding`` behind the message.

    ``end`` is the offset behind the message. ``doubtful`` are the records that may break a rule beyond the layout, for
    :mod:`dcp_codec.views.lint`.
    """

    __slots__ = ("doubtful", "end", "padding", "problems", "root")

    def __init__(self, root: Field, problems: list[Problem], end: int, padding: bytes, doubtful: list[Field]) -> None:
        self.root = root
        self.problems = problems
        self.end = end
        self.padding = padding
        self.doubtful = doubtful

    @property
    def errors(self) -> list[Problem]:
        """What makes the octets no message of the profile."""
        return [problem for problem in self.problems if problem.severity == "error"]

    @property
    def warnings(self) -> list[Problem]:
        """What is well formed and still breaks a rule."""
        return [problem for problem in self.problems if problem.severity == "warning"]
