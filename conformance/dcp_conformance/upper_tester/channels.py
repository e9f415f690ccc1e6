"""Ways for lines to and from an adapter or node: a Unix or TCP socket, or the standard streams of a program.

Nothing here blocks for longer than it is allowed to, and what is kept is bounded.
"""

from __future__ import annotations

import contextlib
import os
import re
import select
import shlex
import socket
import subprocess
import time
from collections.abc import Sequence

from dcp_codec.common.child import LastLines, end_group, ending
from dcp_codec.common.lines import LineBuffer, LineTooLongError
from dcp_conformance.errors import NoListenerError, UpperTesterError, UsageError

#: Octets of the longest line that is taken: the contract allows 16 MiB for the answer to a batch.
LONGEST_LINE = 16 * 1024 * 1024
#: Seconds that an attempt to connect gets at least: over a network an answer takes its time.
_ATTEMPT = 2.0
#: Seconds between attempts to connect, and seconds in which a program must end after a signal.
_RETRY, _END = 0.02, 2.0


class Channel:
    """Lines over descriptors. Subclasses open and close them, and say how it ended."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._lines = LineBuffer(LONGEST_LINE)
        self._ended = False

    # -- what subclasses say -----------------------------------------------------------------------------------

    def filenos(self) -> tuple[int, ...]:
        """Descriptors that become readable when there is something to read."""
        raise NotImplementedError

    def _read(self) -> bytes | None:
        """Return received octets; ``b""`` at the end of the stream, None if none are there now. Raises ``OSError``."""
        raise NotImplementedError

    def _write(self, octets: memoryview) -> int:
        """Write some of it; how much. Raises ``OSError``."""
        raise NotImplementedError

    def _write_fileno(self) -> int:
        raise NotImplementedError

    def close(self) -> None:
        """Let go; may be called twice."""
        raise NotImplementedError

    def end_description(self) -> str:
        """Return how the other side ended, as text."""
        raise NotImplementedError

    # -- lines -------------------------------------------------------------------------------------------------

    def line(self, deadline: float) -> bytes | None:
        """The next line without its end; None at ``deadline`` (s of the monotonic clock; 0: do not wait).

        Raises ``UpperTesterError`` when the other side has ended, or sends a line that has no end.
        """
        while True:
            try:
                found = self._lines.next()
            except LineTooLongError:
                raise UpperTesterError(
                    f"{self.name}: sends a line of more than {LONGEST_LINE >> 20} MiB; messages end with a line feed"
                ) from None
            if found is not None:
                if found := found.removesuffix(b"\r"):
                    return found
                continue
            if self._ended:
                raise UpperTesterError(f"{self.name}: {self.end_description()}")
            if not self._fill(deadline):
                return None

    def _fill(self, deadline: float) -> bool:
        """Read more, or see the end; False if nothing came until the deadline."""
        while True:
            try:
                data = self._read()
            except OSError:
                # A reset connection is an ended one.
                data = b""
            if data:
                self._lines.add(data)
                return True
            if data is not None:
                self._ended = True
                return True
            left = deadline - time.monotonic()
            if left <= 0:
                return False
            _wait(self.filenos(), select.POLLIN, left)

    def send(self, octets: bytes, deadline: float) -> None:
        """Write a whole message. Raises ``UpperTesterError`` if the other side has ended or takes nothing."""
        left = memoryview(octets)
        while left:
            try:
                left = left[self._write(left) :]
            except BlockingIOError:
                if time.monotonic() > deadline:
                    raise UpperTesterError(f"{self.name}: takes no more requests; does it hang?") from None
                # It may not take anything before it gets rid of what it has to say.
                with contextlib.suppress(OSError):
                    data = self._read()
                    self._lines.add(data or b"")
                    if len(self._lines) > LONGEST_LINE:
                        raise UpperTesterError(f"{self.name}: talks, but takes no requests") from None
                _wait((self._write_fileno(),), select.POLLOUT, min(0.05, max(0.0, deadline - time.monotonic())))
            except OSError:
                self._ended = True
                raise UpperTesterError(f"{self.name}: {self.end_description()}") from None


class SocketChannel(Channel):
    """A Unix or TCP connection."""

    def __init__(self, name: str, address: str | tuple[str, int], patience: float) -> None:
        """Tries until it succeeds, for ``patience`` s at the most; 0: once. Raises ``UpperTesterError``."""
        super().__init__(name)
        self._socket = _connected(name, address, patience)
        self._socket.setblocking(False)

    def filenos(self) -> tuple[int, ...]:
        """The descriptor of the socket."""
        return () if self._ended else (self._socket.fileno(),)

    def _read(self) -> bytes | None:
        try:
            return self._socket.recv(1 << 16)
        except BlockingIOError:
            return None

    def _write(self, octets: memoryview) -> int:
        return self._socket.send(octets)

    def _write_fileno(self) -> int:
        return self._socket.fileno()

    def close(self) -> None:
        """Close the connection."""
        self._ended = True
        self._socket.close()

    def end_description(self) -> str:
        """Nothing more is known than that it is closed."""
        return "the connection was closed by the other side; did the implementation or its adapter end?"


class ProcessChannel(Channel):
    """The standard streams of a program that is started here."""

    def __init__(self, name: str, command: str) -> None:
        """Raises ``UsageError`` for a command that cannot be started."""
        super().__init__(name)
        words = split(name, command)
        try:
            self._process = subprocess.Popen(  # noqa: S603 - the command is the user's own
                words,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                start_new_session=True,
            )
        except OSError as error:
            raise UsageError(f"{name}: {words[0]} cannot be started: {error.strerror or error}") from None
        pipes = (self._process.stdin, self._process.stdout, self._process.stderr)
        self._pipes = [each for each in pipes if each is not None]
        self._in, self._out, self._err = (each.fileno() for each in self._pipes)
        self._err_open = True
        for descriptor in (self._in, self._out, self._err):
            os.set_blocking(descriptor, False)
        self._said = LastLines()

    def filenos(self) -> tuple[int, ...]:
        """Standard output, and standard error, so that it never gets full."""
        if self._ended:
            return ()
        return (self._out, self._err) if self._err_open else (self._out,)

    def _read(self) -> bytes | None:
        self._drain_errors()
        try:
            return os.read(self._out, 1 << 16)
        except BlockingIOError:
            return None

    def _drain_errors(self) -> None:
        while self._err_open:
            try:
                data = os.read(self._err, 1 << 16)
            except BlockingIOError:
                return
            if not data:
                self._err_open = False
            self._said.take(data)

    def _write(self, octets: memoryview) -> int:
        return os.write(self._in, octets)

    def _write_fileno(self) -> int:
        return self._in

    def close(self) -> None:
        """Close its input, which ends an adapter; then end the program with all that it started."""
        if self._pipes[0].closed:
            return
        self._ended = True
        self._pipes[0].close()
        end_group(self._process, patience=_END, ask_first=False)
        for each in self._pipes[1:]:
            each.close()
        self._err_open = False

    def end_description(self) -> str:
        """Its exit status and last words."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(_END)
        if self._err_open:
            self._drain_errors()
        status = self._process.poll()
        how = "closed its output" if status is None else f"ended with {ending(status)}"
        return f"the program {how}{self._said.shown()}"


