"""One worker of a campaign (:mod:`.workers`): a process with a target and a generator of its own.

It does what it is ordered to, order by order, and reports after each: what it has done in all, effects that it has not
seen before, and findings that it was told to make small. It writes no files and decides nothing. What it does depends
on its chance and its orders alone, never on the time that things take; but for the end of a campaign by ``--max-time``.
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

from dcp_codec.testing.mutation import Touch
from dcp_conformance.errors import ConformanceError
from dcp_conformance.execution.signals import Stop
from dcp_conformance.sut.process import ending_with_parent

from .campaign import Campaign, Limits, State
from .generate.coverage import counter_of
from .generate.guidance import Guide, guide
from .reduce.reduction import Finding
from .steps import Effect, Step, Target

#: Octets for the test that a worker is at; one that is longer is not known if it ends the worker.
SLOT_SIZE: Final = 1 << 20
#: Tests done, and octets of the one that follow.
_HEADER: Final = struct.Struct("=QQ")

Make = Callable[[str], AbstractContextManager[Campaign]]
"""Makes the campaign of a worker, in its process; the argument is the seed that it draws with. It has to be pickled."""


class Settings(NamedTuple):
    """What a worker is told when it begins."""

    seed: str
    state: State
    """Where the campaign goes on from."""
    guided: bool
    rate: float | None
    """Its tests in a second, at most."""
    parent: int
    """The process that it works for."""


class Order(NamedTuple):
    """What to do next."""

    minimise: tuple[str, ...]
    """Signatures of effects that it has reported: they are made small, before anything else."""
    cases: int
    until: float | None
    """No test begins after this time: that of ``time.monotonic``, which all processes of a machine share."""


class Shown(NamedTuple):
    """An effect, the first with its signature in this worker."""

    case: int
    """In which of its tests."""
    steps: list[Step]
    effect: Effect


class Totals(NamedTuple):
    """What a worker has done since it began."""

    cases: int = 0
    frames: int = 0
    kinds: dict[str, int] = {}  # noqa: RUF012 - never changed
    fields: Counter[Touch] = Counter()  # noqa: RUF012
    states: Counter[Touch] = Counter()  # noqa: RUF012
    effects: Counter[str] = Counter()  # noqa: RUF012
    """How often each signature has shown, minimising not counted."""
    lines: frozenset[tuple[str, int]] = frozenset()
    """Lines of the target that were run, where they are counted."""


class Report(NamedTuple):
    """What came of an order; the first of all says that a worker is ready."""

    totals: Totals
    shown: tuple[Shown, ...] = ()
    findings: tuple[Finding, ...] = ()


class Failure(NamedTuple):
    """The last words of a worker."""

    text: str


class Slot:
    """Memory that a worker shares with its campaign: how many tests it has done, and the one that it is at.

    It is there also when the worker is not any more.
    """

    def __init__(self, memory: Any) -> None:
        """``memory``: ``SLOT_SIZE`` octets, all 0, as ``multiprocessing`` shares them."""
        self._memory = memoryview(memory).cast("B")

    def write(self, cases: int, steps: list[Step]) -> None:
        """Another one is about to be carried out, after so many."""
        octets = pickle.dumps(steps, pickle.HIGHEST_PROTOCOL)
        if len(octets) > len(self._memory) - _HEADER.size:
            octets = b""
        _HEADER.pack_into(self._memory, 0, cases, len(octets))
        self._memory[_HEADER.size : _HEADER.size + len(octets)] = octets

    @property
    def cases(self) -> int:
        """How many it has done."""
        done: int = _HEADER.unpack_from(self._memory)[0]
        return done

    def steps(self) -> list[Step]:
        """What was carried out last, or was about to be; nothing if it is not known. Only once the worker is gone."""
        size = _HEADER.unpack_from(self._memory)[1]
        try:
            found: list[Step] = pickle.loads(self._memory[_HEADER.size : _HEADER.size + size])  # noqa: S301 - our own
        except Exception:
            # Nothing yet, or it was ended while it wrote.
            return []
        return found


class _Noted:
    """A target whose tests are written down before they are carried out, and which a signal interrupts.

    It interrupts nothing else: what a test has shown is not lost.
    """

    def __init__(self, campaign: Campaign, slot: Slot, stop: Stop) -> None:
        self._target: Target = campaign.target
        self._state = campaign.state
        self._slot = slot
        self._stop = stop
        self.name = self._target.name

    def run(self, steps: list[Step]) -> Effect | None:
        self._slot.write(self._state.cases, steps)
        with self._stop.heeded():
            return self._target.run(steps)


class Worker:
    """Carries out orders with a campaign that keeps nothing by itself."""

    def __init__(self, campaign: Campaign, settings: Settings, slot: Slot, stop: Stop) -> None:
        self._campaign = campaign
        self._rate = settings.rate
        self._known = set(settings.state.findings)
        coverage = settings.state.coverage
        # What the campaign has reached is not preferred any more, and is not this worker's.
        self._fields, self._states = counter_of(coverage.fields), counter_of(coverage.states)
        campaign.has_reached(coverage)
        campaign.aside = self._aside
        self._guide: Guide | None = guide(campaign) if settings.guided else None
        self._slot = slot
        campaign.target = _Noted(campaign, slot, stop)
        self._effects: Counter[str] = Counter()
        self._waiting: dict[str, Shown] = {}
        """Effects that the campaign has not decided about, by signature."""
        self._shown: list[Shown] = []
        self._findings: list[Finding] = []

    def carry_out(self, order: Order) -> None:
        """Do this, or as much of it as there is time for until a signal."""
        self._shown, self._findings = [], []
        with contextlib.suppress(KeyboardInterrupt):
            for signature in order.minimise:
                self._minimise(self._waiting.pop(signature))
            left = None if order.until is None else order.until - time.monotonic()
            self._campaign.carry_out(Limits(left, order.cases, rate=self._rate))

    def report(self) -> Report:
        """What came of the last order."""
        campaign = self._campaign
        state, mutator = campaign.state, campaign.mutator
        totals = Totals(
            state.cases,
            state.frames,
            state.kinds,
            (mutator.reached if mutator is not None else Counter[Touch]()) - self._fields,
            campaign.reached_states - self._states,
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
            self._waiting[signature] = shown = Shown(self._campaign.state.cases, steps, effect)
            self._shown.append(shown)

    def _minimise(self, shown: Shown) -> None:
        reduction = self._campaign.reduction(shown.effect)
        try:
            reduction.reduce(shown.steps, shown.effect)
        finally:
            self._findings.append(reduction.outcome(shown.steps, shown.effect))


def work(make: Make, settings: Settings, connection: Connection, memory: Any) -> None:
    """What the process of a worker does, until it is given None, or nobody is there any more.

    SIGTERM ends it, with a last report.
    """
    ending_with_parent()()
    if os.getppid() != settings.parent:
        # It was gone before it could be watched.
        return
    stop = Stop()
    signal.signal(signal.SIGTERM, stop)
    # Whoever it works for has closed its end.
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
        with contextlib.suppress(KeyboardInterrupt), stop.heeded():
            order = connection.recv()
        if order is None:
            return
        try:
            worker.carry_out(order)
        finally:
            # Also what was found before something went wrong.
            connection.send(worker.report())
