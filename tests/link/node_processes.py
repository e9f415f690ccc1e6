"""Nodes as processes of their own, on UDP multicast over the loopback interface."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from dcp_stack.control.client import ControlClient, ControlError

from ..ports import own_port
from ..waiting import PATIENCE, eventually

#: Test processes that run side by side must not hear each other.
LINK = f"udp:239.73.126.78:{own_port()}"


class NodeProcess:
    """``dcp-node run`` with a control socket; its log is kept."""

    def __init__(
        self,
        folder: Path,
        number: int,
        *args: str,
        link: str = LINK,
        stdin: int | None = None,
        namespace: str | None = None,
    ) -> None:
        self.path = folder / f"node{number}.sock"
        self.node_id = f"02:00:00:00:00:{number:02x}"
        command = [] if namespace is None else ["ip", "netns", "exec", namespace]
        command += [sys.executable, "-m", "dcp_stack.cli", "run", "--link", link, "--node-id", self.node_id]
        command += ["--control", str(self.path), *args]
        self.popen = subprocess.Popen(
            command, stdin=stdin or subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        self.log: list[str] = []
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.popen.stderr is not None
        self.log.extend(self.popen.stderr)

    def client(self) -> ControlClient:
        """A connection, as soon as the node answers: one that only listens may not have made all that it needs."""
        deadline = time.monotonic() + PATIENCE
        while True:
            try:
                client = ControlClient(self.path, patience=PATIENCE)
                try:
                    client.call("UT-Hello")
                except ControlError:
                    client.close()
                    raise
                return client
            except ControlError:
                if self.popen.poll() is not None or time.monotonic() > deadline:
                    pytest.fail(f"the node does not answer: {''.join(self.log)}")
                time.sleep(0.02)

    def end(self, number: int = signal.SIGTERM) -> int:
        """End it; its exit status."""
        if self.popen.poll() is None:
            self.popen.send_signal(number)
        status = self.popen.wait(PATIENCE)
        self._reader.join(PATIENCE)
        for stream in (self.popen.stdin, self.popen.stdout, self.popen.stderr):
            if stream is not None:
                stream.close()
        return status


def slots_a_second(before: dict[str, Any], after: dict[str, Any]) -> float:
    """Beacons a second for which a node had time, from two answers to UT-Status.

    A node that the machine delays too long leaves beacons out and counts them: they belong to its rate.
    """
    counters = [each["node"]["bp"]["counters"] for each in (before, after)]
    first, last = (each["beacons-sent"] + each["beacons-left-out"] for each in counters)
    return float((last - first) / ((after["now"] - before["now"]) / 1e9))


def keeps_rate(
    client: ControlClient, before: dict[str, Any], rate: float, rel: float, seconds: float
) -> dict[str, Any]:
    """Wait until a node has kept a rate of beacons a second since ``before``; the status at that time.

    At least for ``seconds``. A wait of the machine at the very moment of a status is a part of the time between the
    two that gets smaller the longer one looks; a rate that is wrong stays wrong.
    """
    rates: list[float] = []

    def kept() -> dict[str, Any] | None:
        after: dict[str, Any] = client.call("UT-Status")
        if after["now"] - before["now"] < seconds * 1e9:
            return None
        rates.append(slots_a_second(before, after))
        assert len(rates) < 200, f"{rate} beacons a second were expected, there are {rates[0]:.2f} ... {rates[-1]:.2f}"
        return after if rates[-1] == pytest.approx(rate, rel=rel) else None

    return eventually(kept, f"{rate} beacons a second", pause=0.1)


def command(*args: object, stdin: str | None = None) -> subprocess.CompletedProcess[str]:
    """``dcp-node`` with these arguments, to its end."""
    return subprocess.run(
        [sys.executable, "-m", "dcp_stack.cli", *map(str, args)],
        input=stdin,
        stdin=subprocess.DEVNULL if stdin is None else None,
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
    )


def lines(text: str) -> list[Any]:
    """JSON lines."""
    return [json.loads(line) for line in text.splitlines()]
