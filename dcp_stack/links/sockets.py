"""What links over sockets share: one descriptor for life, outages and how they end, counters."""

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

#: Receptions handed out in one call at the most, so that a flood does not keep the node from its timers.
PORTION = 512

#: ns between attempts to come back, when the system does not tell that something changed.
_FIRST_RETRY, _LAST_RETRY = 100_000_000, 2_000_000_000
#: ns between looks at the watch while frames come in, which no interface that is away brings.
_LOOK_INTERVAL = 1_000_000_000

#: What sockets say of an interface or an address that is away.
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
    """A link over sockets that outlives the interface below it.

    The descriptor that users wait for is that of a selector, so that it stays while the sockets behind it change.
    Behind it is also a watch on the system's interfaces: the return of one wakes the node at once. Where there is no
    watch, calls of :meth:`receive` and :meth:`send` try again every 0.1 to 2 s.

    Subclasses say how to open (:meth:`_open`), read (:meth:`_drain`) and write (:meth:`_transmit`).
    """

    def __init__(self, name: str) -> None:
        """Raises :class:`LinkError` or ``OSError``, as :meth:`_open` does."""
        self._name = name
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
            log.debug("%s: no watch on interfaces; looking from time to time instead", name)

    # -- what subclasses say ---------------------------------------------------------------------------------------

    def _open(self) -> socket.socket:
        """The socket to read from, not blocking; raises :class:`LinkError` or ``OSError``."""
        raise NotImplementedError

    def _release(self, old: socket.socket) -> None:
        """Close what :meth:`_open` opened."""
        old.close()

    def _drain(self, source: socket.socket, receptions: list[Reception]) -> None:
        """Read at most ``PORTION`` datagrams; raises ``BlockingIOError`` when there is nothing more."""
        raise NotImplementedError

    def _transmit(self, octets: bytes) -> None:
        """Send; raises ``OSError``."""
        raise NotImplementedError

    def _lost_by_kernel(self) -> int:
        """Datagrams that the kernel dropped since the last call; raises ``OSError``."""
        raise NotImplementedError

    def _attached(self, source: socket.socket) -> bool:
        """Whether the socket still hears what it was opened for; asked when interfaces changed."""
        raise NotImplementedError

    def _resume(self, source: socket.socket) -> bool:  # noqa: ARG002
        """Whether the socket will do again after an outage; raises ``OSError`` while the interface is down."""
        return False

    # -- the contract of a link ------------------------------------------------------------------------------------

    @property
    def name(self) -> str:
        """What the link is on."""
        return self._name

    @property
    def counters(self) -> LinkCounters:
        """The counters, with the kernel's brought up to date."""
        self._count_lost()
        return self._counters

    @property
    def max_packet_size(self) -> int:
        """The longest bearer payload in octets."""
        raise NotImplementedError

    @property
    def source(self) -> bytes:
        """Our own address."""
        raise NotImplementedError

    @property
    def up(self) -> bool:
        """Whether it is open and in no outage."""
        return not self._down and not self._closed

    def fileno(self) -> int:
        """The descriptor to wait for, -1 after :meth:`close`."""
        return -1 if self._closed else self._selector.fileno()

    def receive(self) -> list[Reception]:
        """What has arrived, at most ``PORTION`` of it."""
        receptions: list[Reception] = []
        source = self._ready()
        if source is None:
            return receptions
        try:
            self._drain(source, receptions)
        except BlockingIOError:
            pass
        except OSError as error:
            # Whatever it is: a socket that cannot be read is no use, and would wake the node again and again.
            self._lose(error)
        if not receptions:
            # It may have been the watch that woke the node.
            self._look()
        self._counters.received += len(receptions)
        return receptions

    def send(self, octets: bytes) -> bool:
        """Broadcast ``octets``; False, counted in ``send_errors``, if they are too long or the system refuses."""
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
        """Give everything back."""
        if self._closed:
            return
        self._count_lost()
        self._closed = True
        if self._watch is not None:
            self._watch.close()
        self._discard()
        self._selector.close()

    def _say_refused(self, reason: int, length: int) -> None:
        """Tell people once about each reason; how often is in the counters."""
        new = reason not in self._refusals
        self._refusals.add(reason)
        level = logging.WARNING if new else logging.DEBUG
        log.log(level, "%s: %d octets cannot be sent: %s", self._name, length, os.strerror(reason))

    # -- outages ---------------------------------------------------------------------------------------------------

    def _ready(self) -> socket.socket | None:
        """The socket to use now; None during an outage."""
        if self._closed:
            return None
        if self._down or time.monotonic_ns() >= self._look_at:
            self._look()
        return None if self._down else self._socket

    def _look(self) -> None:
        """See whether the interface is away, or back."""
        self._look_at = time.monotonic_ns() + _LOOK_INTERVAL
        if self._watch is not None and self._watch.changed():
            self._retry_at = 0
            if not self._down and self._socket is not None and not self._attached(self._socket):
                self._lose(OSError(errno.ENODEV, "the interface was removed"))
        if self._down:
            self._recover()

    def _lose(self, error: OSError) -> None:
        """The interface is away: from now on look for its return."""
        if self._down:
            return
        self._down = True
        self._counters.outages += 1
        self._retry_at = 0
        self._backoff = _FIRST_RETRY
        log.warning("%s: went down (%s); waiting for its return", self._name, error.strerror or error)
        if self._socket is not None:
            # Not to be woken for what cannot be used. The socket itself is kept: when the interface was only
            # switched off it will do again, and to open another may take a privilege that was given up.
            self._selector.unregister(self._socket)

    def _recover(self) -> None:
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
        log.warning("%s: is back", self._name)

    def _say_why(self, error: Exception) -> None:
        """Tell people once what is in the way; it may be more than an interface that is away."""
        new = isinstance(error, LinkError) and str(error) != self._said
        log.log(logging.WARNING if new else logging.DEBUG, "still down: %s", error)
        if new:
            self._said = str(error)

    def _reopen(self) -> None:
        if self._socket is None or not self._resume(self._socket):
            self._count_lost()
            self._discard()
            self._socket = self._open()
        self._selector.register(self._socket, selectors.EVENT_READ)

    def _discard(self) -> None:
        old, self._socket = self._socket, None
        if old is not None:
            self._release(old)

    def _count_lost(self) -> None:
        if self._socket is None or self._closed:
            return
        try:
            self._counters.kernel_drops += self._lost_by_kernel()
        except OSError as error:
            log.debug("%s: the kernel does not say what it dropped: %s", self._name, error)
