"""How often a node may say the instructions about one variable (VD-SCP-01, VD-SCP-02).

A counter of a node is never above repCnt, so however many reasons there were until a moment, behind it come at most
repCnt beacons and what was composed already. And a payload without the instruction, composed behind the last reason,
shows that its queue was empty: from then on it may not come at all.
"""

from __future__ import annotations

from dcp_spec.constants import ICType

Key = tuple[ICType, int]
"""Kind of an instruction, and for updates the sequence number."""

#: Payloads that can have been composed before a moment and be on the air after it, within the latency.
IN_FLIGHT = 2
#: Keys that are remembered of one variable.
_MOST = 128


class Repetitions:
    """The instructions about one variable. Times are ns."""

    __slots__ = ("_allowed", "_behind", "_counted", "_since")

    def __init__(self) -> None:
        self._allowed: dict[Key, int] = {}
        self._counted: dict[Key, int] = {}
        self._since: dict[Key, int] = {}
        """When there was a reason to say it, the last time."""
        self._behind: dict[Key, int] = {}
        """In how many beacons it stood that were certainly composed behind that."""

    def clear(self) -> None:
        """Nothing is to be said of the variable, and nothing counts that was."""
        self._allowed.clear()
        self._counted.clear()
        self._since.clear()
        self._behind.clear()

    def arm(self, key: Key, times: int, time: int) -> None:
        """There is a reason to say it in so many beacons."""
        counted = self._counted.get(key, 0)
        self._allowed[key] = min(self._allowed.get(key, 0) + times, counted + times + IN_FLIGHT)
        self._since[key] = time
        self._behind.pop(key, None)
        if len(self._allowed) > _MOST:
            oldest = next(iter(self._allowed))
            for each in (self._allowed, self._counted, self._since, self._behind):
                each.pop(oldest, None)

    def allowed(self, key: Key) -> int:
        """In how many beacons it may stand; 0 without a reason."""
        return self._allowed.get(key, 0)

    def counted(self, key: Key) -> int:
        """In how many beacons it stood."""
        return self._counted.get(key, 0)

    def armed_at(self, key: Key) -> int | None:
        """When there was a reason to say it, the last time."""
        return self._since.get(key)

    def count(self, key: Key) -> int:
        """It stands in a beacon, and is about what the variable is now; in how many it stood by then."""
        number = self._counted[key] = self._counted.get(key, 0) + 1
        return number

    def stands_behind(self, key: Key) -> int:
        """It stands in a beacon that was composed behind the last reason; in how many such it stood before."""
        before = self._behind.get(key, 0)
        self._behind[key] = before + 1
        return before
