"""Statuses of the services of VarDis in every state (dcp-vardis.md: Application Service Interface)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final, NamedTuple

from dcp_spec.constants import Features, SpecVersion

from .judgement import Expected
from .knowledge import Limits, State

#: Each service, with the number of its requirement about an inactive VarDis and about an unknown variable.
_GROUPS: Final = {
    "RTDB-Create": "CRE", "RTDB-Delete": "DEL", "RTDB-Update": "UPD", "RTDB-Read": "REA",
    "RTDB-DescribeDatabase": "DDB", "RTDB-DescribeVariable": "DVA",
}  # fmt: skip
_P: Final = "VARDIS-STATUS-"
OK: Final = f"{_P}OK"
#: By the beginning of a status that refuses a request: the number of its requirement in each group.
_REFUSING: Final[dict[str, dict[str, str]]] = {
    "VARIABLE-EXISTS": {"CRE": "02"}, "VARIABLE-DESCRIPTION-TOO-LONG": {"CRE": "04"},
    "VALUE-TOO-LONG": {"CRE": "05", "UPD": "05"}, "EMPTY-VALUE": {"CRE": "06", "UPD": "06"},
    "ILLEGAL-REPCOUNT": {"CRE": "07"}, "VARIABLE-DOES-NOT-EXIST": {"DEL": "02", "UPD": "02", "REA": "02", "DVA": "02"},
    "NOT-PRODUCER": {"DEL": "03", "UPD": "03"}, "VARIABLE-IS-DELETED": {"DEL": "04", "UPD": "04", "REA": "03"},
}  # fmt: skip


class Situation(NamedTuple):
    """A state in which a variable may be when a service is called."""

    state: State
    own: bool


def expected(
    method: str,
    params: Mapping[str, Any],
    situations: Iterable[Situation],
    limits: Limits,
    features: Features,
    *,
    active: bool,
) -> list[Expected]:
    """Return the statuses that a service may answer in one of these situations; empty for an unknown service."""
    group = _GROUPS.get(method)
    if method in ("VD-MGMT-Activate", "VD-MGMT-Deactivate"):
        return [Expected(OK, "VD-MGT-05" if method.endswith("-Activate") else "VD-MGT-01")]
    if group is None:
        return []
    if not active:
        return [Expected(f"{_P}INACTIVE", f"VD-{group}-01"), Expected("", "X30")]
    if group == "DDB":
        return [Expected(OK, "VD-DDB-02")]
    found = [each for one in situations for each in _in(one, group, params, limits, features)]
    return list(dict.fromkeys(found))


def refused_by(method: str, status: str) -> tuple[str, ...]:
    """Return the requirement that decides when a service refuses a request with a status; empty for others."""
    group = _GROUPS.get(method, "")
    number = _REFUSING.get(status.removeprefix(_P), {}).get(group)
    return () if number is None else (f"VD-{group}-{number}",)


def _in(one: Situation, group: str, params: Mapping[str, Any], limits: Limits, features: Features) -> list[Expected]:
    old = features.removed_after_deletion
    if group == "CRE":
        return _creating(one, params, limits, features)
    unknown = Expected(f"{_P}VARIABLE-DOES-NOT-EXIST", f"VD-{group}-02")
    if one.state == "unknown":
        return [unknown]
    # Up to 1.3 a deleted variable may be gone already.
    gone = [unknown] if old and one.state == "deleted" else []
    if group == "DVA":
        return [Expected(OK, "VD-DVA-03"), *gone]
    if group in ("DEL", "UPD") and not one.own:
        return [Expected(f"{_P}NOT-PRODUCER", f"VD-{group}-03"), *gone]
    if one.state == "deleted":
        number = {"DEL": ("09", "04"), "UPD": ("12", "04"), "REA": ("06", "03")}[group][0 if old else 1]
        status = "VARIABLE-BEING-DELETED" if old else "VARIABLE-IS-DELETED"
        return [Expected(_P + status, f"VD-{group}-{number}"), *gone]
    if group == "UPD":
        length = len(params["value"]) // 2
        if length > limits.max_value_length:
            return [Expected(f"{_P}VALUE-TOO-LONG", "VD-UPD-05")]
        if not length:
            return [Expected(_empty(features), "VD-UPD-06")]
        return [Expected(OK, "VD-UPD-08")]
    return [Expected(OK, {"DEL": "VD-DEL-05", "REA": "VD-REA-04"}[group])]


def _creating(one: Situation, params: Mapping[str, Any], limits: Limits, features: Features) -> list[Expected]:
    if one.state != "unknown" and not features.creation_time:
        found = [Expected(f"{_P}VARIABLE-EXISTS", "VD-CRE-16")]
        return found + (_checks(params, limits, features) if one.state == "deleted" else [])
    if one.state == "unknown":
        return _checks(params, limits, features)
    checks, taken = _checks(params, limits, features), Expected(f"{_P}VARIABLE-EXISTS", "VD-CRE-02")
    if one.own:
        # X20: by the description, a living variable cannot be created again.
        checks = [Expected(each.status, "VD-CRE-03" if each.status == OK else each.requirement) for each in checks]
        return [*checks, taken._replace(requirement="X20")] if one.state == "alive" else checks
    # X20: by the description, a deleted variable of another node can be created again.
    return [taken, *(each._replace(requirement="X20") for each in checks if one.state == "deleted")]


def _checks(params: Mapping[str, Any], limits: Limits, features: Features) -> list[Expected]:
    """Return the possible results of the checks of the parameters of RTDB-Create (VD-CRE-13)."""
    described, length = len(params["descr"].encode()), len(params["value"]) // 2
    too_long = f"{_P}VARIABLE-DESCRIPTION-TOO-LONG"
    if described > limits.max_description_length:
        return [Expected(too_long, "VD-CRE-04")]
    if length > limits.max_value_length:
        found = Expected(f"{_P}VALUE-TOO-LONG", "VD-CRE-05")
    elif not length:
        found = Expected(_empty(features), "VD-CRE-06")
    elif not 0 < params["repCnt"] <= limits.max_repetitions:
        found = Expected(f"{_P}ILLEGAL-REPCOUNT", "VD-CRE-07")
    else:
        found = Expected(OK, "VD-CRE-12" if described else "VD-CRE-15")
    # X21: an implementation may refuse an empty description, before or after the other checks.
    return [found] if described else [found, Expected(too_long, "VD-CRE-15")]


def _empty(features: Features) -> str:
    return f"{_P}{'INVALID' if features.version < SpecVersion.V1_1 else 'EMPTY'}-VALUE"
