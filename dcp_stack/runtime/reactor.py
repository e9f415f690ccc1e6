"""Waiting for descriptors: a thin layer over :mod:`selectors` that also accepts regular files.

asyncio was measured and not used: it takes 4 MB more, and runs a chain of callbacks and tasks for each of the about
fifty wake-ups per second of a quiet node. A loop over the ready descriptors is sufficient for a node.
"""

from __future__ import annotations

import selectors
from collections.abc import Callable
from typing import Final

READ: Final = selectors.EVENT_READ
WRITE: Final = selectors.EVENT_WRITE
Callback = Callable[[int], None]
"""A function called with the events that are ready, READ and/or WRITE."""


class Reactor:
    """Calls functions for descriptors that are ready."""

    def __init__(self) -> None:
        self._selector = selectors.DefaultSelector()
        # Regular files (redirected standard input) are always ready, and epoll does not accept them.
        self._always: dict[int, tuple[int, Callback]] = {}
        self._known: dict[int, tuple[int, Callback]] = {}

    def watch(self, fd: int, events: int, callback: Callback) -> None:
        """Call ``callback`` whenever one of ``events`` is ready at ``fd``; no events: stop watching it."""
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
        """Stop watching ``fd``; must be called before ``fd`` is closed."""
        if self._known.pop(fd, None) is not None and self._always.pop(fd, None) is None:
            self._selector.unregister(fd)

    def wait(self, timeout: float | None) -> None:
        """Wait up to ``timeout`` s (None: without limit), and call the functions of all ready descriptors."""
        for key, events in self._selector.select(0 if self._always else timeout):
            # A previous callback may have unregistered this one.
            if self._known.get(key.fd, (0, None))[1] == key.data:
                key.data(events)
        for fd, (events, callback) in list(self._always.items()):
            if fd in self._always:
                callback(events)

    def close(self) -> None:
        """Close the selector, but not the watched descriptors."""
        self._selector.close()
