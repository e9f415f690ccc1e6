"""dcp-bp.md: the counter of beacons."""

from __future__ import annotations

from collections import deque

from dcp_spec.constants import BP_SEQNO_MODULUS

from dcp_conformance.check.base import MOST_SENDERS, Context, Invariant, Seen, Trace, name

MS = 1_000_000
#: A sender that has been restarted has sent so many beacons at most, or two in each period since it was last heard.
_RESTART = 3
#: So many restarts, each after less than so many beacons on the average, are none.
_RESTARTS, _LIVED = 5, 10
#: Numbers that were missing, by sender, that may still come: the recorder has them out of order.
_MISSING = 16
#: Counters narrower than they must be begin again after one of these numbers, at once.
NARROW = frozenset((1 << bits) - 1 for bits in (4, 7, 8, 10, 12, 15, 16, 24, 31))
_NO_ACCIDENT = 4095
#: So many beacons with one number, not two alike or all alike, show a counter that stands still.
_STUCK = 4
#: So many beacons, each right after the one before, of which no two have numbers that follow each other.
_JUMPS = 20


def narrow_counter(seen: dict[tuple[str, int], int], who: str, before: int, *, restarts_known: bool) -> bool:
    """Whether 0 after ``before`` shows a counter that is too narrow, and not a restart at just that number.

    ``seen`` counts, by node and number. What nobody can come to by chance shows it at once, and so does everything
    where restarts are known.
    """
    count = seen[who, before] = seen.get((who, before), 0) + 1
    return restarts_known or count > 1 or before >= _NO_ACCIDENT


class SequenceNumbers(Invariant):
    """The beacon counter."""

    id = "CK_BP_SEQNO"
    section = "dcp-bp.md: Transmit Path"
    purpose = "Beacons of a sender are numbered one after the other"
    requirements = ("BP-HDR-08", "BP-HDR-09")
    expect = "each beacon's seqno is that of the one before plus one, modulo 2^32"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._last: dict[bytes, Trace] = {}
        self._missing: dict[bytes, deque[int]] = {}
        self._restarts: dict[bytes, tuple[int, int]] = {}
        """How often a sender started again, and how many beacons of it there are."""
        self._period = context.pics.pixit.beacon_period_ms * MS
        self._begin: int | None = None
        self._same: dict[bytes, int] = {}
        """How many beacons have had the number of the last one."""
        self._wraps: dict[tuple[str, int], int] = {}
        self._steps: dict[bytes, tuple[int, int]] = {}
        """How many beacons came within two periods after the one before, and how many of them had the next number."""
        self.lost: dict[bytes, int] = {}

    def feed(self, seen: Seen) -> None:
        """Compare with the sender's last number."""
        if self._begin is None:
            self._begin = seen.time
        number, first = seen.heard.seqno, self.context.profile.behaviour.first_beacon_seqno
        if number is None:
            return
        last = self._last.get(seen.sender)
        if last is None:
            if len(self._last) >= MOST_SENDERS:
                return
            self._last[seen.sender] = seen.trace
            if number == first and seen.time > self._begin:
                self.exercised("BP-HDR-08")
            return
        before = last.seqno or 0
        step = (number - before) % BP_SEQNO_MODULUS
        missing = self._missing.get(seen.sender)
        restarts, beacons = self._restarts.get(seen.sender, (0, 1))
        self._restarts[seen.sender] = (restarts, beacons + 1)
        if missing and number in missing:
            missing.remove(number)
            self.lost[seen.sender] -= 1
            text = f"{name(seen.sender)}: {number} after {before}"
            self.note("beacons that were recorded out of order", text, [last, seen])
            return
        self._last[seen.sender] = seen.trace
        self._count(seen, last, step)
        if step == 1:
            self.exercised()
        else:
            self._judge(seen, last, step)

    def _judge(self, seen: Seen, last: Trace, step: int) -> None:
        """Judge a number that is not the next one."""
        number, before = seen.heard.seqno or 0, last.seqno or 0
        text = f"{name(seen.sender)}: {number} after {before}"
        restarts, beacons = self._restarts[seen.sender]
        if step == 0 and seen.heard.octets == last.octets and self._same[seen.sender] < _STUCK:
            self.note("the same beacon twice", f"{name(seen.sender)}: seqno {number}", [last, seen])
        elif self._narrow(seen, before, seen.time - last.time):
            bits = before.bit_length()
            self.violated(f"{text}: a counter of {bits} bits", [last, seen], "BP-HDR-08", once=(seen.sender, bits))
        elif 1 < step < BP_SEQNO_MODULUS // 2:
            self.lost[seen.sender] = self.lost.get(seen.sender, 0) + step - 1
            self._missing.setdefault(seen.sender, deque(maxlen=_MISSING)).extend(
                (before + each) % BP_SEQNO_MODULUS for each in range(1, min(step, _MISSING + 1))
            )
        elif self._restarted(number, seen.time - last.time, step):
            restarts += 1
            # What is missing of the life before will not come any more.
            self._missing.pop(seen.sender, None)
            self._restarts[seen.sender] = (restarts, beacons)
            if restarts >= _RESTARTS and beacons < _LIVED * restarts:
                self.violated(
                    f"{text}; it has started again {restarts} times",
                    [last, seen],
                    "BP-HDR-08",
                    once=(seen.sender, "again"),
                )
            else:
                self.note("a sender starts again", text, [last, seen])
        else:
            self.violated(text, [last, seen], "BP-HDR-08", once=(seen.sender, step if step < 2 else "back"))

    def _narrow(self, seen: Seen, before: int, pause: int) -> bool:
        """Whether the counter of a sender is narrower than it must be."""
        if seen.heard.seqno != 0 or before not in NARROW or not 0 <= pause < 2 * self._period:
            return False
        return narrow_counter(self._wraps, name(seen.sender), before, restarts_known=self.context.restarts_known)

    def _count(self, seen: Seen, last: Trace, step: int) -> None:
        """Count what shows only in many beacons. A frame that was recorded twice lies beside itself."""
        pause = seen.time - last.time
        if step == 0 and pause >= self._period / 2:
            self._same[seen.sender] = self._same.get(seen.sender, 1) + 1
        else:
            self._same[seen.sender] = self._same.get(seen.sender, 1) if step == 0 else 1
        if 0 <= pause < 2 * self._period:
            soon, next_ones = self._steps.get(seen.sender, (0, 0))
            self._steps[seen.sender] = (soon + 1, next_ones + (step == 1))

    def interrupted(self) -> None:
        """Numbers may start again; what is missing will not come."""
        self._last.clear()
        self._missing.clear()
        self._same.clear()

    def _restarted(self, number: int, pause: int, step: int) -> bool:
        """Whether a sender may have been restarted and have come so far since it was last heard."""
        if step == 0 and pause < 3 * self._period:
            return False
        return number <= _RESTART + 2 * pause / self._period

    def finish(self) -> None:
        """Say what was lost: that is the recorder's loss as likely as the sender's fault."""
        for sender, (soon, next_ones) in self._steps.items():
            if soon >= _JUMPS and not next_ones:
                text = f"{name(sender)}: none of {soon} beacons has the number after that of the beacon right before it"
                self.violated(text, [], "BP-HDR-08", once=(sender, "jumps"))
        for sender, count in self.lost.items():
            if count:
                self.note("beacons that are not in the recording", f"{name(sender)}: {count}", [])
