"""Who tests the tester: the suite against our node, which must pass, and against mutants of it, which must not.

A mutant is *killed* by a case that fails with a check that names the requirement which the mutant violates. A case that
fails with checks that only name other requirements is listed beside it (``also``): that may follow from the fault, but
it would have sent whoever reads the report to the wrong place. A case that ends with ``error`` is the tester's own
fault, whatever the implementation did.
"""

from __future__ import annotations

import itertools
import logging
import os
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from fnmatch import fnmatchcase
from functools import cache
from typing import Final

import msgspec
from dcp_spec.profile.definition import Profile
from dcp_spec.profile.loading import ProfileError, load_profile
from dcp_spec.version import __version__

from dcp_codec.codec import Codec
from dcp_conformance.errors import ConformanceError, UsageError
from dcp_conformance.execution.concurrent import execute
from dcp_conformance.execution.runner import Runner
from dcp_conformance.execution.selection import ordered
from dcp_conformance.model.case import DECLARED, DENIED, SANITY, Case, all_cases
from dcp_conformance.model.declared import declared_by, denied_by
from dcp_conformance.model.moment import timestamp
from dcp_conformance.model.pics import Capabilities, Pics
from dcp_conformance.model.results import CaseResult
from dcp_conformance.model.verdict import Verdict
from dcp_conformance.reference.inprocess import InProcess, MakeNode, plain_node, reference_config
from dcp_conformance.test_system.bench import Session

from .mutants import Mutant, all_mutants

SCHEMA: Final = "dcp-conformance-selftest/1"
PROFILES: Final = ("dcp-1.0", "dcp-1.1", "dcp-1.2", "dcp-1.3", "dcp-2.0", "cpp-1.2", "cpp-1.3", "cpp-2.0")
"""Profiles on which our node must pass: every version, and the layouts of the public C++ implementation."""
_FINE: Final = frozenset({Verdict.PASS, Verdict.INFO, Verdict.NOT_APPLICABLE})


class Finding(msgspec.Struct, frozen=True, omit_defaults=True):
    """A case that came out as it does with our node as it is, or does not."""

    case: str
    verdict: Verdict
    requirements: tuple[str, ...] = ()
    """Those that failed checks name."""
    reason: str = ""


class Baseline(msgspec.Struct, frozen=True):
    """The suite against our node as it is, on one profile."""

    profile: str
    cases: int
    findings: tuple[Finding, ...]
    """What is neither pass, info nor not applicable: there should be none."""
    seconds: float

    @property
    def good(self) -> bool:
        """Whether the node passes."""
        return not self.findings


class Trial(msgspec.Struct, frozen=True):
    """A mutant, and what the suite said of it."""

    mutant: str
    requirements: tuple[str, ...]
    what: str
    profile: str
    candidates: int
    """Cases that name a requirement of the mutant and apply to the profile."""
    cases: int
    """Cases that were run."""
    killers: tuple[Finding, ...]
    """Cases that failed and name the requirement in a failed check; only the first one unless all were run."""
    also: tuple[Finding, ...]
    """Cases that failed and name other requirements."""
    errors: tuple[Finding, ...]
    """Cases in which the tester stumbled."""
    seconds: float

    @property
    def killed(self) -> bool:
        """Whether a case that names the violated requirement noticed."""
        return bool(self.killers)


class SelftestResult(msgspec.Struct, frozen=True, kw_only=True):
    """What ``selftest.json`` holds."""

    schema: str = SCHEMA
    tool: str = f"dcp-conformance {__version__}"
    started: str = ""
    """ISO 8601, UTC."""
    duration: float = 0.0
    """Seconds."""
    full: bool = False
    """Whether every mutant met every case, on its newest version or on the profiles that were asked for."""
    every: bool = False
    """Whether every mutant met all cases that name its requirement, likewise; otherwise those until one killed it."""
    baselines: tuple[Baseline, ...] = ()
    mutants: tuple[Trial, ...] = ()

    @property
    def survivors(self) -> tuple[Trial, ...]:
        """Mutants that no case noticed which names the requirement, each on the version where that is so."""
        return tuple(each for each in self.mutants if not each.killed)

    @property
    def stumbled(self) -> bool:
        """Whether a case ended in an error of the tester."""
        findings = [each for baseline in self.baselines for each in baseline.findings]
        return any(trial.errors for trial in self.mutants) or any(each.verdict is Verdict.ERROR for each in findings)

    def exit_status(self) -> int:
        """0: our node passes and every mutant is killed; 1: not so; 4: the tester stumbled."""
        if self.stumbled:
            return 4
        return 1 if self.survivors or not all(each.good for each in self.baselines) else 0


