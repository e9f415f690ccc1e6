"""Families of mutants that change the entry of a variable after VarDis has processed a request or a record."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any, ClassVar, Concatenate

from dcp_codec.values import VarCreate
from dcp_stack.config import MS
from dcp_stack.vardis.database import DBEntry, IdQueue
from dcp_stack.vardis.entity import Vardis

from .family import Family, P, Part, R, assign


def on_entry(base: type[Part], method: Callable[Concatenate[Part, P], R]) -> Family[[Part, DBEntry, DBEntry], object]:
    """Return the family that changes an entry after ``method``: a function of object, entry, and copy of it before.

    Rejected requests, and VarCreates that are not stored, change nothing. The copy is that of the new entry if there
    was none before.
    """
    name = method.__name__

    def override(behaviour: Callable[[Part, DBEntry, DBEntry], object], made: type) -> object:
        def changed(self: Any, subject: Any, *args: Any, **kwargs: Any) -> Any:
            named = subject.spec if isinstance(subject, VarCreate) else subject
            var_id: int = named if isinstance(named, int) else named.var_id
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


class Expires(Vardis):
    """Deletes variables by another condition than the end of their timeout, or also by it."""

    also: ClassVar[bool] = False
    """Whether variables are deleted after their timeout, too."""

    def _scrub(self, now: int) -> None:
        if self.also:
            super()._scrub(now)
        for entry in list(self._database.entries.values()):
            if not entry.is_deleted and self.expired(entry.spec.timeout or 0, now - entry.refreshed):
                self._database.mark_deleted(entry)

    def expired(self, timeout: int, age: int) -> bool:
        """Return whether a variable is deleted; timeout in ms, 0 for none, age in ns."""
        return 0 < timeout * MS < age


__all__ = ["Expires", "drop", "on_entry"]
