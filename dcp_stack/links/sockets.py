"""The common part of links over sockets: a constant descriptor, recovery from outages, counters."""

from __future__ import annotations

import errno
import logging
import os
import selectors
import socket
import time

from .base import LinkCounters, LinkError, Reception
from .interfaces import InterfaceWatch

log = logging.getLogger(__name__)

#: Maximum number of receptions per call, so that a flood of frames does not delay the timers of the node.
PORTION = 512

#: ns between attempts to recover if the system does not report changes of interfaces; doubled from first to last.
_FIRST_RETRY, _LAST_RETRY = 100_000_000, 2_000_000_000
#: ns between checks of the interface watch while frames arrive. They show that the interface is up.
_LOOK_INTERVAL = 1_000_000_000

#: Errors of sockets whose interface or address is not available.
AWAY = frozenset(
    {
        errno.ENETDOWN,
        errno.ENODEV,
        errno.ENXIO,
        errno.ENETUNREACH,
        errno.EHOSTUNREACH,
        errno.EADDRNOTAVAIL,
        errno.EBADF,
    }
)


class SocketLink:
    """A link over sockets that recovers when its interface returns after an outage.

    The descriptor to wait for belongs to a selector, so it stays the same when the sockets in the selector are
    replaced. The selector also contains a watch on the interfaces of the system, so the return of an interface wakes
    the node at once. On systems without such a watch, calls of :meth:`receive` and :meth:`send` try to recover every
    0.1 to 2 s.

    Subclasses implement opening (:meth:`_open`), which also sets :attr:`source` and :attr:`max_packet_size`, reading
    (:meth:`_drain`) and writing (:meth:`_transmit`).
    """

    def __init__(self, name: str) -> None:
        """Raises :class:`LinkError` or ``OSError`` if :meth:`_open` does."""
        self.name = name
        self.source = b""
        self.max_packet_size = 0
        self._counters = LinkCounters()
        self._socket: socket.socket | None = None
        self._down = False
        self._closed = False
        self._retry_at = 0
        self._backoff = _FIRST_RETRY
        self._look_at = 0
        self._said = ""
        self._refusals: set[int] = set()
        self._watch: InterfaceWatch | None = None
        self._selector = selectors.DefaultSelector()
        try:
            self._socket = self._open()
            self._selector.register(self._socket, selectors.EVENT_READ)
        except BaseException:
            self.close()
            raise
        try:
            self._watch = InterfaceWatch()
            self._selector.register(self._watch, selectors.EVENT_READ)
        except OSError:
            log.debug("%s: cannot watch the interfaces; trying periodically instead", name)

    # -- for subclasses --------------------------------------------------------------------------------------------

    def _open(self) -> socket.socket:
        """Return the non-blocking socket to read from; raises :class:`LinkError` or ``OSError``."""
        raise NotImplementedError

    def _release(self, old: socket.socket) -> None:
        """Close what :meth:`_open` opened."""
        old.close()

    def _drain(self, source: socket.socket, receptions: list[Reception]) -> None:
        """Append at most ``PORTION`` datagrams to ``receptions``; raises ``BlockingIOError`` if no more are waiting."""
        raise NotImplementedError

    def _transmit(self, octets: bytes) -> None:
        """Send one bearer payload; raises ``OSError``."""
        raise NotImplementedError

    def _lost_by_kernel(self) -> int:
        """Return the number of datagrams that the kernel dropped since the last call; raises ``OSError``."""
        raise NotImplementedError

    def _attached(self, source: socket.socket) -> bool:
        """Whether the socket still receives from its interface; called after interfaces changed."""
        raise NotImplementedError

    def _resume(self, source: socket.socket) -> bool:  # noqa: ARG002
        """Whether the socket can be used again after an outage; raises ``OSError`` while the interface is down."""
        return False

    # -- the interface of a link -----------------------------------------------------------------------------------

    @property
    def counters(self) -> LinkCounters:
        """The current counters, including the frames dropped by the kernel."""
        self._count_lost()
        return self._counters

    @property
    def up(self) -> bool:
        """Whether the link is open and not in an outage."""
        return not self._down and not self._closed

    def fileno(self) -> int:
        """Return the descriptor to wait for; -1 after :meth:`close`."""
        return -1 if self._closed else self._selector.fileno()

    def receive(self) -> list[Reception]:
        """Return the frames that have arrived, at most ``PORTION``."""
        receptions: list[Reception] = []
        source = self._ready()
        if source is None:
            return receptions
        try:
            self._drain(source, receptions)
        except BlockingIOError:
            pass
        except OSError as error:
            # Any error: a socket that cannot be read is useless, and would wake the node again and again.
            self._lose(error)
        if not receptions:
            # The watch may have woken the node.
            self._look()
        self._counters.received += len(receptions)
        return receptions

    def send(self, octets: bytes) -> bool:
        """Broadcast ``octets``; return False and count in ``send_errors`` if too long or refused by the system."""
        if len(octets) > self.max_packet_size:
            self._say_refused(errno.EMSGSIZE, len(octets))
        elif self._ready() is not None:
            try:
                self._transmit(octets)
            except OSError as error:
                if error.errno in AWAY:
                    self._lose(error)
                else:
                    self._say_refused(error.errno or 0, len(octets))
            else:
                self._counters.sent += 1
                return True
        self._counters.send_errors += 1
        return False

    def close(self) -> None:
        """Close all sockets; may be called twice."""
        if self._closed:
            return
        self._count_lost()
        self._closed = True
        if self._watch is not None:
            self._watch.close()
        self._discard()
        self._selector.close()

    def _say_refused(self, reason: int, length: int) -> None:
        """Log each reason for a refusal once as a warning; the counters have the number."""
        new = reason not in self._refusals
        self._refusals.add(reason)
        level = logging.WARNING if new else logging.DEBUG
        log.log(level, "%s: %d octets cannot be sent: %s", self.name, length, os.strerror(reason))

    # -- outages ---------------------------------------------------------------------------------------------------

    def _ready(self) -> socket.socket | None:
        """Return the socket to use now; None during an outage."""
        if self._closed:
            return None
        if self._down or time.monotonic_ns() >= self._look_at:
            self._look()
        return None if self._down else self._socket

    def _look(self) -> None:
        """Check whether the interface has gone or returned."""
        self._look_at = time.monotonic_ns() + _LOOK_INTERVAL
        if self._watch is not None and self._watch.changed():
            self._retry_at = 0
            if not self._down and self._socket is not None and not self._attached(self._socket):
                self._lose(OSError(errno.ENODEV, "the interface was removed"))
        if self._down:
            self._recover()

    def _lose(self, error: OSError) -> None:
        """Start an outage: stop reading the socket, and try to recover from now on."""
        if self._down:
            return
        self._down = True
        self._counters.outages += 1
        self._retry_at = 0
        self._backoff = _FIRST_RETRY
        log.warning("%s: went down (%s); waiting for its return", self.name, error.strerror or error)
        if self._socket is not None:
            # Its events would wake the node for nothing. The socket itself is kept: it can be used again if the
            # interface was only switched off, and opening another may need a privilege that was dropped.
            self._selector.unregister(self._socket)

    def _recover(self) -> None:
        """Try to end the outage; after a failure wait longer before the next attempt."""
        now = time.monotonic_ns()
        if now < self._retry_at:
            return
        try:
            self._reopen()
        except (OSError, LinkError) as error:
            self._say_why(error)
            self._retry_at = now + self._backoff
            self._backoff = min(2 * self._backoff, _LAST_RETRY)
            return
        self._down = False
        self._said = ""
        log.warning("%s: is back", self.name)

    def _say_why(self, error: Exception) -> None:
        """Log the cause of a failed recovery, once as a warning; it can be other than a missing interface."""
        new = isinstance(error, LinkError) and str(error) != self._said
        log.log(logging.WARNING if new else logging.DEBUG, "still down: %s", error)
        if new:
            self._said = str(error)

    def _reopen(self) -> None:
        """Use the kept socket again if possible, otherwise open a new one."""
        if self._socket is None or not self._resume(self._socket):
            self._count_lost()
            self._discard()
            self._socket = self._open()
        self._selector.register(self._socket, selectors.EVENT_READ)

    def _discard(self) -> None:
        """Close the socket, if there is one."""
        old, self._socket = self._socket, None
        if old is not None:
            self._release(old)

    def _count_lost(self) -> None:
        """Add the frames that the kernel dropped since the last call to the counters."""
        if self._socket is None or self._closed:
            return
        try:
            self._counters.kernel_drops += self._lost_by_kernel()
        except OSError as error:
            log.debug("%s: the kernel does not report dropped frames: %s", self.name, error)