@cache
def cases() -> tuple[Case, ...]:
    """All cases, in the order in which they are run."""
    return tuple(ordered(all_cases().values()))


def _sanity() -> Case:
    return next(case for case in cases() if case.id == SANITY)


@cache
def _mutants() -> dict[str, Mutant]:
    return all_mutants()


@cache
def _codec(profile: str) -> Codec:
    return Codec(profile)


class Suite:
    """Our node, as it is or as a mutant, on one profile, with the cases one after the other."""

    def __init__(self, profile: str, make: MakeNode = plain_node) -> None:
        codec = _codec(profile)
        self._sut = InProcess(reference_config(codec), make=make)
        upper = self._sut.upper_tester()
        self._runner = Runner(Session(codec, self._sut.lower_tester(), upper, Pics()), self._sut)
        self._runner.prepare()
        self._begun = False

    def run(self, cases: Iterable[Case]) -> Iterator[CaseResult]:
        """The results of ``cases``, after that of the sanity case, as in a run; a node that died is started again."""
        for case in cases:
            if not self._begun and case.id != SANITY:
                yield self._runner.run(_sanity())
            self._begun = True
            yield self._runner.run(case)
            yield from self._runner.take_revised()
        self._runner.finish()
        yield from self._runner.take_revised()

    def run_side_by_side(self, cases: Sequence[Case], width: int) -> list[CaseResult]:
        """As :meth:`run`, with at most ``width`` cases at a time."""
        passed: dict[str, CaseResult] = {}
        first = self._runner.run(_sanity())
        self._begun = True
        execute(self._runner, _sanity(), cases, width, lambda case, result: passed.update({case.id: result}))
        left = [case for case in cases if case.id not in passed and case.id != SANITY]
        return [first, *passed.values(), *self.run(left)]

    def passive(self) -> Iterator[CaseResult]:
        """The invariants that did not hold while the cases were run."""
        for result in self._runner.session.passive.results("dcp-conformance run"):
            if result.verdict is Verdict.FAIL:
                yield result


def baseline(profile: str) -> Baseline:
    """Run everything against our node as it is."""
    begun = time.monotonic()
    suite = Suite(profile)
    results = list(suite.run(cases()))
    findings = tuple(
        finding_of(each)
        for each in (*results, *suite.passive())
        if each.verdict not in _FINE and not is_declared(each, _codec(profile).profile)
    )
    return Baseline(profile, len(results), findings, round(time.monotonic() - begun, 2))


def is_declared(result: CaseResult, profile: Profile) -> bool:
    """Whether a result says no more than what the profile itself declares, with a PICS that is silent."""
    failed = {each for check in result.checks if check.verdict is Verdict.FAIL for each in check.requirements}
    declared = {DECLARED: declared_by(profile), DENIED: denied_by(Capabilities(), profile)}.get(result.id)
    return bool(declared) and failed == set(declared or ())


