"""How this code base reads the specification where its text is contradictory, incomplete or hazardous.

The entries are in data/readings.toml. Requirements name the readings they depend on. Where another reading
can be defended, the entry lists both by name: a node can be configured for one, and the suite accepts each.
"""

from collections.abc import Mapping
from typing import Final, Literal

import msgspec

from dcp_spec.constants import SpecVersion

from .entries import Catalogue, UnknownEntryError


class UnknownReadingError(UnknownEntryError):
    """No reading has this id; the message names ids that look like it."""


class Alternative(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One of several readings that can be defended."""

    name: str
    """Short name in kebab case, unique within its reading."""
    description: str


class Reading(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A contradiction or gap of the specification (X..), or a hazard of its design (H..)."""

    id: str
    kind: Literal["contradiction", "hazard"] = "contradiction"
    """A hazard is shown by nodes that follow the text; the suite reports it; it is not a failure."""
    title: str
    sections: tuple[str, ...]
    """The places: file and anchor, or file and heading where the heading has no anchor."""
    problem: str
    reading: str
    why: str
    implementations: str | None = None
    """The behaviour of known implementations, where it is known."""
    since: SpecVersion = SpecVersion.V1_0
    """The first version with the hazard."""
    until: SpecVersion | None = None
    """The last version with the hazard, None if the latest draft has it."""
    alternatives: tuple[Alternative, ...] = ()
    """Empty where only one reading can be defended; otherwise ours first."""

    @property
    def default(self) -> Alternative | None:
        """The alternative that is our reading, None where there is nothing to select."""
        return self.alternatives[0] if self.alternatives else None

    def alternative(self, name: str) -> Alternative:
        """The alternative with this name. Raises ValueError, with the names there are, for another one."""
        for candidate in self.alternatives:
            if candidate.name == name:
                return candidate
        names = ", ".join(candidate.name for candidate in self.alternatives) or "none"
        raise ValueError(f"reading {self.id} has no alternative {name!r}; it has: {names}")


_CATALOGUE: Final = Catalogue("readings.toml", "reading", Reading, UnknownReadingError)


def differs_from_reference(reading_id: str, observed: str) -> bool:
    """Whether an observed alternative of a reading is another one than ours.

    False for an observation in free words, and for a reading that is not in the catalogue.
    """
    entry = readings().get(reading_id)
    if entry is None or entry.default is None:
        return False
    return observed != entry.default.name and any(observed == each.name for each in entry.alternatives)


def with_reference_reading(reading_id: str, observed: str) -> str:
    """An observation for people, with our reading beside it where that is another one."""
    if not differs_from_reference(reading_id, observed):
        return observed
    default = reading(reading_id).default
    assert default is not None
    return f"{observed} (reference: {default.name})"


def readings() -> Mapping[str, Reading]:
    """All readings by id: X01, X02, ... and then H1, H2, ..."""
    return _CATALOGUE.entries()


def reading(reading_id: str) -> Reading:
    """The reading with this id. Raises UnknownReadingError, a KeyError that names similar ids."""
    return _CATALOGUE.entry(reading_id)
