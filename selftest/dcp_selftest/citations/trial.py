"""Run the cases that name a requirement against the reference node with a change in the code that cites it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Final

import msgspec
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.errors import ConformanceError
from dcp_spec.catalogue.requirements import requirement
from dcp_spec.constants import SpecVersion

from dcp_selftest.generated.isolation import import_changed

from .changes import CodeChange


class Noticed(msgspec.Struct, frozen=True):
    """The effect of one change on the cases of some requirements."""

    by: dict[str, str]
    """By requirement: the case with a failed check that names it."""
    unusable: bool = False
    """Whether the node does not start, crashes, or fails the sanity case; many unrelated cases fail then."""


#: Maximum number of cases for each requirement and profile: if these do not detect a change, further ones hardly do.
_CASES: Final = 25


def try_change(change: CodeChange, names: Iterable[str]) -> Noticed:
    """Run the cases of the requirements ``names`` until the change is detected for each of them.

    The calling process must be new: it must not have imported ``dcp_stack``.
    """
    import_changed(change.module, compile(change.tree(), f"<changed {change.module}>", "exec"))
    noticed: dict[str, str] = {}
    unusable = False
    for profile, group in _profiles(names):
        open_names = [name for name in group if name not in noticed]
        if not open_names:
            continue
        try:
            unusable |= _run(profile, open_names, noticed)
        except ConformanceError:
            unusable = True
        except Exception:
            # The change makes the node raise an unexpected exception, possibly during its construction.
            unusable = True
    return Noticed(noticed, unusable)


def _run(profile: str, names: Sequence[str], noticed: dict[str, str]) -> bool:
    """Add the detecting cases on one profile to ``noticed``; return whether the sanity case failed or the node died."""
    from dcp_conformance.definitions.case import SANITY, all_cases
    from dcp_conformance.execution.selection import ordered

    from dcp_selftest.runner import Suite, finding_of

    unusable = False
    open_names = set(names)
    chosen: dict[str, None] = {}
    for name in names:
        deciding = [case.id for case in ordered(all_cases().values()) if name in case.requirements]
        chosen.update(dict.fromkeys(deciding[:_CASES]))
    for result in Suite(profile).run([all_cases()[each] for each in chosen]):
        if result.killed:
            # A crash is not evidence for a particular requirement.
            return True
        if result.verdict is not Verdict.FAIL:
            continue
        if result.id == SANITY and SANITY not in chosen:
            unusable = True
            continue
        for name in open_names.intersection(finding_of(result).requirements):
            noticed[name] = f"{result.id} ({profile})"
            open_names.discard(name)
        if not open_names:
            break
    return unusable


def _profiles(names: Iterable[str]) -> Iterator[tuple[str, list[str]]]:
    """Yield profiles with the requirements to try on them: the newest version of each requirement, then the oldest."""
    groups: dict[str, list[str]] = {}
    for newest in (True, False):
        for name in names:
            held = [version for version in SpecVersion if requirement(name).holds_in(version)]
            group = groups.setdefault(f"dcp-{(max if newest else min)(held)}", [])
            if name not in group:
                group.append(name)
    yield from groups.items()
