"""One worker of a campaign (:mod:`.workers`): a process with its own target and generator.

It executes one order after another, and reports after each: its totals, effects with a new signature, and the findings
that the order asked to minimise. It writes no files and makes no decisions. Its behaviour depends only on its seed and
its orders, not on durations, except that ``--max-time`` ends the campaign.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import signal
import struct
import time
import traceback
from collections import Counter
from collections.abc import Callable
from contextlib import AbstractContextManager
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Final, NamedTuple

from dcp_conformance.errors import ConformanceError
from dcp_lab.fuzz.campaign import Campaign, Limits, State
from dcp_lab.fuzz.generate.coverage import counter_of
from dcp_lab.fuzz.reduce.reduction import Finding
from dcp_lab.fuzz.steps import Effect, Step, Target
from dcp_lab.testing.mutation import Touch

from dcp_codec.common.child import ending_with_parent
from dcp_codec.common.signals import Stop

from .guidance import Guide, guide

#: Octets reserved for the current test of a worker. A longer test cannot be recovered if it crashes the worker.
SLOT_SIZE: Final = 1 << 20
#: Number of completed tests, and size of the pickled current test that follows, in octets.
_HEADER: Final = struct.Struct("=QQ")

Make = Callable[[str], AbstractContextManager[Campaign]]
"""Function that makes the campaign of a worker from its seed, in the worker's process. It must be picklable."""


class Settings(NamedTuple):
    """Settings of a worker, sent when it starts."""

    seed: str
    state: State
    """State of the campaign at the start."""
    guided: bool
    rate: float | None
    """Maximum number of tests a second."""
    parent: int
    """Process id of the campaign."""


class Order(NamedTuple):
    """The next work of a worker."""

    minimise: tuple[str, ...]
    """Signatures of effects that the worker has reported and minimises first."""
    cases: int
    until: float | None
    """Time after which no test starts (``time.monotonic``, which all processes of a machine share)."""


class FirstEffect(NamedTuple):
    """The first effect with its signature in a worker."""

    case: int
    """Number of the test in this worker."""
    steps: list[Step]
    effect: Effect


class Totals(NamedTuple):
    """Totals of a worker since its start."""

    cases: int = 0
    frames: int = 0
    kinds: dict[str, int] = {}  # noqa: RUF012 - never changed
    fields: Counter[Touch] = Counter()  # noqa: RUF012
    effects: Counter[str] = Counter()  # noqa: RUF012
    """Number of effects by signature, without those during minimisation."""
    lines: frozenset[tuple[str, int]] = frozenset()
    """Executed lines of the target (file, line), if the campaign is guided."""


class Report(NamedTuple):
    """Result of an order. The first report, without an order, indicates that the worker is ready."""

    totals: Totals
    shown: tuple[FirstEffect, ...] = ()
    findings: tuple[Finding, ...] = ()


class Failure(NamedTuple):
    """Reason why a worker ends."""

    text: str


class Slot:
    """Memory shared by a worker and its campaign: the number of completed tests, and the current test.

    It survives a crash of the worker.
    """

    def __init__(self, memory: Any) -> None:
        """``memory``: an array of ``multiprocessing`` with ``SLOT_SIZE`` octets, all 0."""
        self._memory = memoryview(memory).cast("B")

    def write(self, cases: int, steps: list[Step]) -> None:
        """Store the test that is about to be executed, and the number of tests before it."""
        octets = pickle.dumps(steps, pickle.HIGHEST_PROTOCOL)
        if len(octets) > len(self._memory) - _HEADER.size:
            octets = b""
        _HEADER.pack_into(self._memory, 0, cases, len(octets))
        self._memory[_HEADER.size : _HEADER.size + len(octets)] = octets

    @property
    def cases(self) -> int:
        """Number of completed tests."""
        done: int = _HEADER.unpack_from(self._memory)[0]
        return done

    def steps(self) -> list[Step]:
        """Return the current test; empty if unknown. Call this only after the worker has ended."""
        size = _HEADER.unpack_from(self._memory)[1]
        try:
            found: list[Step] = pickle.loads(self._memory[_HEADER.size : _HEADER.size + size])  # noqa: S301 - our own
        except Exception:
            # No test was stored yet, or the worker was killed while it wrote.
            return []
        return found