def split(name: str, command: str) -> list[str]:
    """Split a command into words as a shell does; run it in a shell if it uses more than quoting.

    Raises ``UsageError``.
    """
    if re.search(r"[|&;<>()$`*?\[#~\n]|^\s*!|^\s*\w+=", command):
        return ["/bin/sh", "-c", command]
    try:
        words = shlex.split(command)
    except ValueError as error:
        raise UsageError(f"{name}: the command cannot be read: {error}") from None
    if not words:
        raise UsageError(f"{name}: which command?")
    return words


def _wait(descriptors: Sequence[int], events: int, seconds: float) -> None:
    waiting = select.poll()
    for descriptor in descriptors:
        waiting.register(descriptor, events)
    waiting.poll(max(1, round(seconds * 1000)))


def _connected(name: str, address: str | tuple[str, int], patience: float) -> socket.socket:
    deadline = time.monotonic() + patience
    while True:
        left = max(_ATTEMPT, deadline - time.monotonic())
        try:
            if isinstance(address, tuple):
                return socket.create_connection(address, timeout=left)
            opened = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
            try:
                opened.settimeout(left)
                opened.connect(address)
            except BaseException:
                opened.close()
                raise
        except (FileNotFoundError, ConnectionRefusedError, BlockingIOError) as error:
            # It may be about to start.
            if time.monotonic() >= deadline:
                raise NoListenerError(f"{name}: {_why_not(error, patience)}") from None
            time.sleep(_RETRY)
        except OSError as error:
            raise UpperTesterError(f"{name}: {_why_not(error, patience)}") from None
        else:
            return opened


def _why_not(error: OSError, patience: float) -> str:
    after = f", after {patience:g} s" if patience else ""
    if isinstance(error, FileNotFoundError):
        return f"there is no such socket{after}; is the implementation running, with this path?"
    if isinstance(error, ConnectionRefusedError):
        return f"no process listens there{after}; is the implementation or its adapter running?"
    if isinstance(error, TimeoutError | BlockingIOError):
        return f"no connection within {max(patience, _ATTEMPT):g} s"
    if isinstance(error, PermissionError):
        return "permission denied; the socket is for the user that runs the implementation"
    return f"cannot be reached: {error.strerror or error}"
