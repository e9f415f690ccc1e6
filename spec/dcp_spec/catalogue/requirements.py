"""The catalogue of requirements: every statement of the specification that can be fulfilled or violated.

The entries are in data/requirements.toml in our own words, each with the section it follows. Code, tests
and conformance cases cite them by id; error messages show the statement. Nothing is read before the first
look-up.
"""

from collections.abc import Mapping
from typing import Final, Literal

import msgspec

from dcp_spec.constants import SpecVersion

from .entries import Catalogue, UnknownEntryError


class UnknownRequirementError(UnknownEntryError):
    """No requirement has this id; the message names ids that look like it."""


class Requirement(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One requirement of the specification: as the draft 2.0 has it, or as the last version that had it (`until`)."""

    id: str
    protocol: Literal["DATA", "UWB", "BP", "SRP", "VD"]
    section: str
    """File and anchor ("dcp-bp.md#bp-transmit-path"), or file and heading where the heading has no anchor."""
    see: tuple[str, ...] = ()
    """Further sections, in the same form."""
    step: str | None = None
    """Step or range of steps of the pseudo-code in `section`."""
    level: Literal["mandatory", "optional", "profile"]
    """"optional" is a freedom of implementations, "profile" a choice that each profile has to state."""
    profile: bool = False
    """True where a mandatory requirement can only be checked with a value of the profile."""
    statement: str
    observable: tuple[Literal["wire", "upper", "internal"], ...]
    """Where a violation can be seen: in frames, at a service interface, or only inside."""
    test: str
    """Black-box stimulus and expectation; "the node" is under test, "the kit" tests it."""
    since: SpecVersion
    """First version in which the statement holds in full."""
    until: SpecVersion | None = None
    """Last version in which it holds, for a rule that has ended; None if it holds in the newest one."""
    not_in: tuple[SpecVersion, ...] = ()
    """Versions between the two in which it nevertheless does not hold."""
    derived: bool = False
    """True where no sentence of the specification says it, but the rest makes no sense without it."""
    history: str | None = None
    readings: tuple[str, ...] = ()
    """Ids of the readings (`dcp_spec.catalogue.readings`) on which the statement depends."""

    def holds_in(self, version: SpecVersion | str) -> bool:
        """Whether the statement holds in `version`. Raises ValueError for a version that does not exist."""
        version = SpecVersion(version)
        return version.is_within(self.since, self.until) and version not in self.not_in

    def cite(self) -> str:
        """The requirement as one line for messages: id, place and statement."""
        step = f", step {self.step}" if self.step else ""
        return f"{self.id} ({self.section}{step}): {self.statement}"


_CATALOGUE: Final = Catalogue("requirements.toml", "requirement", Requirement, UnknownRequirementError)


def requirements() -> Mapping[str, Requirement]:
    """All requirements by id, in the order of the catalogue: DATA, UWB, BP, SRP, VD."""
    return _CATALOGUE.entries()


def requirement(requirement_id: str) -> Requirement:
    """The requirement with this id. Raises UnknownRequirementError, a KeyError that names similar ids."""
    return _CATALOGUE.entry(requirement_id)
