"""The second daemon: reports safety data through the first one, or only waits for its end."""

from __future__ import annotations

import json
import socket
import time

from switches import Switches


def run(switches: Switches) -> None:
    """Until the daemon is gone."""
    with socket.socket(socket.AF_UNIX) as daemon:
        daemon.connect(switches.daemon_socket)
        lines = daemon.makefile("rb")
        number = 0
        while switches.srp == "process":
            number += 1
            data = {"x": float(number % 100), "y": 2.0, "z": 30.0}
            params = {"sData": data}
            message = {"jsonrpc": "2.0", "id": number, "method": "SRP-UpdateSafetyData", "params": params}
            try:
                daemon.sendall(json.dumps(message).encode() + b"\n")
                if not lines.readline():
                    return
            except OSError:
                return
            time.sleep(switches.beacon_period_ms / 1000)
        lines.readline()