def trials(
    mutant: Mutant, profiles: Sequence[str] | None = None, *, full: bool = False, every: bool = False
) -> list[Trial]:
    """Try ``mutant`` on each of ``profiles``, by default on one profile for each version that it is tried on.

    By default, ``full`` and ``every`` (as for :func:`trial`) hold for the newest version only. The case that killed it
    on one version is the first one on the next, where it mostly does so as well.
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
    """Run the cases that name a requirement of ``mutant`` until one kills it.

    ``every``: all of these cases; ``full``: the whole suite. ``profile`` is by default the mutant's own. ``first``:
    the case to begin with, if the others need not be run.
    """
    begun = time.monotonic()
    name = profile or mutant.profile
    named = [case for case in cases() if set(case.requirements) & set(mutant.requirements)]
    if first and not full and not every:
        named.sort(key=lambda case: case.id != first)
    killers: list[Finding] = []
    also: list[Finding] = []
    errors: list[Finding] = []
    count = candidates = 0
    try:
        suite = Suite(name, mutant.make)
    except ConformanceError as error:
        # It cannot even be talked to; a run would end here, with this message.
        return Trial(
            mutant.id, mutant.requirements, mutant.what, name, len(named), 0, (), (),
            (Finding("", Verdict.ERROR, reason=str(error)),), round(time.monotonic() - begun, 3),
        )  # fmt: skip
    for result in itertools.chain(suite.run(cases() if full else named), suite.passive()):
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
    """A result in short, with the requirements that its failed checks name."""
    failed = [check for check in result.checks if check.verdict is Verdict.FAIL]
    named = dict.fromkeys(each for check in failed for each in check.requirements)
    return Finding(result.id, result.verdict, tuple(named), result.reason)


def chosen(patterns: Sequence[str]) -> list[Mutant]:
    """The mutants that identifiers, requirements or globs of either mean; all without any.

    Raises :class:`UsageError` for a pattern that means none.
    """
    mutants = list(_mutants().values())
    if not patterns:
        return mutants
    found: dict[str, None] = {}
    for pattern in patterns:
        meant = [each.id for each in mutants if any(fnmatchcase(name, pattern) for name in (each.id, each.requirement))]
        if not meant:
            raise UsageError(
                f"no mutant is called {pattern!r}; 'dcp-conformance selftest --list' shows those there are"
            )
        found.update(dict.fromkeys(meant))
    return [each for each in mutants if each.id in found]


def _baseline_task(profile: str) -> Baseline:
    return baseline(profile)


def _trials_task(mutant: str, profiles: tuple[str, ...] | None, full: bool, every: bool) -> list[Trial]:
    # A mutant may fail in a service: that is an answer, and nobody needs to read its traceback.
    logging.getLogger("dcp_stack.control.server").setLevel(logging.CRITICAL)
    return trials(_mutants()[mutant], profiles, full=full, every=every)


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
    """Our node as it is, then each of ``mutants``. Raises :class:`UsageError` for a profile that there is not.

    ``profiles``: instead of those in :data:`PROFILES` for the node and one for each version for each mutant; a mutant
    is tried on those of them in whose version it is a fault. ``jobs``: processes, by default one for each processor.
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
    # Before the processes are forked, so that each of them has it.
    cases(), _mutants()
    with process_pool(jobs or os.cpu_count() or 1) as pool:
        waiting = [pool.submit(_baseline_task, profile) for profile in profiles or PROFILES]
        for done in as_completed(waiting):
            result = done.result()
            baselines[result.profile] = result
            if on_result is not None:
                on_result(result)
        tried = [
            pool.submit(_trials_task, each, names if profiles else None, full, every) for each, names in wanted.items()
        ]
        for each in as_completed(tried):
            for outcome in each.result():
                outcomes.setdefault(outcome.mutant, []).append(outcome)
                if on_result is not None:
                    on_result(outcome)
    return SelftestResult(
        started=started,
        duration=round(time.monotonic() - begun, 1),
        full=full,
        every=every or full,
        baselines=tuple(baselines[profile] for profile in profiles or PROFILES),
        mutants=tuple(outcome for each in wanted for outcome in outcomes[each]),
    )


def _profiles(mutant: Mutant, profiles: Sequence[str]) -> tuple[str, ...]:
    """Those of ``profiles`` on which a mutant is tried; by default one for each version."""
    if not profiles:
        return mutant.profiles
    return tuple(each for each in profiles if mutant.exists_in(_codec(each).profile.spec_version))


@contextmanager
def process_pool(jobs: int) -> Iterator[ProcessPoolExecutor]:
    """So many processes; at the end, what has not begun is dropped."""
    pool = ProcessPoolExecutor(jobs)
    try:
        yield pool
    finally:
        # What has not begun is not begun any more: on Ctrl-C nobody waits for the rest.
        pool.shutdown(cancel_futures=True)
