"""The daemon: BP and VarDis of our stack with the faults that a test asks for."""

from __future__ import annotations

import os
import resource
import signal
import sys
import threading
import time
from typing import Any

from faults import Victim, with_faults
from switches import Switches

from dcp_stack.runtime.opening import open_node
from dcp_stack.runtime.settings import load_settings


def run(switches: Switches) -> None:
    """Serve until SIGTERM, or until a fault ends it."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    flags: dict[str, Any] = {
        "link": switches.link,
        "profile": switches.profile,
        "node_id": switches.node_id,
        "control": switches.daemon_socket,
        "log_level": "warning",
        "bp.beacon_period_ms": switches.beacon_period_ms,
        "bp.network_id": switches.network_id,
        "vardis.buffer_check_period_ms": switches.buffer_check_period_ms,
    }
    make = with_faults(switches.faults, Killer(switches), poll_ms=switches.poll_ms)
    with open_node(load_settings(None, flags), make) as driver:

        def ready() -> None:
            if switches.own_variable is not None and driver.node.vardis is not None:
                now, wall = time.monotonic_ns(), time.time_ns()
                confirm = driver.node.vardis.create(switches.own_variable, None, 1, b"own", b"\x01", now=now, wall=wall)
                assert confirm.status.is_ok, confirm
                driver.node.settle(now, wall)

        driver.run(ready)


class Killer(Victim):
    """Ends this process in the way that the switches say, once."""

    def __init__(self, switches: Switches) -> None:
        self._switches = switches
        self._dying = False

    def die(self, words: str, after: float = 0.0) -> None:
        """The daemon has met what it cannot stand."""
        if self._dying:
            return
        self._dying = True
        delay = after + self._switches.death_delay
        adapter_after = self._switches.adapter_after
        if adapter_after is not None and adapter_after < 0:
            pid = self._switches.pid_of("adapter")
            if pid is not None:
                os.kill(pid, signal.SIGKILL)
            delay -= adapter_after
        if delay > 0:
            threading.Timer(delay, self._end, (words,)).start()
        else:
            self._end(words)

    def _end(self, words: str) -> None:
        print(f"[daemon] [fatal] {words}", file=sys.stderr, flush=True)
        how = self._switches.death
        if how == "hangs":
            os.kill(os.getpid(), signal.SIGSTOP)
        elif how == "exits":
            os._exit(0)
        else:
            os.abort()
