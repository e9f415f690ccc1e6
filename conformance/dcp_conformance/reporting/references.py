"""Links from a page to the places of the specification: of requirements, and of disputed text."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

from dcp_spec.catalogue.origins import FOLDER, REPOSITORY, link, newest_statements, origins, revisions
from dcp_spec.constants import SpecVersion


@cache
def requirement_links(version: str) -> Mapping[str, str]:
    """By requirement: the address of the first sentence it stands on, in this version of the specification.

    For a requirement without one in this version, that of the newest version that has one.
    """
    found: dict[str, str] = {}
    for identifier, entry in origins().items():
        places = [place for each in _versions(version) for place in entry.origins.get(each, ())]
        if places:
            found[identifier] = link(places[0])
    return found


def _versions(first: str) -> list[SpecVersion]:
    """All versions, this one before the others, which come newest first."""
    known = [each.version for each in revisions()]
    return sorted(known, key=lambda each: str(each) != first)


@cache
def _lines() -> Mapping[tuple[str, str], int]:
    """The first line of each section of the newest version: by its file with its anchor, and with its title."""
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
    """The address of a section of the newest version, as readings and requirements name it.

    ``dcp-bp.md#anchor``, or ``dcp-bp.md: Heading``. A section that is not known is linked as its file; text that names
    no file of the specification has no address.
    """
    file, _, name = section.partition("#") if "#" in section else section.partition(": ")
    if not file.endswith(".md") or not file.startswith("dcp-"):
        return ""
    newest = revisions()[0].commit
    line = _lines().get((file, name.replace("`", "").lower())) or _lines().get((file, name.lower()))
    place = f"#L{line}" if line is not None else ""
    return f"{REPOSITORY}/blob/{newest}/{FOLDER}/{file}?plain=1{place}"
