"""``spec/anchors.toml``: the statements of the specification that each requirement stands on, chosen by people.

A requirement names its statements in one version, mostly 2.0; they are followed into the other versions by their
wording and their place. Where that does not lead to the right statement, the entry names that of the other version.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import msgspec
from dcp_conformance.errors import UsageError
from dcp_spec.catalogue.requirements import requirements
from dcp_spec.constants import SpecVersion

from .statements import Statement

PATH: Final = "spec/anchors.toml"


class RevisionEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A version and the tag or commit that is read as this version."""

    version: SpecVersion
    revision: str


class _File(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    revision: tuple[RevisionEntry, ...]
    requirement: dict[str, dict[str, str | list[str]]]


class Anchors(msgspec.Struct, frozen=True):
    """The content of the file."""

    revisions: tuple[RevisionEntry, ...]
    """Newest first."""
    statements: dict[str, dict[SpecVersion, tuple[str, ...]]]
    """References (:func:`reference`) by requirement and version."""
    why: dict[str, str]
    """Why no sentence of its own states a requirement."""


def reference(statement: Statement) -> str:
    """A statement in the file: ``FILE:LINE FINGERPRINT``."""
    return f"{statement.file}:{statement.line} {statement.fingerprint}"


def read_anchors(path: Path) -> Anchors:
    """Read the file. Raises :class:`UsageError` that names what is wrong in it."""
    try:
        file = msgspec.toml.decode(path.read_bytes(), type=_File)
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror}") from None
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise UsageError(f"{path}: {error}") from None
    versions = [each.version for each in file.revision]
    if sorted(versions, reverse=True) != versions or len(set(versions)) != len(versions):
        raise UsageError(f"{path}: the revisions are not ordered from the newest version to the oldest")
    found: dict[str, dict[SpecVersion, tuple[str, ...]]] = {}
    why: dict[str, str] = {}
    for name, entry in file.requirement.items():
        if name not in requirements():
            raise UsageError(f"{path}: the catalogue has no requirement {name}")
        found[name] = {}
        for key, value in entry.items():
            if key == "why" and isinstance(value, str):
                why[name] = value
            elif key in versions and isinstance(value, list):
                found[name][SpecVersion(key)] = tuple(value)
            else:
                raise UsageError(f"{path}: {name}: {key!r} is neither a version with a list of statements nor `why`")
    return Anchors(file.revision, found, why)
