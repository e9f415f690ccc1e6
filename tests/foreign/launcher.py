"""The start script of a foreign-like implementation: ``python launcher.py SWITCHES.json``.

Starts the daemon, then the adapter and the second daemon, each a process of its own. Everything is forked from here,
so that one Python interpreter has to be started.
"""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import sys
import time
from collections.abc import Callable
from pathlib import Path

from switches import Switches


def main(path: str) -> None:
    """Start everything, then do what ``Switches.launcher`` says."""
    switches = Switches.load(path)
    switches.note_process("launcher", os.getpid())
    for stale in (switches.daemon_socket, switches.adapter_socket):
        Path(stale).unlink(missing_ok=True)
    time.sleep(switches.start_delay)
    daemon = child(switches, "daemon", run_daemon)
    wait_for_daemon(switches, daemon)
    if switches.srp != "none":
        child(switches, "srp", run_srp)
    if switches.adapter:
        time.sleep(switches.adapter_delay)
        child(switches, "adapter", run_adapter)
    if switches.launcher == "detaches":
        return
    while True:
        try:
            pid, status = os.wait()
        except ChildProcessError:
            # No child is left; a supervisor that stays waits for signals.
            signal.pause()
        if pid == daemon and switches.launcher == "ends":
            print(f"[start script] the daemon ended with status {status}", file=sys.stderr, flush=True)
            sys.exit(1)


def child(switches: Switches, name: str, run: Callable[[Switches], None]) -> int:
    """Fork a process; its number."""
    pid = os.fork()
    if pid:
        switches.note_process(name, pid)
        return pid
    status = 1
    try:
        run(switches)
        status = 0
    except SystemExit as error:
        status = error.code if isinstance(error.code, int) else 1
    except BaseException:
        import traceback

        traceback.print_exc()
    finally:
        sys.stderr.flush()
        os._exit(status)


def wait_for_daemon(switches: Switches, daemon: int) -> None:
    """Wait until the daemon serves; ends with it if it dies before."""
    while True:
        with socket.socket(socket.AF_UNIX) as trial, contextlib.suppress(OSError):
            trial.connect(switches.daemon_socket)
            return
        ended, _ = os.waitpid(daemon, os.WNOHANG)
        if ended:
            sys.exit("[start script] the daemon did not come up")
        time.sleep(0.01)


def run_daemon(switches: Switches) -> None:
    """BP and VarDis, as ``daemon.py`` has them."""
    import daemon

    daemon.run(switches)


def run_adapter(switches: Switches) -> None:
    """The program that speaks the contract."""
    import adapter

    adapter.run(switches)


def run_srp(switches: Switches) -> None:
    """The second daemon: it ends when the first one has."""
    import reports

    reports.run(switches)


if __name__ == "__main__":
    main(sys.argv[1])
