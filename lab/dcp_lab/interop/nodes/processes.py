"""Processes of a network in real time: started in a namespace, watched, and ended with their log kept."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from dcp_conformance.errors import ConformanceError, NoAnswerError, UpperTesterError, UsageError
from dcp_conformance.upper_tester import Answer
from dcp_conformance.upper_tester.base import Reconnecting
from dcp_conformance.upper_tester.opening import open_upper

from dcp_lab.sim.testbed.place import Place

#: Seconds that an answer may take, and an end.
_ANSWER: Final = 30.0
_END: Final = 3.0
#: Tables of open sockets in /proc/PID/net, each with a line of headings.
_SOCKETS: Final = ("packet", "udp", "udp6")


class Station(Place):
    """One place: its process while it is switched on, and its upper tester."""

    def __init__(self, place: int, namespace: str, command: list[str], upper: str, log: Path, ready_s: float) -> None:
        """``upper``: as ``--ut`` has it; empty: none. ``ready_s``: seconds that the process may take to be ready."""
        super().__init__(namespace, log, Path(upper[5:]) if upper.startswith("unix:") else None)
        self.place = place
        self.ready_s = ready_s
        self.death = ""
        self.methods: frozenset[str] | None = frozenset() if not upper else None
        self._command = command
        self._upper_spec = upper
        self._upper: Reconnecting | None = None
        self.node_id = ""
        """The node identifier that its upper tester reports; empty if it reports none."""
        #: Methods that the running process did not answer.
        self._unanswered: set[str] = set()

    def start(self) -> None:
        """Start the process. Raises ``UsageError`` if there is no such program."""
        self._unanswered.clear()
        try:
            self.launch(self._command)
        except OSError as error:
            raise UsageError(str(error)) from None

    def connect(self) -> bool:
        """Open the upper tester; True if there is none, or it answers."""
        if not self._upper_spec or self._upper is not None or self.ended():
            return True
        if self.socket is not None and not self.listens:
            return False
        try:
            self._upper = open_upper(self._upper_spec, _ANSWER)
        except UpperTesterError:
            return False
        self.methods = self._upper.methods
        node_id = self._upper.about.get("nodeId", "")
        self.node_id = node_id if isinstance(node_id, str) else ""
        return True

    def call(self, method: str, params: Mapping[str, Any]) -> Answer | None:
        """Call a method; None without an upper tester, or if it lacks the method.

        A method that the process did not answer in time is not called again: each call would take as long.
        """
        if self._upper is None or method not in self._upper.methods:
            return None
        if self.ended():
            # Reconnecting would wait for a process that does not come back.
            return Answer(code=-32603, message="the process has ended")
        if method in self._unanswered:
            return Answer(code=-32603, message=f"{method} was not called again: the process did not answer it before")
        try:
            answer = self._upper.call(method, dict(params))
            self._upper.poll()
        except UpperTesterError as error:
            if isinstance(error, NoAnswerError):
                self._unanswered.add(method)
            return Answer(code=-32603, message=str(error))
        return answer

    def ended(self) -> bool:
        """Whether the process ended by itself; ``death`` then says how."""
        how = self.end_of_process()
        if how:
            self.death = self.death or f"it {how}"
        return bool(how)

    def stop(self) -> None:
        """Switch it off as an empty battery does; processes that it has started end with it."""
        if self._upper is not None:
            self._upper.close()
            self._upper = None
        process = self.process
        if process is not None and not self.kill_process(_END):
            raise ConformanceError(f"process {process.pid} does not end after SIGKILL")

    def awaited(self, *, heard: bool) -> str:
        """Say what shows that the process is ready and has not happened; empty if it is ready, or has ended.

        With an upper tester, its answer; else its first beacon (``heard``), or an open socket: a station that has
        nothing to say sends no beacon (BP-FMT-03).
        """
        if self.process is None or self.ended():
            return ""
        if self._upper_spec:
            return "" if self.connect() else "no answer of its upper tester"
        return "" if heard or self._listens() else "no beacon, and no packet or UDP socket"

    def _listens(self) -> bool:
        assert self.process is not None
        own = Path("/proc", str(self.process.pid))
        try:
            if not (own / "ns/net").samefile(Path("/run/netns", self._namespace)):
                # It has not entered its namespace, and what it sees are sockets of others.
                return False
            return any(len((own / "net" / name).read_text().splitlines()) > 1 for name in _SOCKETS)
        except OSError:
            return False
