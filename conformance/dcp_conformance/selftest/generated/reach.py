"""Which cases execute which lines of the node: a change of a line can only be noticed by a case that executes it.

The suite is run once on each profile with a tracer, in a process of its own (:func:`measure`). A trial then runs the
cases that execute the changed lines and no others.
"""

from __future__ import annotations

from collections.abc import Iterable
from types import CodeType, FrameType
from typing import Any, Final

import msgspec

from .sites import MODULES, Site

_FILES: Final = {f"/dcp_stack/{module.replace('.', '/')}.py": module for module in MODULES}


class Reach(msgspec.Struct, frozen=True):
    """What the cases execute on one node."""

    node: str
    """One of :data:`trial.NODES`."""
    lines: dict[str, dict[int, tuple[int, ...]]]
    """By module and line: the numbers of the cases that execute the line, in the order of :func:`trial.cases`."""
    always: dict[str, tuple[int, ...]]
    """By module: lines that are executed when the node is imported and configured: every case depends on them."""

    def cases(self, site: Site) -> frozenset[int] | None:
        """The cases that execute the statement of ``site``; None if every case may depend on it."""
        if site.first == 0:
            return None
        span = range(site.first, site.last + 1)
        if not set(self.always.get(site.module, ())).isdisjoint(span):
            return None
        lines = self.lines.get(site.module, {})
        return frozenset(number for line in span for number in lines.get(line, ()))


class Tracer:
    """Collects executed lines of the modules that are changed."""

    def __init__(self) -> None:
        self.seen: set[tuple[str, int]] = set()
        self._modules: dict[CodeType, str] = {}

    def __call__(self, frame: FrameType, _event: str, _argument: object) -> Any:
        """Trace a call if it is one of the node's: the global function of ``sys.settrace``."""
        code = frame.f_code
        module = self._modules.get(code)
        if module is None:
            name = code.co_filename
            place = name.rfind("/dcp_stack/")
            module = self._modules[code] = _FILES.get(name[place:], "") if place >= 0 else ""
        if not module:
            return None
        add = self.seen.add
        add((module, frame.f_lineno))

        def line(frame: FrameType, _event: str, _argument: object) -> Any:
            add((module, frame.f_lineno))
            return line

        return line

    def take(self) -> set[tuple[str, int]]:
        """The lines since the last time."""
        # The same set: functions that are still running hold its `add`.
        taken = set(self.seen)
        self.seen.clear()
        return taken


def of_module(module: str, lines: Iterable[tuple[str, int]]) -> tuple[int, ...]:
    return tuple(sorted(line for name, line in lines if name == module))
