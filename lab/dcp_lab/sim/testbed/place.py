"""The places of a network in real time: namespaces with one interface each, and the process in each of them.

Testbeds of scenarios, the relay and the network tests of the tester use this module.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from dcp_codec.common.child import Child
from dcp_codec.network.namespaces import batch, enter_command

#: The interface of a place in its namespace.
INTERFACE: Final = "dcp0"


def place_names(prefix: str, count: int) -> list[str]:
    """Return the names of the namespaces of ``count`` places."""
    width = len(str(max(0, count - 1)))
    return [f"{prefix}-n{place:0{width}}" for place in range(count)]


def cable_to_hub(hub: str, places: Sequence[str], addresses: Sequence[bytes], *, bridge: str = "") -> None:
    """Create a veth pair from each place to the namespace ``hub``, where the other end is ``p0``, ``p1``, ...

    ``addresses``: MAC addresses of the interfaces of the places; octets after the sixth are ignored. ``bridge``: a
    bridge in ``hub`` of which the other ends become ports. Raises ``NamespaceError``.
    """
    master = f"master {bridge} " if bridge else ""
    lines = []
    for number, (name, address) in enumerate(zip(places, addresses, strict=True)):
        peer = f"{INTERFACE} address {address[:6].hex(':')} netns {name}"
        lines.append(f"link add p{number} type veth peer name {peer}")
        lines.append(f"link set p{number} addrgenmode none {master}up")
    batch("ip", hub, lines)
    for name in places:
        batch("ip", name, ["link set lo up", f"link set {INTERFACE} addrgenmode none up"])


class Place:
    """A namespace with a process while its node is switched on."""

    def __init__(self, namespace: str, log: Path, socket: Path | None) -> None:
        """``socket``: the Unix socket at which the process listens; None without one."""
        self.log = log
        self.socket = socket
        self.process: Child | None = None
        self._namespace = namespace

    @property
    def on(self) -> bool:
        """Whether it was switched on."""
        return self.process is not None

    def launch(self, command: Sequence[str]) -> None:
        """Start the process without waiting until it is ready. Raises ``OSError`` if there is no such program."""
        if self.socket is not None:
            # The process would refuse to start with the socket of an earlier one.
            self.socket.unlink(missing_ok=True)
        self.process = Child([*enter_command(self._namespace), *command], self.log)

    @property
    def listens(self) -> bool:
        """Whether its socket exists."""
        return self.socket is not None and self.socket.exists()

    def end_of_process(self, patience: float = 0.0) -> str:
        """Say how the process ended by itself, within ``patience`` s; empty while it runs, or is off."""
        status = None if self.process is None else self.process.status(patience)
        if self.process is None or status is None:
            return ""
        return f"ended with status {status}: {self.process.last_line() or 'it wrote nothing'}"

    def kill_process(self, patience: float) -> bool:
        """Kill the process with all that it has started, as if the battery were empty.

        Returns whether it ends within ``patience`` s.
        """
        process, self.process = self.process, None
        return process is None or process.kill(patience)
