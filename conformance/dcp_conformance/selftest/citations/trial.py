"""The cases that name a requirement, against our node with a change in the code that cites it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Final

import msgspec
from dcp_spec.catalogue.requirements import requirement
from dcp_spec.constants import SpecVersion

from dcp_conformance.errors import ConformanceError
from dcp_conformance.model.verdict import Verdict
from dcp_conformance.selftest.generated.isolation import import_changed

from .changes import CodeChange


class Noticed(msgspec.Struct, frozen=True):
    """What one change did to the cases of some requirements."""

    by: dict[str, str]
    """The case with a failed check that names the requirement, by requirement."""
    crippled: bool = False
    """Whether the node does not start, dies, or does not even pass the sanity case: then many cases fail."""


#: Cases per requirement and profile: a citation that dozens of cases do not notice stands in the wrong place.
_CASES: Final = 25


def try_change(change: CodeChange, names: Iterable[str]) -> Noticed:
    """Run the cases of requirements until each is noticed. For a new process that has not imported ``dcp_stack``."""
    import_changed(change.module, compile(change.tree(), f"<changed {change.module}>", "exec"))
    noticed: dict[str, str] = {}
    crippled = False
    for profile, group in _profiles(names):
        open_names = [name for name in group if name not in noticed]
        if not open_names:
            continue
        try:
            crippled |= _run(profile, open_names, noticed)
        except ConformanceError:
            crippled = True
        except Exception:
            # The change makes the node raise where nobody expects it.
            crippled = True
    return Noticed(noticed, crippled)


def _run(profile: str, names: Sequence[str], noticed: dict[str, str]) -> bool:
    """Add what the cases notice on one profile; whether the sanity case failed, or the node died."""
    from dcp_conformance.execution.selection import ordered
    from dcp_conformance.model.case import SANITY, all_cases
    from dcp_conformance.selftest.runner import Suite, finding_of

    crippled = False
    open_names = set(names)
    chosen: dict[str, None] = {}
    for name in names:
        deciding = [case.id for case in ordered(all_cases().values()) if name in case.requirements]
        chosen.update(dict.fromkeys(deciding[:_CASES]))
    for result in Suite(profile).run([all_cases()[each] for each in chosen]):
        if result.killed:
            # A death is no evidence of one requirement rather than another.
            return True
        if result.verdict is not Verdict.FAIL:
            continue
        if result.id == SANITY and SANITY not in chosen:
            crippled = True
            continue
        for name in open_names.intersection(finding_of(result).requirements):
            noticed[name] = f"{result.id} ({profile})"
            open_names.discard(name)
        if not open_names:
            break
    return crippled


def _profiles(names: Iterable[str]) -> Iterator[tuple[str, list[str]]]:
    """On which profiles to try which requirements: the newest version that has it first, then the oldest."""
    groups: dict[str, list[str]] = {}
    for newest in (True, False):
        for name in names:
            held = [version for version in SpecVersion if requirement(name).holds_in(version)]
            group = groups.setdefault(f"dcp-{(max if newest else min)(held)}", [])
            if name not in group:
                group.append(name)
    yield from groups.items()