class _Noted:
    """A target that stores each test in the slot before its execution.

    Signals interrupt the execution only, so that the effect of a completed test is not lost.
    """

    def __init__(self, campaign: Campaign, slot: Slot, stop: Stop) -> None:
        self._target: Target = campaign.target
        self._state = campaign.state
        self._slot = slot
        self._stop = stop
        self.name = self._target.name

    def run(self, steps: list[Step]) -> Effect | None:
        self._slot.write(self._state.cases, steps)
        with self._stop.interruptible_by_signals():
            return self._target.run(steps)


class Worker:
    """Executes orders with a campaign that does not save findings itself."""

    def __init__(self, campaign: Campaign, settings: Settings, slot: Slot, stop: Stop) -> None:
        self._campaign = campaign
        self._rate = settings.rate
        self._known = set(settings.state.findings)
        coverage = settings.state.coverage
        # Coverage from before counts as reached, but is not part of this worker's report.
        self._fields = counter_of(coverage.fields)
        campaign.has_reached(coverage)
        campaign.aside = self._aside
        self._guide: Guide | None = guide(campaign) if settings.guided else None
        self._slot = slot
        campaign.target = _Noted(campaign, slot, stop)
        self._effects: Counter[str] = Counter()
        self._waiting: dict[str, FirstEffect] = {}
        """Reported effects, by signature, that the campaign has not yet asked to minimise."""
        self._shown: list[FirstEffect] = []
        self._findings: list[Finding] = []

    def carry_out(self, order: Order) -> None:
        """Execute an order; a signal ends it early."""
        self._shown, self._findings = [], []
        with contextlib.suppress(KeyboardInterrupt):
            for signature in order.minimise:
                self._minimise(self._waiting.pop(signature))
            left = None if order.until is None else order.until - time.monotonic()
            self._campaign.carry_out(Limits(left, order.cases, rate=self._rate))

    def report(self) -> Report:
        """Return the result of the last order."""
        campaign = self._campaign
        state, mutator = campaign.state, campaign.mutator
        totals = Totals(
            state.cases,
            state.frames,
            state.kinds,
            (mutator.reached if mutator is not None else Counter[Touch]()) - self._fields,
            self._effects,
            frozenset(self._guide.lines) if self._guide is not None else frozenset(),
        )
        self._slot.write(state.cases, [])
        return Report(totals, tuple(self._shown), tuple(self._findings))

    def _aside(self, steps: list[Step], effect: Effect) -> None:
        signature = effect.signature
        self._effects[signature] += 1
        if signature not in self._known:
            self._known.add(signature)
            self._waiting[signature] = shown = FirstEffect(self._campaign.state.cases, steps, effect)
            self._shown.append(shown)

    def _minimise(self, shown: FirstEffect) -> None:
        reduction = self._campaign.reduction(shown.effect)
        try:
            reduction.reduce(shown.steps, shown.effect)
        finally:
            self._findings.append(reduction.outcome(shown.steps, shown.effect))


def work(connection: Connection, make: Make, settings: Settings, memory: Any) -> None:
    """Run a worker process until it receives None or its campaign ends. SIGTERM ends it after a last report."""
    ending_with_parent()()
    if os.getppid() != settings.parent:
        # The parent ended before this process could ask to be ended with it.
        return
    stop = Stop()
    signal.signal(signal.SIGTERM, stop)
    # The campaign has closed its end of the connection.
    with contextlib.suppress(BrokenPipeError, ConnectionResetError, EOFError):
        try:
            with make(settings.seed) as campaign:
                _serve(Worker(campaign, settings, Slot(memory), stop), connection, stop)
        except ConformanceError as error:
            connection.send(Failure(str(error)))
        except (BrokenPipeError, ConnectionResetError, EOFError):
            raise
        except Exception as error:
            last = traceback.extract_tb(error.__traceback__)[-1]
            place = f"{Path(last.filename).name}:{last.lineno}"
            connection.send(Failure(f"{type(error).__name__}: {error} (in {last.name}, {place})"))


def _serve(worker: Worker, connection: Connection, stop: Stop) -> None:
    connection.send(worker.report())
    while not stop.wanted:
        order: Order | None = None
        with contextlib.suppress(KeyboardInterrupt), stop.interruptible_by_signals():
            order = connection.recv()
        if order is None:
            return
        try:
            worker.carry_out(order)
        finally:
            # Report the findings before an exception, too.
            connection.send(worker.report())
