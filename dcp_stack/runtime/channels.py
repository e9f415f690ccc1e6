"""Clients of the control interface: a Unix socket that they connect to, or standard input and output."""

from __future__ import annotations

import contextlib
import fcntl
import logging
import os
import socket
import stat
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

from dcp_stack.control.server import HIGH_WATER, ControlServer, ControlSession

from .privileges import roots_alone
from .reactor import READ, WRITE, Reactor

log = logging.getLogger(__name__)

MAX_CLIENTS: Final = 64
CHUNK: Final = 1 << 16
STALL: Final = 10_000_000_000
"""ns after which a client that takes nothing of what waits for it is given up."""
_LONGEST_PATH: Final = 107
"""Octets of the path of a Unix socket, of <linux/un.h>."""


class ControlSocketError(Exception):
    """The control socket cannot be made; the message names it and says why."""


class Channel:
    """One client: a session, and the descriptors its octets come from and go to."""

    def __init__(
        self,
        name: str,
        session: ControlSession,
        reactor: Reactor,
        fds: tuple[int, int],
        on_close: Callable[[Channel], None],
    ) -> None:
        self.name = name
        self.session = session
        self.busy = False
        """There are requests to answer without waiting for anything."""
        self._reactor = reactor
        self._in, self._out = fds
        self._on_close = on_close
        self._closed = False
        self._stalled_since: int | None = None
        self._watch()

    @property
    def stalled_since(self) -> int | None:
        """Since when the client has not taken what waits for it (monotonic ns)."""
        return self._stalled_since

    def on_ready(self, events: int) -> None:
        """A descriptor is ready."""
        self.busy = True
        if events & WRITE:
            self._send()
        if events & READ and not self._closed:
            self._read()

    def advance(self, now: int, wall: int) -> None:
        """Answer some requests, and send what there is."""
        if self._closed:
            return
        self.busy = self.session.process(now=now, wall=wall)
        if self.session.output:
            held_back = len(self.session.output) > HIGH_WATER
            self._send()
            if self._closed:
                return
            # Requests that waited because too much was to be sent have their turn now.
            self.busy |= held_back and len(self.session.output) <= HIGH_WATER
        if self.session.overrun:
            log.warning("client %s does not read what it asked for; dropped", self.name)
            self.close()
        elif self.session.finished:
            self.close()
        elif not self.session.output:
            self._stalled_since = None
        elif self._stalled_since is None:
            self._stalled_since = now
        elif now - self._stalled_since > STALL:
            log.warning("client %s takes nothing of its answers; dropped", self.name)
            self.close()
        self._watch()

    def _read(self) -> None:
        try:
            data = os.read(self._in, CHUNK)
        except (BlockingIOError, InterruptedError):
            return
        except OSError as error:
            log.debug("client %s is gone: %s", self.name, error.strerror)
            self.close()
            return
        if data:
            self.session.receive(data)
        else:
            self.session.end_of_input()

    def _send(self) -> None:
        try:
            with memoryview(self.session.output) as waiting:
                count = os.write(self._out, waiting[:CHUNK])
        except (BlockingIOError, InterruptedError):
            return
        except OSError as error:
            log.debug("client %s is gone: %s", self.name, error.strerror)
            self.close()
            return
        if count:
            self.session.sent(count)
            self._stalled_since = None

    def _watch(self) -> None:
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
        """End it from our side; may be called twice."""
        if self._closed:
            return
        self._closed = True
        self.busy = False
        for fd in {self._in, self._out}:
            self._reactor.forget(fd)
        self.session.close()
        self._on_close(self)


