"""Whether a case concerns an implementation, and if not, why."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .case import Case

if TYPE_CHECKING:
    from dcp_conformance.test_system.bench import Bench


def why_not(bench: Bench, case: Case) -> str:
    """Why the case does not apply; empty if it does."""
    needs, session = case.needs, bench.session
    version = bench.profile.spec_version
    if version < needs.since:
        return f"the specification has this since {needs.since}; the profile {bench.profile.name} follows {version}"
    if needs.until is not None and version > needs.until:
        return f"the specification has this until {needs.until}; the profile {bench.profile.name} follows {version}"
    for entity in needs.entities:
        if getattr(bench.sut.pics, entity) is False:
            return f"the PICS says that there is no {entity}"
    if "srp" in needs.entities and not bench.profile.srp.is_report:
        return f"the profile {bench.profile.name} has no octets for a state report"
    for name in needs.header:
        if not bench.profile.has_header_field(name):
            return f"the beacon header of the profile {bench.profile.name} has no field {name}"
    if needs.ut and session.upper is None:
        return "there is no upper tester (--ut)"
    if session.upper is not None:
        missing = [method for method in needs.ut if method not in session.upper.methods]
        if missing:
            return f"the upper tester does not offer {', '.join(missing)}"
    if "UT-Reset" in needs.ut and session.pics.pixit.reset == "none":
        return 'the PIXIT excludes resets ([pixit] reset = "none")'
    for name in needs.pics:
        claimed = getattr(bench.sut.pics, name)
        if claimed is None:
            return f"the PICS does not say whether there is {name} ([pics] {name} = true)"
        if claimed is False:
            return f"the PICS denies {name}"
    if needs.link and session.switch_link is None:
        return "there are no commands to take its link down and up (pixit.link_down, pixit.link_up)"
    if needs.restart and not session.can_restart:
        return "there is no command to restart the implementation (--restart)"
    return (needs.when(bench) or "") if needs.when is not None else ""
