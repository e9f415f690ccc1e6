"""Ports for tests: of one test process alone, whatever runs beside it on this machine."""

from __future__ import annotations

import os
import random
import socket
from pathlib import Path

#: Where nothing else is bound, so that to have a number there is to hold it against all other test processes.
_LOCK = "127.73.126.77"


def own_port() -> int:
    """A port that no other test process is given while this one lives, free for UDP and for TCP now.

    It is below those that the system chooses itself, for sockets of whoever runs here.
    """
    lowest = int(Path("/proc/sys/net/ipv4/ip_local_port_range").read_text().split()[0])
    # Processes that search at the same time begin elsewhere.
    candidates = list(range(10_000, lowest))
    random.Random(os.getpid()).shuffle(candidates)
    for port in candidates:
        lock = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            lock.bind((_LOCK, port))
            for kind in (socket.SOCK_DGRAM, socket.SOCK_STREAM):
                with socket.socket(socket.AF_INET, kind) as trial:
                    trial.bind(("", port) if kind is socket.SOCK_DGRAM else ("127.0.0.1", port))
        except OSError:
            lock.close()
            continue
        # Held until the process ends.
        lock.detach()
        return port
    raise AssertionError("there is no free port")
