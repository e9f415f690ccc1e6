"""Run one campaign in several worker processes, to use several processor cores.

All workers mutate the same pool of messages, with different seeds. Only the campaign decides which effects are
findings, reports them, and writes files.

**Reproducibility.** Tests are ordered in rounds, with the same number for each worker. Two rounds are ordered at a
time, so that few workers wait. When all workers have reported a round, the campaign processes its effects in the order
of their tests. Each new effect is minimised by the worker that observed it, before the tests of its next order. The
result of a campaign depends only on its seed, the number of workers and the number of tests, not on their speed.

**Independence.** Workers do not exchange coverage; each prefers fields that it has not reached itself. Together they
reach as much as one process with the same number of tests: of 300 pairs of field and class two workers reached 286,
286 and 271 after 1000 sequences (seeds 1, 2, 3), eight 265, 275 and 252, one process 286, 291 and 287; after 2000
there was no difference. With an exchange every 16 sequences, two workers reached 278, 271 and 284.

**Processes are spawned** by this one: they do not inherit its sockets and files, and the kernel ends them with it. The
fork server of the workers of a run (:mod:`dcp_conformance.execution.workers.parallel`) is not used: a signal to the
whole process group would end the server, and with it the workers, before they have reported their findings. It would
save less than half a second for each worker.
"""

from __future__ import annotations

import contextlib
import math
import multiprocessing
import os
import signal
import time
from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from typing import Final

from dcp_conformance.errors import WorkerError
from dcp_lab.fuzz.campaign import Campaign, Limits, Progress, State
from dcp_lab.fuzz.reduce.reduction import Finding, not_minimised
from dcp_lab.fuzz.steps import Effect, Step

from dcp_codec.common.signals import Stop
from dcp_codec.common.workers import Worker

from .worker import SLOT_SIZE, Failure, FirstEffect, Make, Order, Report, Settings, Slot, Totals, work

#: Number of rounds that are ordered and not yet reported.
_AHEAD: Final = 2
#: Tests of a worker in the first round, and in the largest round; each round is twice as large as the one before.
_FIRST_ROUND: Final = 8
_ROUND: Final = 250
#: Largest round if lines of code are traced, which makes tests slow.
_GUIDED_ROUND: Final = 20
#: Seconds that workers have to send their last reports and to end.
_PATIENCE: Final = 10.0
#: Signals that end a process because of a fault in native code.
_CRASHES: Final = (signal.SIGSEGV, signal.SIGBUS, signal.SIGILL, signal.SIGFPE, signal.SIGABRT)


@dataclass(slots=True)
class _Member:
    """The connection of the campaign to one worker: messages, shared memory, and work to order."""

    name: str
    worker: Worker
    slot: Slot
    left: int | None
    """Number of tests that may still be ordered; None for no limit."""
    reports: deque[Report] = field(default_factory=deque)
    totals: Totals = field(default_factory=Totals)
    minimise: list[str] = field(default_factory=list)
    """Signatures of effects to minimise with the next order."""
    open: bool = True

    def send(self, order: Order | None) -> None:
        # A worker that has ended is detected when its reports are read.
        with contextlib.suppress(OSError):
            self.worker.connection.send(order)


def run_in_workers(campaign: Campaign, make: Make, jobs: int, limits: Limits, *, guided: bool = False) -> State:
    """Run a campaign in ``jobs`` processes until a limit is reached. ``make`` makes the campaign of each process.

    ``limits`` apply to all processes together. Ctrl-C and SIGTERM raise :class:`KeyboardInterrupt`. Raises
    :class:`WorkerError` if a worker ends by itself. In both cases the findings so far are saved.
    """
    return _Workers(campaign, limits, guided).run(make, jobs)


