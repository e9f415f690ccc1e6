"""Changes that cannot be observed from outside, with reasons: the files of ``data/invisible-changes/``.

Each file is a list of tables ``[[entry]]`` with the keys of :class:`Entry`. An entry names changes by their keys (see
:mod:`dcp_selftest.generated.sites`). After an edit of the changed code the key no longer exists, and a
test fails until the entry is removed.
"""

from __future__ import annotations

from functools import cache
from importlib import resources
from importlib.resources.abc import Traversable
from typing import Final

import msgspec

#: Kinds of reasons, with their meanings.
CLASSES: Final = {
    "counter": "a counter, statistic or drop reason that only dcp-node shows",
    "representation": "another representation of the same: names in messages, text of an error, a cache",
    "speed": "work that is saved or repeated, with the same outcome",
    "equivalent": "the same behaviour for every input that can occur",
    "unreachable": "a state that callers exclude, or a guard against misuse by our own program",
    "freedom": "another behaviour that the specification allows as well",
    "limit": "a limit of ours beyond what the specification asks for",
    "internal": "a check of invariants, or an interface of the node that no protocol partner and no service sees",
}


class Entry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Changes with the same reason."""

    kind: str
    """One of :data:`CLASSES`."""
    reason: str
    changes: tuple[str, ...]
    """``key  description of the change`` for each change."""

    def __post_init__(self) -> None:
        if self.kind not in CLASSES:
            raise ValueError(f"`kind` is {self.kind!r}, not one of {', '.join(CLASSES)}")
        if not self.reason.strip():
            raise ValueError("`reason` is empty")

    @property
    def text(self) -> str:
        """Kind and reason, for messages."""
        return f"{self.kind}: {self.reason}"


class _File(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    entry: tuple[Entry, ...] = ()


@cache
def entries() -> tuple[Entry, ...]:
    """Return all entries in the order of file names. Raise ``ValueError`` for a file that is not well-formed."""
    folder = resources.files("dcp_selftest").joinpath("data", "invisible-changes")
    found: list[Entry] = []
    for file in sorted(folder.iterdir(), key=lambda each: each.name):
        if file.name.endswith(".toml"):
            found += _read(file)
    return tuple(found)


def _read(file: Traversable) -> tuple[Entry, ...]:
    try:
        return msgspec.toml.decode(file.read_bytes(), type=_File).entry
    except msgspec.DecodeError as error:
        raise ValueError(f"{file.name}: {error}") from None


@cache
def ledger() -> dict[str, Entry]:
    """Return the entries by the keys of their changes."""
    return {change.split()[0]: entry for entry in entries() for change in entry.changes}
