"""Selection and order of the cases of a run: by identifier, glob, section, requirement and plan."""

from __future__ import annotations

import difflib
import fnmatch
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from importlib import resources

from dcp_spec.catalogue.requirements import requirements

from dcp_conformance.definitions.case import SANITY, Case
from dcp_conformance.definitions.registry import unknown
from dcp_conformance.errors import UsageError

PLANS = ("full", "smoke", "long")
"""``full``: all cases except those that take long; ``long``: all cases; ``smoke``: the cases that detect most of the
known faults in a few seconds."""


@dataclass(frozen=True, slots=True)
class Selection:
    """The selection of a user. Without any criterion, all cases of the plan are selected."""

    patterns: tuple[str, ...] = ()
    """Identifiers of cases or requirements, or globs of them."""
    sections: tuple[str, ...] = ()
    """Parts of section headings, such as ``bp`` or ``receive path``, in upper or lower case."""
    exclude: tuple[str, ...] = ()
    """Identifiers of cases, or globs of them, that are left out."""
    plan: str = "full"
    """One of :data:`PLANS`."""
    only: frozenset[str] | None = None
    """Identifiers of the cases to which the selection is restricted; unknown ones are ignored."""


def select(cases: Mapping[str, Case], selection: Selection) -> list[Case]:
    """Return the selected cases in the order of execution.

    Raise :class:`UsageError` for an unknown name (with similar names), and if no case is left.
    """
    chosen = list(cases.values())
    if selection.plan not in PLANS:
        raise UsageError(f"unknown plan {selection.plan!r}; the plans are {', '.join(PLANS)}")
    if selection.plan == "smoke":
        chosen = [case for case in chosen if case.smoke]
    elif selection.plan == "full":
        # A case that the user names is executed, although the plan does not have it.
        chosen = [case for case in chosen if not case.long or {case.id, case.base}.intersection(selection.patterns)]
    if selection.patterns:
        wanted = {case.id for pattern in selection.patterns for case in _matching(cases, pattern)}
        chosen = [case for case in chosen if case.id in wanted]
    for part in selection.sections:
        if not any(part.lower() in case.section.lower() for case in cases.values()):
            headings = sorted({case.section for case in cases.values()})
            near = difflib.get_close_matches(part, [*headings, *{each.partition(":")[0] for each in headings}], n=3)
            hint = f"did you mean {' or '.join(near)}?" if near else "'dcp-conformance list' shows the sections"
            raise UsageError(f"no section is called {part!r}; {hint}")
    if selection.sections:
        parts = [part.lower() for part in selection.sections]
        chosen = [case for case in chosen if any(part in case.section.lower() for part in parts)]
    excluded = {case.id for pattern in selection.exclude for case in _matching(cases, pattern)}
    chosen = [case for case in chosen if case.id not in excluded]
    if selection.only is not None:
        chosen = [case for case in chosen if case.id in selection.only]
        if not chosen:
            raise UsageError(
                "none of the selected cases failed or was undecided in that report: there is nothing to run"
            )
    if not chosen:
        raise UsageError("no case is left to run; 'dcp-conformance list' shows the cases")
    return ordered(chosen)


def left_out(cases: Mapping[str, Case], selection: Selection) -> list[Case]:
    """Return the cases that the plan ``full`` leaves out because they take long. Raise the errors of :func:`select`."""
    if selection.plan != "full":
        return []
    chosen = {case.id for case in select(cases, selection)}
    return [case for case in select(cases, replace(selection, plan="long")) if case.id not in chosen]


def ordered(cases: Iterable[Case]) -> list[Case]:
    """Return the cases in the order of execution.

    The sanity case comes first, then cases on conformance, cases on robustness, and destructive cases. Otherwise the
    order of ``cases`` is kept.
    """
    return sorted(cases, key=lambda case: (case.base != SANITY, case.destructive, case.robustness))


def matches(case: Case, pattern: str) -> bool:
    """Return whether a pattern is the identifier of the case or that of all its variants, or a glob of either."""
    return fnmatch.fnmatchcase(case.id, pattern) or fnmatch.fnmatchcase(case.base, pattern)


def _matching(cases: Mapping[str, Case], pattern: str) -> list[Case]:
    found = [case for case in cases.values() if matches(case, pattern)]
    if not found:
        ids = [each for each in requirements() if fnmatch.fnmatchcase(each, pattern)]
        found = [case for case in cases.values() if set(ids).intersection(case.requirements)]
        if ids and not found:
            raise UsageError(f"no case decides {', '.join(ids)}; docs/traceability.md has the reason")
    if not found:
        if pattern in retired():
            raise UsageError(f"the case {pattern} is retired: CHANGELOG.md names its replacement")
        names = (*cases, *(case.base for case in cases.values()), *requirements())
        raise unknown("case", pattern, names, "dcp-conformance list")
    return found


@cache
def retired() -> frozenset[str]:
    """Return the identifiers of removed cases, which reports of earlier runs still name."""
    ledger = resources.files("dcp_conformance").joinpath("data", "case-ids.txt").read_text(encoding="utf-8")
    return frozenset(name for name, _, why in (line.partition(" ") for line in ledger.splitlines()) if why)
