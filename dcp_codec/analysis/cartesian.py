"""Find the fields of safety data that are a Cartesian position, and their scale."""

from __future__ import annotations

from collections.abc import Mapping

from dcp_spec.profile.definition import Profile, SafetyField

#: Metres in one unit of a position; positions in other units are not Cartesian.
METRES: Mapping[str, float] = {"": 1.0, "m": 1.0, "mm": 0.001, "cm": 0.01, "dm": 0.1, "km": 1000.0}


def cartesian_axes(profile: Profile) -> dict[str, tuple[str, float]]:
    """Return for each of x, y, z the name of its field in safety data and the metres in one unit of it.

    Empty if the profile has no x and y, or a coordinate has a unit that is not a length.
    """
    fields: dict[str, SafetyField] = {member.role: member for member in profile.srp.safety_data}
    found = {axis: fields[f"position.{axis}"] for axis in "xyz" if f"position.{axis}" in fields}
    if not {"x", "y"} <= set(found) or any(member.unit not in METRES for member in found.values()):
        return {}
    return {axis: (member.name, METRES[member.unit]) for axis, member in found.items()}
