"""A client of the control interface over a Unix socket, for commands and test programs: one request at a time."""

from __future__ import annotations

import os
import socket
import time
from collections import deque
from pathlib import Path
from typing import Any, NamedTuple, Self

from dcp_codec.common.lines import LineBuffer, LineTooLongError

from .jsonrpc import RpcError, parse, request_message

PATIENCE = 10.0
"""Default time in s for an answer of the node."""
CLOSED = "the node has closed the connection: it has ended, or its log has the reason, such as too many clients"
LONGEST_ANSWER = 1 << 30
"""Maximum length of a line from the node in octets: a database of 65,536 variables has about ten million."""


class ControlError(Exception):
    """The node cannot be reached, or it stopped answering; the message names the socket, the cause and a remedy."""


class ServiceError(Exception):
    """The node answered with a JSON-RPC error: ``code``, ``message`` and ``data`` are its members."""

    def __init__(self, code: int, message: str, data: Any = None) -> None:
        # Pass all arguments, so that the error can be pickled and sent to another process.
        super().__init__(code, message, data)
        self.code = code
        self.message = message
        self.data = data

    def __str__(self) -> str:
        return self.message


class Notification(NamedTuple):
    """A message that the node sent without a request, such as an indication."""

    method: str
    params: dict[str, Any]


class ControlClient:
    """A connection to a node; not thread-safe."""

    def __init__(self, path: str | Path, *, patience: float = PATIENCE) -> None:
        """Connect to ``path``; ``patience``: s for each answer. Raises ControlError if no node listens."""
        self.path = Path(path)
        self._patience = patience
        self._lines = LineBuffer(LONGEST_ANSWER)
        self._notifications: deque[Notification] = deque()
        self._last_id = 0
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            self._connect(patience)
        except OSError as error:
            self._socket.close()
            why = "is not a socket" if _is_something_else(self.path) else _why_not(error)
            raise ControlError(f"{path}: {why}") from None

    def _connect(self, patience: float) -> None:
        """Connect the socket, and wait up to ``patience`` s while the queue of the node is full."""
        deadline = time.monotonic() + patience
        while True:
            try:
                self._socket.settimeout(patience)
                self._socket.connect(os.fspath(self.path))
            except BlockingIOError:
                # Many clients are waiting to be accepted; a socket with a timeout returns at once instead of waiting.
                if time.monotonic() > deadline:
                    raise
                time.sleep(0.01)
            else:
                return

    def fileno(self) -> int:
        """Return the descriptor of the socket."""
        return self._socket.fileno()

    def call(self, method: str, /, **params: Any) -> dict[str, Any]:
        """Call a method and return its result; parameters have the names of the specification.

        Raises ServiceError if the node answers with an error, ControlError if it does not answer.
        """
        self._last_id += 1
        try:
            self._socket.settimeout(self._patience)
            self._socket.sendall(request_message(self._last_id, method, params) + b"\n")
        except OSError as error:
            raise ControlError(f"{self.path}: {_why_not(error)}") from None
        deadline = time.monotonic() + self._patience
        while True:
            message = self._message(deadline)
            if message is None:
                raise ControlError(f"{self.path}: the node did not answer {method} within {self._patience:g} s")
            # A node answers a request that it could not parse without an id; it can only be this request.
            if message.get("id") not in (self._last_id, None):
                # A late answer to an earlier call that timed out.
                continue
            match message:
                case {"error": {"code": int(code), "message": str(text), **more}}:
                    raise ServiceError(code, text, more.get("data"))
                case {"result": dict(result), "id": int()}:
                    return result
                case _:
                    raise self._no_node()

    def wait(self, timeout: float | None = None) -> Notification | None:
        """Return the next notification; None if there is none within ``timeout`` s (None: wait without limit)."""
        if self._notifications:
            return self._notifications.popleft()
        deadline = None if timeout is None else time.monotonic() + timeout
        while not self._notifications:
            if self._message(deadline, once=True) is None and not self._notifications:
                return None
        return self._notifications.popleft()

    def _message(self, deadline: float | None, *, once: bool = False) -> dict[str, Any] | None:
        """Return the next response; None at the deadline. Notifications are queued; with ``once`` they end the wait."""
        while True:
            try:
                line = self._lines.next()
                message = None if line is None else parse(line)
            except (LineTooLongError, RpcError):
                raise self._no_node() from None
            if line is None:
                if not self._fill(deadline):
                    return None
                continue
            if not isinstance(message, dict):
                raise self._no_node()
            match message:
                case {"method": str(method), "params": dict(params)}:
                    self._notifications.append(Notification(method, params))
                    if not once:
                        continue
                case {"method": _}:
                    raise self._no_node()
            return message

    def _no_node(self) -> ControlError:
        return ControlError(f"{self.path}: the program that listens there is not a node; check the path")

    def _fill(self, deadline: float | None) -> bool:
        """Read more octets; return False at the deadline. Raises ControlError at the end of the connection."""
        left = None if deadline is None else deadline - time.monotonic()
        if left is not None and left <= 0:
            return False
        try:
            self._socket.settimeout(left)
            data = self._socket.recv(1 << 16)
        except TimeoutError:
            return False
        except OSError as error:
            raise ControlError(f"{self.path}: {_why_not(error)}") from None
        if not data:
            raise ControlError(f"{self.path}: {CLOSED}")
        self._lines.add(data)
        return True

    def close(self) -> None:
        """Close the connection; may be called twice."""
        self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()


def _is_something_else(path: Path) -> bool:
    """Whether the path exists and is not a socket."""
    try:
        return not path.is_socket() and path.exists()
    except OSError:
        return False


def _why_not(error: OSError) -> str:
    """Describe an error of the connection for the user."""
    if isinstance(error, FileNotFoundError):
        return "there is no such socket; is a node running with --control on this path?"
    if isinstance(error, ConnectionRefusedError):
        return "no program listens there; the node that made this socket has ended"
    if isinstance(error, PermissionError):
        return "permission denied; only the user of the node and its control_group may use the socket"
    if isinstance(error, ConnectionResetError | BrokenPipeError):
        return CLOSED
    return error.strerror or str(error)
