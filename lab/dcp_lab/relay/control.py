"""The client side of a relay that runs in its own process."""

from __future__ import annotations

import contextlib
import select
import sys
import time
from collections.abc import Sequence
from typing import Any, Final

import msgspec

from dcp_codec.common.child import Child

from .messages import Answer, Command, Count, Setup

#: Maximum time in s for the start of the relay, and for an answer.
START_PATIENCE: Final = 180.0
PATIENCE: Final = 60.0


class RelayError(Exception):
    """The relay refused a command, does not answer or has ended; the message has the reason."""


class RelayProcess:
    """A process of ``python -m dcp_lab.relay``. It ends with this process at the latest."""

    def __init__(self, setup: Setup, around: Sequence[str] = ()) -> None:
        """Start the relay, and wait until its ports are open.

        ``around``: arguments that precede the command, such as those of ``nsenter``. Raises :class:`RelayError` if it
        does not start or refuses the setup.
        """
        self._rest = b""
        try:
            # Signals to the group of this program (Ctrl-C, timeout(1)) must not end the relay before its stations.
            self._child = Child([*around, sys.executable, "-m", "dcp_lab.relay"], pipes=True)
        except OSError as error:
            raise RelayError(f"the relay cannot be started: {error}") from None
        self._process = self._child.popen
        self._final: dict[str, Any] | None = None
        try:
            self._ask(msgspec.json.encode(setup), START_PATIENCE)
        except RelayError:
            self.close()
            raise

    @property
    def pid(self) -> int:
        """Identifier of the process."""
        return self._process.pid

    def command(self, command: Command) -> Answer:
        """Send a command, and return the answer. Raises :class:`RelayError` if it is refused or the relay has ended."""
        return self._ask(msgspec.json.encode(command), PATIENCE)

    def counters(self) -> dict[str, Any]:
        """Return the current counters, after :meth:`close` the last ones. Raises :class:`RelayError`."""
        return self._final if self._final is not None else self.command(Count()).counters

    def close(self) -> dict[str, Any]:
        """End the relay; returns its last counters (empty if it did not end normally). May be called twice."""
        if self._final is not None:
            return self._final
        self._final = {}
        assert self._process.stdin is not None
        with contextlib.suppress(OSError):
            self._process.stdin.close()
        with contextlib.suppress(RelayError, msgspec.DecodeError):
            self._final = msgspec.json.decode(self._line(PATIENCE), type=Answer).counters
        self._child.status(PATIENCE)
        self._child.kill(PATIENCE)
        return self._final

    def _ask(self, line: bytes, patience: float) -> Answer:
        """Send a line, and return the answer to it within ``patience`` s."""
        assert self._process.stdin is not None
        if self._final is not None:
            raise RelayError("the relay is closed")
        try:
            self._process.stdin.write(line + b"\n")
            self._process.stdin.flush()
        except OSError:
            raise self._gone() from None
        answer = msgspec.json.decode(self._line(patience), type=Answer)
        if not answer.ok:
            raise RelayError(f"the relay refuses: {answer.why}")
        return answer

    def _line(self, patience: float) -> bytes:
        """Return the next line of the relay within ``patience`` s."""
        assert self._process.stdout is not None
        deadline = time.monotonic() + patience
        while b"\n" not in self._rest:
            left = deadline - time.monotonic()
            if left <= 0 or not select.select([self._process.stdout], [], [], left)[0]:
                raise RelayError(f"the relay does not answer within {patience:g} s")
            octets = self._process.stdout.read1()  # type: ignore[attr-defined]
            if not octets:
                raise self._gone()
            self._rest += octets
        line, _, self._rest = self._rest.partition(b"\n")
        return line

    def _gone(self) -> RelayError:
        """Return the error for a relay that has ended, with its exit status and the last line that it wrote."""
        status, said = self._child.status(1.0), self._child.last_line()
        last = f"; its last message: {said}" if said else ""
        return RelayError(f"the relay has ended (exit status {status}){last}")
