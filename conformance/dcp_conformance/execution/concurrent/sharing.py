"""Rules on cases that cannot be executed side by side."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, Final

from dcp_spec.constants import ProtocolId

from dcp_conformance.definitions.case import SANITY, Case

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

_CONFIGURED: Final = re.compile(r"TC_BP_(TX_TI|PAR|INI)_.*|TC_VD_SCR_TI_(09|16|24)")
"""Cases about the configured beacon period, and cases with repetitions that must outlast a timeout: with a short period
they would be over before it."""

_RELATIVE: Final = re.compile(r"TC_BP_(TX_TI_02|HDR_BV_10).*")
"""Cases that set the beacon period to a multiple or a fraction of the one in force, and restore that one."""


def why_alone(case: Case) -> str:
    """Return why the case cannot be executed beside others; empty if it can.

    Destructive cases can be executed beside each other if the implementation can be restarted.
    """
    if case.needs.restart or case.needs.link:
        return "it restarts the implementation, or takes its link down"
    if methods := ALONE.intersection(case.needs.ut):
        return f"it calls {', '.join(sorted(methods))}"
    if case.long:
        return "it takes long"
    if case.id == SANITY:
        return "it shows that the implementation answers"
    return case.alone


def at_short_period(case: Case) -> bool:
    """Return whether the case can be executed with a shorter beacon period without an effect on its verdict."""
    needs = case.needs
    if _RELATIVE.fullmatch(case.id):
        return True
    if needs.restart or needs.link or case.long or case.destructive or "BP-SetParameter" in needs.ut:
        return False
    if _CONFIGURED.fullmatch(case.id):
        return False
    # A reset restores the configured period. Cases with VD-SetParameter need it only to restore the parameter.
    return "UT-Reset" not in needs.ut or "VD-SetParameter" in needs.ut


def forbidden(method: str, params: Mapping[str, Any]) -> str:
    """Return why a case must not call a service with these parameters while others are executed; empty if it may."""
    if method in ALONE:
        return f"{method} changes the implementation as a whole"
    if method == "BP-DeregisterProtocol" and params.get("protId") in (ProtocolId.SRP, ProtocolId.VARDIS):
        return "other cases need the registrations of SRP and VarDis"
    return ""


def group(case: Case) -> str:
    """Return the group of the case, of which only one case is executed at a time; empty without a group."""
    return "safety data" if "SRP-UpdateSafetyData" in case.needs.ut else ""
