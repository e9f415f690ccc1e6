"""Connections of clients: listening sockets for control and metrics, or standard input and output."""

from __future__ import annotations

import contextlib
import fcntl
import logging
import os
import socket
import stat
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final, Protocol

from dcp_stack.control.places import is_answered
from dcp_stack.control.server import HIGH_WATER, ControlServer

from .errors import NodeError
from .privileges import roots_alone
from .reactor import READ, WRITE, Reactor

log = logging.getLogger(__name__)

MAX_CLIENTS: Final = 64
CHUNK: Final = 1 << 16
STALL: Final = 10_000_000_000
"""ns after which a client that reads none of its pending output is disconnected."""
_LONGEST_PATH: Final = 107
"""Maximum length of the path of a Unix socket in octets, from <linux/un.h>."""


class ControlSocketError(NodeError):
    """The control socket cannot be created; the message names it and the cause."""


class Session(Protocol):
    """The state of one client; :class:`~dcp_stack.control.server.ControlSession` is one."""

    output: bytearray
    """Octets for the client."""
    overrun: bool
    """Whether the client is too slow and should be disconnected."""

    @property
    def wants_input(self) -> bool:
        """Whether to read more input."""

    @property
    def finished(self) -> bool:
        """Whether the client should be disconnected: all its requests are answered, and the answers sent."""

    def receive(self, data: bytes) -> None:
        """Add octets from the client."""

    def end_of_input(self) -> None:
        """Mark the end of input."""

    def process(self, *, now: int, wall: int) -> bool:
        """Answer some requests (times in ns); return whether more could be answered at once. Never raises."""

    def sent(self, count: int) -> None:
        """Remove the first ``count`` octets of ``output``, which were sent."""

    def close(self) -> None:
        """Note that the client has gone."""


class Channel:
    """One client: its session, and the descriptors for input and output."""

    def __init__(
        self,
        name: str,
        session: Session,
        reactor: Reactor,
        fds: tuple[int, int],
        on_close: Callable[[Channel], None],
    ) -> None:
        self.name = name
        self.session = session
        self.busy = False
        """Whether there are requests that can be answered without waiting."""
        self._reactor = reactor
        self._in, self._out = fds
        self._on_close = on_close
        self._closed = False
        self._stalled_since: int | None = None
        self._watch()

    def on_ready(self, events: int) -> None:
        """Send and receive what is possible; called when a descriptor is ready."""
        self.busy = True
        if events & WRITE:
            self._send()
        if events & READ and not self._closed:
            self._read()

    def advance(self, now: int, wall: int) -> None:
        """Answer some requests, and send pending output."""
        if self._closed:
            return
        self.busy = self.session.process(now=now, wall=wall)
        if self.session.output:
            held_back = len(self.session.output) > HIGH_WATER
            self._send()
            if self._closed:
                return
            # Requests that waited for the output to shrink can be answered now.
            self.busy |= held_back and len(self.session.output) <= HIGH_WATER
        if self.session.overrun:
            log.warning("client %s is too slow; disconnected", self.name)
            self.close()
        elif self.session.finished:
            self.close()
        elif not self.session.output:
            self._stalled_since = None
        elif self._stalled_since is None:
            self._stalled_since = now
        elif now - self._stalled_since > STALL:
            log.warning("client %s does not read its answers; disconnected", self.name)
            self.close()
        self._watch()

    def _read(self) -> None:
        """Pass available input to the session; close the channel on an error."""
        try:
            data = os.read(self._in, CHUNK)
        except (BlockingIOError, InterruptedError):
            return
        except OSError as error:
            log.debug("client %s disconnected: %s", self.name, error.strerror)
            self.close()
            return
        if data:
            self.session.receive(data)
        else:
            self.session.end_of_input()

    def _send(self) -> None:
        """Write pending output as far as possible; close the channel on an error."""
        try:
            with memoryview(self.session.output) as waiting:
                count = os.write(self._out, waiting[:CHUNK])
        except (BlockingIOError, InterruptedError):
            return
        except OSError as error:
            log.debug("client %s disconnected: %s", self.name, error.strerror)
            self.close()
            return
        if count:
            self.session.sent(count)
            self._stalled_since = None

    def _watch(self) -> None:
        """Register the descriptors for the events that the session waits for."""
        if self._closed:
            return
        read = READ if self.session.wants_input else 0
        write = WRITE if self.session.output else 0
        if self._in == self._out:
            self._reactor.watch(self._in, read | write, self.on_ready)
        else:
            self._reactor.watch(self._in, read, self.on_ready)
            self._reactor.watch(self._out, write, self.on_ready)

    def close(self) -> None:
        """Disconnect the client; may be called twice."""
        if self._closed:
            return
        self._closed = True
        self.busy = False
        for fd in {self._in, self._out}:
            self._reactor.forget(fd)
        self.session.close()
        self._on_close(self)


