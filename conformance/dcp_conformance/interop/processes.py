"""Processes of a network in real time: started in a namespace, watched, and ended with their log kept."""

from __future__ import annotations

import contextlib
import subprocess
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from dcp_conformance.errors import ConformanceError, UpperTesterError, UsageError
from dcp_conformance.upper_tester import Answer
from dcp_conformance.upper_tester.base import Reconnecting
from dcp_conformance.upper_tester.opening import open_upper
from dcp_stack.sim.testbed.namespaces import enter_command

#: Seconds that an answer may take, and an orderly end.
_ANSWER: Final = 10.0
_END: Final = 3.0


class Station:
    """One place: its process while it is switched on, and its upper tester."""

    def __init__(self, place: int, namespace: str, command: list[str], upper: str, log: Path, ready_s: float) -> None:
        """``upper``: as ``--ut`` has it; empty: none. ``ready_s``: seconds that the process may take to be ready."""
        self.place = place
        self.log = log
        self.ready_s = ready_s
        self.death = ""
        self.methods: frozenset[str] | None = frozenset() if not upper else None
        self._namespace = namespace
        self._command = command
        self._upper_spec = upper
        self._upper: Reconnecting | None = None
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def on(self) -> bool:
        """Whether it was switched on."""
        return self._process is not None

    def start(self) -> None:
        """Start the process. Raises ``UsageError`` if there is no such program."""
        if self._upper_spec.startswith("unix:"):
            # A socket of an earlier life would be refused as one in use.
            Path(self._upper_spec[5:]).unlink(missing_ok=True)
        with self.log.open("ab") as log:
            try:
                self._process = subprocess.Popen(  # noqa: S603 - the user's own command, without a shell
                    [*enter_command(self._namespace), *self._command],
                    stdin=subprocess.DEVNULL,
                    stdout=log,
                    stderr=log,
                    start_new_session=True,
                )
            except OSError as error:
                raise UsageError(f"{self._command[0]} cannot be started: {error.strerror or error}") from None

    def connect(self) -> bool:
        """Open the upper tester; True if there is none, or it answers."""
        if not self._upper_spec or self._upper is not None or self.ended():
            return True
        if self._upper_spec.startswith("unix:") and not Path(self._upper_spec[5:]).exists():
            return False
        try:
            self._upper = open_upper(self._upper_spec, _ANSWER)
        except UpperTesterError:
            return False
        self.methods = self._upper.methods
        return True

    def call(self, method: str, params: Mapping[str, Any]) -> Answer | None:
        """Call a method; None without an upper tester, or if it lacks the method."""
        if self._upper is None or method not in self._upper.methods:
            return None
        if self.ended():
            # Reconnecting would wait for a process that does not come back.
            return Answer(code=-32603, message="the process has ended")
        try:
            answer = self._upper.call(method, dict(params))
            self._upper.poll()
        except UpperTesterError as error:
            return Answer(code=-32603, message=str(error))
        return answer

    def ended(self) -> bool:
        """Whether the process ended by itself; ``death`` then says how."""
        if self._process is None or self._process.poll() is None:
            return False
        self.death = self.death or f"it ended with status {self._process.returncode}: {self._last_words()}"
        return True

    def stop(self) -> None:
        """Switch it off as an empty battery does; processes that it has started end with it."""
        if self._upper is not None:
            self._upper.close()
            self._upper = None
        if self._process is not None:
            with contextlib.suppress(ProcessLookupError):
                self._process.kill()
            try:
                self._process.wait(_END)
            except subprocess.TimeoutExpired:
                raise ConformanceError(f"process {self._process.pid} does not end after SIGKILL") from None
            self._process = None

    def _last_words(self) -> str:
        lines = self.log.read_text(errors="replace").strip().splitlines() if self.log.is_file() else []
        return lines[-1][-300:] if lines else "it wrote nothing"


def wait_ready(stations: list[Station], deadline_s: float, heard: set[int]) -> list[Station]:
    """Return the stations that are still not ready after one look at each.

    A station without an upper tester is ready with its first beacon (``heard``), or after its time.
    """
    late = time.monotonic() > deadline_s
    waiting = []
    for station in stations:
        if not station.connect():
            if late:
                raise ConformanceError(
                    f"place {station.place}: its upper tester does not answer in {station.ready_s:g} s"
                )
            waiting.append(station)
        elif station.methods == frozenset() and station.place not in heard and not late and not station.ended():
            waiting.append(station)
    return waiting
