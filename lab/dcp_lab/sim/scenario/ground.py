"""The execution of a scenario, common to simulations and testbeds: its events, expectations and report."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from functools import cached_property, partial
from typing import Any, ClassVar

from dcp_codec.codec import Codec
from dcp_stack.control.client import ControlError, ServiceError

from .agreement import Agreement, ConvergenceClock
from .definition import (
    NS_PER_S,
    Activate,
    Create,
    Deactivate,
    Delete,
    Down,
    Event,
    Heal,
    LinkQuality,
    Partition,
    Restart,
    Scenario,
    SetLink,
    Submission,
    Up,
    Update,
)
from .expectations import Observed, checks, describe, judge_all, judge_now
from .loading import check, scenario_codec, trial_node
from .provenance import Provenance
from .report import Finding, NodeTraffic, Report
from .requests import request, trouble


class Ground(Observed, ABC):
    """Nodes and links on which one scenario is executed. Times are ns since its start."""

    name: ClassVar[str]
    """``simulate`` or ``testbed``."""
    survival: ClassVar[str]
    """The expectation that no node fails."""

    def __init__(self, scenario: Scenario) -> None:
        """Raises :class:`ScenarioError` for an invalid scenario, and for parameters that the nodes refuse."""
        self.scenario = check(scenario)
        self.codec: Codec = scenario_codec(scenario)
        trial_node(scenario, self.codec)
        self.agreement = Agreement(scenario.nodes)
        self.clock = ConvergenceClock()
        self.findings: list[Finding] = []
        self._problems: list[str] = []

    @cached_property
    def provenance(self) -> Provenance:
        """All inputs of the run."""
        return Provenance.of(self.scenario, self.codec)

    @property
    @abstractmethod
    def now(self) -> int:
        """Current time."""

    @abstractmethod
    def _request(self, node: int, method: str, params: dict[str, Any]) -> dict[str, Any]:
        """Send a request to a node, and return its answer.

        Raises LookupError while the node is off, ServiceError or ControlError if there is no answer to the service.
        """

    @abstractmethod
    def _switch(self, node: int, *, up: bool) -> None:
        """Switch a node on or off, if it is not yet."""

    @abstractmethod
    def _partition(self, groups: Sequence[Sequence[int]]) -> None:
        """Restrict frames to the groups; nodes in no group form another one. Without groups the partition ends."""

    @abstractmethod
    def _set_quality(self, direction: tuple[int, int] | None, quality: LinkQuality) -> None:
        """Set the quality of one direction (sender, receiver), or with None of all directions without their own."""

    @abstractmethod
    def _look(self) -> None:
        """Check whether the databases agree now."""

    def _timeline(self) -> list[tuple[int, Callable[[], None]]]:
        """Return the events and checks of the scenario as (time, function), sorted by time."""
        found: list[tuple[int, Callable[[], None]]] = [
            (at, partial(self._happen, event, n, at)) for at, n, event in self.scenario.timeline()
        ]
        for at, expected in checks(self.scenario):
            found.append((at, lambda expected=expected: self.findings.append(judge_now(expected, self))))  # type: ignore[misc]
        return sorted(found, key=lambda each: each[0])

    def _happen(self, event: Event, n: int, at: int) -> None:
        """Perform the ``n``-th repetition of an event, which is due ``at`` this time, and note if it fails."""
        what = describe(event, n)
        if event.disturbs:
            self.clock.event(self.now, what)
        try:
            status = self._perform(event, n)
        except (LookupError, ServiceError, ControlError) as error:
            status = str(error)
        if status:
            self._problems.append(f"at {at / NS_PER_S:g} s {what}: {status}")
        self._look()

    def _perform(self, event: Event, n: int) -> str:
        """Perform an event; returns a status that is not OK, otherwise an empty text.

        Raises the errors of :meth:`_request`.
        """
        match event:
            case Create() | Update() | Delete() | Submission() | Activate() | Deactivate():
                return trouble(self._request(event.node, *request(event, n)))
            case Down(node=node):
                self._switch(node, up=False)
            case Up(node=node):
                self._switch(node, up=True)
            case Restart(node=node):
                self._switch(node, up=False)
                self._switch(node, up=True)
            case Partition(groups=groups):
                self._partition(groups)
            case Heal():
                self._partition(())
            case SetLink(sender=int() as sender, receiver=int() as receiver, quality=quality):
                for direction in ((sender, receiver), (receiver, sender))[: 1 + event.both_ways]:
                    self._set_quality(direction, quality)
            case SetLink(quality=quality):
                self._set_quality(None, quality)
        return ""

    @property
    def _interrupted(self) -> set[int]:
        """The nodes that are not switched on during the whole run."""
        events = (event.node for event in self.scenario.events if isinstance(event, Down | Up | Restart))
        return {*events, *self.scenario.down_at_start}

    def _report(self, traffic: list[NodeTraffic], failures: Sequence[str], **more: Any) -> Report:
        """Return the report; ``failures``: of nodes. ``more``: members that depend on the ground."""
        scenario = self.scenario
        return Report(
            title=scenario.title,
            ground=self.name,
            nodes=scenario.nodes,
            profile=scenario.profile,
            seed=scenario.seed,
            provenance=self.provenance,
            findings=[
                *judge_all(scenario.expect, self.clock.events, traffic),
                *self.findings,
                Finding(self.survival, not failures, "; ".join(failures[:3])),
                Finding("every event succeeds", not self._problems, "; ".join(self._problems[:3])),
            ],
            convergences=self.clock.events,
            traffic=traffic,
            **more,
        )
