"""Which cases are run: by identifier, section, requirement or glob, in a plan, in their order."""

from __future__ import annotations

import difflib
import fnmatch
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib import resources

from dcp_spec.catalogue.requirements import UnknownRequirementError, requirement, requirements

from dcp_conformance.errors import UsageError
from dcp_conformance.model.case import SANITY, Case

PLANS = ("full", "smoke", "long")
"""``full``: all cases but those that take long; ``long``: those, too; ``smoke``: those that notice most
of the known faults in a few seconds."""


@dataclass(frozen=True, slots=True)
class Selection:
    """What a user asked for. Empty means everything."""

    patterns: tuple[str, ...] = ()
    """Identifiers of cases or requirements, or globs of them."""
    sections: tuple[str, ...] = ()
    """Parts of section headings, such as ``bp`` or ``receive path``; case does not matter."""
    requirements: tuple[str, ...] = ()
    exclude: tuple[str, ...] = ()
    """Identifiers of cases, or globs of them, that are left out."""
    plan: str = "full"
    first: frozenset[str] = frozenset()
    """Identifiers of cases that are run before the others; those that no longer exist are ignored."""
    only_first: bool = False
    """Whether no other cases are run."""


def select(cases: Mapping[str, Case], selection: Selection) -> list[Case]:
    """The cases that were asked for, in the order in which they are run.

    Raises :class:`UsageError` for a name that means nothing (with those it resembles), and if nothing is left.
    """
    chosen = list(cases.values())
    if selection.plan not in PLANS:
        raise UsageError(f"there is no plan {selection.plan!r}; there are {', '.join(PLANS)}")
    if selection.plan == "smoke":
        chosen = [case for case in chosen if case.smoke]
    elif selection.plan == "full":
        # Those that are named are meant, whatever the plan is.
        chosen = [case for case in chosen if not case.long or {case.id, case.base}.intersection(selection.patterns)]
    if selection.patterns:
        wanted = {case.id for pattern in selection.patterns for case in _matching(cases, pattern)}
        chosen = [case for case in chosen if case.id in wanted]
    for part in selection.sections:
        if not any(part.lower() in case.section.lower() for case in cases.values()):
            headings = sorted({case.section for case in cases.values()})
            near = difflib.get_close_matches(part, [*headings, *{each.partition(":")[0] for each in headings}], n=3)
            hint = f"did you mean {' or '.join(near)}?" if near else "'dcp-conformance list' shows those there are"
            raise UsageError(f"no section is called {part!r}; {hint}")
    if selection.sections:
        parts = [part.lower() for part in selection.sections]
        chosen = [case for case in chosen if any(part in case.section.lower() for part in parts)]
    if selection.requirements:
        ids = {each for pattern in selection.requirements for each in _requirements(pattern)}
        chosen = [case for case in chosen if ids.intersection(case.requirements)]
    excluded = {case.id for pattern in selection.exclude for case in _matching(cases, pattern)}
    chosen = [case for case in chosen if case.id not in excluded]
    if selection.only_first:
        chosen = [case for case in chosen if case.id in selection.first]
        if not chosen:
            raise UsageError(
                "none of the selected cases failed or was undecided in that report: there is nothing to run"
            )
    if not chosen:
        raise UsageError("no case is left to run; 'dcp-conformance list' shows those there are")
    return ordered(chosen, selection.first)


def left_out(cases: Mapping[str, Case], selection: Selection) -> list[Case]:
    """The cases that only the plan ``full`` has left out, because they take long. Raises as :func:`select`."""
    if selection.plan != "full":
        return []
    chosen = {case.id for case in select(cases, selection)}
    return [case for case in select(cases, replace(selection, plan="long")) if case.id not in chosen]


def ordered(cases: Iterable[Case], first: Collection[str] = ()) -> list[Case]:
    """The cases in the order in which they are run.

    The sanity case, then the identifiers in ``first``, cases about conformance, those about robustness; otherwise as
    they stand. Destructive cases are last in any case, those in ``first`` before the others.
    """
    return sorted(
        cases, key=lambda case: (case.base != SANITY, case.destructive, case.id not in first, case.robustness)
    )


def matches(case: Case, pattern: str) -> bool:
    """Whether a pattern means this case: its identifier, that of all its variants, or a glob of either."""
    return fnmatch.fnmatchcase(case.id, pattern) or fnmatch.fnmatchcase(case.base, pattern)


def _matching(cases: Mapping[str, Case], pattern: str) -> list[Case]:
    found = [case for case in cases.values() if matches(case, pattern)]
    if not found:
        ids = [each for each in requirements() if fnmatch.fnmatchcase(each, pattern)]
        found = [case for case in cases.values() if set(ids).intersection(case.requirements)]
        if ids and not found:
            raise UsageError(f"no case decides {', '.join(ids)}; docs/traceability.md says why")
    if not found:
        if pattern in retired():
            raise UsageError(f"the case {pattern} is retired: CHANGELOG.md says what has taken its place")
        names: Sequence[str] = list(dict.fromkeys((*cases, *(case.base for case in cases.values()), *requirements())))
        near = difflib.get_close_matches(pattern, names, n=3)
        hint = f"; did you mean {', '.join(near)}?" if near else "; 'dcp-conformance list' shows those there are"
        raise UsageError(f"no case is called {pattern!r}{hint}")
    return found


@cache
def retired() -> frozenset[str]:
    """The identifiers of cases that do not exist any more: reports of earlier runs still name them."""
    ledger = resources.files("dcp_conformance").joinpath("data", "case-ids.txt").read_text(encoding="utf-8")
    return frozenset(name for name, _, why in (line.partition(" ") for line in ledger.splitlines()) if why)


def _requirements(pattern: str) -> list[str]:
    found = [each for each in requirements() if fnmatch.fnmatchcase(each, pattern.upper())]
    if found:
        return found
    try:
        return [requirement(pattern).id]
    except UnknownRequirementError as error:
        raise UsageError(str(error)) from None
