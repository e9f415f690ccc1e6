"""Run the suite against permitted variants, to find cases that fail a permitted implementation."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterable, Sequence
from typing import Final

import msgspec
from dcp_conformance.definitions.case import Case, all_cases
from dcp_conformance.definitions.results import CaseResult, timestamp
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.execution.runner import Runner
from dcp_conformance.execution.selection import ordered
from dcp_conformance.reference.surroundings import Tested
from dcp_conformance.test_system.bench import Session
from dcp_spec.version import __version__

from dcp_selftest.runner import PROFILES, Finding, finding_of, in_processes, is_declared

from .variant import Variant, all_variants, codec_of

SCHEMA: Final = "dcp-conformance-variants/1"
_FINE: Final = frozenset({Verdict.PASS, Verdict.INFO, Verdict.NOT_APPLICABLE})


class Judged(msgspec.Struct, frozen=True):
    """The outcome of the suite for one variant on one profile."""

    variant: str
    profile: str
    what: str
    why: str
    cases: int
    """Number of applicable cases."""
    passed: int
    """Number of cases with the verdict pass or info."""
    fails: tuple[Finding, ...]
    inconclusive: tuple[Finding, ...]
    """Inconclusive verdicts without an explanation."""
    explained: int
    """Number of unavoidable inconclusive verdicts, and of fails that the profile itself declares."""
    errors: tuple[Finding, ...]
    """Cases with the verdict error; one finding without a case if the set-up could not be tested."""
    seconds: float
    """Processor time."""
    used: tuple[str, ...] = ()
    """The expressions of the variant that explained an inconclusive verdict."""

    @property
    def good(self) -> bool:
        """Whether the variant got no fail, error or unexplained inconclusive verdict."""
        return not (self.fails or self.inconclusive or self.errors)


class VariantsResult(msgspec.Struct, frozen=True, kw_only=True):
    """The content of ``variants.json``."""

    schema: str = SCHEMA
    tool: str = f"dcp-conformance {__version__}"
    started: str = ""
    """ISO 8601, UTC."""
    duration: float = 0.0
    """Seconds."""
    trials: tuple[Judged, ...] = ()

    def idle(self, variants: Iterable[Variant]) -> dict[str, list[str]]:
        """Return the expressions that explained no verdict, by variant.

        Variants that were not judged on all of their profiles are left out.
        """
        used = {(each.variant, one) for each in self.trials for one in each.used}
        tried = {(each.variant, each.profile) for each in self.trials}
        whole = [each for each in variants if tried >= {(each.id, profile) for _, profile in trials_of([each])}]
        idle = {each.id: [one for one in each.explains if (each.id, one) not in used] for each in whole}
        return {name: found for name, found in idle.items() if found}

    def exit_status(self) -> int:
        """Return 4 after an error of the tester, 1 after a fail or unexplained inconclusive verdict, else 0."""
        if any(each.errors for each in self.trials):
            return 4
        return 0 if all(each.good for each in self.trials) else 1


def judge(variant: Variant, profile: str, cases: Sequence[Case] | None = None) -> Judged:
    """Run the sanity case and then ``cases``, by default the whole suite, against a variant on a profile.

    An exception that prevents the test is stored in the outcome, not raised.
    """
    began = time.process_time()
    count = passed = explained = 0
    fails: list[Finding] = []
    unexplained: list[Finding] = []
    errors: list[Finding] = []
    used: dict[str, None] = {}
    try:
        results = _results(variant, profile, cases)
    except Exception as error:
        # A node that cannot be made or reached must not end the campaign.
        results = []
        errors.append(Finding("", Verdict.ERROR, reason=f"the node cannot be tested: {type(error).__name__}: {error}"))
    for result in results:
        count += result.verdict is not Verdict.NOT_APPLICABLE
        if result.verdict in _FINE:
            passed += result.verdict is not Verdict.NOT_APPLICABLE
        elif result.verdict is Verdict.FAIL and is_declared(result, codec_of(profile).profile):
            explained += 1
        elif result.verdict is Verdict.FAIL:
            fails.append(finding_of(result))
        elif result.verdict is Verdict.ERROR:
            errors.append(finding_of(result))
        elif reason := variant.explanation(result.id, result.reason):
            explained += 1
            used[reason] = None
        else:
            unexplained.append(finding_of(result))
    return Judged(
        variant.id,
        profile,
        variant.what,
        variant.why,
        count,
        passed,
        tuple(fails),
        tuple(unexplained),
        explained,
        tuple(errors),
        round(time.process_time() - began, 2),
        tuple(used),
    )


def _results(variant: Variant, profile: str, cases: Sequence[Case] | None) -> list[CaseResult]:
    """Run the cases; return the last result of each, in the order of the run, and the passive rules that failed."""
    setup = variant.build(profile)
    sut = Tested(setup) if setup.surroundings is None else setup.surroundings(setup)
    session = Session(setup.config.codec, sut.lower_tester(), sut.connection(setup.upper), setup.pics)
    runner = Runner(session, sut)
    runner.prepare()
    found: dict[str, CaseResult] = {}
    # The sanity case is the first one of an ordered suite.
    for case in ordered(all_cases().values() if cases is None else cases):
        found[case.id] = runner.run(case)
        found.update({each.id: each for each in runner.take_revised()})
    runner.finish()
    found.update({each.id: each for each in runner.take_revised()})
    invariants = session.passive.results("dcp-conformance run")
    return [*found.values(), *(each for each in invariants if each.verdict is Verdict.FAIL)]


def _task(task: tuple[str, str]) -> Judged:
    variant, profile = task
    # Without garbage collection a run is faster by a twelfth, and hardly any of its objects are in cycles.
    gc.disable()
    try:
        return judge(all_variants()[variant], profile)
    finally:
        gc.enable()
        gc.collect()


def trials_of(variants: Sequence[Variant], profiles: Sequence[str] = ()) -> list[tuple[Variant, str]]:
    """Return the pairs of variants and profile names that apply to each other, of ``profiles`` or of all PROFILES."""
    return [(each, profile) for each in variants for profile in profiles or PROFILES if each.applies_to(profile)]


def run(
    variants: Sequence[Variant],
    *,
    profiles: Sequence[str] = (),
    jobs: int | None = None,
    on_start: Callable[[int], None] | None = None,
    on_result: Callable[[Judged], None] | None = None,
) -> VariantsResult:
    """Judge each variant on every profile that it applies to, in ``jobs`` processes (default: one per processor).

    ``on_start`` is called with the number of pairs, and ``on_result`` with each outcome.
    """
    began, started = time.monotonic(), timestamp()
    pairs = trials_of(variants, profiles)
    if on_start is not None:
        on_start(len(pairs))
    # Load the cases and variants before the processes are forked: all of them share these.
    all_cases(), all_variants()
    judged: dict[tuple[str, str], Judged] = {}
    for _, outcome in in_processes(_task, [(each.id, profile) for each, profile in pairs], jobs):
        judged[outcome.variant, outcome.profile] = outcome
        if on_result is not None:
            on_result(outcome)
    return VariantsResult(
        started=started,
        duration=round(time.monotonic() - began, 1),
        trials=tuple(judged[each.id, profile] for each, profile in pairs),
    )
