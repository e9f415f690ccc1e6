"""Execution of a scenario with node processes on a virtual Ethernet, in real time."""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Self

from dcp_lab.sim.scenario.definition import NS_PER_S, Clock, LinkQuality, Scenario, ScenarioError
from dcp_lab.sim.scenario.expectations import VariableState
from dcp_lab.sim.scenario.ground import Ground
from dcp_lab.sim.scenario.loading import check
from dcp_lab.sim.scenario.report import NodeTraffic, Report
from dcp_lab.sim.scenario.requests import trouble
from dcp_stack.control.client import ControlError, ServiceError
from dcp_stack.virtual.world import node_id

from .cleanup import CleanupProcess
from .fabric import Air, Fabric, MakeAir
from .namespaces import own_prefix, sweep
from .processes import END_PATIENCE, NodeProcess, seconds_between, settings_for

log = logging.getLogger(__name__)

#: Time in s between two queries of all nodes: the resolution of measured convergence.
LOOK_INTERVAL = 0.05
#: Minimum time in ns between two reports of how far the scenario is.
TOLD_EVERY = 5 * NS_PER_S
#: Maximum time in s for the start of a node; on a busy machine the start of Python takes several of them.
START_PATIENCE = 30.0


class StartError(Exception):
    """A node does not start; the message has its number and the last line of its log."""


