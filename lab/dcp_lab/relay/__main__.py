"""``python -m dcp_lab.relay``: forward frames between the interfaces of this network namespace.

The process reads the setup (``messages.Setup``) and then commands, each as a line of JSON, and answers each with a
line. At the end of its input it writes its counters and ends. Exit status: 0, or 2 if the setup is refused.
"""

from __future__ import annotations

import contextlib
import gc
import os
import signal
import sys
from pathlib import Path

import msgspec
from dcp_spec.profile.loading import ProfileError

from dcp_codec.capture import CaptureError
from dcp_codec.impairment import ImpairmentError, parse_impairment
from dcp_codec.network.sockets import OpeningError
from dcp_stack.virtual.medium import ImpairedMedium

from .loop import Relay, prefer
from .messages import Answer, Command, Setup
from .port import Port
from .recorder import PortRecorder

_COMMAND = msgspec.json.Decoder(Command)


def main() -> int:
    """Run the relay until its input ends; returns the exit status."""
    # A terminal sends SIGINT to all processes at once; the relay has to outlive the stations whose frames it carries.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    lines = _Lines(sys.stdin.fileno())
    first = lines.wait()
    try:
        relay = _make(msgspec.json.decode(first, type=Setup))
    except (msgspec.DecodeError, ImpairmentError, OpeningError, CaptureError, ProfileError, OSError) as error:
        _say(Answer(ok=False, why=str(error)))
        return 2
    prefer()
    # The relay creates no reference cycles from here on, and a garbage collection would delay frames that are due.
    gc.freeze()
    gc.disable()
    _say(Answer(ok=True))
    while not lines.ended:
        if relay.step(lines.descriptor):
            for line in lines.read():
                try:
                    answer = relay.carry_out(_COMMAND.decode(line))
                except msgspec.DecodeError as error:
                    answer = Answer(ok=False, why=f"not a command: {error}")
                _say(answer)
    found = relay.counters()
    relay.close()
    _say(Answer(ok=True, counters=found))
    return 0


def _make(setup: Setup) -> Relay:
    """Return a relay with open ports and recordings. Raises the errors of impairments, ports and recordings."""
    medium = ImpairedMedium(len(setup.ports), parse_impairment(setup.impairment), seed=setup.seed, pairs=setup.hears)
    ports: list[Port] = []
    recorders: list[PortRecorder] = []
    for number, interface in enumerate(setup.ports):
        try:
            ports.append(Port(interface))
        except (OpeningError, OSError) as error:
            raise OpeningError(f"port {number}, interface {interface}: {error}") from None
        if setup.record:
            path = Path(setup.record, f"port-{number}.mcap")
            recorders.append(PortRecorder(path, number, interface, setup.profile))
    return Relay(medium, ports, recorders)


class _Lines:
    """A reader of lines from a descriptor."""

    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor
        self.ended = False
        self._rest = b""

    def read(self) -> list[bytes]:
        """Return the complete lines that have arrived; waits only if there is no input at all."""
        octets = os.read(self.descriptor, 1 << 16)
        self.ended = not octets
        *lines, self._rest = (self._rest + octets).split(b"\n")
        return [each for each in lines if each.strip()]

    def wait(self) -> bytes:
        """Wait for the first line, and return it; empty at the end of input."""
        while not self.ended:
            if lines := self.read():
                # The client sends no further line before the answer.
                return lines[0]
        return b""


def _say(answer: Answer) -> None:
    """Write an answer as a line of JSON."""
    # The client may have ended.
    with contextlib.suppress(OSError):
        sys.stdout.buffer.write(msgspec.json.encode(answer) + b"\n")
        sys.stdout.buffer.flush()


if __name__ == "__main__":
    sys.exit(main())
