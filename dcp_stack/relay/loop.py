"""The relay itself: waits for frames, commands and deadlines, and forwards what is due."""

from __future__ import annotations

import os
import select
import socket
import time
from collections.abc import Iterator, Sequence
from typing import Any, Final

from dcp_codec.impairment import ImpairmentError, Network, parse_impairment
from dcp_codec.network.sockets import ETHERNET_HEADER

from .lateness import Lateness
from .messages import Answer, Command, Count, Partition, SetQuality, SwitchPort
from .port import Port, Taken
from .recorder import PortRecorder

#: Frames that are read from one port before what is due is sent.
_AT_A_TIME: Final = 16
#: The longest wait in s, after which interfaces that were away are tried again.
_LOOK: Final = 0.2
#: ns before a deadline in which the relay stays awake.
_AWAKE: Final = 150_000


class Relay:
    """Forwards frames between ports; times are ns of the monotonic clock since the relay was made."""

    def __init__(self, network: Network, ports: Sequence[Port], recorders: Sequence[PortRecorder] = ()) -> None:
        """``recorders``: none, or one for each port."""
        self._network, self._ports, self._recorders = network, list(ports), list(recorders)
        self._start = time.monotonic_ns()
        self._last = 0
        self.lateness = Lateness()

    def now(self) -> int:
        """ns since the start."""
        return time.monotonic_ns() - self._start

    def step(self, commands: int) -> bool:
        """Wait for frames, for the next deadline or for commands, and forward; whether there are commands to read.

        ``commands``: the descriptor that commands come from.
        """
        sources = [port.socket for port in self._ports]
        left = _LOOK
        if (due := self._network.poll_timeout()) is not None:
            # Shortly before a deadline this does not sleep, since waking up takes longer than that.
            left = min(max(0.0, (due - self.now() - _AWAKE) / 1e9), _LOOK)
        readable: list[int | socket.socket] = [commands, *(each for each in sources if each is not None)]
        ready, _, _ = select.select(readable, [], [], left)
        taken = [
            (each.time, number, each)
            for number, source in enumerate(sources)
            if source is not None and source in ready
            for each in self._read(self._ports[number])
        ]
        # Stations whose frames are heard by the same others are heard in the order in which they have sent.
        for _, number, each in sorted(taken):
            self._take(number, each)
        self._forward()
        for port in self._ports:
            port.revive(self.now() + self._start)
        return commands in ready

    @staticmethod
    def _read(port: Port) -> Iterator[Taken]:
        for _ in range(_AT_A_TIME):
            taken = port.read()
            if taken is None:
                return
            yield taken

    def _take(self, number: int, taken: Taken) -> None:
        # A frame that came earlier may be read later; channels expect times that do not go back.
        self._last = max(self._last, taken.time - self._start, 0)
        if self._recorders:
            self._recorders[number].saw(taken.frame, taken.wall)
        self._network.broadcast(number, taken.frame, self._last, ETHERNET_HEADER)

    def _forward(self) -> None:
        for transit in self._network.due(self.now()):
            if not self._ports[transit.receiver].send(transit.octets):
                continue
            self.lateness.add(self.now() - transit.time)
            if self._recorders:
                self._recorders[transit.receiver].saw(transit.octets, time.time_ns())

    def carry_out(self, command: Command) -> Answer:
        """Do what was commanded. What is wrong with it is in the answer."""
        try:
            if isinstance(command, SetQuality):
                self._network.set(parse_impairment(command.impairment), command.sender, command.receiver)
            elif isinstance(command, Partition):
                self._network.partition(command.groups)
            elif isinstance(command, SwitchPort):
                self._network.port(command.number, up=command.up)
            else:
                assert isinstance(command, Count)
                return Answer(ok=True, counters=self.counters())
        except ImpairmentError as error:
            return Answer(ok=False, why=str(error))
        return Answer(ok=True)

    def counters(self) -> dict[str, Any]:
        """What became of all frames so far, as plain data for JSON."""
        for port in self._ports:
            port.count_drops()
        return {
            "links": self._network.counters(),
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
        """Give everything back; frames under way are lost."""
        for recorder in self._recorders:
            recorder.close()
        for port in self._ports:
            port.close()


def prefer() -> None:
    """Let this process wake up in time: before others, and without the slack that the kernel gives timers."""
    import contextlib
    import ctypes

    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, -10)
    with contextlib.suppress(OSError, AttributeError):
        # PR_SET_TIMERSLACK of <linux/prctl.h>, in ns.
        ctypes.CDLL(None).prctl(29, 1, 0, 0, 0)
