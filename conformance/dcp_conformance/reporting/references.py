"""Links from a page into the specification: for requirements, and for disputed text."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

from dcp_spec.catalogue.origins import FOLDER, REPOSITORY, link, newest_statements, origins, revisions
from dcp_spec.constants import SpecVersion


@cache
def requirement_links(version: str) -> Mapping[str, str]:
    """Return for each requirement the URL of its first sentence in this version of the specification.

    For a requirement without a sentence in this version, the URL is that in the newest version that has one.
    """
    found: dict[str, str] = {}
    for identifier, entry in origins().items():
        places = [place for each in _versions(version) for place in entry.origins.get(each, ())]
        if places:
            found[identifier] = link(places[0])
    return found


def _versions(first: str) -> list[SpecVersion]:
    """Return all versions: ``first``, then the others from the newest to the oldest."""
    known = [each.version for each in revisions()]
    return sorted(known, key=lambda each: str(each) != first)


@cache
def _lines() -> Mapping[tuple[str, str], int]:
    """Return the first line of each section of the newest version, by (file, anchor) and by (file, heading)."""
    file = newest_statements()
    found: dict[tuple[str, str], int] = {}
    for each in file.statements:
        section = file.sections[each.section]
        for name in (section.anchor, *section.headings):
            if name:
                key = (section.file, name.lower())
                found[key] = min(each.line, found.get(key, each.line))
    return found


def section_link(section: str) -> str:
    """Return the URL of a section in the newest version; empty if ``section`` names no file of the specification.

    ``section`` has the form ``dcp-bp.md#anchor`` or ``dcp-bp.md: Heading``. The URL of an unknown section is that of
    its file.
    """
    file, _, name = section.partition("#") if "#" in section else section.partition(": ")
    if not file.endswith(".md") or not file.startswith("dcp-"):
        return ""
    newest = revisions()[0].commit
    line = _lines().get((file, name.replace("`", "").lower())) or _lines().get((file, name.lower()))
    place = f"#L{line}" if line is not None else ""
    return f"{REPOSITORY}/blob/{newest}/{FOLDER}/{file}?plain=1{place}"
