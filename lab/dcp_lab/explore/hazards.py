"""The hazards of the catalogue (``dcp_spec.catalogue.readings``) that the violations of an exploration are."""

from __future__ import annotations

from typing import Final, NamedTuple

from dcp_spec.constants import SpecVersion

from .search import Violation


class Sign(NamedTuple):
    """How a hazard shows: a violated property whose cause has the kinds of events ``needs``.

    ``until``: the last version for which the row applies, None for all.
    """

    hazard: str
    name: str
    needs: frozenset[str] = frozenset()
    until: SpecVersion | None = None


def _sign(hazard: str, name: str, needs: str = "", until: SpecVersion | None = None) -> Sign:
    return Sign(hazard, name, frozenset(needs.split()), until)


#: The first row that fits a violation names its hazard.
_SIGNS: Final = (
    *(
        _sign("H5", name, "clock")
        for name in ("stale-creation", "older-value", "taken-over", "split", "missing", "refused")
    ),
    _sign("H13", "unstable"),
    _sign("H1", "no-answer"),
    _sign("H2", "orphaned"),
    _sign("H2", "refused", "restart"),
    _sign("H11", "spread"),
    _sign("H11", "refused", "delete"),
    _sign("H10", "undeleted"),
    _sign("H3", "deleted", "silence"),
    _sign("H3", "deleted", "other delete"),
    _sign("H7", "deleted", "again"),
    _sign("H4", "taken-over"),
    _sign("H12", "split"),
    _sign("H12", "older-value", "other", until=SpecVersion.V1_3),
    _sign("H12", "stale-creation", "other", until=SpecVersion.V1_3),
    _sign("H6", "older-value", "restart", until=SpecVersion.V1_3),
    _sign("H6", "stale-creation", "restart", until=SpecVersion.V1_3),
    _sign("H8", "older-value", "again"),
    _sign("H8", "older-value", "other"),
    _sign("H8", "stale-creation", "other update"),
    _sign("H7", "stale-creation", "again"),
    _sign("H9", "stale", "update"),
    _sign("H9", "older-value", "update"),
    _sign("H9", "refused", "update"),
)


def hazard_of(violation: Violation, version: SpecVersion) -> str | None:
    """Return the hazard that a violation is, None if the catalogue has none."""
    for sign in _SIGNS:
        if sign.name == violation.name and sign.needs <= violation.kinds and (sign.until or version) >= version:
            return sign.hazard
    return None
