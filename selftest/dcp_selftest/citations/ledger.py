"""Citations for which no change of the code can be detected, with reasons: ``data/unproved-citations.toml``."""

from __future__ import annotations

from functools import cache
from importlib import resources

import msgspec

from .places import Citation


class Entry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Citations with the same reason."""

    reason: str
    citations: tuple[str, ...]
    """Keys of citations: ``ID path function``, with ``-`` as the function at module level; for a deviation followed by
    ``exception``."""


class _File(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    entry: tuple[Entry, ...] = ()


def key(citation: Citation) -> str:
    """Return the key of a citation in the ledger; it does not change with the line number."""
    exception = " exception" if citation.remark.startswith("exception") else ""
    return f"{citation.requirement} {citation.path} {citation.function or '-'}{exception}"


@cache
def ledger() -> dict[str, str]:
    """Return the reasons by the keys of citations. Raise ``msgspec.DecodeError`` for a file that is not well-formed."""
    text = resources.files("dcp_selftest").joinpath("data", "unproved-citations.toml").read_bytes()
    entries = msgspec.toml.decode(text, type=_File).entry
    return {each: entry.reason for entry in entries for each in entry.citations}
