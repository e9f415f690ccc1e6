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
"""Seconds that a node may take to answer."""
LONGEST_ANSWER = 1 << 30
"""Octets of a line of the node: a database of 65,536 variables has some ten million."""


class ControlError(Exception):
    """The node cannot be reached, or it stopped answering; the message says where and what to look at."""


class ServiceError(Exception):
    """The node answered with a JSON-RPC error: ``code``, ``message`` and ``data`` are its members."""

    def __init__(self, code: int, message: str, data: Any = None) -> None:
        # All arguments, so that the error can be sent from one process to another.
        super().__init__(code, message, data)
        self.code = code
        self.message = message
        self.data = data

    def __str__(self) -> str:
        return self.message


class Notification(NamedTuple):
    """Something the node told without being asked."""

    method: str
    params: dict[str, Any]


class ControlClient:
    """A connection to a node. Not for several threads at once."""

    def __init__(self, path: str | Path, *, patience: float = PATIENCE) -> None:
        """Raises ControlError if nobody listens at ``path``; ``patience`` is in s, for each answer."""
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
            why = "is no socket" if _is_something_else(self.path) else _why_not(error)
            raise ControlError(f"{path}: {why}") from None

    def _connect(self, patience: float) -> None:
        deadline = time.monotonic() + patience
        while True:
            try:
                self._socket.settimeout(patience)
                self._socket.connect(os.fspath(self.path))
            except BlockingIOError:
                # Many others are waiting to be let in; with a timeout, the system does not wait by itself.
                if time.monotonic() > deadline:
                    raise
                time.sleep(0.01)
            else:
                return

    def fileno(self) -> int:
        """The descriptor of the socket."""
        return self._socket.fileno()

    def call(self, method: str, /, **params: Any) -> dict[str, Any]:
        """The result of a method; parameters under the specification's names.

        Raises ServiceError for an error of the node, ControlError if there is no answer.
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
            # Without an id: a request that the node could not read, which can only be this one.
            if message.get("id") not in (self._last_id, None):
                # An answer to what an earlier call gave up waiting for.
                continue
            match message:
                case {"error": {"code": int(code), "message": str(text), **more}}:
                    raise ServiceError(code, text, more.get("data"))
                case {"result": dict(result), "id": int()}:
                    return result
                case _:
                    raise self._no_node()

    def wait(self, timeout: float | None = None) -> Notification | None:
        """The next notification; None if there is none within ``timeout`` s (None: wait for ever)."""
        if self._notifications:
            return self._notifications.popleft()
        deadline = None if timeout is None else time.monotonic() + timeout
        while not self._notifications:
            if self._message(deadline, once=True) is None and not self._notifications:
                return None
        return self._notifications.popleft()

    def _message(self, deadline: float | None, *, once: bool = False) -> dict[str, Any] | None:
        """The next response; None at the deadline. Notifications are put aside, ``once``: any message will do."""
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
        return ControlError(f"{self.path}: what answers there does not speak as a node does")

    def _fill(self, deadline: float | None) -> bool:
        """Read more; False at the deadline. Raises ControlError at the end of the connection."""
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
            raise ControlError(f"{self.path}: the node has closed the connection")
        self._lines.add(data)
        return True

    def close(self) -> None:
        """End the connection; may be called twice."""
        self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()


def _is_something_else(path: Path) -> bool:
    try:
        return not path.is_socket() and path.exists()
    except OSError:
        return False


def _why_not(error: OSError) -> str:
    if isinstance(error, FileNotFoundError):
        return "there is no such socket; is a node running with --control on this path?"
    if isinstance(error, ConnectionRefusedError):
        return "nobody listens there; the node that made this socket has ended"
    if isinstance(error, PermissionError):
        return "permission denied; the socket is for the user that runs the node"
    if isinstance(error, ConnectionResetError | BrokenPipeError):
        return "the node has closed the connection"
    return error.strerror or str(error)
