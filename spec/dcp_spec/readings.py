"""How this code base reads the specification where its text is contradictory, incomplete or hazardous.

The entries stand in data/readings.toml. Requirements name the readings they depend on. Where another reading
can be defended, the entry lists both by name: a node can be configured for one, and the suite accepts each.
"""

import difflib
from collections.abc import Mapping
from functools import cache
from importlib import resources
from types import MappingProxyType
from typing import Literal

import msgspec


class UnknownReadingError(KeyError):
    """No reading has this id; the message names ids that look like it."""

    def __init__(self, reading_id: str, near: list[str]) -> None:
        hint = f"; did you mean {', '.join(near)}?" if near else ""
        self.message = f"no reading {reading_id!r}{hint}"
        super().__init__(self.message)

    def __str__(self) -> str:
        # KeyError shows the repr of its argument, which would put quotes around a sentence.
        return self.message


class Alternative(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One of several readings that can be defended."""

    name: str
    """Short name in kebab case, unique within its reading."""
    description: str


class Reading(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A contradiction or gap of the specification (X..), or a hazard of its design (H..)."""

    id: str
    kind: Literal["contradiction", "hazard"] = "contradiction"
    """A hazard is shown by nodes that follow the text; the suite reports it and fails nobody for it."""
    title: str
    sections: tuple[str, ...]
    """The places: file and anchor, or file and heading where the heading has no anchor."""
    problem: str
    reading: str
    why: str
    implementations: str | None = None
    """What known implementations do, where that is known."""
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


class _Readings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    reading: tuple[Reading, ...]


@cache
def readings() -> Mapping[str, Reading]:
    """All readings by id: X01, X02, ... and then H1, H2, ..."""
    text = resources.files("dcp_spec").joinpath("data/readings.toml").read_bytes()
    entries = msgspec.toml.decode(text, type=_Readings)
    return MappingProxyType({entry.id: entry for entry in entries.reading})


def reading(reading_id: str) -> Reading:
    """The reading with this id. Raises UnknownReadingError, a KeyError that names similar ids."""
    known = readings()
    try:
        return known[reading_id]
    except KeyError:
        near = difflib.get_close_matches(reading_id.upper(), known, n=3)
        raise UnknownReadingError(reading_id, near) from None
