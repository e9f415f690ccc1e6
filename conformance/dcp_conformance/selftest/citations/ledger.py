"""Citations that no change proves to stand in the right place, with reasons: ``data/unproved-citations.toml``."""

from __future__ import annotations

from functools import cache
from importlib import resources

import msgspec

from .places import Citation


class Entry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Citations that share a reason."""

    reason: str
    citations: tuple[str, ...]
    """``ID path function``, for a deviation followed by ``exception``; the function is ``-`` at module level."""


class _File(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    entry: tuple[Entry, ...] = ()


def key(citation: Citation) -> str:
    """What the ledger calls a citation: it survives edits elsewhere in the file."""
    exception = " exception" if citation.remark.startswith("exception") else ""
    return f"{citation.requirement} {citation.path} {citation.function or '-'}{exception}"


@cache
def ledger() -> dict[str, str]:
    """Reasons by the keys of citations. Raises ``msgspec.DecodeError`` for a file that is not well-formed."""
    text = resources.files("dcp_conformance").joinpath("data", "unproved-citations.toml").read_bytes()
    entries = msgspec.toml.decode(text, type=_File).entry
    return {each: entry.reason for entry in entries for each in entry.citations}
