"""How a state of a variable came to a node, and where newer ones stop on the way to it."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from .entry import Entry, Stamp

Hears = Callable[[bytes, bytes], bool | None]
"""Whether a node (first argument) hears another one; None if that is not known."""


#: Time in ns after its last record with a value in which a node may have been the source of the value.
_RECENT = 10_000_000_000


class Hop(NamedTuple):
    """The state of a node, and the frame that brought it."""

    entry: Entry
    source: Entry | None
    """The state of the node that sent the frame; None if the recording has no such frame."""
    frame: Stamp | None
    """The last frame with the value before the node stated it."""
    frames: int
    """Number of frames with the value that may have brought it. With 1, the node has certainly received this one."""


def sources(entries: Sequence[Entry], producers: Mapping[int, bytes], hears: Hears) -> list[Hop]:
    """Return for each state, in the order of time, the frame that brought it; none for those of producers."""
    carriers: dict[tuple[int, int], dict[bytes, Entry]] = {}
    known: dict[bytes, dict[bytes, bool]] = {}
    """Node -> whether it may hear another one."""
    hops = []
    for each in entries:
        others = carriers.setdefault((each.var_id, each.number), {})
        best: tuple[Stamp, Entry] | None = None
        frames, node, frame, least = 0, each.node, (each.frame,), each.time - _RECENT
        if each.number >= 0 and producers.get(each.var_id) != node:
            heard, gone = known.setdefault(node, {node: False}), []
            for who, other in others.items():
                # Numbers are used again: the node that sent the value still states it, or did so shortly before.
                if other.until < least:
                    gone.append(who)
                    continue
                if (may := heard.get(who)) is None:
                    may = heard[who] = hears(node, who) is not False
                if not may or not (carried := other.carried):
                    continue
                latest = carried[-1]
                if latest < frame:
                    frames += len(carried)
                elif before := bisect_left(carried, frame):
                    frames += before
                    latest = carried[before - 1]
                else:
                    continue
                if best is None or latest > best[0]:
                    best = latest, other
            for who in gone:
                del others[who]
        hops.append(Hop(each, None, None, 0) if best is None else Hop(each, best[1], best[0], frames))
        others[node] = each
    return hops


def came(entry: Entry, entries: Sequence[Entry], producers: Mapping[int, bytes], hears: Hears) -> list[Hop]:
    """Return the hops on which a state came to a node, that of the producer first.

    ``entries`` are all of the variable, in the order of time.
    """
    of = {id(hop.entry): hop for hop in sources(entries, producers, hears)}
    hops = [of[id(entry)]]
    # The source of a state begins before it, so that this ends.
    while (source := hops[-1].source) is not None:
        hops.append(of[id(source)])
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
