"""The implementation as a process: started and restarted by commands, watched, and ended with all that it started."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

from dcp_codec.common.child import Child, ending
from dcp_codec.common.processes import Held, Started, end_all
from dcp_conformance.errors import ConformanceError, UsageError
from dcp_conformance.upper_tester.channels import split

#: Seconds that commands which stop or restart something may take.
PATIENCE = 30.0
#: Seconds in which a start command may end by itself if it only launches something.
SETTLE = 0.5
#: Seconds that a process has to end after SIGTERM.
END_PATIENCE = 3.0


class ProcessControl:
    """Controls the implementation by the given commands and processes, all of them optional.

    * ``start``: a command that is the implementation, or launches it and ends with status 0: within ``SETTLE`` s, or
      later, if something that it has started still runs.
    * ``stop``: a command that stops it; without one the process of ``start`` and all that it has started get SIGTERM,
      and SIGKILL after 3 s.
    * ``restart``: a command that restarts it and ends; without one it is stopped and started.
    * ``pid``: a process to watch until a restart.

    Commands are run without a shell unless they use one (pipes, variables, ``&&``). Nothing is started here before
    :meth:`start` is called.
    """

    def __init__(
        self,
        start: str | list[str] | None = None,
        stop: str | None = None,
        restart: str | None = None,
        pid: int | None = None,
        *,
        around: Callable[[], AbstractContextManager[object]] = contextlib.nullcontext,
        ends_with_tester: bool = False,
        settle: float = SETTLE,
        udp_port: int | None = None,
        log: Path | None = None,
    ) -> None:
        """``around`` is entered while a process is made. ``ends_with_tester``: end it with the tester, also on SIGKILL.

        ``udp_port``: that of the link; None for Ethernet. ``log``: a new file for the output of all processes that are
        started.

        Raises ``UsageError`` for commands that cannot be read and for a process that is not there.
        """
        self._start = split("--start", start) if isinstance(start, str) else start
        self._stop = None if stop is None else split("access.stop", stop)
        self._restart = None if restart is None else split("--restart", restart)
        self._log = log
        if log is not None:
            log.unlink(missing_ok=True)
        self._around = around
        self._ends_with_tester = ends_with_tester
        self._settle = settle
        self._udp_port = udp_port
        self.can_restart = self._restart is not None or self._start is not None
        self.after_restart: list[Callable[[], None]] = []
        """Called after each restart, to reconnect upper testers."""
        self._process: Child | None = None
        self._launched = self._opened = False
        self._watched: Held | None = None
        self._why = ""
        self._started = Started()
        if pid is not None:
            try:
                self._watched = Held(pid)
            except ProcessLookupError:
                raise UsageError(f"--pid {pid}: there is no such process") from None

    # -- SutControl --------------------------------------------------------------------------------------------

    def alive(self) -> bool | None:
        """Whether the process runs; None if no process is known."""
        if self._watched is not None:
            if self._watched.ended():
                self._why = self._why or f"process {self._watched.pid} is gone"
                return False
            return True
        if self._process is None or self._launched:
            return None
        status = self._process.status()
        if status is None:
            self._process.trim()
            return True
        if status == 0 and self._settle and not self._why and self._started.running():
            # It is a launcher that has ended only now, since the machine is busy; or the process on the link has ended,
            # while another one that was started with it still runs.
            self._launched = not self._opened or self.on_link()
            if self._launched:
                return None
        self._why = self._why or f"it ended with {ending(status)}{self._process.last_lines()}"
        return False

    def why_dead(self) -> str:
        """How the process ended, and the last lines of its output."""
        return "" if self.alive() is not False else self._why

    def restart(self) -> None:
        """Restart it. Raises ``ConformanceError``: no command, or one that fails."""
        if self._restart is not None:
            self._run("--restart", self._restart)
            self._watched = None
        elif self._start is not None:
            self._end()
            self.start()
        else:
            raise ConformanceError("there is no command to restart the implementation (--restart, or --start)")
        for each in self.after_restart:
            each()

    def close(self) -> None:
        """End what was started here."""
        if self._process is not None:
            with contextlib.suppress(ConformanceError):
                self._end()

    # -- starting and ending -----------------------------------------------------------------------------------

    def start(self) -> None:
        """Start the implementation for the first time, if there is a start command.

        Raises ``UsageError`` if the command cannot be started, ``ConformanceError`` if it fails at once.
        """
        if self._start is None:
            return
        self._why, self._launched, self._opened = "", False, False
        try:
            self._process = Child(
                self._start,
                self._log,
                environment=self._started.environment(),
                around=self._around,
                ends_with_parent=self._ends_with_tester,
            )
        except OSError as error:
            raise UsageError(f"--start: {error}") from None
        status = self._process.status(self._settle)
        if status:
            said = self._process.last_lines()
            raise ConformanceError(f"--start: the command ended at once with {ending(status)}{said}")
        if status == 0:
            self._launched = True

    def _end(self) -> None:
        if self._stop is not None:
            self._run("access.stop", self._stop)
        if self._process is not None:
            if self._stop is None:
                # Held before a signal ends them.
                self._started.running()
            self._process.end(END_PATIENCE)
            self._process = None
            if self._stop is None:
                # Also those in other sessions: two nodes of one name spoil every verdict.
                end_all(self._started.running, END_PATIENCE)
        self._watched = None

    def _run(self, name: str, words: list[str]) -> None:
        """Run a command to its end. Raises ``ConformanceError`` if it fails or hangs."""
        try:
            command = Child(words, around=self._around)
        except OSError as error:
            raise UsageError(f"{name}: {error}") from None
        try:
            status = command.status(PATIENCE)
            if status is None:
                raise ConformanceError(f"{name}: the command did not end within {PATIENCE:g} s")
            if status:
                raise ConformanceError(f"{name}: the command ended with {ending(status)}{command.last_lines()}")
        finally:
            # End the command itself; processes that it started continue.
            command.popen.kill()
            command.popen.wait()
            command.close()

    # -- watching ----------------------------------------------------------------------------------------------

    def on_link(self) -> bool:
        """Whether a process of the implementation has a socket open for the link; False if that cannot be seen."""
        found = any(has_link_socket(each.pid, self._udp_port) for each in self._started.running())
        self._opened = self._opened or found
        return found


def has_link_socket(pid: int, udp_port: int | None) -> bool:
    """Whether a process has a packet socket open, or with ``udp_port`` a socket bound to it."""
    # Not by psutil, which knows no packet sockets, and UDP sockets of the own network namespace only.
    process = Path("/proc", str(pid))
    owned: set[str] = set()
    try:
        for link in (process / "fd").iterdir():
            # Closed in the meantime by another thread.
            with contextlib.suppress(OSError):
                owned.add(str(link.readlink()))
        if udp_port is None:
            rows = [line.split() for line in _lines(process / "net" / "packet")]
            return any(f"socket:[{row[8]}]" in owned for row in rows if len(row) > 8)
        rows = [line.split() for name in ("udp", "udp6") for line in _lines(process / "net" / name)]
        port = f"{udp_port:04X}"
        return any(row[1].endswith(f":{port}") and f"socket:[{row[9]}]" in owned for row in rows if len(row) > 9)
    except OSError:
        return False


def _lines(path: Path) -> list[str]:
    """The lines of a table in /proc without its heading; none where there is no such table."""
    return path.read_text().splitlines()[1:] if path.exists() else []
