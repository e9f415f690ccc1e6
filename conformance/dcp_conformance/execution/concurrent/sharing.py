"""Rules on cases that cannot be executed side by side."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, Final

from dcp_spec.constants import ProtocolId

from dcp_conformance.model.case import Case

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

_CONFIGURED: Final = re.compile(r"TC_BP_(TX_TI|PAR|INI)_.*|TC_VD_SCR_TI_(09|16)")
"""Cases about the configured beacon period, and cases with repetitions that must outlast a timeout: with a short period
they would be over before it."""

_RELATIVE: Final = re.compile(r"TC_BP_(TX_TI_02|HDR_BV_10).*")
"""Cases that set the beacon period to a multiple or a fraction of the one in force, and restore that one."""

_FILLS: Final = "it fills payloads, and depends on the room in them"
_LISTENS: Final = "it judges the whole content of beacons"
_REPLACES: Final = "it deregisters SRP or VarDis"
_MEASURES: Final = (
    (r"TC_DCP_SANITY_.*", "it shows that the implementation answers"),
    (r"TC_VD_ROOM_.*", _FILLS),
    (r"TC_NET_CROWD_.*", _FILLS),
    (r"TC_VD_PAY_BV_(0[67]|12).*", _FILLS),
    (r"TC_VD_CMP_BV_(01|02|04.*|06|09|12|13|14|15).*", _FILLS),
    (r"TC_VD_SUM_BV_0[235].*", _FILLS),
    (r"TC_VD_SPLIT_BV_0[34]", _FILLS),
    (r"TC_VD_SCR_TI_15", _FILLS),
    (r"TC_VD_ID_BV_01-.*", _FILLS),
    (r"TC_VD_SCR_TI_(04|05|08|14).*", "it measures when a variable is deleted"),
    (r"TC_BP_RXP_BV_05-.*", _REPLACES),
    (r"TC_(SRP|VD)_SRV_BO_01", _REPLACES),
    (r"TC_SRP_(NT_TI_0[346]|RX_BO_02-.*)", "it shortens the timeout of neighbours"),
    (r"TC_SRP_NT_BV_04", "it fills the neighbour table"),
    (r"TC_SRP_NT_BV_06", "it needs an empty neighbour table"),
    (r"TC_BP_HDR_BV_(02|09|12)", _LISTENS),
    (r"TC_BP_FMT_BV_02", _LISTENS),
    (r"TC_BP_TX_(BV_03|TI_03)", _LISTENS),
    (r"TC_BP_QM_BV_06", _LISTENS),
    (r"TC_BP_RXP_BV_02", _LISTENS),
    (r"TC_VD_RUN_TI_01", _LISTENS),
    (r"TC_VD_ROB_BI_03-.*", "it sends records with random identifiers"),
)
_FAMILIES: Final = (
    (re.compile(r"TC_VD_ID_BV_01-.*"), "boundary values of identifiers"),
    # A receiver may take other octets of such a payload for a record, of a variable of another case.
    (re.compile(r"TC_VD_ROB_BI_0[12].*"), "malformed containers"),
)
"""Families: cases that are executed beside each other, but not beside other cases."""
_PATTERNS: Final = tuple((re.compile(pattern), reason) for pattern, reason in _MEASURES)


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
    return next((reason for pattern, reason in _PATTERNS if pattern.fullmatch(case.id)), "")


def family(case: Case) -> str:
    """Return the family of the case, which is executed beside its family only; empty without a family."""
    return next((name for pattern, name in _FAMILIES if pattern.fullmatch(case.id)), "")


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
