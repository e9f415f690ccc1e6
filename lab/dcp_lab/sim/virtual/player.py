"""Execution of a scenario on a simulated network."""

from __future__ import annotations

import copy
import random
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from msgspec.structs import astuple

from dcp_codec.analysis.vantage_point import MEDIUM
from dcp_lab.sim.measuring.ages import Ages
from dcp_lab.sim.measuring.measurements import Measurements
from dcp_lab.sim.scenario.agreement import Known
from dcp_lab.sim.scenario.definition import (
    NS_PER_S,
    Activate,
    Clock,
    Deactivate,
    Event,
    LinkQuality,
    Scenario,
    ScenarioError,
)
from dcp_lab.sim.scenario.expectations import VariableState
from dcp_lab.sim.scenario.ground import Ground
from dcp_lab.sim.scenario.report import Finding, NodeTraffic, Report
from dcp_stack.effects import NeighbourExpired, NeighbourSeen, VariableChanged
from dcp_stack.links.recording import Recorder
from dcp_stack.positions.base import SourceError
from dcp_stack.positions.opening import open_source
from dcp_stack.virtual.medium import MediumCounters
from dcp_stack.virtual.radio import RadioError

from .network import Network


class Simulation(Ground):
    """One run of a scenario. After the run ``network`` and ``agreement`` have the final state."""

    name = "simulate"
    survival = "no node raises an exception"

    def __init__(
        self,
        scenario: Scenario,
        *,
        record: Path | None = None,
        record_medium: Path | None = None,
        share_decoding: bool = True,
    ) -> None:
        """``record``: directory for one MCAP file per node. ``record_medium``: file with each transmission once.

        Raises :class:`ScenarioError` for parameters that the nodes refuse, LinkError if a file cannot be recorded.
        """
        super().__init__(scenario)
        try:
            radio = None if scenario.radio is None else scenario.radio.radio()
        except RadioError as error:
            raise ScenarioError(f"radio.model: {error}") from None
        self.network = Network(
            scenario.nodes,
            self.codec,
            seed=scenario.seed,
            topology=scenario.topology.heard_by(scenario.nodes),
            quality=scenario.link.quality(),
            radio=radio,
            bp=scenario.bp,
            srp=scenario.srp_config,
            vardis=scenario.vardis_config,
            readings=scenario.readings,
            share_decoding=share_decoding,
        )
        self._recorders: list[Recorder] = []
        period = scenario.bp.beacon_period_ms * 1_000_000
        queued = scenario.vardis_config.bp_queue_entries if scenario.vardis_config is not None else 1
        self._numbers = {station.config.node_id: station.index for station in self.network.stations}
        self.measurements = Measurements(
            self.network.medium,
            self._numbers,
            warm_up=scenario.warm_up,
            # Twice the time of the payloads before it, for jitter and for beacons that other clients fill. One of 10^9
            # exponential intervals is longer than 20 periods.
            held_back=(20 if scenario.bp.intervals == "exponential" else 2) * (queued + 2) * period,
        )
        self._before = Traffic.of(self.network)
        self._own_quality: set[tuple[int, int]] = set()
        self.ages: Ages | None = None
        """See :meth:`measure_ages`."""
        self._plan()
        self._record(record, record_medium)

    def measure_ages(self) -> None:
        """Measure the ages of state reports, which takes the fast path from the nodes. Call it before :meth:`run`."""
        self.ages = Ages(self.scenario.warm_up)
        self.network.listen(NeighbourSeen, self._seen)
        self.network.listen(NeighbourExpired, self._expired)

    @property
    def now(self) -> int:
        """Current virtual time in ns."""
        return self.network.now

    # -- running -------------------------------------------------------------------------------------------------------

    def run(self) -> Report:
        """Execute the scenario from beginning to end. Call it once.

        An interruption (Ctrl-C) ends the run; the report then has what was measured before. Raises
        :class:`ScenarioError` if a model of the radio fails.
        """
        real, cpu = time.perf_counter(), time.process_time()
        try:
            self.network.run_until(self.scenario.duration)
        except RadioError as error:
            raise ScenarioError(f"radio.model: {error}") from error
        except KeyboardInterrupt:
            at = f"interrupted at {self.now / NS_PER_S:.3f} s; later expectations are not judged"
            self.findings.append(Finding("the run reaches its end", False, at))
        finally:
            self.network.close()
            for recorder in self._recorders:
                recorder.close()
        return self._result(time.perf_counter() - real, time.process_time() - cpu)

    def _plan(self) -> None:
        """Schedule the start of nodes, the events and the expectations of the scenario."""
        network, scenario = self.network, self.scenario
        for link in scenario.links:
            for direction in link.directions:
                self._set_quality(direction, link.quality)
        network.listen(VariableChanged, self._changed)
        # Real nodes do not start simultaneously: each starts at a random moment of the first beacon period.
        spread = random.Random(f"{scenario.seed}/start")  # noqa: S311 - runs have to be repeatable
        for node in range(scenario.nodes):
            begin = spread.randrange(scenario.bp.beacon_period_ms * 1_000_000)
            if node not in scenario.down_at_start:
                network.at(begin, lambda node=node: self._switch(node, up=True))  # type: ignore[misc]
        self._attach_tracks()
        if scenario.warm_up:
            network.at(scenario.warm_up, self._warmed_up)
        for at, act in self._timeline():
            network.at(at, act)

    def _attach_tracks(self) -> None:
        """Open the position sources of the scenario. Raises ScenarioError for one that cannot be opened."""
        for index, track in enumerate(self.scenario.tracks):
            for node in range(self.scenario.nodes) if track.nodes is None else track.nodes:
                rng = random.Random(f"{self.scenario.seed}/track/{index}/{node}")  # noqa: S311 - as above
                try:
                    source = open_source(track.source, self.codec, rng=rng)
                except SourceError as error:
                    raise ScenarioError(f"tracks[{index}].source: {error}") from None
                self.network.attach(node, source)

    @property
    def recorded(self) -> bool:
        """Whether all recordings are complete; the log has the errors."""
        return not any(recorder.problem for recorder in self._recorders)

    def _record(self, directory: Path | None, medium: Path | None) -> None:
        """Attach recorders to the nodes and to the medium."""

        def recorder(path: Path, vantage: str) -> Recorder:
            """Open a recording with this vantage point in its metadata."""
            about = {
                "vantage": vantage,
                "ground": "simulate",
                "seed": str(self.scenario.seed),
                "scenario_sha256": self.provenance.scenario_sha256,
                "kit_version": self.provenance.kit_version,
            }
            made = Recorder(path, self.codec, overwrite=True, clock=lambda: self.now, about=about)
            self._recorders.append(made)
            return made

        if directory is not None:
            width = len(str(self.scenario.nodes - 1))
            for station in self.network.stations:
                station.watchers.append(
                    recorder(directory / f"node-{station.index:0{width}}.mcap", station.config.node_id.hex(":"))
                )
        if medium is not None:
            self.network.watchers.append(recorder(medium, MEDIUM))

    # -- events --------------------------------------------------------------------------------------------------------

    def _perform(self, event: Event, n: int) -> str:
        if isinstance(event, Clock):
            self.network.stations[event.node].offset += round(event.step_s * NS_PER_S)
            return ""
        status = super()._perform(event, n)
        if isinstance(event, Activate | Deactivate):
            self._refresh(event.node)
        return status

    def _request(self, node: int, method: str, params: dict[str, Any]) -> dict[str, Any]:
        return self.network.request(node, method, **params)

    def _partition(self, groups: Sequence[Sequence[int]]) -> None:
        self.network.medium.partition(groups)
        self.measurements.connections_changed()

    def _set_quality(self, direction: tuple[int, int] | None, quality: LinkQuality) -> None:
        """Set the quality of one direction, which events for all links do not change any more, or of all others."""
        if direction is None:
            pairs = self.scenario.topology.pairs(len(self.network))
            chosen = [each for pair in pairs for each in (pair, pair[::-1]) if each not in self._own_quality]
        else:
            self._own_quality.add(direction)
            chosen = [direction]
        for sender, receiver in chosen:
            self.network.medium.set_quality(quality.quality(), sender, receiver)
        self.measurements.connections_changed()

    def _switch(self, node: int, *, up: bool) -> None:
        """Start or stop a node, and include it in the measurements or exclude it."""
        if up:
            self.measurements.on(node)
            self.network.start(node)
        else:
            self.measurements.off(self.now, node)
            if self.ages is not None:
                self.ages.lost(self.now, node)
            self.network.stop(node)
        self._refresh(node)

    def _refresh(self, index: int) -> None:
        """Update whether a node is present for agreement and consistency, after it was started, stopped or
        (de)activated."""
        node = self.network.stations[index].node
        vardis = None if node is None else node.vardis
        if node is None:
            self.agreement.forget(index)
        active = vardis is not None and vardis.active
        self.agreement.enter(index, active)
        self.measurements.consistency.enter(self.now, index, active)
        self._look()

    def _look(self) -> None:
        self.clock.look(self.now, self.agreement)

    def _changed(self, now: int, index: int, effect: VariableChanged) -> None:
        """Pass a change of a variable at a node to agreement and measurements."""
        node = self.network.stations[index].node
        if node is None or node.vardis is None:
            return
        entry = node.vardis.entry(effect.var_id)
        if effect.event == "deleted" or entry is None or entry.is_deleted:
            self.agreement.learn(index, effect.var_id, None)
            self.measurements.deleted(now, index, effect.var_id)
        else:
            created = entry.spec.creation_time
            self.agreement.learn(index, effect.var_id, Known(effect.prod_id, created, entry.seqno, entry.value))
            self.measurements.stored(now, index, effect.var_id, entry, self.network.delivering, effect.event)
        self._look()

    def _seen(self, now: int, index: int, effect: NeighbourSeen) -> None:
        """Pass a received state report to the measurement of ages."""
        node, neighbour = self.network.stations[index].node, self._numbers.get(effect.node_id)
        if self.ages is None or node is None or node.srp is None or neighbour is None:
            return
        entry = node.srp.neighbours.lookup(effect.node_id)
        if entry is not None:
            # Profiles whose stamps cannot be compared count from the reception.
            self.ages.heard(now, index, neighbour, node.srp.neighbours.delay(entry) or 0)

    def _expired(self, now: int, index: int, effect: NeighbourExpired) -> None:
        """Pass the end of an entry of a neighbour table to the measurement of ages."""
        if self.ages is not None and (neighbour := self._numbers.get(effect.node_id)) is not None:
            self.ages.lost(now, index, neighbour)

    def _warmed_up(self) -> None:
        """Restart traffic counters and consistency at the end of the warm-up."""
        self._before = Traffic.of(self.network)
        self.measurements.consistency.settle(self.now)
        self.measurements.consistency.restart(self.now)

    # -- results -------------------------------------------------------------------------------------------------------

    def variable(self, node: int, var_id: int) -> VariableState:
        """Return the current state of a variable at a node."""
        there = self.network.stations[node].node
        if there is None or there.vardis is None or not there.vardis.active:
            return VariableState("off")
        entry = there.vardis.describe_variable(var_id).entry
        if entry is None:
            return VariableState("unknown")
        return VariableState("deleted") if entry.is_deleted else VariableState("alive", entry.value)

    def neighbours(self, node: int) -> list[int] | None:
        """Return the node numbers in a node's neighbour table, ascending; None while it has no active SRP."""
        there = self.network.stations[node].node
        if there is None or there.srp is None or not there.srp.registered:
            return None
        numbers = {each.config.node_id: each.index for each in self.network.stations}
        return sorted(numbers[found] for found in there.srp.neighbours.list_all_node_ids() if found in numbers)

    def _result(self, elapsed: float, cpu: float) -> Report:
        """Return the report of a run that took ``elapsed`` s of real time and ``cpu`` s of CPU time."""
        scenario, medium = self.scenario, Traffic.of(self.network).since(self._before).medium
        failures = [f"node {each.index} {each.failure}" for each in self.network.stations if each.failure]
        totals = self.measurements.values.totals()
        if scenario.bp.triggered and scenario.vardis and scenario.readings.get("X54") != "after-the-beacon":
            totals.notes.append(
                "bp.triggered has no effect on VarDis: it composes just before a beacon (reading X54), so no new "
                "payload brings the beacon forward"
            )
        if scenario.vardis and self.codec.profile.name.startswith("cpp-") and "X54" not in scenario.readings:
            totals.notes.append(
                "the C++ implementation composes a payload right after the beacon before it, this simulation just "
                'before its beacon: readings = { X54 = "after-the-beacon" } has the delays of C++'
            )
        total = max(medium.expected, 1)
        shares = {"delivered": medium.delivered, "lost": medium.lost, "duplicated": medium.duplicated}
        shares |= {"missed": medium.missed, "overlapped": medium.overlapped, "corrupted": medium.corrupted}
        return self._report(
            list(self._traffic()),
            failures,
            duration_s=self.now / NS_PER_S,
            values=totals,
            delays=self.measurements.values.rows(),
            consistency=self.measurements.consistency.found(self.now),
            ages=[] if self.ages is None else self.ages.found(self.now),
            shares={name: number / total for name, number in shares.items() if number or name == "delivered"},
            expected=medium.expected,
            digest=self.network.digest.hexdigest(),
            elapsed_s=elapsed,
            cpu_s=cpu,
        )

    def _traffic(self) -> Iterator[NodeTraffic]:
        """Yield the traffic of each node since the warm-up."""
        interrupted = self._interrupted
        counted = Traffic.of(self.network).since(self._before).nodes
        for each, (sent, octets, received) in zip(self.network.stations, counted, strict=True):
            rate = None
            if each.up_since is not None and each.index not in interrupted:
                up = self.now - max(each.up_since, self.scenario.warm_up)
                rate = sent / (up / NS_PER_S) if up else None
            yield NodeTraffic(each.index, sent, octets, received, rate)


class Traffic(NamedTuple):
    """Counters of a network at one moment, or between two of them."""

    nodes: list[tuple[int, int, int]]
    """For each node: beacons and octets sent, beacons received."""
    medium: MediumCounters

    @classmethod
    def of(cls, network: Network) -> Traffic:
        """Return the current counters."""
        nodes = [(each.beacons_sent, each.octets_sent, each.beacons_received) for each in network.stations]
        return cls(nodes, copy.copy(network.medium.counters))

    def since(self, before: Traffic) -> Traffic:
        """Return the difference to an earlier state of the counters."""
        nodes = [
            (now[0] - then[0], now[1] - then[1], now[2] - then[2])
            for now, then in zip(self.nodes, before.nodes, strict=True)
        ]
        medium = MediumCounters(
            *(now - then for now, then in zip(astuple(self.medium), astuple(before.medium), strict=True))
        )
        return Traffic(nodes, medium)


def simulate(scenario: Scenario, **options: Any) -> Report:
    """Execute a scenario in virtual time; ``options`` are those of :class:`Simulation`."""
    return Simulation(scenario, **options).run()
