"""How a state of a variable came to a node, and where newer ones stop on the way to it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from .ledger import Entry, Stamp

Hears = Callable[[bytes, bytes], bool | None]
"""Whether a node (first argument) hears another one; None if that is not known."""


class Hop(NamedTuple):
    """The state of a node, and the frame that brought it."""

    entry: Entry
    source: Entry | None
    """The state of the node that sent the frame; None if the recording has no such frame."""
    frame: Stamp | None
    """The last frame with the value before the node stated it."""
    frames: int
    """Number of frames with the value that may have brought it. With 1, the node has certainly received this one."""


def source_of(entry: Entry, entries: Sequence[Entry], hears: Hears) -> Hop:
    """Return the frame that brought a state; ``entries`` are all of the variable."""
    best: tuple[Stamp, Entry] | None = None
    frames = 0
    for each in entries:
        if each.number != entry.number or each.node == entry.node or hears(entry.node, each.node) is False:
            continue
        before = [stamp for stamp in each.carried if stamp[0] < entry.frame]
        # Numbers are used again: the node that sent the value still states it, or did so shortly before.
        if not before or entry.time - each.until > 10_000_000_000:
            continue
        frames += len(before)
        if best is None or before[-1] > best[0]:
            best = before[-1], each
    return Hop(entry, None, None, 0) if best is None else Hop(entry, best[1], best[0], frames)


def came(entry: Entry, entries: Sequence[Entry], producer: bytes | None, hears: Hears) -> list[Hop]:
    """Return the hops on which a state came to a node, that of the producer first."""
    hops: list[Hop] = []
    while len(hops) < 64:
        hop = Hop(entry, None, None, 0) if entry.node == producer else source_of(entry, entries, hears)
        hops.append(hop)
        if hop.source is None or any(hop.source is each.entry for each in hops):
            break
        entry = hop.source
    return hops[::-1]


def at(entries: Sequence[Entry], node: bytes, time: int) -> Entry | None:
    """Return the state of a node at a time (ns since 1970); ``entries`` are all of the variable, in order of time."""
    return next((each for each in reversed(entries) if each.node == node and each.time <= time), None)


def ahead(entry: Entry | None, than: Entry | None, own: Sequence[Entry]) -> bool:
    """Return whether a state is newer than another one; ``own`` are the states of the producer, in order of time."""
    if entry is None:
        return False
    order = {each.number: place for place, each in enumerate(own)}
    if entry.number not in order:
        return False
    return than is None or order[entry.number] > order.get(than.number, -1)


def way(
    node: bytes, nodes: Sequence[bytes], producer: bytes, hears: Hears, reached: Callable[[bytes], bool]
) -> list[bytes]:
    """Return the nodes from the first one that is ``reached`` to ``node``, by the fewest links.

    Links that are not known are used only if the known ones do not lead to the producer. Empty if there is no way.
    """
    for known in (True, False):
        ways = {node: [node]}
        edge = [node]
        while edge:
            following: list[bytes] = []
            for each in edge:
                for other in nodes:
                    link = hears(each, other)
                    if other not in ways and (link or (link is None and not known)):
                        ways[other] = [other, *ways[each]]
                        following.append(other)
                        if other == producer or reached(other):
                            return ways[other]
            edge = following
    return []
