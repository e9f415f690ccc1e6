"""Writing ``origins.json`` and ``statements.json`` from the anchors and the git repository of the specification."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Final

from dcp_conformance.errors import UsageError
from dcp_spec.catalogue.origins import ORIGINS, STATEMENTS, Section
from dcp_spec.catalogue.requirements import requirements
from dcp_spec.constants import SpecVersion

from .anchors import PATH, Anchors, reference
from .checkout import commit_of, read_checkout
from .comparison import align
from .statements import Statement

DATA: Final = "spec/dcp_spec/data"


@dataclass(frozen=True, slots=True)
class Recording:
    """The generated files, and the statements to be reviewed."""

    files: dict[str, str]
    """Content by name in the folder of data."""
    remarks: tuple[str, ...]
    """Requirements that have lost all of their statements on the way to another version, or never had any."""


def record(repository: Path, anchors: Anchors) -> Recording:
    """Follow the anchors through all versions.

    Raises :class:`UsageError` if the repository has no such revision, or a revision no such statement.
    """
    versions = [each.version for each in anchors.revisions]
    commits = {each.version: commit_of(repository, each.revision) for each in anchors.revisions}
    texts = {version: read_checkout(repository, commits[version]).statements() for version in versions}
    found = _follow(versions, texts, anchors)
    remarks = list(_remarks(versions, found, anchors))
    sections = _Sections()
    lines: list[str] = []
    for name in requirements():
        entry = {
            str(version): [[sections.number(each), each.line, each.step, each.fingerprint] for each in statements]
            for version, statements in found.get(name, {}).items()
        }
        lines.append(f"{json.dumps(name)}: {json.dumps(entry, separators=(',', ':'))}")
    revisions = [
        json.dumps(
            {
                "version": str(each.version),
                "commit": commits[each.version],
                "tag": each.revision if each.revision != commits[each.version] else "",
            }
        )
        for each in anchors.revisions
    ]
    why = [f"{json.dumps(name)}: {json.dumps(anchors.why[name])}" for name in requirements() if name in anchors.why]
    origins = _json(
        revisions=_list(revisions), sections=_list(sections.lines()), origins=_table(lines), why=_table(why)
    )  # fmt: skip
    return Recording({ORIGINS: origins, STATEMENTS: _statements(versions[0], texts[versions[0]])}, tuple(remarks))


Partners = dict[tuple[SpecVersion, SpecVersion], dict[str, Statement]]
"""The corresponding statement in the other version, by reference."""


def _follow(
    versions: Sequence[SpecVersion], texts: dict[SpecVersion, list[Statement]], anchors: Anchors
) -> dict[str, dict[SpecVersion, list[Statement]]]:
    """The statements of each requirement in each version that it holds in.

    They are followed from the newest version in which they are named, into newer ones first and then into older ones.
    """
    named = {version: {reference(each): each for each in texts[version]} for version in versions}
    partners: Partners = {}
    for newer, older in pairwise(versions):
        for left, right in ((newer, older), (older, newer)):
            pairs = align(texts[left], texts[right])
            partners[left, right] = {reference(each.old): each.new for each in pairs if each.old and each.new}
    found: dict[str, dict[SpecVersion, list[Statement]]] = {}
    for name, chosen in anchors.statements.items():
        known = {
            version: [_look_up(named[version], each, name, version) for each in references]
            for version, references in chosen.items()
        }
        start = next((number for number, version in enumerate(versions) if version in known), 0)
        for ways in (versions[start::-1], versions[start:]):
            for before, after in pairwise(ways):
                if after not in known:
                    known[after] = _partners_of(known.get(before, []), partners[before, after])
        found[name] = {
            version: known.get(version, []) for version in versions if requirements()[name].holds_in(version)
        }
    return found


def _partners_of(statements: Iterable[Statement], partners: dict[str, Statement]) -> list[Statement]:
    followed = (partners.get(reference(each)) for each in statements)
    return list({reference(each): each for each in followed if each is not None}.values())


def _look_up(known: dict[str, Statement], name: str, requirement: str, version: SpecVersion) -> Statement:
    if name not in known:
        raise UsageError(f"{PATH}: {requirement}: version {version} has no statement {name!r}")
    return known[name]


def _remarks(
    versions: Iterable[SpecVersion], found: dict[str, dict[SpecVersion, list[Statement]]], anchors: Anchors
) -> Iterable[str]:
    for name, requirement in requirements().items():
        if name not in anchors.statements:
            yield f"{name} has no entry in {PATH}: name its statements, or say why it has none"
            continue
        for version in versions:
            if requirement.holds_in(version) and not found[name][version] and name not in anchors.why:
                yield f"{name} holds in {version}, but none of its statements was found there: name them in {PATH}"


class _Sections:
    def __init__(self) -> None:
        self._numbers: dict[Section, int] = {}

    def number(self, statement: Statement) -> int:
        section = Section(statement.file, statement.headings, statement.anchor)
        return self._numbers.setdefault(section, len(self._numbers))

    def lines(self) -> list[str]:
        return [json.dumps([each.file, each.headings, each.anchor]) for each in self._numbers]


def _statements(version: SpecVersion, statements: Iterable[Statement]) -> str:
    sections = _Sections()
    lines = [
        json.dumps(
            [sections.number(each), each.line, each.kind, each.step, each.fingerprint, each.sketch, each.normative],
            separators=(",", ":"),
        )
        for each in statements
    ]
    return _json(version=json.dumps(str(version)), sections=_list(sections.lines()), statements=_list(lines))


def _json(**members: str) -> str:
    """An object with an entry on each line, so that differences can be read."""
    return "{\n" + ",\n".join(f'"{name}": {value}' for name, value in members.items()) + "\n}\n"


def _list(lines: Iterable[str]) -> str:
    return "[\n" + ",\n".join(lines) + "\n]"


def _table(lines: Iterable[str]) -> str:
    return "{\n" + ",\n".join(lines) + "\n}"
