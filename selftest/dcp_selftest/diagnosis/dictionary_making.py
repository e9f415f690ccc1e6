"""Make the fault dictionary: run the whole suite against each mutant."""

from __future__ import annotations

import signal
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple, NoReturn

from dcp_conformance.definitions.case import SANITY
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.diagnosis.dictionary import Dictionary, Fault
from dcp_conformance.diagnosis.observation import observations

from dcp_selftest.mutants import Mutant, all_mutants
from dcp_selftest.runner import Suite, cases, in_processes

#: Limit of the processor time for each mutant, in seconds. A mutant that crashes in every case would take minutes; its
#: signature is then the set of cases that failed until the limit.
_PATIENCE: Final = 60


class _OutOfTimeError(BaseException):
    """The processor time is used up. Not an ``Exception``, so that no case catches it as a finding."""


class Outcome(NamedTuple):
    """The signature of a mutant."""

    fault: Fault
    complete: bool
    """Whether all cases were executed within the limit of processor time."""


def make(
    mutants: Sequence[Mutant], *, jobs: int | None = None, on_result: Callable[[Outcome], None] = lambda _: None
) -> Dictionary:
    """Run every case against each mutant, on the newest version that it affects; return the fault dictionary.

    ``jobs`` is the number of processes, by default one for each processor. ``on_result`` is called with each outcome.
    """
    found: list[Fault] = []
    for _, outcome in in_processes(_task, [each.id for each in mutants], jobs):
        found.append(outcome.fault)
        on_result(outcome)
    return Dictionary(tuple(sorted(found, key=lambda fault: fault.id)))


def _task(name: str) -> Outcome:
    return signature(all_mutants()[name])


def signature(mutant: Mutant) -> Outcome:
    """Run every case against the mutant, and return its signature."""
    verdicts: dict[str, Verdict] = {}
    observed: set[tuple[str, str]] = set()
    before = signal.signal(signal.SIGPROF, _out_of_time)
    signal.setitimer(signal.ITIMER_PROF, _PATIENCE)
    complete = False
    try:
        for result in Suite(mutant.profile, mutant.make).run(cases(mutant.requirements)):
            verdicts[result.id] = result.verdict
            if result.verdict is Verdict.FAIL and result.id != SANITY:
                observed.update((result.id, digest) for digest in observations(result))
        complete = True
    except _OutOfTimeError:
        pass
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)
    verdicts.pop(SANITY, None)
    fault = Fault(
        id=mutant.id,
        requirements=mutant.requirements,
        what=mutant.what,
        fails=frozenset(case for case, verdict in verdicts.items() if verdict is Verdict.FAIL),
        undecided=frozenset(case for case, verdict in verdicts.items() if verdict is Verdict.INCONCLUSIVE),
        observed=frozenset(observed),
    )
    return Outcome(fault, complete)


def _out_of_time(*_: object) -> NoReturn:
    raise _OutOfTimeError
