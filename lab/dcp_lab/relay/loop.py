"""The event loop of the relay: waits for frames, commands and deadlines, and forwards frames when they are due."""

from __future__ import annotations

import os
import select
import socket
import time
from collections.abc import Iterator, Sequence
from typing import Any, Final

from dcp_codec.impairment import ImpairmentError, parse_impairment
from dcp_codec.network.sockets import ETHERNET_HEADER
from dcp_stack.virtual.medium import ImpairedMedium

from .messages import Answer, Command, Count, Partition, SetQuality, SwitchPort
from .port import Port, Taken
from .recorder import PortRecorder

#: Maximum number of frames read from one port before due frames are sent.
_AT_A_TIME: Final = 16
#: Maximum wait in s, after which the relay tries to open missing interfaces again.
_LOOK: Final = 0.2
#: Time in ns before a deadline in which the relay does not sleep.
_AWAKE: Final = 150_000
#: Width of a class of the lateness in ns, and number of classes: together 40 ms.
_WIDTH: Final = 20_000
_CLASSES: Final = 2000


class Lateness:
    """A histogram of the times between deadline and transmission of frames, in bounded memory."""

    def __init__(self) -> None:
        self._counts = [0] * (_CLASSES + 1)
        self._most = 0

    def add(self, late: int) -> None:
        """Count a frame that was sent ``late`` ns after its deadline."""
        self._counts[min(max(late, 0) // _WIDTH, _CLASSES)] += 1
        self._most = max(self._most, late)

    def quantile(self, share: float) -> int:
        """Return the time in ns that at least this share of frames did not exceed; 0 without frames.

        The resolution is 20 us; above 40 ms the result is the largest time.
        """
        total = sum(self._counts)
        seen = 0
        for place, count in enumerate(self._counts):
            seen += count
            if total and seen >= share * total:
                return self._most if place == _CLASSES else min((place + 1) * _WIDTH, self._most)
        return 0

    def summary(self) -> dict[str, int]:
        """Return the median, the 99th percentile and the maximum in ns."""
        return {"p50": self.quantile(0.5), "p99": self.quantile(0.99), "max": self._most}


class Relay:
    """Forwards frames between ports. Times are monotonic ns since the creation of the relay."""

    def __init__(self, medium: ImpairedMedium, ports: Sequence[Port], recorders: Sequence[PortRecorder] = ()) -> None:
        """``medium`` decides about frames. ``recorders``: none, or one for each port."""
        self._medium, self._ports, self._recorders = medium, list(ports), list(recorders)
        self._start = time.monotonic_ns()
        self._last = 0
        self.lateness = Lateness()

    def now(self) -> int:
        """Return the current time in ns since the creation of the relay."""
        return time.monotonic_ns() - self._start

    def step(self, commands: int) -> bool:
        """Wait for frames, the next deadline or commands, and forward frames.

        ``commands``: the descriptor of commands. Returns whether it is readable.
        """
        sources = [port.socket for port in self._ports]
        left = _LOOK
        if (due := self._medium.poll_timeout()) is not None:
            # No sleep shortly before a deadline: waking up takes longer than the remaining time.
            left = min(max(0.0, (due - self.now() - _AWAKE) / 1e9), _LOOK)
        readable: list[int | socket.socket] = [commands, *(each for each in sources if each is not None)]
        ready, _, _ = select.select(readable, [], [], left)
        taken = [
            (each.time, number, each)
            for number, source in enumerate(sources)
            if source is not None and source in ready
            for each in self._read(self._ports[number])
        ]
        # Frames of different stations are forwarded in the order in which they were sent.
        for _, number, each in sorted(taken):
            self._take(number, each)
        self._forward()
        for port in self._ports:
            port.revive(self.now() + self._start)
        return commands in ready

    @staticmethod
    def _read(port: Port) -> Iterator[Taken]:
        """Yield the frames that a port has received, at most :data:`_AT_A_TIME`."""
        for _ in range(_AT_A_TIME):
            taken = port.read()
            if taken is None:
                return
            yield taken

    def _take(self, number: int, taken: Taken) -> None:
        """Record a received frame, and schedule it for its receivers."""
        # Frames may be read out of order, but the times for the medium must not decrease.
        self._last = max(self._last, taken.time - self._start, 0)
        if self._recorders:
            self._recorders[number].saw(taken.frame, taken.wall)
        self._medium.broadcast(number, taken.frame, self._last, ETHERNET_HEADER)

    def _forward(self) -> None:
        """Send all frames that are due."""
        for arrival in self._medium.arrivals(self.now()):
            for receiver in arrival.receivers:
                if not self._ports[receiver].send(arrival.octets):
                    continue
                self.lateness.add(self.now() - arrival.time)
                if self._recorders:
                    self._recorders[receiver].saw(arrival.octets, time.time_ns())

    def carry_out(self, command: Command) -> Answer:
        """Execute a command; returns the answer, which has the reason if the command is refused."""
        try:
            if isinstance(command, SetQuality):
                self._medium.set_quality(parse_impairment(command.impairment), command.sender, command.receiver)
            elif isinstance(command, Partition):
                self._medium.partition(command.groups)
            elif isinstance(command, SwitchPort):
                self._medium.switch(command.number, up=command.up)
            else:
                assert isinstance(command, Count)
                return Answer(ok=True, counters=self.counters())
        except ImpairmentError as error:
            return Answer(ok=False, why=str(error))
        return Answer(ok=True)

    def counters(self) -> dict[str, Any]:
        """Return the counters of links and ports and the lateness so far, as plain data for JSON."""
        for port in self._ports:
            port.count_drops()
        return {
            "links": self._medium.directions(),
            "ports": [
                {
                    "interface": port.interface,
                    "refused": port.refused,
                    "dropped": port.dropped,
                    "outages": port.outages,
                    "recorded": self._recorders[number].frames if self._recorders else 0,
                    "problem": self._recorders[number].problem if self._recorders else "",
                }
                for number, port in enumerate(self._ports)
            ],
            "lateness_ns": self.lateness.summary(),
        }

    def close(self) -> None:
        """Close recordings and ports; frames in flight are lost."""
        for recorder in self._recorders:
            recorder.close()
        for port in self._ports:
            port.close()


def prefer() -> None:
    """Raise the priority of this process, and remove the slack of its timers, so that it wakes up in time.

    No effect where the system does not permit it.
    """
    import contextlib
    import ctypes

    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, -10)
    with contextlib.suppress(OSError, AttributeError):
        # PR_SET_TIMERSLACK of <linux/prctl.h>, in ns.
        ctypes.CDLL(None).prctl(29, 1, 0, 0, 0)
