"""The nodes of a testbed: processes of ``dcp-node run``, each in its own namespace, controlled by their sockets."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
from msgspec.structs import asdict

from dcp_lab.sim.scenario.agreement import Known
from dcp_lab.sim.scenario.definition import NS_PER_S, Scenario
from dcp_stack.control.client import ControlClient, ControlError
from dcp_stack.runtime.settings import Settings, SRPSettings, VardisSettings, settings_text

from .place import INTERFACE, Place

#: Maximum time in s for the answer to a request, and for the end of a node after SIGTERM.
ANSWER_PATIENCE = 10.0
END_PATIENCE = 10.0


class Look(NamedTuple):
    """The state that a node reports at one moment."""

    now: int
    """Monotonic time of the node in ns; all nodes use the clock of the machine."""
    beacons_sent: int
    beacons_left_out: int
    octets_sent: int
    beacons_received: int
    active: bool
    known: dict[int, Known]
    deleted: frozenset[int]


class NodeProcess(Place):
    """One node of the testbed, and its process while the node is switched on."""

    def __init__(
        self, index: int, namespace: str, settings: Settings, directory: Path, name: str, *, record: bool = True
    ) -> None:
        """``settings``: those of the node except interface, control socket and recording, which are set here.

        ``directory``: for settings, log, control socket and recording, whose names begin with ``name``.
        """
        super().__init__(namespace, directory / f"{name}.log", directory / f"{name}.sock")
        self.index = index
        self.failure = ""
        """How the process ended unexpectedly; empty if it did not."""
        self.runs: list[tuple[Look, Look]] = []
        """First and last reported state of each process that has ended."""
        self._settings = settings
        self._directory = directory
        self._name = name
        self._record = record
        self._lives = 0
        self._client: ControlClient | None = None
        self._first: Look | None = None
        self._last: Look | None = None
        self._begun = 0.0
        self.starts: list[float] = []
        """Time in s from each start of the process to its first answer."""

    @property
    def answers(self) -> bool:
        """Whether the node is ready for requests."""
        return self._client is not None

    def start(self) -> None:
        """Switch the node on: start its process without waiting until it is ready. No effect if it is on."""
        if self.on:
            return
        self._lives += 1
        life = "" if self._lives == 1 else f".{self._lives}"
        recording = self._directory / f"{self._name}{life}.mcap"
        settings = msgspec.structs.replace(
            self._settings,
            interface=INTERFACE,
            control=str(self.socket),
            record=str(recording) if self._record else None,
        )
        path = self._directory / f"{self._name}.toml"
        path.write_text(settings_text(settings))
        recording.unlink(missing_ok=True)
        self._begun = time.monotonic()
        self.launch([sys.executable, "-m", "dcp_stack.cli", "run", "--config", str(path)])

    def connect(self) -> bool:
        """Try to connect to the control socket; returns whether the node is ready. Does not wait until it is."""
        if self._client is None and self.on and self.listens and not self.ended():
            assert self.socket is not None
            try:
                self._client = ControlClient(self.socket, patience=ANSWER_PATIENCE)
                self._first = self.look()
                self.starts.append(time.monotonic() - self._begun)
            except ControlError:
                # The socket is bound, and does not listen yet.
                self.disconnect()
        return self._client is not None

    def ended(self) -> bool:
        """Return whether there is no running process; note in ``failure`` if it ended unexpectedly."""
        if how := self.end_of_process():
            self.failure = self.failure or f"node {self.index} {how}"
            self.kill()
        return not self.on

    def call(self, method: str, /, **params: Any) -> dict[str, Any]:
        """Send a request to the node, and return its answer.

        Raises LookupError while the node is off or not ready, ControlError if the connection fails, and ServiceError
        if the node answers with an error.
        """
        if self._client is None:
            raise LookupError(f"node {self.index} is {'not ready' if self.on else 'switched off'}")
        return self._client.call(method, **params)

    def look(self) -> Look:
        """Query the current state of the node. Raises the errors of :meth:`call`."""
        status = self.call("UT-Status")
        node = status["node"]
        counters, vardis = node["bp"]["counters"], node.get("vardis", {})
        known, deleted = {}, set()
        for var_id, entry in vardis.get("variables", {}).items():
            if entry["isDeleted"]:
                deleted.add(int(var_id))
                continue
            producer, value = entry["prodId"].encode(), bytes.fromhex(entry["value"])
            known[int(var_id)] = Known(producer, entry["creationTime"], entry["seqno"], value)
        self._last = Look(
            status["now"],
            counters.get("beacons-sent", 0),
            counters.get("beacons-left-out", 0),
            counters.get("octets-sent", 0),
            counters.get("beacons-received", 0),
            bool(vardis.get("active")),
            known,
            frozenset(deleted),
        )
        return self._last

    def kill(self) -> None:
        """Kill the process, as if the battery were empty, and note its reported states."""
        self.disconnect()
        self.kill_process(END_PATIENCE)
        if self._first is not None and self._last is not None:
            self.runs.append((self._first, self._last))
        self._first = self._last = None

    def ask_to_end(self) -> None:
        """Request an orderly end of the process (SIGTERM); :meth:`wait` waits for it."""
        if self.process is not None:
            self.process.popen.terminate()

    def wait(self, deadline: float) -> None:
        """Wait for the end of the process until ``deadline`` (monotonic s), then kill it."""
        if self.process is None:
            return
        how = self.end_of_process(max(deadline - time.monotonic(), 0.01)) or f"did not end within {END_PATIENCE:g} s"
        if self.process.status() != 0:
            self.failure = self.failure or f"node {self.index} {how}"
        self.kill()

    def disconnect(self) -> None:
        """Close the connection to the control socket."""
        if self._client is not None:
            self._client.close()
            self._client = None


def settings_for(scenario: Scenario, index: int, node_id: str) -> Settings:
    """Return the settings of a node of a scenario, except those that depend on its directory and namespace."""
    sources = [track.source for track in scenario.tracks if track.nodes is None or index in track.nodes]
    srp, vardis = scenario.srp_config, scenario.vardis_config
    return Settings(
        node_id=node_id,
        profile=scenario.profile,
        readings=scenario.readings,
        # The last track of the node takes precedence: it may be an exception to an earlier one for all nodes.
        position=sources[-1] if sources else None,
        seed=scenario.seed * 1000 + index,
        bp=scenario.bp,
        srp=SRPSettings(enabled=False) if srp is None else SRPSettings(enabled=True, **asdict(srp)),
        vardis=VardisSettings(enabled=False)
        if vardis is None
        else VardisSettings(enabled=True, recommended=False, **asdict(vardis)),
    )


def seconds_between(first: Look, last: Look) -> float:
    """Return the time between two reported states in s."""
    return (last.now - first.now) / NS_PER_S
