"""How a foreign-like implementation behaves: one value, written by a test and read by the programs.

No import beyond the standard library: the launcher and the adapter start quickly.
"""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Literal


@dataclass(frozen=True, kw_only=True)
class Switches:
    """Everything that a test can choose. Times are in s unless the name says ms."""

    # -- the node ------------------------------------------------------------------------------------------------

    profile: str = "dcp-2.0"
    node_id: str = "02:00:00:00:00:01"
    faults: tuple[str, ...] = ()
    """Names in ``faults.py``, or identifiers of mutants of the self-test (``M-BP-HDR-02-swapped``)."""
    death: Literal["aborts", "exits", "hangs"] = "aborts"
    """What a fault ``crashes-on-...`` does to the daemon: SIGABRT, exit with status 0, or live on without doing
    anything."""
    death_delay: float = 0.0
    """Time between the cause and the death; the daemon works until then."""
    beacon_period_ms: int = 20
    buffer_check_period_ms: int = 10
    poll_ms: float | None = None
    """Slow but legal: VarDis takes one received payload every so many ms, the others wait. None: at once."""
    network_id: int | None = None
    """None: that of the profile."""
    ether_type: int | None = None
    """On Ethernet; None: that of the profile."""
    own_variable: int | None = None
    """A variable with this identifier is created at the start, so that every beacon has a summary."""

    # -- the processes -------------------------------------------------------------------------------------------

    launcher: Literal["stays", "ends", "detaches"] = "ends"
    """What the start script does: lives on when the daemon has died, ends with it (status 1), or starts everything and
    ends with status 0."""
    start_delay: float = 0.0
    """Time before the daemon is started."""
    srp: Literal["none", "process", "child"] = "none"
    """A second daemon: one that reports safety data (``process``), or one that only runs (``child``)."""
    adapter: bool = True
    adapter_after: float | None = 0.0
    """When the adapter ends, in seconds after the crash of the daemon. Negative: before it (the daemon continues to
        work until its crash). None: never, the adapter outlives the daemon."""
    adapter_delay: float = 0.0
    """Time between the start of the daemon and that of the adapter."""

    # -- the adapter ---------------------------------------------------------------------------------------------

    call_delay: float = 0.0
    """Time that each call takes in addition."""
    reset: bool = False
    """Whether there is a UT-Reset."""
    hides: tuple[str, ...] = ()
    """Methods that the adapter does not have."""
    tells: tuple[str, ...] = ("nodeId", "profile")
    """Which of these two UT-Hello tells."""
    without_daemon: Literal["error", "silence", "status"] = "error"
    """What a call gets when the daemon is dead and the adapter is not: a JSON-RPC error, nothing, or a status that the
    specification does not have. UT-Hello is answered as usual: the adapter knows its methods."""
    while_inactive: Literal["conforming", "status", "error"] = "conforming"
    """What RTDB-Create, -Update and -Delete get in place of INACTIVE: a status that the specification does not have
    (INTERNAL_SHARED_MEMORY_ERROR), or a JSON-RPC error for a reason of the adapter's own."""
    transmit_while_inactive: Literal["conforming", "status", "error"] = "conforming"
    """The same for BP-TransmitPayload while BP is deactivated, which should succeed."""

    # -- the surroundings ----------------------------------------------------------------------------------------

    link: str = ""
    """The daemon's link, as ``dcp-node run --link`` has it; the rig fills it in."""
    folder: str = ""
    """For sockets and the file of process numbers; the rig fills it in."""

    @property
    def daemon_socket(self) -> str:
        """Where the daemon serves the adapter."""
        return f"{self.folder}/daemon.sock"

    @property
    def adapter_socket(self) -> str:
        """Where the adapter serves the tester."""
        return f"{self.folder}/ut.sock"

    @property
    def process_file(self) -> Path:
        """Lines ``NAME PID``, one for every process that was ever started."""
        return Path(self.folder, "processes")

    def save(self, path: Path) -> None:
        """Write them."""
        path.write_text(json.dumps(dataclasses.asdict(self)), encoding="utf-8")

    @classmethod
    def load(cls, path: str) -> Switches:
        """Read what :meth:`save` has written."""
        data = json.loads(Path(path).read_text(encoding="utf-8"))
        return cls(**{name: tuple(value) if isinstance(value, list) else value for name, value in data.items()})

    def note_process(self, name: str, pid: int) -> None:
        """Add a line to the file of processes."""
        with self.process_file.open("a", encoding="utf-8") as file:
            file.write(f"{name} {pid}\n")

    def pid_of(self, name: str) -> int | None:
        """The number of the process that was started last under this name."""
        lines = self.process_file.read_text(encoding="utf-8").splitlines() if self.process_file.exists() else []
        return next((int(line.split()[1]) for line in reversed(lines) if line.split()[0] == name), None)
