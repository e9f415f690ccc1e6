"""Run the suite against the reference node, which must pass, and against mutants of it, which must fail.

A case *kills* a mutant if a failed check names a requirement that the mutant violates. A case whose failed checks name
other requirements only is listed separately (``also``): its failure is a consequence of the fault, but its report would
point the user to the wrong requirement. The verdict ``error`` is always a fault of the tester.
"""

from __future__ import annotations

import itertools
import logging
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from functools import cache, partial
from typing import Final

import msgspec
from dcp_conformance.definitions.case import DECLARED, DENIED, SANITY, Case, all_cases
from dcp_conformance.definitions.declared import declared_by, denied_by
from dcp_conformance.definitions.pics import Capabilities, Pics
from dcp_conformance.definitions.results import CaseResult, timestamp
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.errors import ConformanceError, UsageError
from dcp_conformance.execution.concurrent import execute
from dcp_conformance.execution.runner import Runner
from dcp_conformance.execution.selection import ordered
from dcp_conformance.reference.inprocess import InProcess, MakeNode, plain_node, reference_config
from dcp_conformance.test_system.bench import Session
from dcp_spec.profile.definition import Profile
from dcp_spec.profile.loading import ProfileError, load_profile
from dcp_spec.version import __version__

from dcp_codec.codec import Codec
from dcp_codec.common.workers import Item, Result, WorkerLostError, completed

from .costs import COUNTING
from .mutants import ALL_MUTANTS, Mutant, all_mutants

SCHEMA: Final = "dcp-conformance-selftest/1"
PROFILES: Final = ("dcp-1.0", "dcp-1.1", "dcp-1.2", "dcp-1.3", "dcp-2.0", "cpp-1.2", "cpp-1.3", "cpp-2.0")
"""Profiles on which the reference node must pass: every version, and the layouts of the public C++ implementation."""
_FINE: Final = frozenset({Verdict.PASS, Verdict.INFO, Verdict.NOT_APPLICABLE})


class Finding(msgspec.Struct, frozen=True, omit_defaults=True):
    """The outcome of one case in a trial or a baseline."""

    case: str
    verdict: Verdict
    requirements: tuple[str, ...] = ()
    """The requirements that failed checks name."""
    reason: str = ""


class Baseline(msgspec.Struct, frozen=True):
    """The outcome of the suite for the reference node on one profile."""

    profile: str
    cases: int
    findings: tuple[Finding, ...]
    """Cases whose verdict is neither pass, info nor not applicable; empty if the node passes."""
    seconds: float

    @property
    def good(self) -> bool:
        """Whether the node passes."""
        return not self.findings


class Trial(msgspec.Struct, frozen=True):
    """The outcome of the suite for one mutant on one profile."""

    mutant: str
    requirements: tuple[str, ...]
    what: str
    profile: str
    candidates: int
    """Cases that name a requirement of the mutant and apply to the profile."""
    cases: int
    """Cases that were executed."""
    killers: tuple[Finding, ...]
    """Cases with a failed check that names a violated requirement; only the first one unless all were executed."""
    also: tuple[Finding, ...]
    """Cases whose failed checks name other requirements only."""
    errors: tuple[Finding, ...]
    """Cases with the verdict ``error``."""
    seconds: float

    @property
    def killed(self) -> bool:
        """Whether a failed check names a violated requirement."""
        return bool(self.killers)


class SelftestResult(msgspec.Struct, frozen=True, kw_only=True):
    """The content of ``selftest.json``."""

    schema: str = SCHEMA
    tool: str = f"dcp-conformance {__version__}"
    started: str = ""
    """ISO 8601, UTC."""
    duration: float = 0.0
    """Seconds."""
    full: bool = False
    """Whether all cases were executed against each mutant, on its newest version or on the selected profiles."""
    every: bool = False
    """Whether all cases that name a requirement of a mutant were executed; otherwise only up to the first killer."""
    baselines: tuple[Baseline, ...] = ()
    mutants: tuple[Trial, ...] = ()

    @property
    def survivors(self) -> tuple[Trial, ...]:
        """The trials, one for each mutant and profile, in which no case killed the mutant."""
        return tuple(each for each in self.mutants if not each.killed)

    @property
    def had_errors(self) -> bool:
        """Whether a case has the verdict ``error``."""
        findings = [each for baseline in self.baselines for each in baseline.findings]
        return any(trial.errors for trial in self.mutants) or any(each.verdict is Verdict.ERROR for each in findings)

    def exit_status(self) -> int:
        """Return 0 if the reference node passes and every mutant is killed, 4 after an error of the tester, else 1."""
        if self.had_errors:
            return 4
        return 1 if self.survivors or not all(each.good for each in self.baselines) else 0


@cache
def cases(about: Collection[str] = ()) -> tuple[Case, ...]:
    """Return the cases in the order of execution; of :data:`COUNTING` those that name a requirement in ``about``."""
    every = ordered(all_cases().values())
    return tuple(each for each in every if each.id not in COUNTING or set(each.requirements) & set(about))


