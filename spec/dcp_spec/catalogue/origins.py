"""Where in the specification each requirement stands, for every published version.

``data/origins.json`` is generated (``dcp-selftest origins``): places and fingerprints, no wording.
``data/statements.json`` lists all statements of the newest version in the same way, so that another version can be
compared with it. Nothing is read before the first look-up.
"""

from collections.abc import Mapping
from functools import cache
from importlib import resources
from types import MappingProxyType
from typing import Final

import msgspec

from dcp_spec.constants import SpecVersion

from .requirements import UnknownRequirementError, requirements

REPOSITORY: Final = "https://github.com/awillig/dcp-vardis"
FOLDER: Final = "dcp-vardis-project/specification"
ORIGINS: Final = "origins.json"
STATEMENTS: Final = "statements.json"


class Revision(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The commit that is read as a version of the specification."""

    version: SpecVersion
    commit: str
    tag: str = ""
    """Empty for a draft that has no tag."""


class Section(msgspec.Struct, frozen=True, array_like=True):
    """A section of a file."""

    file: str
    headings: tuple[str, ...]
    """Titles, outermost first."""
    anchor: str
    """Identifier of its heading, empty if it has none."""


class Origin(msgspec.Struct, frozen=True):
    """A sentence or step of one version of the specification."""

    version: SpecVersion
    section: Section
    line: int
    """From 1, in the file at the commit of the version."""
    step: str
    """Step of the pseudo-code ("3", "3.d"); empty for a sentence."""
    fingerprint: str
    """Of the normalised wording; see ``dcp_selftest.provenance.statements``."""

    def __str__(self) -> str:
        step = f", step {self.step}" if self.step else ""
        return f"{self.section.file}:{self.line} ({self.section.headings[-1]}{step})"


class RequirementOrigins(msgspec.Struct, frozen=True):
    """The statement of the specification that a requirement is taken from."""

    id: str
    origins: Mapping[SpecVersion, tuple[Origin, ...]]
    """For each version in which the requirement holds; empty tuples only if no sentence says it."""
    why: str = ""
    """Why no sentence of its own states the requirement; the origins are then what it follows from. Otherwise empty."""


class StatementRecord(msgspec.Struct, frozen=True, array_like=True):
    """A statement of the newest version; ``section`` is a position in the list of sections."""

    section: int
    line: int
    kind: str
    step: str
    fingerprint: str
    sketch: str
    normative: bool


class StatementsFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The content of ``statements.json``."""

    version: SpecVersion
    sections: tuple[Section, ...]
    statements: tuple[StatementRecord, ...]


class OriginsFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The content of ``origins.json``; an origin is (position of the section, line, step, fingerprint)."""

    revisions: tuple[Revision, ...]
    sections: tuple[Section, ...]
    origins: dict[str, dict[SpecVersion, tuple[tuple[int, int, str, str], ...]]]
    why: dict[str, str]


@cache
def _file() -> OriginsFile:
    return msgspec.json.decode(resources.files("dcp_spec").joinpath("data", ORIGINS).read_bytes(), type=OriginsFile)


def revisions() -> tuple[Revision, ...]:
    """The commits that stand for the versions, newest first."""
    return _file().revisions


@cache
def origins() -> Mapping[str, RequirementOrigins]:
    """The origins of all requirements by id, in the order of the catalogue."""
    file = _file()

    def entry(name: str) -> RequirementOrigins:
        found = {
            version: tuple(
                Origin(version, file.sections[section], line, step, fingerprint)
                for section, line, step, fingerprint in each
            )
            for version, each in file.origins.get(name, {}).items()
        }
        return RequirementOrigins(name, MappingProxyType(found), file.why.get(name, ""))

    return MappingProxyType({name: entry(name) for name in requirements()})


def origins_of(requirement_id: str) -> RequirementOrigins:
    """The origins of one requirement. Raises UnknownRequirementError, a KeyError that names similar ids."""
    known = origins()
    if requirement_id not in known:
        raise UnknownRequirementError.among("requirement", requirement_id, known)
    return known[requirement_id]


def newest_statements() -> StatementsFile:
    """All statements of the newest version."""
    data = resources.files("dcp_spec").joinpath("data", STATEMENTS).read_bytes()
    return msgspec.json.decode(data, type=StatementsFile)


def link(origin: Origin) -> str:
    """The place in the public repository."""
    commit = next(each.commit for each in revisions() if each.version == origin.version)
    return f"{REPOSITORY}/blob/{commit}/{FOLDER}/{origin.section.file}?plain=1#L{origin.line}"
