"""``docs/selftest.md``: a document of sections, each of which one command writes and all others leave alone.

A section stands between two lines that are comments in Markdown::

    <!-- section: mutants -->
    ...
    <!-- end: mutants -->
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from dcp_codec.common.atomic_write import write_whole

SECTIONS: Final = ("mutants", "generated", "variants")
"""The names of sections in the order in which they stand in a document."""
_PREFACE: Final = (
    "# Who tests the tester\n\nMade by `make selftest-doc`; do not edit. Each section says which command makes it.\n"
)


class DocumentError(ValueError):
    """The markers of a document do not match, so that no section can be replaced without losing text."""


def write_section(path: Path, name: str, text: str) -> None:
    """Put ``text`` into the section ``name`` of the document at ``path``; a document that is missing is made.

    ``name`` is one of :data:`SECTIONS`. Raises :class:`DocumentError`, and OSError if the file cannot be read or
    written.
    """
    document = path.read_text(encoding="utf-8") if path.exists() else ""
    write_whole(path, with_section(document, name, text).encode())


def with_section(document: str, name: str, text: str) -> str:
    """The document with ``text`` as its section ``name``, in place of the one that it has.

    A section that the document lacks comes after those that precede it in :data:`SECTIONS`. Text outside of sections
    stays as it is. Raises :class:`DocumentError`.
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
    """The text of the section ``name``, empty if there is none. Raises :class:`DocumentError`."""
    place = _place(document, name)
    if place is None:
        return ""
    return document[place[0] : place[1]].removeprefix(_begin(name)).rstrip().removesuffix(_end(name)).strip()


def _begin(name: str) -> str:
    return f"<!-- section: {name} -->"


def _end(name: str) -> str:
    return f"<!-- end: {name} -->"


def _place(document: str, name: str) -> tuple[int, int] | None:
    """Where the section begins and ends, its markers and the end of their line included."""
    begin, end = (document.count(f"{mark(name)}\n") for mark in (_begin, _end))
    if (begin, end) == (0, 0):
        return None
    first = document.find(_begin(name))
    last = document.find(f"{_end(name)}\n")
    if (begin, end) != (1, 1) or last < first:
        raise DocumentError(f"the markers of the section {name!r} do not match: {begin} begin it and {end} end it")
    return first, last + len(_end(name)) + 1


def _after_predecessors(document: str, name: str) -> int:
    """Where a new section belongs: after the last one that precedes it, before the first one that follows it."""
    position = SECTIONS.index(name)
    before = [place[1] for each in SECTIONS[:position] if (place := _place(document, each))]
    after = [place[0] for each in SECTIONS[position + 1 :] if (place := _place(document, each))]
    if before:
        return max(before)
    return min(after) if after else len(document)


__all__ = ["SECTIONS", "DocumentError", "section_of", "with_section", "write_section"]
