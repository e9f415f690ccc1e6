"""Sentences about a run as a whole: what several cases have in common, in one note."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

#: Cases that a note names; the others are counted.
_NAMED: Final = 6


def executed_again(cases: Mapping[str, str]) -> str:
    """Cases that were executed more than once, with what the tester did wrong in the first execution of each."""
    names = list(cases)
    if len(names) == 1:
        return f"{names[0]} was executed again, since the tester could not decide it: {cases[names[0]]}"
    first = f"in the first of them {cases[names[0]]}"
    return f"{len(names)} cases were executed again, since the tester could not decide them ({first}): {_listed(names)}"


def left_changed(cases: Mapping[str, str]) -> str:
    """Cases whose changes are still in force, with the reason for each."""
    first = next(iter(cases))
    return (
        f"not all that was changed in {_listed(list(cases))} could be changed back ({cases[first]}), and there is no "
        "command to restart the implementation (--restart): what follows may suffer from it"
    )


def deaths_alike(how: str, cases: Sequence[str]) -> str:
    """Name the cases in which the implementation ended in the same way (``how``: ``Loss.group``)."""
    kind, _, cause = how.partition(": ")
    if len(cases) == 1:
        return f"the implementation {kind} in {cases[0]} and was restarted"
    many = f"the implementation {kind} in {len(cases)} cases in the same way ({cause})"
    return f"{many}: {_listed(cases)}; restarted each time"


def _listed(cases: Sequence[str]) -> str:
    """The first of some cases, and how many more there are."""
    return ", ".join(cases[:_NAMED]) + (f" and {len(cases) - _NAMED} more" if len(cases) > _NAMED else "")
