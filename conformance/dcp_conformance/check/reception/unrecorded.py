"""Times at which nodes may have sent beacons that the recorder missed.

A reaction shows that its node received one of the recorded causes only if no beacon outside the recording can be the
cause: a neighbour may have forwarded the same record in a beacon that the recorder missed.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable

#: Number of periods after the last recorded beacon of a node in which the recorder may have missed beacons of it. Later
#: the node is assumed to be silent. A period lasts at most ``_LONGEST`` ns.
_TAIL, _LONGEST = 2, 500_000_000
#: Time (ns) before the first recorded beacon of a node for each earlier beacon that its sequence number tells.
_EACH = 1_000_000_000
#: Maximum number of gaps that are kept; further ones extend the last gap of their node.
_GAPS = 50_000

Timeline = tuple[list[int], list[int]]
"""Times in order, and for each the nodes (a mask) that may have sent unrecorded beacons from then to the next time."""


class Unrecorded:
    """The gaps in the beacons of all nodes. All times are ns of :attr:`.observer.Observer.time`."""

    def __init__(self) -> None:
        self._gaps: dict[int, list[tuple[int, int]]] = {}
        self._count = 0

    def gap(self, bit: int, begin: int, end: int) -> None:
        """Add a gap of a node between two recorded beacons. Gaps of one node must be added in order."""
        gaps = self._gaps.setdefault(bit, [])
        if gaps and (begin <= gaps[-1][1] or self._count >= _GAPS):
            gaps[-1] = (gaps[-1][0], end)
        else:
            gaps.append((begin, end))
            self._count += 1

    def before_first(self, bit: int, missed: int, time: int) -> None:
        """Add the gap before the first recorded beacon of a node, which has sent ``missed`` beacons before."""
        if missed > 0:
            self.gap(bit, max(0, time - missed * _EACH), time)

    def restart(self, bit: int, last: int, before: int, missed: int, time: int) -> None:
        """Add the gaps around a restart of a node: after its last beacon, and before its first one afterwards.

        ``last``, ``before``: times of its last recorded beacon and the one before. ``missed``: number of beacons that
        it has sent between the restart and the recorded beacon at ``time``.
        """
        self.gap(bit, last, min(_falls_silent(last, before), time))
        self.before_first(bit, missed, time)

    def timeline(self, last: Iterable[tuple[int, int, int]]) -> Timeline:
        """Return the gaps by time.

        ``last``: for all nodes, the bit of the node and the times of its last recorded beacon and the one before; these
        are equal if there is only one.
        """
        changes: list[tuple[int, int]] = []
        for bit, gaps in self._gaps.items():
            for begin, end in gaps:
                changes += ((begin, bit), (end, bit))
        for bit, time, before in last:
            changes += ((time, bit), (_falls_silent(time, before), bit))
        changes.sort()
        times, masks, mask = [0], [0], 0
        for time, bit in changes:
            # The gaps of a node do not overlap: each of its changes ends a gap or begins one.
            mask ^= bit
            if time == times[-1]:
                masks[-1] = mask
            else:
                times.append(time)
                masks.append(mask)
        return times, masks

    def forget(self, before: int) -> None:
        """Forget the gaps that ended before a time."""
        for bit, gaps in list(self._gaps.items()):
            self._gaps[bit] = kept = [each for each in gaps if each[1] >= before]
            self._count -= len(gaps) - len(kept)


def _falls_silent(last: int, before: int) -> int:
    """Return the time from which a node is assumed to be silent, from the times of its last two beacons."""
    return last + _TAIL * min(last - before, _LONGEST)


def silent_senders(timeline: Timeline, begin: int, end: int) -> int:
    """Return the nodes (a mask) that may have sent an unrecorded beacon between two times."""
    times, masks = timeline
    place = bisect_right(times, begin) - 1
    found = masks[place]
    place += 1
    while place < len(times) and times[place] < end:
        found |= masks[place]
        place += 1
    return found
