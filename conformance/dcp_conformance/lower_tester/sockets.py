"""The common part of lower testers over sockets: waiting, time stamps of the kernel, and faults of the tester."""

from __future__ import annotations

import errno
import os
import select
import socket
import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from typing import Self

from dcp_conformance.errors import LowerTesterError

from .base import Arrival, LinkHealth

#: ns that a send may wait for room in the interface's queue.
_PATIENCE = 1_000_000_000
#: Frames that are kept in memory until a case reads them; more wait in the kernel.
_MOST_HELD = 100_000
#: ms until the tester tries again to send to a full queue of an interface: there is no event for free space.
_PAUSE = 5
#: Maximum time in ns between two readings of the clocks, and maximum number of readings.
_CLOCKS_APART, _CLOCK_READS = 100_000, 8
#: Load for each processor from which what runs must wait for its turn for milliseconds.
_OVERLOAD = 3


class SocketLowerTester:
    """A lower tester over one socket. Subclasses open it (:meth:`_open`), read (:meth:`_read`) and write.

    The clock is ``time.monotonic_ns``. Arrivals have the kernel's stamp, carried over to that clock when they are read,
    so that a tester that is late still knows when they came. What comes after ``until`` is kept for the next call.
    """

    def __init__(self, name: str) -> None:
        """Raises ``LowerTesterError`` or ``UsageError``."""
        self.name = name
        self._socket: socket.socket | None = None
        self._closed = False
        self._held: deque[Arrival] = deque()
        """Read and not returned yet, in order."""
        self._dropped = 0
        self._last = 0
        self._socket = self._open()

    def overload(self) -> str:
        """Whether more wanted to run on this machine in the last five minutes than it has processors for, in words."""
        load, processors = os.getloadavg()[1], len(os.sched_getaffinity(0))
        if load <= _OVERLOAD * processors:
            return ""
        return f"the machine was overloaded (load {load:.0f} on {processors} processors)"

    # -- what subclasses say -----------------------------------------------------------------------------------

    def _open(self) -> socket.socket:
        """The socket to read from, not blocking."""
        raise NotImplementedError

    def _read(self, source: socket.socket) -> tuple[bytes, bytes, bytes, int] | None:
        """Payload, frame, source and stamp (ns since 1970, 0 if there is none) of the next datagram.

        None: one that is to be ignored. Raises ``OSError``.
        """
        raise NotImplementedError

    def _kernel_drops(self) -> int:
        """Return the number of frames that the kernel dropped since the last call. Raises ``OSError``."""
        raise NotImplementedError

    def _attached(self, source: socket.socket) -> None:
        """Raise ``OSError`` if the socket no longer receives its group or interface although reading does not fail."""

    def _gone(self, error: OSError) -> LowerTesterError:
        """Explain why the socket cannot be used."""
        raise NotImplementedError

    # -- the contract of a lower tester ------------------------------------------------------------------------

    def now(self) -> int:
        """Monotonic ns."""
        return time.monotonic_ns()

    def wall(self) -> int:
        """ns since 1970."""
        return time.time_ns()

    def receive(self, until: int, also: Sequence[int] = ()) -> Arrival | None:
        """The next frame before ``until``; None then, or when a descriptor of ``also`` is readable."""
        source = self._ready()
        while True:
            # Before reading: frames that arrive during a later delay of this process are still read.
            now = time.monotonic_ns()
            arrival = self._held.popleft() if self._held else self._next(source)
            if arrival is not None:
                if arrival.time >= until:
                    self._held.appendleft(arrival)
                    return None
                return arrival
            left = until - now
            if left <= 0:
                self._make_sure(source)
                return None
            waiting = select.poll()
            for descriptor in (source.fileno(), *also):
                waiting.register(descriptor, select.POLLIN)
            found = waiting.poll(max(1, -(-left // 1_000_000)))
            if found and all(descriptor != source.fileno() for descriptor, _ in found):
                return None

    def take_in(self) -> None:
        """Read what has arrived, up to a bound; :meth:`receive` returns it."""
        source = self._ready()
        while len(self._held) < _MOST_HELD and (arrival := self._next(source)) is not None:
            self._held.append(arrival)

    def health(self) -> LinkHealth:
        """Drops of the kernel since the last call."""
        self._count_drops()
        found = LinkHealth(self._dropped)
        self._dropped = 0
        return found

    def close(self) -> None:
        """Give the socket back."""
        self._closed = True
        self._discard()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # -- beneath it --------------------------------------------------------------------------------------------

    def _ready(self) -> socket.socket:
        """The socket; after it was lost a new one, if the interface is back. Raises ``LowerTesterError``."""
        if self._closed:
            raise LowerTesterError(f"{self.name}: it has been closed")
        if self._socket is None:
            self._socket = self._open()
        return self._socket

    def _make_sure(self, source: socket.socket) -> None:
        """Silence must not be that of a deaf tester. Raises ``LowerTesterError``."""
        try:
            self._attached(source)
        except OSError as error:
            self._discard()
            raise self._gone(error) from None

    def _next(self, source: socket.socket) -> Arrival | None:
        """The next frame that has arrived already."""
        while True:
            try:
                found = self._read(source)
            except BlockingIOError:
                return None
            except InterruptedError:
                continue
            except OSError as error:
                self._discard()
                raise self._gone(error) from None
            if found is not None:
                octets, frame, sender, stamp = found
                wall, now = _clocks()
                wall_of_arrival = stamp or wall
                # Never after now, and never before another that was read earlier, whatever the clocks do.
                when = min(max(wall_of_arrival - wall + now, self._last), now)
                self._last = when
                return Arrival(when, wall_of_arrival, octets, frame, sender)

    def _push(self, to: socket.socket, send: Callable[[], object]) -> None:
        """Send by ``to``, and wait a little for room. Raises ``OSError``."""
        deadline = time.monotonic_ns() + _PATIENCE
        while True:
            waiting = select.poll()
            try:
                send()
            except OSError as error:
                if error.errno not in (errno.EAGAIN, errno.ENOBUFS) or time.monotonic_ns() > deadline:
                    raise
                if error.errno == errno.ENOBUFS:
                    waiting.poll(_PAUSE)
                else:
                    waiting.register(to.fileno(), select.POLLOUT)
                    waiting.poll(100)
            else:
                return

    def _count_drops(self) -> None:
        if self._socket is not None:
            try:
                self._dropped += self._kernel_drops()
            except OSError:
                # The interface disappears; the next attempt to use it fails.
                return

    def _discard(self) -> None:
        self._count_drops()
        old, self._socket = self._socket, None
        if old is not None:
            self._release(old)

    def _release(self, old: socket.socket) -> None:
        """Close what was opened."""
        old.close()


def _clocks() -> tuple[int, int]:
    """Return the time since 1970 and the monotonic time of one moment, in ns.

    They are read again if the process was not executed in between, which would make frames later than they were.
    """
    for _ in range(_CLOCK_READS):
        before, wall, after = time.monotonic_ns(), time.time_ns(), time.monotonic_ns()
        if after - before < _CLOCKS_APART:
            break
    return wall, after


class Echoes:
    """Recognises own datagrams that come back, where only their octets identify them.

    What was sent is remembered for two seconds and recognised once.
    """

    _HORIZON, _MOST = 2_000_000_000, 4096

    def __init__(self) -> None:
        self._order: deque[tuple[int, bytes]] = deque()
        self._count: Counter[bytes] = Counter()

    def sent(self, octets: bytes, now: int) -> None:
        """Remember what was sent."""
        self._order.append((now, octets))
        self._count[octets] += 1
        while self._order and (len(self._order) > self._MOST or self._order[0][0] < now - self._HORIZON):
            self._forget(self._order.popleft()[1])

    def is_one(self, octets: bytes, now: int) -> bool:
        """Return whether this is the echo of a sent datagram; each echo is recognised once."""
        while self._order and self._order[0][0] < now - self._HORIZON:
            self._forget(self._order.popleft()[1])
        if not self._count[octets]:
            del self._count[octets]
            return False
        self._forget(octets)
        return True

    def _forget(self, octets: bytes) -> None:
        self._count[octets] -= 1
        if self._count[octets] <= 0:
            del self._count[octets]