def _sanity() -> Case:
    return next(case for case in cases() if case.id == SANITY)


@cache
def _codec(profile: str) -> Codec:
    return Codec(profile)


class Suite:
    """The suite with one node in the process, the reference node or a mutant, on one profile."""

    def __init__(
        self, profile: str, make: MakeNode = plain_node, pics: Pics | None = None, *, runner: Runner | None = None
    ) -> None:
        """``runner``: that of a node outside of this process, instead of one that ``make`` makes."""
        if runner is None:
            codec = _codec(profile)
            sut = InProcess(reference_config(codec), make=make)
            runner = Runner(Session(codec, sut.lower_tester(), sut.upper_tester(), pics or Pics()), sut)
        self._runner = runner
        self._runner.prepare()
        self._begun = False

    def run(self, cases: Iterable[Case]) -> Iterator[CaseResult]:
        """Execute ``cases`` in succession and yield their results, that of the sanity case first.

        The node is restarted after a crash. A result is yielded again if a later case revises it.
        """
        for case in cases:
            if not self._begun and case.id != SANITY:
                yield self._runner.run(_sanity())
            self._begun = True
            yield self._runner.run(case)
            yield from self._runner.take_revised()
        self._runner.finish()
        yield from self._runner.take_revised()

    def run_side_by_side(self, cases: Sequence[Case], width: int) -> list[CaseResult]:
        """Return the results of :meth:`run`, but execute up to ``width`` cases concurrently."""
        passed: dict[str, CaseResult] = {}
        first = self._runner.run(_sanity())
        self._begun = True
        execute(self._runner, _sanity(), cases, width, lambda case, result: passed.update({case.id: result}))
        left = [case for case in cases if case.id not in passed and case.id != SANITY]
        return [first, *passed.values(), *self.run(left)]

    def passive(self) -> Iterator[CaseResult]:
        """Yield the results of the passive rules that failed during the cases."""
        for result in self._runner.session.passive.results("dcp-conformance run"):
            if result.verdict is Verdict.FAIL:
                yield result


def baseline(profile: str) -> Baseline:
    """Execute all cases and passive rules against the reference node."""
    begun = time.monotonic()
    suite = Suite(profile)
    results = list(suite.run(ordered(all_cases().values())))
    findings = tuple(
        finding_of(each)
        for each in (*results, *suite.passive())
        if each.verdict not in _FINE and not is_declared(each, _codec(profile).profile)
    )
    return Baseline(profile, len(results), findings, round(time.monotonic() - begun, 2))


def is_declared(result: CaseResult, profile: Profile) -> bool:
    """Return whether the failed checks of a result are exactly the violations that the profile itself declares.

    The PICS is assumed to be empty.
    """
    failed = {each for check in result.checks if check.verdict is Verdict.FAIL for each in check.requirements}
    declared = {DECLARED: declared_by(profile), DENIED: denied_by(Capabilities(), profile)}.get(result.id)
    return bool(declared) and failed == set(declared or ())


def trials(
    mutant: Mutant, profiles: Sequence[str] | None = None, *, full: bool = False, every: bool = False
) -> list[Trial]:
    """Try ``mutant`` on each of ``profiles``, by default on ``mutant.profiles`` (one for each version that it affects).

    ``full`` and ``every`` are those of :func:`trial`; without ``profiles`` they apply to the newest version only. The
    case that killed the mutant on one profile is executed first on the next, because it usually kills it there, too.
    """
    found: list[Trial] = []
    first = ""
    for profile in mutant.profiles if profiles is None else profiles:
        whole = profiles is not None or not found
        found.append(trial(mutant, profile=profile, full=full and whole, every=every and whole, first=first))
        first = found[-1].killers[0].case if found[-1].killers else first
    return found


def trial(
    mutant: Mutant, *, profile: str | None = None, full: bool = False, every: bool = False, first: str = ""
) -> Trial:
    """Execute the cases that name a requirement of ``mutant`` until one kills it.

    ``every`` executes all of these cases, ``full`` the whole suite. ``profile`` defaults to ``mutant.profile``.
    ``first`` is the identifier of the case to begin with; ``full`` and ``every`` ignore it.
    """
    begun = time.monotonic()
    name = profile or mutant.profile
    named = [case for case in cases(mutant.requirements) if set(case.requirements) & set(mutant.requirements)]
    # A mutant that a short case kills does not wait for cases of the long plan.
    named.sort(key=lambda case: (bool(first) and case.id != first and not (full or every), case.long))
    killers: list[Finding] = []
    also: list[Finding] = []
    errors: list[Finding] = []
    count = candidates = 0
    try:
        suite = Suite(name, mutant.make)
    except ConformanceError as error:
        # The suite could not be prepared with this node; a run would end here with this message.
        return Trial(
            mutant.id, mutant.requirements, mutant.what, name, len(named), 0, (), (),
            (Finding("", Verdict.ERROR, reason=str(error)),), round(time.monotonic() - begun, 3),
        )  # fmt: skip
    for result in itertools.chain(suite.run(cases(mutant.requirements) if full else named), suite.passive()):
        count += result.verdict is not Verdict.NOT_APPLICABLE
        candidates += result.verdict is not Verdict.NOT_APPLICABLE and bool(
            set(result.requirements) & set(mutant.requirements)
        )
        finding = finding_of(result)
        if result.verdict is Verdict.ERROR:
            errors.append(finding)
        elif result.verdict is Verdict.FAIL:
            hit = set(finding.requirements) & set(mutant.requirements)
            (killers if hit else also).append(finding)
            if hit and not full and not every:
                break
    seconds = round(time.monotonic() - begun, 3)
    return Trial(
        mutant.id,
        mutant.requirements,
        mutant.what,
        name,
        candidates,
        count,
        tuple(killers),
        tuple(also),
        tuple(errors),
        seconds,
    )