class ControlSocket:
    """Listens at a path for clients; only the user who runs the node may connect (mode 0600)."""

    def __init__(self, path: str | Path) -> None:
        """A socket that nobody listens at any more is replaced. Raises ControlSocketError."""
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
        self._socket.setblocking(False)
        self._channels: dict[Channel, socket.socket] = {}
        self._count = 0

    def _bind(self) -> None:
        with contextlib.suppress(FileNotFoundError):
            if not stat.S_ISSOCK(self.path.lstat().st_mode):
                raise ControlSocketError(f"{self.path}: exists and is no socket; choose another path")
            if _is_answered(self.path):
                raise ControlSocketError(f"{self.path}: another node listens there; choose another path or end it")
            self.path.unlink()
        # The mode has to be right from the beginning: between bind and chmod anybody could connect. Linux takes it from
        # the socket; the umask belongs to all threads.
        os.fchmod(self._socket.fileno(), 0o600)
        self._socket.bind(os.fspath(self.path))
        self._identity = _identity(self.path)

    def give_to(self, uid: int, gid: int) -> None:
        """Make it the socket of another user, as root.

        Raises ControlSocketError unless only root can change the folder: somebody else could have put a link to a file
        of root into the socket's place.
        """
        if not roots_alone(self.path.parent):
            raise ControlSocketError(f"{self.path}: its folder is not root's alone, so its owner is not changed")
        os.chown(self.path, uid, gid, follow_symlinks=False)

    def attach(self, server: ControlServer, reactor: Reactor) -> None:
        """Begin to take clients."""
        self._server, self._reactor = server, reactor
        reactor.watch(self._socket.fileno(), READ, self._accept)

    @property
    def channels(self) -> list[Channel]:
        """The clients there are."""
        return list(self._channels)

    def _accept(self, _events: int) -> None:
        for _ in range(8):
            try:
                client, _ = self._socket.accept()
            except BlockingIOError:
                return
            except OSError as error:
                log.warning("%s: cannot take another client: %s", self.path, error.strerror)
                return
            if len(self._channels) >= MAX_CLIENTS:
                log.warning("%s: %d clients are enough; refused another one", self.path, MAX_CLIENTS)
                client.close()
                continue
            client.setblocking(False)
            self._count += 1
            fd = client.fileno()
            channel = Channel(str(self._count), self._server.open(), self._reactor, (fd, fd), self._closed)
            self._channels[channel] = client
            log.debug("client %s connected", channel.name)

    def _closed(self, channel: Channel) -> None:
        self._channels.pop(channel).close()
        log.debug("client %s disconnected", channel.name)

    def close(self) -> None:
        """Close all clients and remove the socket."""
        for channel in self.channels:
            channel.close()
        with contextlib.suppress(OSError):
            # A successor may have put its own socket in the place of ours.
            if _identity(self.path) == self._identity:
                self.path.unlink()
        self._socket.close()


class StandardStreams:
    """One client at standard input and output; its end is reported, for it is the one the node was started for."""

    def __init__(self, on_end: Callable[[], None], fds: tuple[int, int] = (0, 1)) -> None:
        self._on_end = on_end
        self._fds = fds
        self._blocking: dict[int, bool] = {}
        self._channel: Channel | None = None

    def attach(self, server: ControlServer, reactor: Reactor) -> None:
        """Begin."""
        for fd in self._fds:
            # Not on terminals: they share this state with the shell, and people read what is shown to them.
            if not os.isatty(fd):
                self._blocking[fd] = os.get_blocking(fd)
                os.set_blocking(fd, False)
        self._channel = Channel("stdio", server.open(), reactor, self._fds, self._closed)

    @property
    def channels(self) -> list[Channel]:
        """The client, until it has ended."""
        return [] if self._channel is None else [self._channel]

    def _closed(self, _channel: Channel) -> None:
        self._channel = None
        self._on_end()

    def close(self) -> None:
        """Leave the streams as they were."""
        channel, self._channel = self._channel, None
        if channel is not None:
            channel.close()
        for fd, blocking in self._blocking.items():
            with contextlib.suppress(OSError):
                os.set_blocking(fd, blocking)
        self._blocking.clear()


@contextlib.contextmanager
def _alone_in(folder: Path) -> Iterator[None]:
    """Let no other node look for stale sockets in ``folder`` meanwhile, or both would take the same for one."""
    try:
        fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    except OSError:
        # A folder that may not be read, or none: what follows says so better.
        yield
        return
    try:
        with contextlib.suppress(OSError):
            fcntl.flock(fd, fcntl.LOCK_EX)
        yield
    finally:
        os.close(fd)


def _is_answered(path: Path) -> bool:
    """Whether somebody listens at a socket."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.settimeout(1.0)
        try:
            probe.connect(os.fspath(path))
        except (ConnectionRefusedError, FileNotFoundError):
            return False
        except TimeoutError:
            return True
    return True


def _identity(path: Path) -> tuple[int, int]:
    status = path.lstat()
    return status.st_dev, status.st_ino
