"""Which cases need the implementation for themselves."""

from __future__ import annotations

import re
from typing import Final

from dcp_conformance.case import Case

ALONE: Final = frozenset(
    {
        "UT-Reset",
        "UT-Subscribe",
        "BP-MGMT-Activate",
        "BP-MGMT-Deactivate",
        "VD-MGMT-Activate",
        "VD-MGMT-Deactivate",
        "BP-SetParameter",
        "SRP-SetParameter",
        "VD-SetParameter",
    }
)
"""Services that change the implementation as a whole."""

_MEASURES: Final = ((r"TC_DCP_SANITY_.*", "it shows that the implementation is there"),)
"""Patterns of case identifiers, each with the reason."""
_PATTERNS: Final = tuple((re.compile(pattern), reason) for pattern, reason in _MEASURES)


def why_alone(case: Case) -> str:
    """Why the case cannot be executed beside others, in words; empty if it can."""
    if case.destructive:
        return "it may end the implementation"
    if case.needs.restart or case.needs.link:
        return "it restarts the implementation, or takes its link down"
    if methods := ALONE.intersection(case.needs.ut):
        return f"it calls {', '.join(sorted(methods))}"
    if case.long:
        return "it takes long"
    return next((reason for pattern, reason in _PATTERNS if pattern.fullmatch(case.id)), "")