def finding_of(result: CaseResult) -> Finding:
    """Return the summary of a result, with the requirements that its failed checks name."""
    failed = [check for check in result.checks if check.verdict is Verdict.FAIL]
    named = dict.fromkeys(each for check in failed for each in check.requirements)
    return Finding(result.id, result.verdict, tuple(named), result.reason)


chosen = ALL_MUTANTS.select
"""Function that returns the mutants that identifiers, requirements or globs of either denote."""


def _baseline_task(profile: str) -> list[Baseline]:
    return [baseline(profile)]


def _trials_task(mutant: str, profiles: tuple[str, ...] | None, full: bool, every: bool) -> list[Trial]:
    return trials(all_mutants()[mutant], profiles, full=full, every=every)


def _execute(task: Callable[[], Sequence[Baseline | Trial]]) -> Sequence[Baseline | Trial]:
    return task()


Progress = Callable[[Baseline | Trial], None]


def selftest(
    mutants: Sequence[Mutant],
    *,
    profiles: Sequence[str] = (),
    full: bool = False,
    every: bool = False,
    jobs: int | None = None,
    on_start: Callable[[int], None] | None = None,
    on_result: Progress | None = None,
) -> SelftestResult:
    """Run the suite against the reference node, then against each of ``mutants``.

    ``profiles`` replaces :data:`PROFILES` for the reference node, and the default profiles of the mutants; a mutant is
    tried on those of them in whose version it is a fault. ``full`` and ``every`` are those of :func:`trial`. ``jobs``
    is the number of processes, by default one for each processor. ``on_start`` is called with the number of expected
    results, and ``on_result`` with each result. Raise :class:`UsageError` for an unknown profile.
    """
    for name in profiles:
        try:
            load_profile(name)
        except ProfileError as error:
            raise UsageError(str(error)) from None
    begun, started = time.monotonic(), timestamp()
    baselines: dict[str, Baseline] = {}
    outcomes: dict[str, list[Trial]] = {}
    wanted = {each.id: _profiles(each, profiles) for each in mutants}
    wanted = {each: names for each, names in wanted.items() if names}
    if on_start is not None:
        on_start(len(profiles or PROFILES) + sum(map(len, wanted.values())))
    # Load the cases and mutants before the processes are forked: all of them share these.
    cases(), all_mutants()
    tasks: list[Callable[[], Sequence[Baseline | Trial]]] = [
        *(partial(_baseline_task, profile) for profile in profiles or PROFILES),
        *(partial(_trials_task, each, names if profiles else None, full, every) for each, names in wanted.items()),
    ]
    for _, results in in_processes(_execute, tasks, jobs):
        for result in results:
            if isinstance(result, Baseline):
                baselines[result.profile] = result
            else:
                outcomes.setdefault(result.mutant, []).append(result)
            if on_result is not None:
                on_result(result)
    return SelftestResult(
        started=started,
        duration=round(time.monotonic() - begun, 1),
        full=full,
        every=every or full,
        baselines=tuple(baselines[profile] for profile in profiles or PROFILES),
        mutants=tuple(outcome for each in wanted for outcome in outcomes[each]),
    )


def _profiles(mutant: Mutant, profiles: Sequence[str]) -> tuple[str, ...]:
    """Return the profiles on which a mutant is tried: of ``profiles``, or by default one for each version."""
    if not profiles:
        return mutant.profiles
    return tuple(each for each in profiles if mutant.exists_in(_codec(each).profile.spec_version))


def _without_tracebacks() -> None:
    """Do not log the tracebacks of services: those of a mutant may fail by intention."""
    logging.getLogger("dcp_stack.control.server").setLevel(logging.CRITICAL)


def in_processes(
    work: Callable[[Item], Result], items: Iterable[Item], jobs: int | None
) -> Iterator[tuple[int, Result]]:
    """Yield places and results as :func:`completed` does. Raise ``ConformanceError`` if a process ends by itself."""
    try:
        yield from completed(work, items, jobs, begin=_without_tracebacks)
    except WorkerLostError as error:
        raise ConformanceError(str(error)) from None
