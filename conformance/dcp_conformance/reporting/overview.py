"""Summarise a run in a few sentences, for the page and for the terminal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import NamedTuple

from dcp_spec.catalogue.readings import differs_from_reference, readings, with_reference_reading

from dcp_conformance.definitions.results import CaseResult, Probable, RunResult
from dcp_conformance.definitions.survival import SURVIVAL, bad_checks, only_died
from dcp_conformance.definitions.verdict import Verdict

#: Maximum number of cases that a sentence lists.
_NAMED = 6


def headline(run: RunResult) -> str:
    """Return the headline of a run: the numbers of requirements that pass, fail, and have another verdict."""
    count = Counter(run.requirements.values())
    passed, failed = count[Verdict.PASS], count[Verdict.FAIL]
    if not passed and not failed:
        text = "No requirement was decided"
    else:
        one = "requirement passes" if passed == 1 else "requirements pass"
        text = f"{passed} {one}, {failed or 'none'} {'fails' if failed < 2 else 'fail'}"
        found = run.diagnosis
        if found is not None and (faults := len(found.faults)):
            probable = f"{faults} probable fault{'' if faults == 1 else 's'}"
            if found.unexplained or found.ended:
                explained = found.failed - len(found.unexplained) - len(found.ended)
                text += f"; {probable} explain{'s' if faults == 1 else ''} {explained} of {found.failed} failed cases"
            else:
                text += f", explained by {probable}"
    others = {
        Verdict.INCONCLUSIVE: "inconclusive",
        Verdict.ERROR: "in error",
        Verdict.INFO: "only reported",
        Verdict.TOO_LITTLE: "seen too rarely to decide",
    }
    more = [f"{count[each]} {_are(count[each])} {word}" for each, word in others.items() if count[each]]
    return "; ".join(filter(None, [text, *more, undecided_deaths(run)]))


def diagnosed(run: RunResult) -> str:
    """Return a sentence with the numbers of probable faults and of failures they explain; empty if no case failed."""
    found = run.diagnosis
    if found is None or not found.failed:
        return ""
    failed = f"{found.failed} case{'' if found.failed == 1 else 's'}"
    ended = f"in {len(found.ended)} the implementation only ended or stopped answering" if found.ended else ""
    if not found.faults:
        text = f"{failed} failed; no known fault explains {'it' if found.failed == 1 else 'them'}"
        return "; ".join(filter(None, [text, ended]))
    explained = found.failed - len(found.unexplained) - len(found.ended)
    faults = f"{len(found.faults)} probable fault{'' if len(found.faults) == 1 else 's'}"
    text = f"{faults} explain{'s' if len(found.faults) == 1 else ''} {explained} of {failed} that failed"
    left = len(found.unexplained)
    unexplained = f"{left} {_are(left)} unexplained" if left else ""
    return "; ".join(filter(None, [text, ended, unexplained]))


def stated(run: RunResult) -> str:
    """Return what the sanity case states by itself: a fault from which most others follow; empty without any."""
    check = run.diagnosis.stated if run.diagnosis is not None else None
    return f"first of all: expected {check.expected}; observed {check.observed}" if check is not None else ""


def sentence(fault: Probable) -> str:
    """Return what a probable fault says about the implementation.

    It names the requirement as a fact only if all failures agree with the fault. The behaviour is always "probable": a
    fault that is not in the dictionary can fail the same cases with the same observations. If fewer than half of the
    cases agree, the sentence contains only which cases fail that also fail for a node with the fault.
    """
    if fault.certain:
        return f"the implementation violates {', '.join(violated(fault))}: it probably {fault.what}"
    if fault.likely:
        return f"the implementation probably {fault.what}"
    if len(fault.explains) == 1:
        text = f"{fault.explains[0]} fails, as it does for a node that {fault.what}"
    else:
        text = f"{len(fault.explains)} cases fail that also fail for a node that {fault.what}"
    contrary = []
    if not fault.alike:
        contrary.append("the observation differs")
    elif fault.alike < len(fault.explains):
        contrary.append(f"the observation differs in {len(fault.explains) - fault.alike} of them")
    if fault.missing:
        contrary.append(f"{len(fault.missing)} that should fail passed")
    return f"{text}, but {' and '.join(contrary)}" if contrary else text


def violated(fault: Probable) -> tuple[str, ...]:
    """Return the requirements of the fault that its best failed check names; without any, all of them."""
    named = () if fault.check is None else fault.check.requirements
    return tuple(each for each in named if each in fault.requirements) or fault.requirements


def certainty(fault: Probable) -> str:
    """Return how well the failures of a run fit a fault, as a sentence without its subject."""
    hits = fault.expected - len(fault.missing)
    text = f"explains {len(fault.explains)} failed case{'' if len(fault.explains) == 1 else 's'}"
    if fault.expected:
        text += f"; of {fault.expected} decided cases that fail for a node with only this fault, {hits} failed here"
    if fault.alike < len(fault.explains):
        text += f"; what was observed is the same in {fault.alike} of {len(fault.explains)} cases"
    if len(fault.explains) == 1:
        text += "; another fault that only this case shows is as likely"
    return text


def _are(count: int) -> str:
    return "is" if count == 1 else "are"


class Death(NamedTuple):
    """Cases in which the implementation ended or stopped answering in the same way, and nothing else failed."""

    how: str
    cases: tuple[CaseResult, ...]


def deaths(run: RunResult) -> list[Death]:
    """Return how the implementation ended or stopped answering in several cases, the most frequent first."""
    found: dict[str, list[CaseResult]] = {}
    for case in run.cases:
        if case.killed and case.death and only_died(case):
            found.setdefault(case.death, []).append(case)
    groups = [Death(how, tuple(cases)) for how, cases in found.items() if len(cases) > 1]
    return sorted(groups, key=lambda group: -len(group.cases))


def undecided_deaths(run: RunResult) -> str:
    """Return a sentence with the cases that the implementation did not survive and no requirement decides, or ""."""
    cases = [
        case.id
        for case in run.cases
        if any(check.expected.startswith(SURVIVAL) and not check.requirements for check in bad_checks(case))
    ]
    if not cases:
        return ""
    listed = ", ".join(cases[:_NAMED]) + (f" and {len(cases) - _NAMED} more" if len(cases) > _NAMED else "")
    many = "1 case" if len(cases) == 1 else f"{len(cases)} cases"
    return f"the implementation did not survive {many}, which no requirement decides: {listed}"


class Reading(NamedTuple):
    """A disputed text of the specification, and the readings of it that were observed."""

    id: str
    title: str
    observed: tuple[str, ...]
    """The observed readings. One that differs from the reference reading is followed by the latter."""
    differs: bool
    """Whether an observed reading differs from the reference reading of this kit."""
    named: bool
    """Whether ``observed`` contains names of readings; otherwise it contains sentences."""


def observed_readings(run: RunResult) -> Iterator[Reading]:
    """Yield the disputed texts of which a reading was observed, in the order of the results."""
    known = readings()
    for identifier, observed in run.readings.items():
        entry = known.get(identifier)
        if entry is None:
            continue
        names = {each.name for each in entry.alternatives}
        differs = any(differs_from_reference(identifier, each) for each in observed)
        shown = tuple(with_reference_reading(identifier, each) for each in observed)
        yield Reading(identifier, entry.title, shown, differs, bool(names.intersection(observed)))
