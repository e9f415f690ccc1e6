"""Waiting for descriptors: a thin layer over :mod:`selectors` that also takes regular files.

asyncio was measured and left out: 4 MB more, and a chain of callbacks and tasks for each of the some fifty times a
second that a quiet node is woken. A node has one thing to do at a time, so a loop over what is ready is all it needs.
"""

from __future__ import annotations

import selectors
from collections.abc import Callable
from typing import Final

READ: Final = selectors.EVENT_READ
WRITE: Final = selectors.EVENT_WRITE
Callback = Callable[[int], None]
"""Called with what is possible, READ and/or WRITE."""


class Reactor:
    """Calls back for descriptors that are ready."""

    def __init__(self) -> None:
        self._selector = selectors.DefaultSelector()
        # Regular files (redirected standard input) are always ready, and epoll does not take them.
        self._always: dict[int, tuple[int, Callback]] = {}
        self._known: dict[int, tuple[int, Callback]] = {}

    def watch(self, fd: int, events: int, callback: Callback) -> None:
        """Call back when one of ``events`` is possible at ``fd``; no events: not any more."""
        before = self._known.get(fd)
        if before == (events, callback) or (before is None and not events):
            return
        if not events:
            self.forget(fd)
            return
        self._known[fd] = (events, callback)
        if fd in self._always:
            self._always[fd] = (events, callback)
            return
        try:
            if before is None:
                self._selector.register(fd, events, callback)
            else:
                self._selector.modify(fd, events, callback)
        except PermissionError:
            self._always[fd] = (events, callback)

    def forget(self, fd: int) -> None:
        """Do not look at ``fd`` any more; to be called before it is closed."""
        if self._known.pop(fd, None) is not None and self._always.pop(fd, None) is None:
            self._selector.unregister(fd)

    def wait(self, timeout: float | None) -> None:
        """Wait up to ``timeout`` s (None: for ever) and call back for everything that is ready."""
        for key, events in self._selector.select(0 if self._always else timeout):
            # One callback may have ended what another was to be called for.
            if self._known.get(key.fd, (0, None))[1] == key.data:
                key.data(events)
        for fd, (events, callback) in list(self._always.items()):
            if fd in self._always:
                callback(events)

    def close(self) -> None:
        """Give the selector back; the descriptors belong to others."""
        self._selector.close()
