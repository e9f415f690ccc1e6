"""Notes about a run as a whole, each about several cases."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

#: Maximum number of cases that a note names; further ones are counted.
_NAMED: Final = 6


def executed_again(cases: Mapping[str, str]) -> str:
    """Return a note on cases that were executed again. ``cases``: by case, the disturbance of its first execution."""
    names = list(cases)
    if len(names) == 1:
        return f"{names[0]} was executed again, since the tester could not decide it: {cases[names[0]]}"
    first = f"in the first of them {cases[names[0]]}"
    return f"{len(names)} cases were executed again, since the tester could not decide them ({first}): {listed(names)}"


def left_changed(cases: Mapping[str, str]) -> str:
    """Return a note on cases whose changes could not be undone. ``cases`` has the reasons by case."""
    first = next(iter(cases))
    return (
        f"not all changes that were made in {listed(list(cases))} could be undone ({cases[first]}), and there is no "
        "command to restart the implementation (--restart): later cases may be affected"
    )


def deaths_alike(how: str, cases: Sequence[str]) -> str:
    """Return a note on cases in which the implementation ended in the same way (``how``: ``Loss.group``)."""
    kind, _, cause = how.partition(": ")
    if len(cases) == 1:
        return f"the implementation {kind} in {cases[0]} and was restarted"
    many = f"the implementation {kind} in {len(cases)} cases in the same way ({cause})"
    return f"{many}: {listed(cases)}; restarted each time"


def listed(names: Sequence[str], most: int = _NAMED) -> str:
    """Return the first ``most`` names, and the number of further ones."""
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")
