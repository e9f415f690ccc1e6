"""Choose the behaviour vectors that are published: one of each group of cases, and one for each requirement."""

from __future__ import annotations

import msgspec
from dcp_conformance.vectors.behaviour import BehaviourGroup, Vector


def selected(found: BehaviourGroup, kept: BehaviourGroup | None = None) -> BehaviourGroup:
    """Return the shortest vector of each group of cases that differ in a value only, the shortest for each requirement
    that is still without one, and those of ``kept``.
    """
    wanted = {each.tc_id for each in kept.tests} if kept is not None else set()
    by_size = sorted(found.tests, key=lambda each: (len(msgspec.json.encode(each)), each.tc_id))
    groups: dict[str, Vector] = {}
    for each in by_size:
        groups.setdefault(each.tc_id.rpartition("/")[2].partition("-")[0], each)
    wanted |= {each.tc_id for each in groups.values()}
    covered = {name for each in found.tests if each.tc_id in wanted for name in each.requirements}
    for each in by_size:
        if set(each.requirements) - covered:
            wanted.add(each.tc_id)
            covered |= set(each.requirements)
    return msgspec.structs.replace(found, tests=[each for each in found.tests if each.tc_id in wanted])


__all__ = ["selected"]