class Testbed(Ground):
    """Namespaces, links and processes for one scenario; as a context manager it removes all of them at the end."""

    __test__ = False
    name = "testbed"
    survival = "no node ends unexpectedly"

    def __init__(
        self, scenario: Scenario, directory: Path, *, keep: bool, record: bool = True, make_air: MakeAir = Fabric
    ) -> None:
        """``directory``: an existing directory for settings, logs, sockets and recordings; removed unless ``keep``.

        ``make_air`` builds the links; by default the kernel carries the frames.

        ``record`` False omits the recordings. Raises ScenarioError for an invalid scenario, NamespaceError if the
        system refuses namespaces or interfaces.
        """
        check(scenario)
        if scenario.topology.kind == "positions" and not scenario.topology.positions:
            raise ScenarioError(
                "topology.positions: a testbed needs the position of each node; tracks change links in simulations only"
            )
        if any(isinstance(event, Clock) for event in scenario.events):
            raise ScenarioError("events: a testbed cannot set the clocks of its nodes; clock is for simulations only")
        if scenario.radio is not None:
            raise ScenarioError("radio: a testbed has no radio; use [link] for losses, or dcp-node simulate")
        super().__init__(scenario)
        self.nodes: list[NodeProcess] = []
        self._begin = 0.0
        self._tell: Callable[[str], None] = lambda _text: None
        self._told, self._told_every = 0, max(self.scenario.duration // 10, TOLD_EVERY)
        self._late = self._slowest_start = 0.0
        sweep()
        prefix = own_prefix()
        self._janitor = CleanupProcess(prefix, None if keep else str(directory))
        self._closing = contextlib.ExitStack()
        try:
            identifiers = [node_id(self.codec.profile, index) for index in range(scenario.nodes)]
            # The address of an interface has six octets, independently of the node identifier of the profile.
            addresses = [b"\x02" + index.to_bytes(5, "big") for index in range(scenario.nodes)]
            self._fabric: Air = make_air(scenario, prefix, addresses)
            self._closing.callback(self._fabric.close)
            text = self.codec.profile.types.node_id.representation == "text"
            width = len(str(scenario.nodes - 1))
            for index, identifier in enumerate(identifiers):
                settings = settings_for(scenario, index, identifier.decode() if text else identifier.hex(":"))
                name, namespace = f"node-{index:0{width}}", self._fabric.namespaces[index]
                self.nodes.append(NodeProcess(index, namespace, settings, directory, name, record=record))
        except BaseException:
            self._closing.close()
            self._janitor.finish()
            raise
        self._numbers = {identifier.hex(":"): index for index, identifier in enumerate(identifiers)}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """End all nodes in an orderly way, and remove namespaces and links. May be called twice."""
        try:
            for node in self.nodes:
                node.ask_to_end()
            deadline = time.monotonic() + END_PATIENCE
            for node in self.nodes:
                node.wait(deadline)
        finally:
            self._closing.close()
            self._janitor.finish()

    # -- running -------------------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Start the nodes that are not in ``down_at_start``, and wait until they answer; the scenario's time 0.

        Raises :class:`StartError` if a node ends or does not answer in time.
        """
        awaited = [node for node in self.nodes if node.index not in self.scenario.down_at_start]
        for node in awaited:
            node.start()
        deadline = time.monotonic() + START_PATIENCE + len(awaited)
        while True:
            ready = [node.connect() for node in awaited]
            if all(ready):
                break
            for node in awaited:
                if node.ended():
                    raise StartError(node.failure)
            if time.monotonic() > deadline:
                missing = ", ".join(str(node.index) for node in awaited if not node.answers)
                raise StartError(f"no answer from nodes {missing} within {START_PATIENCE + len(awaited):g} s")
            time.sleep(0.02)
        self._begin = time.monotonic()

    @property
    def now(self) -> int:
        """Current time of the scenario in ns."""
        return round((time.monotonic() - self._begin) * NS_PER_S)

    def run(self, tell: Callable[[str], None] = lambda _text: None) -> Report:
        """Start the nodes, execute the scenario, end the nodes, and return the report.

        ``tell`` is called with how long the scenario takes, and now and then with the time that has passed. Raises
        :class:`StartError`.
        """
        started = time.perf_counter()
        self._tell = tell
        seconds = self.scenario.duration / NS_PER_S
        tell(f"starting {len(self.nodes)} node{'' if len(self.nodes) == 1 else 's'}; the scenario takes {seconds:g} s")
        self.start()
        started_before = [len(node.starts) for node in self.nodes]
        for at, act in self._timeline():
            self._wait_until(at)
            act()
        self._wait_until(self.scenario.duration)
        for node, before in zip(self.nodes, started_before, strict=True):
            self._slowest_start = max([self._slowest_start, *node.starts[before:]])
        for node in self.nodes:
            if node.answers:
                # Update the traffic counters up to the end.
                self._query(node)
        self.clock.look(self.now, self.agreement)
        self.close()
        return self._report(
            list(self._traffic()),
            [node.failure for node in self.nodes if node.failure],
            duration_s=self.scenario.duration_s,
            elapsed_s=time.perf_counter() - started,
            late_s=round(self._late, 3),
            slowest_start_s=round(self._slowest_start, 3),
        )

    def _wait_until(self, at: int) -> None:
        """Query the nodes until a time of the scenario (ns), and note how late this ends."""
        while True:
            self._look()
            if self.now >= self._told + self._told_every:
                self._told = self.now
                self._tell(f"{self.now // NS_PER_S} s of {self.scenario.duration / NS_PER_S:g} s")
            left = (at - self.now) / NS_PER_S
            if left <= 0:
                self._late = max(self._late, -left)
                return
            time.sleep(min(left, LOOK_INTERVAL))

    def _look(self) -> None:
        """Query all nodes while convergence is measured, and check whether they agree."""
        pending = False
        for node in self.nodes:
            if not node.on or node.ended():
                self._absent(node.index)
            elif not node.connect():
                # Switched on, and not ready yet: until then agreement is not determined.
                self._absent(node.index)
                pending = True
            elif self.clock.pending:
                self._query(node)
        if not pending:
            self.clock.look(self.now, self.agreement)

    def _query(self, node: NodeProcess) -> None:
        """Query one node for its variables; note a failure if it does not answer."""
        try:
            seen = node.look()
        except (ControlError, ServiceError, LookupError) as error:
            node.failure = node.failure or f"node {node.index}: {error}"
            self._absent(node.index)
            return
        self.agreement.replace(node.index, seen.known)
        self.agreement.enter(node.index, seen.active)

    def _absent(self, index: int) -> None:
        """Exclude a node from the agreement."""
        self.agreement.forget(index)
        self.agreement.enter(index, False)

    # -- events --------------------------------------------------------------------------------------------------------

    def _request(self, node: int, method: str, params: dict[str, Any]) -> dict[str, Any]:
        return self.nodes[node].call(method, **params)

    def _switch(self, node: int, *, up: bool) -> None:
        if up:
            self.nodes[node].start()
        else:
            self.nodes[node].kill()

    def _partition(self, groups: Sequence[Sequence[int]]) -> None:
        self._fabric.partition(groups)

    def _set_quality(self, direction: tuple[int, int] | None, quality: LinkQuality) -> None:
        self._fabric.set_quality(direction, quality)

    # -- results -------------------------------------------------------------------------------------------------------

    def variable(self, node: int, var_id: int) -> VariableState:
        """Return the current state of a variable at a node."""
        try:
            seen = self.nodes[node].look()
        except (ControlError, ServiceError, LookupError):
            return VariableState("off")
        if not seen.active:
            return VariableState("off")
        known = seen.known.get(var_id)
        if known is not None:
            return VariableState("alive", known.value)
        return VariableState("deleted" if var_id in seen.deleted else "unknown")

    def neighbours(self, node: int) -> list[int] | None:
        """Return the node numbers in a node's neighbour table, ascending; None while it has no active SRP."""
        try:
            table = self.nodes[node].call("SRP-NeighbourTable")
        except (ControlError, ServiceError, LookupError):
            return None
        if trouble(table):
            return None
        found = (self._numbers.get(each["nodeId"]) for each in table["neighbours"])
        return sorted(index for index in found if index is not None)

    def _traffic(self) -> Iterator[NodeTraffic]:
        """Yield the traffic of each node, over all its processes."""
        interrupted = self._interrupted
        for node in self.nodes:
            rate, left_out = None, 0.0
            for first, last in node.runs:
                seconds = seconds_between(first, last)
                if node.index not in interrupted and seconds > 0:
                    rate = (last.beacons_sent - first.beacons_sent) / seconds
                    left_out = (last.beacons_left_out - first.beacons_left_out) / seconds
            lives = [last for _, last in node.runs]
            yield NodeTraffic(
                node=node.index,
                beacons_sent=sum(last.beacons_sent for last in lives),
                octets_sent=sum(last.octets_sent for last in lives),
                beacons_received=sum(last.beacons_received for last in lives),
                beacons_per_s=rate,
                left_out_per_s=left_out,
            )
