"""The lines of the node that each case executes: only cases that execute a changed line can detect the change.

The suite is run once on each node with a tracer, in a separate process (:func:`trial.measure`). A trial then runs only
the cases that execute the changed lines.
"""

from __future__ import annotations

from collections.abc import Iterable
from types import CodeType, FrameType
from typing import Any, Final

import msgspec

from .sites import MODULES, Site

_FILES: Final = {f"/dcp_stack/{module.replace('.', '/')}.py": module for module in MODULES}


class Reach(msgspec.Struct, frozen=True):
    """The lines that the cases execute on one node."""

    node: str
    """One of :data:`trial.NODES`."""
    lines: dict[str, dict[int, tuple[int, ...]]]
    """By module and line: the numbers of the cases that execute the line, in the order of :func:`trial.cases`."""
    always: dict[str, tuple[int, ...]]
    """By module: lines that are executed when the node is imported and configured; every case depends on them."""

    def cases(self, site: Site) -> frozenset[int] | None:
        """Return the numbers of the cases that execute the statement of ``site``; None if every case depends on it."""
        if site.first == 0:
            return None
        span = range(site.first, site.last + 1)
        if not set(self.always.get(site.module, ())).isdisjoint(span):
            return None
        lines = self.lines.get(site.module, {})
        return frozenset(number for line in span for number in lines.get(line, ()))


class Tracer:
    """Trace function that collects the executed lines of the modules in :data:`sites.MODULES`."""

    def __init__(self) -> None:
        self.seen: set[tuple[str, int]] = set()
        self._modules: dict[CodeType, str] = {}

    def __call__(self, frame: FrameType, _event: str, _argument: object) -> Any:
        """Start tracing a function call if its code is in one of the modules (protocol of ``sys.settrace``)."""
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
        """Return the lines that were executed since the previous call."""
        # Clear the set instead of replacing it: functions that are still running hold its method `add`.
        taken = set(self.seen)
        self.seen.clear()
        return taken


def of_module(module: str, lines: Iterable[tuple[str, int]]) -> tuple[int, ...]:
    """Return the sorted line numbers of one module."""
    return tuple(sorted(line for name, line in lines if name == module))
