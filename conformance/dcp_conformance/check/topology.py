"""Links that the user tells: which nodes can hear which others."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from itertools import pairwise
from pathlib import Path

from dcp_conformance.errors import UsageError

from .base import name


class Topology:
    """For each listener the nodes that it can hear. It hears no others; a given link may still fail.

    Nodes are named by the text of their identifiers, or by its end (``00:05``), where that is unambiguous.
    """

    def __init__(self, hears: Mapping[str, Iterable[str]], origin: str) -> None:
        """``origin``: names the source in results (an option, or a file)."""
        self._hears = {listener.lower(): frozenset(map(str.lower, others)) for listener, others in hears.items()}
        self.origin = origin

    def hears(self, listener: bytes, speaker: bytes) -> bool | None:
        """Return whether a node can hear another one; None without links of the listener."""
        mine, other = name(listener), name(speaker)
        told = [each for node, each in self._hears.items() if mine.endswith(node)]
        return any(other.endswith(node) for each in told for node in each) if told else None

    def unknown(self, nodes: Iterable[bytes]) -> list[str]:
        """Return the names that fit none, or several, of these nodes."""
        texts = [name(each) for each in nodes]
        named = dict.fromkeys([*self._hears, *(each for told in self._hears.values() for each in sorted(told))])
        return [each for each in named if sum(text.endswith(each) for text in texts) != 1]


def told(options: Iterable[str]) -> Topology:
    """Return the links of ``--hears``: ``A=B,C`` (A hears B and C), or ``A-B-C`` (neighbours hear each other).

    Raises :class:`UsageError`.
    """
    hears: dict[str, set[str]] = {}
    for option in options:
        listener, equal, others = option.partition("=")
        chain = [each.strip() for each in option.split("-")]
        if equal and listener.strip() and all(each.strip() for each in others.split(",")):
            hears.setdefault(listener.strip(), set()).update(each.strip() for each in others.split(","))
        elif not equal and len(chain) > 1 and all(chain):
            for one, two in pairwise(chain):
                hears.setdefault(one, set()).add(two)
                hears.setdefault(two, set()).add(one)
        else:
            raise UsageError(f"--hears {option!r}: expected A=B,C (A hears B and C) or A-B-C (a line)")
    return Topology(hears, "--hears")


def table_of(path: Path) -> dict[str, object]:
    """Return the content of a TOML file. Raises :class:`UsageError`."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror}") from None
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise UsageError(f"{path}: not TOML: {error}") from None


def from_table(path: Path, table: Mapping[str, object]) -> Topology:
    """Return the links of a file with a table ``[hears]``: listener -> list of nodes. Raises :class:`UsageError`."""
    hears = table.get("hears")
    if not isinstance(hears, dict) or not all(
        isinstance(others, list) and all(isinstance(each, str) for each in others) for others in hears.values()
    ):
        raise UsageError(f'{path}: expected a scenario, or a table [hears] with lines as "00:02" = ["00:01", "00:03"]')
    return Topology(hears, str(path))
