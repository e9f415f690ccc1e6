"""Who hears whom in a recording."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

from dcp_spec.constants import ICType

from .base import MOST_VARIABLES, Context
from .rules_vardis import SENT, seqno_of
from .said import Said

MS = 1_000_000
#: For how long before and after it was shown that one node hears another this is believed, in ns.
BELIEF = 20_000 * MS
#: A gap in the recording shows within so many ns, or never.
GAP_SHOWS = 2_000 * MS
#: Of the times at which it was shown, so many are remembered of each pair.
_REMEMBERED = 64
_PENDING = 10_000


class _Shown(NamedTuple):
    """It looks as if one node heard another."""

    begin: int
    end: int
    listener: bytes
    speaker: bytes


class Hearing:
    """Who is known to hear whom.

    A node that comes to a number of a variable, of which one other node alone has sent the value, hears that one, if no
    third has sent it that the recorder missed: that is waited for. Only variables with a single life count; of others
    several nodes may come up with the same.
    """

    def __init__(self, context: Context) -> None:
        self._context = context
        self._half = 1 << (8 * context.profile.types.var_seqno.width - 1)
        self._numbers: dict[tuple[bytes, int], int] = {}
        """(node, variable) -> the number that it sent last."""
        self._origins: dict[tuple[int, int], tuple[int, set[bytes]]] = {}
        """(variable, number) -> since when, and who has sent its value."""
        self._open: deque[_Shown] = deque()
        self._heard: dict[tuple[bytes, bytes], deque[int]] = {}

    def feed(self, instruction: Said, sender: bytes, time: int) -> None:
        """Take an instruction."""
        while self._open and self._open[0].end + GAP_SHOWS < time:
            self._believe(self._open.popleft())
        if instruction.kind not in SENT:
            return
        var_id, number = instruction.var_id, seqno_of(instruction)
        had = self._numbers.get((sender, var_id))
        if had is not None or len(self._numbers) < MOST_VARIABLES:
            self._numbers[sender, var_id] = number
        if instruction.kind is ICType.SUMMARIES:
            return
        lives = self._context.lives
        if lives.born(var_id) is None:
            self._origins.pop((var_id, number), None)
            return
        # The numbers come round again: half a circle ahead is half a circle back.
        self._origins.pop((var_id, (number + self._half) % (2 * self._half)), None)
        begin, senders = self._origins.get((var_id, number), (time, set()))
        if not senders:
            if len(self._origins) >= MOST_VARIABLES:
                self._origins.clear()
            self._origins[var_id, number] = (time, {sender})
        elif sender not in senders:
            new = had != number and lives.producer(var_id) != sender
            if new and len(senders) == 1 and time - begin < BELIEF and len(self._open) < _PENDING:
                self._open.append(_Shown(begin, time, sender, next(iter(senders))))
            senders.add(sender)

    def _believe(self, shown: _Shown) -> None:
        if self._context.senders.complete(shown.begin, shown.end) and len(self._heard) < MOST_VARIABLES:
            self._heard.setdefault((shown.listener, shown.speaker), deque(maxlen=_REMEMBERED)).append(shown.end)

    def finish(self) -> None:
        """No gap will show any more."""
        while self._open:
            self._believe(self._open.popleft())

    def hears(self, listener: bytes, speaker: bytes, time: int) -> bool:
        """Whether it was shown, not long before or after, that ``listener`` hears ``speaker``."""
        shown = self._heard.get((listener, speaker), ())
        return any(abs(time - each) <= BELIEF for each in shown)
