"""The sections of ``docs/selftest.md``. Each section is written by one command and kept by all others.

A section is enclosed by two lines that are comments in Markdown::

    <!-- section: mutants -->
    ...
    <!-- end: mutants -->
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from dcp_codec.common.atomic_write import write_whole

SECTIONS: Final = ("mutants", "model", "generated", "variants", "vectors")
"""The names of sections in the order of the document."""
_PREFACE: Final = (
    "# Tests of the test suite\n\nMade by `make selftest-doc`; do not edit. Each section names its own command.\n"
)


class DocumentError(ValueError):
    """The markers of a document do not match: replacing a section could delete other text."""


def write_section(path: Path, name: str, text: str) -> None:
    """Replace the section ``name`` of the document at ``path`` with ``text``; create a missing document.

    ``name`` is one of :data:`SECTIONS`. Raise :class:`DocumentError` for markers that do not match, and OSError if the
    file cannot be read or written.
    """
    document = path.read_text(encoding="utf-8") if path.exists() else ""
    write_whole(path, with_section(document, name, text).encode())


def with_section(document: str, name: str, text: str) -> str:
    """Return the document with ``text`` as its section ``name``, instead of the section that it has.

    A new section is inserted after the sections that precede it in :data:`SECTIONS`. Text outside of sections is kept.
    Raise :class:`DocumentError` for markers that do not match.
    """
    if name not in SECTIONS:
        raise ValueError(f"no section is called {name!r}: {', '.join(SECTIONS)}")
    made = f"{_begin(name)}\n\n{text.strip()}\n\n{_end(name)}\n"
    if (place := _place(document, name)) is not None:
        return document[: place[0]] + made + document[place[1] :]
    at = _after_predecessors(document, name)
    before, rest = document[:at] or _PREFACE, document[at:].lstrip("\n")
    return f"{before.rstrip()}\n\n{made}" + (f"\n{rest}" if rest else "")


def section_of(document: str, name: str) -> str:
    """Return the text of the section ``name``; empty if the document does not have it. Raise :class:`DocumentError`."""
    place = _place(document, name)
    if place is None:
        return ""
    return document[place[0] : place[1]].removeprefix(_begin(name)).rstrip().removesuffix(_end(name)).strip()


def _begin(name: str) -> str:
    return f"<!-- section: {name} -->"


def _end(name: str) -> str:
    return f"<!-- end: {name} -->"


def _place(document: str, name: str) -> tuple[int, int] | None:
    """Return the start and end of a section with its markers, as offsets in the text; None without the section."""
    begin, end = (document.count(f"{mark(name)}\n") for mark in (_begin, _end))
    if (begin, end) == (0, 0):
        return None
    first = document.find(_begin(name))
    last = document.find(f"{_end(name)}\n")
    if (begin, end) != (1, 1) or last < first:
        raise DocumentError(f"the markers of the section {name!r} do not match: {begin} begin it and {end} end it")
    return first, last + len(_end(name)) + 1


def _after_predecessors(document: str, name: str) -> int:
    """Return the offset for a new section: after the last section that precedes it, before the first that follows."""
    position = SECTIONS.index(name)
    before = [place[1] for each in SECTIONS[:position] if (place := _place(document, each))]
    after = [place[0] for each in SECTIONS[position + 1 :] if (place := _place(document, each))]
    if before:
        return max(before)
    return min(after) if after else len(document)


__all__ = ["SECTIONS", "DocumentError", "section_of", "with_section", "write_section"]
