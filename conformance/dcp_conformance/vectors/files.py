"""Files of test vectors: one folder for each profile, with schemas and a page that explains them.

The layout is that of Wycheproof: a file has groups of tests, a test has an identifier, a comment and flags, and the
file explains its flags.
"""

from __future__ import annotations

import hashlib
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any, Final

import msgspec
from dcp_spec.catalogue.readings import reading
from dcp_spec.reasons import WARNINGS
from dcp_spec.version import __version__

from dcp_codec.codec import Codec, get_codec
from dcp_codec.common.schemas import schema_components
from dcp_codec.export.jsonschema import DRAFT, beacon_schema

from . import behaviour, wire
from .showing import show_values

WIRE: Final = "wire.schema.json"
BEHAVIOUR: Final = "behaviour.schema.json"
KINDS: Final = ("wire", "behaviour")
#: Date of all files in an archive: archives of equal vectors are equal.
_DATE: Final = (2020, 1, 1, 0, 0, 0)


class Note(msgspec.Struct, frozen=True, omit_defaults=True):
    """The meaning of a flag."""

    description: str
    alternatives: Mapping[str, str] = {}
    """For a reading: the ways to read the text, by name; the vectors follow the first."""


class VectorFile(msgspec.Struct, frozen=True, rename="camel"):
    """The beginning of each file of vectors."""

    schema: str
    generator_version: str
    profile: str
    spec_version: str
    number_of_tests: int
    notes: Mapping[str, Note]


class WireGroup(msgspec.Struct, frozen=True):
    """The vectors that are valid, or those that are not."""

    type: str
    tests: Sequence[wire.Vector]


class WireFile(VectorFile, frozen=True):
    """The content of ``wire.json``."""

    test_groups: Sequence[WireGroup]


class BehaviourFile(VectorFile, frozen=True):
    """The content of ``behaviour.json``."""

    test_groups: Sequence[behaviour.BehaviourGroup]


def notes_of(flags: Iterable[str], meanings: Mapping[str, str]) -> dict[str, Note]:
    """Return what flags mean: readings by their catalogue, others by ``meanings``."""
    found = {}
    for each in sorted(set(flags)):
        if each in meanings:
            found[each] = Note(meanings[each])
        else:
            entry = reading(each)
            ways = {way.name: way.description for way in entry.alternatives}
            found[each] = Note(f"{entry.title}. {entry.reading}", ways)
    return found


def wire_file(codec: Codec, vectors: Sequence[wire.Vector]) -> WireFile:
    """Return the content of ``wire.json``."""
    groups = [WireGroup(kind, [each for each in vectors if each.result == kind]) for kind in ("valid", "invalid")]
    notes = notes_of((flag for each in vectors for flag in each.flags), WARNINGS)
    version = str(codec.profile.spec_version)
    return WireFile(WIRE, __version__, codec.profile.name, version, len(vectors), notes, groups)


def behaviour_file(codec: Codec, found: behaviour.BehaviourGroup) -> BehaviourFile:
    """Return the content of ``behaviour.json``."""
    notes = notes_of((flag for each in found.tests for flag in each.flags), {})
    version = str(codec.profile.spec_version)
    return BehaviourFile(BEHAVIOUR, __version__, codec.profile.name, version, len(found.tests), notes, [found])


def schema(root: type, title: str) -> dict[str, Any]:
    """Return the JSON Schema (2020-12) of a file."""
    (reference,), definitions = schema_components([root])
    return {"$schema": DRAFT, "title": title, **reference, "$defs": definitions}


def files(profiles: Iterable[str], kinds: Iterable[str] = KINDS) -> Iterator[tuple[str, bytes]]:
    """Yield paths and contents of all files of these profiles."""
    yield "README.md", resources.files("dcp_conformance").joinpath("data", "vectors-readme.md").read_bytes()
    kinds = set(kinds)
    if "wire" in kinds:
        yield WIRE, _json(schema(WireFile, "Wire vectors of the Drone Coordination Protocol"))
    if "behaviour" in kinds:
        yield BEHAVIOUR, _json(schema(BehaviourFile, "Behaviour vectors of the Drone Coordination Protocol"))
    for name in profiles:
        codec = get_codec(name)
        if "wire" in kinds:
            vectors = wire.vectors(codec)
            yield f"{name}/wire.json", _json(wire_file(codec, vectors))
            yield f"{name}/wire.txt", _lines(wire.lines(codec, vectors))
            yield f"{name}/beacon.schema.json", _json(beacon_schema(codec))
            yield f"{name}/show_values.h", show_values(codec).encode()
        if "behaviour" in kinds and (found := behaviour.load(name)) is not None:
            yield f"{name}/behaviour.json", _json(behaviour_file(codec, found))
            yield f"{name}/behaviour.txt", _lines(behaviour.lines(found))


def _lines(lines: Iterable[str]) -> bytes:
    return "".join(f"{each}\n" for each in lines).encode()


def _json(value: object) -> bytes:
    return msgspec.json.format(msgspec.json.encode(value), indent=1) + b"\n"


def write(folder: Path, found: Iterable[tuple[str, bytes]], archive: Path | None = None) -> int:
    """Write files below a folder, and into a zip if ``archive`` is given. Return the number of files."""
    written = []
    for name, octets in found:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(octets)
        written.append((name, octets))
    if archive is not None:
        with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as target:
            for name, octets in sorted(written):
                target.writestr(zipfile.ZipInfo(name, _DATE), octets, zipfile.ZIP_DEFLATED)
    return len(written)


def digest(meaning: object) -> str:
    """Return six hex digits of what a vector means; a change of identifier or expectation changes them."""
    return hashlib.sha256(msgspec.json.encode(meaning)).hexdigest()[:6]


def wire_digests(vectors: Iterable[wire.Vector]) -> dict[str, list[str]]:
    """Return the digests of wire vectors by the messages from which they are made."""
    found: dict[str, list[str]] = {}
    for each in vectors:
        meaning = each.tc_id, each.octets, each.values, each.problem, each.used, each.direction
        found.setdefault(each.tc_id.partition(":")[0], []).append(digest(meaning))
    return found


def behaviour_digests(found: behaviour.BehaviourGroup) -> list[str]:
    """Return the digests of behaviour vectors."""
    return [digest(each) for each in found.tests]
