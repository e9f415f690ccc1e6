"""The nodes of a testbed: processes of ``dcp-node run``, each in its namespace, talked to by their control sockets."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from dcp_stack.control.client import ControlClient, ControlError
from dcp_stack.runtime.settings import Settings, SRPSettings, VardisSettings, settings_text
from dcp_stack.sim.scenario.agreement import Known
from dcp_stack.sim.scenario.definition import NS_PER_S, Scenario

from .fabric import INTERFACE
from .namespaces import enter_command

#: Seconds that a node may take to answer once it runs, and to end once it is told to.
ANSWER_PATIENCE = 10.0
END_PATIENCE = 10.0


class Look(NamedTuple):
    """What a node says of itself at one moment."""

    now: int
    """Its monotonic clock in ns, which is that of the machine."""
    beacons_sent: int
    beacons_left_out: int
    octets_sent: int
    beacons_received: int
    active: bool
    known: dict[int, Known]
    deleted: frozenset[int]


class NodeProcess:
    """One place in the testbed, and the process there while it is switched on."""

    def __init__(
        self, index: int, namespace: str, settings: Settings, directory: Path, name: str, *, record: bool = True
    ) -> None:
        """``settings`` lack what is of this place: interface, control socket and recording."""
        self.index = index
        self.namespace = namespace
        self.control = directory / f"{name}.sock"
        self.log = directory / f"{name}.log"
        self.failure = ""
        """How the process ended without being told to; empty as it should be."""
        self.runs: list[tuple[Look, Look]] = []
        """First and last look at each life."""
        self._settings = settings
        self._directory = directory
        self._name = name
        self._record = record
        self._lives = 0
        self._process: subprocess.Popen[bytes] | None = None
        self._client: ControlClient | None = None
        self._first: Look | None = None
        self._last: Look | None = None
        self._begun = 0.0
        self.starts: list[float] = []
        """Seconds that it took until it answered, each time it was switched on."""

    @property
    def on(self) -> bool:
        """Whether it was switched on, and not off again."""
        return self._process is not None

    @property
    def answers(self) -> bool:
        """Whether it is ready for requests."""
        return self._client is not None

    def start(self) -> None:
        """Switch it on: start the process, and do not wait for it."""
        if self._process is not None:
            return
        self._lives += 1
        life = "" if self._lives == 1 else f".{self._lives}"
        recording = self._directory / f"{self._name}{life}.mcap"
        settings = msgspec.structs.replace(
            self._settings,
            interface=INTERFACE,
            control=str(self.control),
            record=str(recording) if self._record else None,
        )
        path = self._directory / f"{self._name}.toml"
        path.write_text(settings_text(settings))
        # A socket that is still there from a life before would be refused as one in use, or answer for the dead.
        self.control.unlink(missing_ok=True)
        recording.unlink(missing_ok=True)
        command = [sys.executable, "-m", "dcp_stack.cli", "run", "--config", str(path)]
        self._begun = time.monotonic()
        with self.log.open("ab") as log:
            self._process = subprocess.Popen(  # noqa: S603 - our own program
                [*enter_command(self.namespace), *command],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                start_new_session=True,
            )

    def connect(self) -> bool:
        """Look whether it is ready; True if it is. Never waits for it."""
        if self._client is None and self._process is not None and self.control.exists() and not self.ended():
            try:
                self._client = ControlClient(self.control, patience=ANSWER_PATIENCE)
                self._first = self.look()
                self.starts.append(time.monotonic() - self._begun)
            except ControlError:
                # Bound, and not yet listening.
                self.disconnect()
        return self._client is not None

    def ended(self) -> bool:
        """Whether the process ended by itself; says so in ``failure``."""
        if self._process is None or self._process.poll() is None:
            return self._process is None
        status = self._process.returncode
        self.failure = self.failure or f"node {self.index} ended with status {status}: {self.last_words()}"
        self._forget()
        return True

    def last_words(self) -> str:
        """The end of what it logged."""
        try:
            lines = self.log.read_text(errors="replace").strip().splitlines()
        except OSError:
            return ""
        return lines[-1][-300:] if lines else "it logged nothing"

    def call(self, method: str, /, **params: Any) -> dict[str, Any]:
        """Request something of the node; raises LookupError while it is off, ControlError, ServiceError."""
        if self._client is None:
            raise LookupError(f"node {self.index} is {'not ready' if self.on else 'switched off'}")
        return self._client.call(method, **params)

    def look(self) -> Look:
        """What the node says of itself now; raises as :meth:`call`."""
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
        """Switch it off as an empty battery does."""
        if self._process is not None:
            self._process.kill()
            self._process.wait(END_PATIENCE)
        self._forget()

    def ask_to_end(self) -> None:
        """Have it end in an orderly way; :meth:`wait` is for the outcome."""
        if self._process is not None and self._process.poll() is None:
            self._process.terminate()

    def wait(self, deadline: float) -> None:
        """Wait until it ended, up to a moment of the monotonic clock; then it is killed."""
        if self._process is None:
            return
        try:
            status = self._process.wait(max(deadline - time.monotonic(), 0.01))
        except subprocess.TimeoutExpired:
            self.failure = self.failure or f"node {self.index} did not end within {END_PATIENCE:g} s"
            self._process.kill()
            status = self._process.wait(END_PATIENCE)
        if status and not self.failure:
            self.failure = f"node {self.index} ended with status {status}: {self.last_words()}"
        self._forget()

    def disconnect(self) -> None:
        """Let go of the control socket."""
        if self._client is not None:
            self._client.close()
            self._client = None

    def _forget(self) -> None:
        self.disconnect()
        self._process = None
        if self._first is not None and self._last is not None:
            self.runs.append((self._first, self._last))
        self._first = self._last = None


def settings_for(scenario: Scenario, index: int, node_id: str) -> Settings:
    """The settings of a node of a scenario, as far as they do not depend on where it runs."""
    sources = [track.source for track in scenario.tracks if track.nodes is None or index in track.nodes]
    srp, vardis = scenario.srp_config, scenario.vardis_config
    return Settings(
        node_id=node_id,
        profile=scenario.profile,
        readings=scenario.readings,
        # The last one that names the node, as a more special case after a general one.
        position=sources[-1] if sources else None,
        seed=scenario.seed * 1000 + index,
        bp=scenario.bp,
        srp=SRPSettings(enabled=False) if srp is None else SRPSettings(enabled=True, **_fields(srp)),
        vardis=VardisSettings(enabled=False)
        if vardis is None
        else VardisSettings(enabled=True, recommended=False, **_fields(vardis)),
    )


def _fields(config: msgspec.Struct) -> dict[str, Any]:
    return {name: getattr(config, name) for name in config.__struct_fields__}


def seconds_between(first: Look, last: Look) -> float:
    """The time between two looks."""
    return (last.now - first.now) / NS_PER_S