class _Workers:
    def __init__(self, campaign: Campaign, limits: Limits, guided: bool) -> None:
        self._campaign = campaign
        self._limits = limits
        self._guided = guided
        self._stop = Stop()
        self._members: list[_Member] = []
        self._first = campaign.state.cases
        self._most = _GUIDED_ROUND if guided else _ROUND
        self._round = _FIRST_ROUND
        self._under_way = 0
        self._begun = time.monotonic()
        self._told = math.inf
        """Time of the last progress report; infinite until all workers are ready."""
        self._pending: dict[str, FirstEffect] = {}
        """Effects that are being minimised, by signature."""
        self._kept: set[str] = set()
        """Signatures of the findings of this run."""

    def run(self, make: Make, jobs: int) -> State:
        state = self._campaign.state
        done_before = state.seconds
        with contextlib.ExitStack() as stack:
            for number in (signal.SIGINT, signal.SIGTERM):
                stack.callback(signal.signal, number, signal.signal(number, self._stop))
            stack.callback(self._end)
            try:
                self._start(make, jobs)
                self._carry_out()
            except BaseException:
                self._gather()
                raise
            finally:
                state.seconds = done_before + time.monotonic() - self._begun
                self._close()
        return state

    # -- processes ---------------------------------------------------------------------------------------------

    def _start(self, make: Make, jobs: int) -> None:
        context = multiprocessing.get_context("spawn")
        campaign, cases = self._campaign, self._limits.cases
        rate = None if self._limits.rate is None else self._limits.rate / jobs
        if rate is not None:
            # At least one report in a second.
            self._most = max(1, min(self._most, int(rate)))
        with _without_sigint():
            for number in range(jobs):
                # A resumed campaign must draw other tests than before.
                seed = f"{campaign.seed}/{self._first}/{number}"
                settings = Settings(seed, campaign.state, self._guided, rate, os.getpid())
                memory = context.RawArray("B", SLOT_SIZE)
                name = f"worker {number + 1} of {jobs} (seed {seed!r})"
                try:
                    worker = Worker(context, work, make, settings, memory, duplex=True)
                except OSError as error:
                    raise WorkerError(f"{name} cannot be started: {error.strerror or error}") from None
                share = None if cases is None else cases // jobs + (number < cases % jobs)
                self._members.append(_Member(name, worker, Slot(memory), share))

    def _ready(self, seconds: float) -> list[_Member]:
        """Wait at most ``seconds``; return the workers that have sent a message or closed their connection."""
        there = {member.worker.connection: member for member in self._members if member.open}
        return [there[connection] for connection in wait(list(there), seconds) if isinstance(connection, Connection)]

    def _listen(self, member: _Member) -> None:
        """Receive one message of a worker. Raises :class:`WorkerError` if the worker has ended."""
        try:
            message = member.worker.connection.recv()
        except (EOFError, OSError):
            self._gone(member)
            return
        if isinstance(message, Failure):
            raise WorkerError(f"{member.name} has ended after {member.slot.cases} tests: {message.text}")
        member.reports.append(message)
        member.totals = message.totals

    def _gone(self, member: _Member) -> None:
        """Process the end of a worker that was not ordered. Raises :class:`WorkerError`."""
        member.open = False
        status = member.worker.status(_PATIENCE)
        if self._stop.wanted:
            return
        how = f"has ended with status {status}"
        if status is not None and status < 0:
            by = signal.Signals(-status).name
            how = f"was ended by {by}"
            if -status in _CRASHES:
                self._crashed(member, by)
        again = "the same --seed and --jobs repeat them"
        raise WorkerError(f"{member.name} {how} after {member.slot.cases} tests; {again}")

    def _crashed(self, member: _Member, by: str) -> None:
        """Keep the current test of a crashed worker as a finding."""
        steps = member.slot.steps()
        effect = Effect("dead", f"its process was ended by {by}", max(0, len(steps) - 1), by)
        if steps and effect.signature not in self._campaign.state.findings:
            self._campaign.keep(self._not_minimised(steps, effect))

    def _gather(self) -> None:
        """Terminate all workers and receive their last reports."""
        self._stop.wanted = True
        for member in self._members:
            member.worker.process.terminate()
        deadline = time.monotonic() + _PATIENCE
        while any(member.open for member in self._members) and (left := deadline - time.monotonic()) > 0:
            for member in self._ready(left):
                # The first error is already being raised.
                with contextlib.suppress(WorkerError):
                    self._listen(member)

    def _end(self) -> None:
        for member in self._members:
            member.send(None)
        for member in self._members:
            # Terminated workers had time to end in _gather.
            member.worker.end(0 if self._stop.wanted else _PATIENCE)

    # -- the campaign ------------------------------------------------------------------------------------------

    def _carry_out(self) -> None:
        # The first report says that a worker is ready.
        self._reports()
        self._begun = self._told = time.monotonic()
        for _ in range(_AHEAD):
            self._order()
        while self._under_way:
            reports = self._reports()
            self._under_way -= 1
            self._decide(reports)
            self._order()

    def _reports(self) -> list[Report]:
        """Return the reports of all workers for one round, when all have been received."""
        while not all(member.reports for member in self._members):
            with self._stop.interruptible_by_signals():
                ready = self._ready(1.0)
            self._progress()
            for member in ready:
                self._listen(member)
        return [member.reports.popleft() for member in self._members]

    def _order(self) -> None:
        """Order the next round, unless there is nothing left to do."""
        seconds, cases = self._limits.seconds, 0
        until = None if seconds is None else self._begun + seconds
        if not self._enough() and (until is None or time.monotonic() < until):
            cases = min(self._round, self._most)
            self._round = 2 * cases
        shares = [cases if member.left is None else min(cases, member.left) for member in self._members]
        if not any(shares) and not any(member.minimise for member in self._members):
            return
        for member, share in zip(self._members, shares, strict=True):
            if member.left is not None:
                member.left -= share
            member.send(Order(tuple(member.minimise), share, until))
            member.minimise = []
        self._under_way += 1

    def _enough(self) -> bool:
        found = len(self._campaign.artefacts) + len(self._pending)
        return self._limits.findings is not None and found >= self._limits.findings

    def _decide(self, reports: list[Report]) -> None:
        """Keep the findings of a round, and order the minimisation of new effects."""
        numbered = list(enumerate(reports))
        self._keep_findings(numbered)
        for number, shown in self._new(numbered):
            self._members[number].minimise.append(shown.effect.signature)
            if self._campaign.on_effect is not None:
                self._campaign.on_effect(shown.effect)

    def _keep_findings(self, reports: list[tuple[int, Report]]) -> None:
        for _, report in reports:
            for finding in report.findings:
                self._keep(finding)

    def _new(self, reports: list[tuple[int, Report]]) -> Iterator[tuple[int, FirstEffect]]:
        """Yield new effects with the numbers of their workers, in the order of their tests; mark them as pending."""
        shown = [(each.case, number, each) for number, report in reports for each in report.shown]
        for _, number, each in sorted(shown, key=lambda entry: entry[:2]):
            signature = each.effect.signature
            known = signature in self._pending or signature in self._campaign.state.findings
            if not known and not self._enough():
                self._pending[signature] = each
                yield number, each

    def _keep(self, finding: Finding) -> None:
        signature = finding.effect.signature
        self._pending.pop(signature, None)
        self._kept.add(signature)
        self._campaign.keep(finding)

    def _not_minimised(self, steps: list[Step], effect: Effect) -> Finding:
        campaign = self._campaign
        return not_minimised(steps, effect, None if campaign.saved_target.mode == "codec" else campaign.codec)

    def _progress(self) -> None:
        now = time.monotonic()
        if self._campaign.on_progress is None or now - self._told < 1:
            return
        self._told, seconds = now, now - self._begun
        done = sum(member.slot.cases for member in self._members)
        findings = len(self._campaign.state.findings)
        self._campaign.on_progress(Progress(self._first + done, done / seconds, findings, seconds))

    def _close(self) -> None:
        """Keep effects whose minimisation was not completed, add up the totals, and save the state."""
        left = [(number, report) for number, member in enumerate(self._members) for report in member.reports]
        self._keep_findings(left)
        for _, shown in [*enumerate(self._pending.values()), *self._new(left)]:
            self._keep(self._not_minimised(shown.steps, shown.effect))
        campaign, state = self._campaign, self._campaign.state
        kinds, effects, lines = Counter(state.kinds), Counter[str](), set[tuple[str, int]]()
        for totals in (member.totals for member in self._members):
            state.cases += totals.cases
            state.frames += totals.frames
            kinds.update(totals.kinds)
            effects.update(totals.effects)
            lines |= totals.lines
            if campaign.mutator is not None:
                campaign.mutator.reached.update(totals.fields)
        state.kinds = dict(kinds)
        state.again += sum(effects[signature] for signature in state.findings) - len(self._kept)
        campaign.lines = lambda: len(lines)
        campaign.close()


@contextlib.contextmanager
def _without_sigint() -> Iterator[None]:
    """Start processes in this context with SIGINT blocked.

    A terminal sends SIGINT to all processes of the group, but only the campaign may handle it.
    """
    # The resource tracker unblocks SIGINT while it starts, so it has to run before.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


__all__ = ["run_in_workers"]
