"""Count how often a node may send the instructions about one variable (VD-SCP-01, VD-SCP-02).

A counter of a node is at most repCnt. After any moment, at most repCnt beacons and the payloads that were already
composed contain the instruction, however many reasons there were before. A payload without the instruction that was
composed after the last reason shows that the queue was empty: after it, the instruction must not be sent.
"""

from __future__ import annotations

import msgspec
from dcp_spec.constants import ICType

Key = tuple[ICType, int]
"""Kind of an instruction, and for updates the sequence number."""

#: Payloads that can be composed before a moment and sent after it, within the latency.
IN_FLIGHT = 2
#: Keys that are remembered of one variable; there are far fewer that are no updates.
_MOST = 128


class _Instruction(msgspec.Struct):
    """One instruction: in how many beacons it may stand, and in how many it stood."""

    allowed: int = 0
    counted: int = 0
    since: int | None = None
    """When there was a reason to say it, the last time."""
    behind: int = 0
    """The number of beacons with it that were certainly composed after that."""


class Repetitions(dict[Key, _Instruction]):
    """The instructions about one variable; none after ``clear``. Times are ns."""

    __slots__ = ()

    def __missing__(self, key: Key) -> _Instruction:
        one = self[key] = _Instruction()
        if len(self) > _MOST:
            # Each number of an update has a key; the oldest ones are not sent any more.
            del self[next(each for each in self if each[0] is ICType.UPDATES)]
        return one

    def arm(self, key: Key, times: int, time: int) -> None:
        """Allow it in this number of beacons."""
        one = self[key]
        if key[0] is ICType.UPDATES:
            # The last of them; numbers come again.
            self[key] = self.pop(key)
        flying = one.counted + IN_FLIGHT
        one.allowed = (one.allowed if one.allowed < flying else flying) + times
        one.since, one.behind = time, 0

    def allowed(self, key: Key) -> int:
        """In how many beacons it may stand; 0 without a reason."""
        one = self.get(key)
        return 0 if one is None else one.allowed

    def counted(self, key: Key) -> int:
        """In how many beacons it stood."""
        one = self.get(key)
        return 0 if one is None else one.counted

    def count(self, key: Key) -> tuple[int, int]:
        """Count a beacon that contains it, about the present state of the variable.

        In how many it stood by then, and in how many it may stand.
        """
        one = self[key]
        one.counted += 1
        return one.counted, one.allowed

    def stands(self, key: Key, composed: int) -> tuple[int, int] | None:
        """Count a beacon that contains it and was composed at this time or later.

        Return the time of the last reason, and the number of beacons after it that contained the instruction before;
        None if this beacon may be older than the reason.
        """
        one = self.get(key)
        if one is None or one.since is None or composed <= one.since:
            return None
        one.behind += 1
        return one.since, one.behind - 1
