"""Count how often a node may send the instructions about one variable (VD-SCP-01, VD-SCP-02).

The counter of an instruction in a node is at most repCnt. From any time on, at most repCnt beacons and the payloads
that were already composed contain the instruction, however many events caused it before. A payload without the
instruction that was composed after the last cause shows that the queue was empty: the instruction must not be sent
after it.
"""

from __future__ import annotations

import msgspec
from dcp_spec.constants import ICType

Key = tuple[ICType, int]
"""Kind of an instruction, and the sequence number of an update (0 for other kinds)."""

#: Payloads that can be composed before a cause and sent after it, within the latency.
IN_FLIGHT = 2
#: Maximum number of keys of one variable. Nearly all are of updates.
_MOST = 128


class _Instruction(msgspec.Struct):
    """The numbers of beacons that may contain an instruction (``allowed``) and that did (``counted``)."""

    allowed: int = 0
    counted: int = 0
    since: int | None = None
    """Time of the last cause in ns."""
    behind: int = 0
    """Number of beacons with the instruction that were certainly composed after the last cause."""


class Repetitions(dict[Key, _Instruction]):
    """Counts the instructions about one variable; ``clear`` removes all counts. Times are ns."""

    __slots__ = ()

    def __missing__(self, key: Key) -> _Instruction:
        one = self[key] = _Instruction()
        if len(self) > _MOST:
            # Each sequence number of an update has a key; the oldest are no longer sent.
            del self[next(each for each in self if each[0] is ICType.UPDATES)]
        return one

    def arm(self, key: Key, times: int, time: int) -> None:
        """Allow the instruction in ``times`` more beacons, because of an event at ``time``."""
        one = self[key]
        if key[0] is ICType.UPDATES:
            # Move the key to the end: sequence numbers wrap around, and the oldest key is removed first.
            self[key] = self.pop(key)
        flying = one.counted + IN_FLIGHT
        one.allowed = (one.allowed if one.allowed < flying else flying) + times
        one.since, one.behind = time, 0

    def drop(self, key: Key) -> None:
        """Record that the instruction left its queue: no further beacon may contain it."""
        one = self.get(key)
        if one is not None:
            one.allowed = min(one.allowed, one.counted)

    def allowed(self, key: Key) -> int:
        """Return the number of beacons that may contain the instruction; 0 without a cause."""
        one = self.get(key)
        return 0 if one is None else one.allowed

    def counted(self, key: Key) -> int:
        """Return the number of beacons that contained the instruction."""
        one = self.get(key)
        return 0 if one is None else one.counted

    def count(self, key: Key) -> tuple[int, int]:
        """Count a beacon that contains the instruction for the current state of the variable.

        Return the number of beacons that contained it, including this one, and the number that may contain it.
        """
        one = self[key]
        one.counted += 1
        return one.counted, one.allowed

    def stands(self, key: Key, composed: int) -> tuple[int, int] | None:
        """Count a beacon that contains the instruction and was composed at time ``composed`` or later.

        Return the time of the last cause, and the number of earlier beacons with the instruction since then; None if
        this beacon may have been composed before the cause.
        """
        one = self.get(key)
        if one is None or one.since is None or composed <= one.since:
            return None
        one.behind += 1
        return one.since, one.behind - 1
