"""Requirements that a profile declares as not met: what an implementation of that profile passes is something else.

A profile describes the octets of an implementation, also where they are not those of the specification. Cases test
against the profile; that they pass does not show the sentence of the specification.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dcp_spec.profile import Opaque, Profile, Types
from dcp_spec.requirements import requirements

from .verdict import Verdict


def declared_by(profile: Profile) -> dict[str, str]:
    """Requirement -> what the profile says instead; empty for one that keeps to its version of the specification."""
    found: dict[str, str] = {}
    little = [name for name, layout in _integers(profile.types) if layout.byte_order == "little"]
    if little:
        found["DATA-01"] = f"least significant octet first: {', '.join(little)}"
    opaque = [
        each.note or each.name for each in (*profile.srp.record, *profile.bp.payload_header) if isinstance(each, Opaque)
    ]
    if opaque:
        found["DATA-02"] = f"octets that belong to no field: {'; '.join(dict.fromkeys(opaque))}"
    if profile.types.string.terminated:
        found["DATA-07"] = "strings end with a NUL octet"
    if profile.bp.length_means != "blocks":
        found["BP-HDR-06"] = "length is the size of the header"
    if profile.bp.payload_area:
        found["BP-FMT-01"] = f"each payload lies in an area of {profile.bp.payload_area} octets"
    if profile.vardis.list_length is not None or profile.vardis.container_extra:
        found["VD-IC-01"] = "container headers have further fields"
    known = requirements()
    return {name: text for name, text in found.items() if known[name].since <= profile.spec_version}


def _integers(types: Types) -> list[tuple[str, Any]]:
    layouts = {name: getattr(types, name) for name in types.__struct_fields__}
    return [
        (name, layout) for name, layout in layouts.items() if hasattr(layout, "byte_order") and (layout.width or 2) > 1
    ]


def without_declared(verdicts: Mapping[str, Verdict], declared: Mapping[str, str]) -> dict[str, Verdict]:
    """The verdicts, with no pass for a requirement that the profile declares as not met."""
    return {
        name: Verdict.INFO if verdict is Verdict.PASS and name in declared else verdict
        for name, verdict in verdicts.items()
    }
