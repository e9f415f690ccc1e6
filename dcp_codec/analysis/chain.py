"""How a state of a variable came to a node, and where newer ones stop on the way to it."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Mapping, Sequence
from itertools import takewhile
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


def sources(entries: Sequence[Entry], producers: Mapping[int, bytes], hears: Hears) -> list[Hop]:
    """Return for each state, in the order of time, the frame that brought it; none for those of producers."""
    hops = [Hop(each, None, None) for each in entries]
    states: dict[tuple[int, int], list[int]] = {}
    """Variable and number -> the places of its states in ``entries``."""
    for place, each in enumerate(entries):
        if each.number >= 0:
            states.setdefault((each.var_id, each.number), []).append(place)
    known: dict[tuple[bytes, bytes], bool] = {}
    """(listener, speaker) -> False if the listener cannot hear the speaker."""
    for (var_id, _), places in states.items():
        if len(places) < 2:
            continue
        carried = sorted([(stamp, place) for place in places for stamp in entries[place].carried])
        latest: dict[bytes, int] = {}
        """Node -> the place of its latest state so far."""
        for here in places:
            each = entries[here]
            node, begin = each.node, bisect_left(carried, ((each.frame,),))
            while begin and producers.get(var_id) != node:
                begin -= 1
                stamp, place = carried[begin]
                other = entries[place]
                if place >= here:
                    continue
                if latest[other.node] != place or other.until < each.time - _RECENT:
                    # The node had left this state before: it cannot be the source of any later state.
                    del carried[begin]
                    continue
                pair = node, other.node
                if (may := known.get(pair)) is None:
                    may = known[pair] = node != other.node and hears(*pair) is not False
                if may:
                    hops[here] = Hop(each, other, stamp)
                    break
            latest[node] = here
    return hops


def count(hop: Hop, entries: Sequence[Entry], hears: Hears) -> int:
    """Return the number of frames with a value that may have brought it to a node.

    With 1, the node has certainly received this frame. ``entries`` are all of the variable, in the order of time.
    """
    each, others = hop.entry, dict[bytes, Entry]()
    for other in takewhile(lambda other: other is not each, entries):
        if other.number == each.number and other.node != each.node and hears(each.node, other.node) is not False:
            others[other.node] = other
    near = [other for other in others.values() if other.until >= each.time - _RECENT]
    return sum(bisect_left(other.carried, (each.frame,)) for other in near)


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