class Listener:
    """The clients of a listening socket."""

    def __init__(self, name: str, listening: socket.socket, limit: int) -> None:
        """``name`` is for the log; ``limit``: maximum number of clients at the same time."""
        self._name = name
        self._socket = listening
        self._limit = limit
        self._channels: dict[Channel, socket.socket] = {}
        self._count = 0
        listening.setblocking(False)

    def attach(self, server: ControlServer, reactor: Reactor) -> None:
        """Start to accept clients of ``server``."""
        self._server, self._reactor = server, reactor
        reactor.watch(self._socket.fileno(), READ, self._accept)

    def open_session(self) -> Session:
        """Return the session of a new client."""
        return self._server.open()

    @property
    def channels(self) -> list[Channel]:
        """The connected clients."""
        return list(self._channels)

    def _accept(self, _events: int) -> None:
        for _ in range(8):
            try:
                client, _ = self._socket.accept()
            except BlockingIOError:
                return
            except OSError as error:
                log.warning("%s: cannot accept another client: %s", self._name, error.strerror)
                return
            if len(self._channels) >= self._limit:
                log.warning("%s: the limit of %d clients is reached; refused another one", self._name, self._limit)
                client.close()
                continue
            client.setblocking(False)
            self._count += 1
            fd = client.fileno()
            channel = Channel(f"{self._name}#{self._count}", self.open_session(), self._reactor, (fd, fd), self._closed)
            self._channels[channel] = client
            log.debug("client %s connected", channel.name)

    def _closed(self, channel: Channel) -> None:
        self._channels.pop(channel).close()
        log.debug("client %s disconnected", channel.name)

    def close(self) -> None:
        """Close all clients and the socket."""
        for channel in self.channels:
            channel.close()
        self._socket.close()


class ControlSocket(Listener):
    """A listening Unix socket; only the user of the node may connect (mode 0600)."""

    def __init__(self, path: str | Path) -> None:
        """Create the socket; a stale one of an ended node is replaced. Raises ControlSocketError."""
        self.path = Path(path)
        if len(os.fsencode(self.path)) > _LONGEST_PATH:
            raise ControlSocketError(f"{path}: the path of a socket has at most {_LONGEST_PATH} octets")
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            with _alone_in(self.path.parent):
                self._bind()
            self._socket.listen(MAX_CLIENTS)
        except OSError as error:
            self._socket.close()
            missing = f"there is no folder {self.path.parent}" if isinstance(error, FileNotFoundError) else ""
            raise ControlSocketError(f"{path}: {missing or error.strerror or error}") from None
        except ControlSocketError:
            self._socket.close()
            raise
        super().__init__(str(path), self._socket, MAX_CLIENTS)

    def _bind(self) -> None:
        """Bind the socket, after removing a stale one. Raises ControlSocketError if the path is in use."""
        with contextlib.suppress(FileNotFoundError):
            if not stat.S_ISSOCK(self.path.lstat().st_mode):
                raise ControlSocketError(f"{self.path}: exists and is not a socket; choose another path")
            if is_answered(self.path):
                raise ControlSocketError(f"{self.path}: another node listens there; choose another path or end it")
            self.path.unlink()
        # The mode has to be set before bind: any user could connect between bind and chmod. Linux takes the mode from
        # the socket; setting the umask would affect all threads.
        os.fchmod(self._socket.fileno(), 0o600)
        self._socket.bind(os.fspath(self.path))
        self._identity = _identity(self.path)

    def give_to(self, uid: int, gid: int) -> None:
        """Change the owner of the socket; requires root.

        Raises ControlSocketError unless only root can change the folder: another user could have replaced the socket by
        a link to a file of root.
        """
        if not roots_alone(self.path.parent):
            raise ControlSocketError(f"{self.path}: not only root can change its folder, so its owner stays")
        os.chown(self.path, uid, gid, follow_symlinks=False)

    def close(self) -> None:
        """Close all clients and remove the socket."""
        with contextlib.suppress(OSError):
            # Another node may have replaced our socket by its own.
            if _identity(self.path) == self._identity:
                self.path.unlink()
        super().close()


class StandardStreams:
    """A single client at standard input and output; ``on_end`` is called when it ends."""

    def __init__(self, on_end: Callable[[], None], fds: tuple[int, int] = (0, 1)) -> None:
        self._on_end = on_end
        self._fds = fds
        self._blocking: dict[int, bool] = {}
        self._channel: Channel | None = None

    def attach(self, server: ControlServer, reactor: Reactor) -> None:
        """Start to read standard input."""
        for fd in self._fds:
            # Terminals stay blocking: they share this state with the shell, and a user at a terminal reads the output.
            if not os.isatty(fd):
                self._blocking[fd] = os.get_blocking(fd)
                os.set_blocking(fd, False)
        self._channel = Channel("stdio", server.open(), reactor, self._fds, self._closed)

    @property
    def channels(self) -> list[Channel]:
        """The client; empty after its end."""
        return [] if self._channel is None else [self._channel]

    def _closed(self, _channel: Channel) -> None:
        self._channel = None
        self._on_end()

    def close(self) -> None:
        """End the client, and restore the blocking mode of the streams."""
        channel, self._channel = self._channel, None
        if channel is not None:
            channel.close()
        for fd, blocking in self._blocking.items():
            with contextlib.suppress(OSError):
                os.set_blocking(fd, blocking)
        self._blocking.clear()


@contextlib.contextmanager
def _alone_in(folder: Path) -> Iterator[None]:
    """Lock ``folder`` against other nodes, so that no two nodes replace the same stale socket."""
    try:
        fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    except OSError:
        # Missing or unreadable: bind() will report it.
        yield
        return
    try:
        with contextlib.suppress(OSError):
            fcntl.flock(fd, fcntl.LOCK_EX)
        yield
    finally:
        os.close(fd)


def _identity(path: Path) -> tuple[int, int]:
    """Return device and inode of a file, to recognise it later."""
    status = path.lstat()
    return status.st_dev, status.st_ino
