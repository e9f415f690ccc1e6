"""Play a scenario on a simulated network."""

from __future__ import annotations

import random
import time
from collections import OrderedDict, deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from dcp_codec.codec import Codec
from dcp_stack.control.client import ServiceError
from dcp_stack.effects import VariableChanged
from dcp_stack.links.recording import Recorder
from dcp_stack.positions import SourceError, open_source

from .agreement import Agreement, ConvergenceClock, Known
from .expectations import VariableState, checks, describe, judge_all, judge_now
from .loading import check, check_nodes, scenario_codec
from .network import Network
from .report import Finding, NodeTraffic, Report, hop_delays
from .requests import request, trouble
from .scenario import (
    NS_PER_S,
    Activate,
    Create,
    Deactivate,
    Delete,
    Down,
    Event,
    HandDown,
    Heal,
    LinkQuality,
    Partition,
    Restart,
    Scenario,
    ScenarioError,
    SetLink,
    Up,
    Update,
)

#: Values whose way through the network is followed at a time.
FOLLOWED = 4096


class Simulation:
    """One run of a scenario. Afterwards ``network`` and ``agreement`` can be looked at."""

    def __init__(
        self,
        scenario: Scenario,
        *,
        record: Path | None = None,
        record_medium: Path | None = None,
        share_decoding: bool = True,
    ) -> None:
        """``record`` is a directory for one MCAP file per node, ``record_medium`` a file for each transmission once.

        Raises :class:`ScenarioError` for what the nodes refuse, LinkError if something cannot be recorded.
        """
        self.scenario = check(scenario)
        self.codec: Codec = scenario_codec(scenario)
        check_nodes(scenario, self.codec)
        self.network = Network(
            scenario.nodes,
            self.codec,
            seed=scenario.seed,
            topology=scenario.topology.heard_by(scenario.nodes),
            quality=scenario.link.quality(),
            bp=scenario.bp,
            srp=scenario.srp_config,
            vardis=scenario.vardis_config,
            share_decoding=share_decoding,
        )
        self.agreement = Agreement(scenario.nodes)
        self.clock = ConvergenceClock()
        self.findings: list[Finding] = []
        self._recorders: list[Recorder] = []
        self._problems: list[str] = []
        # Value -> when its producer had it; how long it took, by hops.
        self._origins: OrderedDict[tuple[int, bytes, int | None, int], int] = OrderedDict()
        self._delays: dict[int, list[int]] = {}
        self._distances: dict[int, dict[int, int]] = {}
        self._own_quality: set[tuple[int, int]] = set()
        self._plan()
        self._record(record, record_medium)

    # -- running -------------------------------------------------------------------------------------------------------

    def run(self) -> Report:
        """Play it from beginning to end. Call it once."""
        real, cpu = time.perf_counter(), time.process_time()
        try:
            self.network.run_until(self.scenario.duration)
        finally:
            self.network.close()
            for recorder in self._recorders:
                recorder.close()
        return self._report(time.perf_counter() - real, time.process_time() - cpu)

    def _plan(self) -> None:
        network, scenario = self.network, self.scenario
        for link in scenario.links:
            for sender, receiver in link.directions:
                self._set_link(sender, receiver, link.quality)
        network.listen(VariableChanged, self._changed)
        # Nodes are not switched on by one hand: each begins at some moment of the first beacon period.
        spread = random.Random(f"{scenario.seed}/start")  # noqa: S311 - to be repeatable is the point
        for node in range(scenario.nodes):
            begin = spread.randrange(scenario.bp.beacon_period_ms * 1_000_000)
            if node not in scenario.down_at_start:
                network.at(begin, lambda node=node: self._switch_on(node))  # type: ignore[misc]
        self._attach_tracks()
        for at, n, event in scenario.timeline():
            network.at(at, lambda event=event, n=n: self._happen(event, n))  # type: ignore[misc]
        for at, expected in checks(scenario):
            network.at(at, lambda expected=expected: self.findings.append(judge_now(expected, self)))  # type: ignore[misc]

    def _attach_tracks(self) -> None:
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
        """Whether all that was to be recorded was; the log says what was not."""
        return not any(recorder.problem for recorder in self._recorders)

    def _record(self, directory: Path | None, medium: Path | None) -> None:
        def recorder(path: Path) -> Recorder:
            made = Recorder(path, self.codec, overwrite=True, clock=lambda: self.network.now)
            self._recorders.append(made)
            return made

        if directory is not None:
            width = len(str(self.scenario.nodes - 1))
            for station in self.network.stations:
                station.watchers.append(recorder(directory / f"node-{station.index:0{width}}.mcap"))
        if medium is not None:
            self.network.watchers.append(recorder(medium))

    # -- what happens --------------------------------------------------------------------------------------------------

    def _happen(self, event: Event, n: int) -> None:
        what = describe(event, n)
        if event.disturbs:
            self.clock.event(self.network.now, what)
        try:
            status = self._perform(event, n)
        except (LookupError, ServiceError) as error:
            status = str(error)
        if status:
            self._problems.append(f"at {self.network.now / NS_PER_S:g} s {what}: {status}")
        self._distances.clear()
        self._look()

    def _perform(self, event: Event, n: int) -> str:
        """Do it; the status if it is not OK, empty if it is."""
        network, medium = self.network, self.network.medium
        match event:
            case Create() | Update() | Delete() | HandDown() | Activate() | Deactivate():
                method, params = request(event, n)
                found = network.request(event.node, method, **params)
                if isinstance(event, Activate | Deactivate):
                    self._refresh(event.node)
                return trouble(found)
            case Down(node=node):
                self._switch_off(node)
            case Up(node=node):
                self._switch_on(node)
            case Restart(node=node):
                self._switch_off(node)
                self._switch_on(node)
            case Partition(groups=groups):
                medium.partition(*groups)
            case Heal():
                medium.heal()
            case SetLink(sender=int() as sender, receiver=int() as receiver, quality=quality):
                self._set_link(sender, receiver, quality)
                if event.both_ways:
                    self._set_link(receiver, sender, quality)
            case SetLink(quality=quality):
                for pair in self.scenario.topology.pairs(len(network)):
                    for sender, receiver in (pair, pair[::-1]):
                        if (sender, receiver) not in self._own_quality:
                            medium.set_quality(sender, receiver, quality.quality())
        return ""

    def _set_link(self, sender: int, receiver: int, quality: LinkQuality) -> None:
        """Give one direction a quality of its own, which it then keeps."""
        self._own_quality.add((sender, receiver))
        self.network.medium.set_quality(sender, receiver, quality.quality())

    def _switch_on(self, node: int) -> None:
        self.network.start(node)
        self._refresh(node)

    def _switch_off(self, node: int) -> None:
        self.network.stop(node)
        self._refresh(node)

    def _refresh(self, index: int) -> None:
        """Compare a node with the others anew: it appeared, or is not there any more."""
        node = self.network.stations[index].node
        vardis = None if node is None else node.vardis
        if node is None:
            self.agreement.forget(index)
        self.agreement.enter(index, vardis is not None and vardis.active)
        self._look()

    def _look(self) -> None:
        self.clock.look(self.network.now, self.agreement)

    def _changed(self, now: int, index: int, effect: VariableChanged) -> None:
        node = self.network.stations[index].node
        if node is None or node.vardis is None:
            return
        entry = node.vardis.describe_variable(effect.var_id).entry
        if effect.event == "deleted" or entry is None or entry.is_deleted:
            self.agreement.learn(index, effect.var_id, None)
        else:
            created = entry.spec.creation_time
            self.agreement.learn(index, effect.var_id, Known(effect.prod_id, created, entry.seqno, entry.value))
            self._follow(now, index, (effect.var_id, effect.prod_id, created, entry.seqno))
        self._look()

    def _follow(self, now: int, index: int, value: tuple[int, bytes, int | None, int]) -> None:
        """Note how long a value took to a node that was there when it came into the world."""
        station = self.network.stations[index]
        if value[1] == station.config.node_id:
            self._origins[value] = now
            self._origins.move_to_end(value)
            if len(self._origins) > FOLLOWED:
                self._origins.popitem(last=False)
            return
        born = self._origins.get(value)
        if born is None or station.up_since is None or station.up_since > born:
            return
        hops = self._hops(value[1], index)
        if hops is not None:
            self._delays.setdefault(hops, []).append(now - born)

    def _hops(self, producer: bytes, index: int) -> int | None:
        source = next((each.index for each in self.network.stations if each.config.node_id == producer), None)
        if source is None:
            return None
        distances = self._distances.get(source)
        if distances is None:
            distances = self._distances[source] = _distances(source, self.network.medium.neighbours)
        return distances.get(index)

    # -- looking -------------------------------------------------------------------------------------------------------

    def variable(self, node: int, var_id: int) -> VariableState:
        """What a node knows about a variable now."""
        there = self.network.stations[node].node
        if there is None or there.vardis is None or not there.vardis.active:
            return VariableState("off")
        entry = there.vardis.describe_variable(var_id).entry
        if entry is None:
            return VariableState("unknown")
        return VariableState("deleted") if entry.is_deleted else VariableState("alive", entry.value)

    def neighbours(self, node: int) -> list[int] | None:
        """Whom a node has in its neighbour table now."""
        there = self.network.stations[node].node
        if there is None or there.srp is None or not there.srp.registered:
            return None
        numbers = {each.config.node_id: each.index for each in self.network.stations}
        return sorted(numbers[found] for found in there.srp.neighbours.list_all_node_ids() if found in numbers)

    def _report(self, elapsed: float, cpu: float) -> Report:
        scenario, counters = self.scenario, self.network.medium.counters
        traffic = list(self._traffic())
        failures = [f"node {each.index} {each.failure}" for each in self.network.stations if each.failure]
        findings = [
            *judge_all(scenario.expect, self.clock.events, traffic),
            *self.findings,
            Finding("no node raises anything", not failures, "; ".join(failures[:3])),
            Finding("every event can happen", not self._problems, "; ".join(self._problems[:3])),
        ]
        total = max(counters.expected, 1)
        shares = {"delivered": counters.delivered, "lost": counters.lost, "duplicated": counters.duplicated}
        shares["missed"] = counters.missed
        return Report(
            title=scenario.title,
            ground="simulate",
            nodes=scenario.nodes,
            profile=scenario.profile,
            seed=scenario.seed,
            duration_s=scenario.duration_s,
            findings=findings,
            convergences=self.clock.events,
            traffic=traffic,
            delays=hop_delays(self._delays),
            shares={name: number / total for name, number in shares.items() if number or name == "delivered"},
            expected=counters.expected,
            digest=self.network.digest.hexdigest(),
            elapsed_s=elapsed,
            cpu_s=cpu,
        )

    def _traffic(self) -> Iterator[NodeTraffic]:
        interrupted = {event.node for event in self.scenario.events if isinstance(event, Down | Up | Restart)} | set(
            self.scenario.down_at_start
        )
        for each in self.network.stations:
            up = None if each.up_since is None or each.index in interrupted else self.network.now - each.up_since
            rate = each.beacons_sent / (up / NS_PER_S) if up else None
            yield NodeTraffic(each.index, each.beacons_sent, each.octets_sent, each.beacons_received, rate)


def _distances(source: int, neighbours: Callable[[int], tuple[int, ...]]) -> dict[int, int]:
    """Hops from ``source`` to each node that can be reached."""
    found, waiting = {source: 0}, deque([source])
    while waiting:
        node = waiting.popleft()
        for other in neighbours(node):
            if other not in found:
                found[other] = found[node] + 1
                waiting.append(other)
    return found


def simulate(scenario: Scenario, **options: Any) -> Report:
    """Play a scenario in virtual time; options as for :class:`Simulation`."""
    return Simulation(scenario, **options).run()
