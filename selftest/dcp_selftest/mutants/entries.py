"""Families of mutants that change the entry of a variable after VarDis has processed a request or a record."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any, Concatenate

from dcp_stack.vardis.database import DBEntry, IdQueue

from .family import Family, P, Part, R, assign


def on_entry(base: type[Part], method: Callable[Concatenate[Part, P], R]) -> Family[[Part, DBEntry, DBEntry], object]:
    """Return the family that changes an entry after ``method``: a function of object, entry, and copy of it before.

    Rejected requests, and VarCreates that are not stored, change nothing. The copy is that of the new entry if there
    was none before.
    """
    name = method.__name__

    def override(behaviour: Callable[[Part, DBEntry, DBEntry], object], made: type) -> object:
        def changed(self: Any, subject: Any, *args: Any, **kwargs: Any) -> Any:
            var_id: int = (
                subject if isinstance(subject, int) else getattr(subject, "var_id", None) or subject.spec.var_id
            )
            old = self._database.lookup(var_id)
            before = copy.copy(old)
            result = getattr(super(made, self), name)(subject, *args, **kwargs)
            entry = self._database.lookup(var_id)
            stored = entry is not old if name == "_create" else result is None or result.status.is_ok
            if entry is not None and stored:
                behaviour(self, entry, before or copy.copy(entry))
            return result

        return changed

    return Family(base, name, override)


def drop(queue: IdQueue, entry: DBEntry, *, when: bool = True, **values: int) -> None:
    """Remove the variable of an entry from a queue, and set counters of the entry, if ``when`` is true."""
    if when:
        queue.remove(entry.spec.var_id)
        assign(entry, **values)


__all__ = ["drop", "on_entry"]
