"""dcp-bp.md: the sequence numbers of beacons."""

from __future__ import annotations

from collections import deque

from dcp_spec.constants import BP_SEQNO_MODULUS

from dcp_conformance.check.base import MOST_SENDERS, Context, Invariant, Seen, Trace, name

MS = 1_000_000
#: The number of the first beacon heard after a restart is at most this, plus two for each period of silence.
_RESTART = 3
#: Apparent restarts are a fault of the counter if there are at least ``_RESTARTS`` of them, on average less than
#: ``_LIVED`` beacons apart.
_RESTARTS, _LIVED = 5, 10
#: Number of missing sequence numbers, for each sender, that may still follow: recorders store some frames out of order.
_MISSING = 16
#: Maximum values of counters that are narrower than 32 bits.
NARROW = frozenset((1 << bits) - 1 for bits in (4, 7, 8, 10, 12, 15, 16, 24, 31))
#: From this number on, a single wrap to 0 proves a narrow counter: a restart at just that number is too improbable.
_NO_ACCIDENT = 4095
#: Number of beacons with one sequence number that are a stuck counter; fewer equal beacons are copies of one beacon.
_STUCK = 4
#: Number of successive beacons, without any step of one between their numbers, that are a fault of the counter.
_JUMPS = 20


def narrow_counter(seen: dict[tuple[str, int], int], who: str, before: int, *, restarts_known: bool) -> bool:
    """Whether the number 0 after ``before`` proves a counter with too few bits, and not a restart at that number.

    ``seen`` counts the occurrences by node and number; this call adds one. The first occurrence is a proof if
    ``before`` is large or if all restarts are known; otherwise the second one is.
    """
    count = seen[who, before] = seen.get((who, before), 0) + 1
    return restarts_known or count > 1 or before >= _NO_ACCIDENT


class SequenceNumbers(Invariant):
    """Check the sequence numbers of beacons."""

    id = "CK_BP_SEQNO"
    section = "dcp-bp.md: Transmit Path"
    purpose = "The sequence number of a sender increases by one with each beacon"
    requirements = ("BP-HDR-08", "BP-HDR-09")
    expect = "the seqno of each beacon is the previous one plus one, modulo 2^32"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._last: dict[bytes, Trace] = {}
        self._missing: dict[bytes, deque[int]] = {}
        self._restarts: dict[bytes, int] = {}
        """Node -> number of its restarts."""
        self._beacons: dict[bytes, int] = {}
        """Node -> number of its beacons."""
        self._period = context.pics.pixit.beacon_period_ms * MS
        self._begin: int | None = None
        self._same: dict[bytes, int] = {}
        """Node -> number of successive beacons with the same sequence number, if there are several."""
        self._wraps: dict[tuple[str, int], int] = {}
        """(node, number) -> how often 0 followed this number."""
        self._soon: dict[bytes, int] = {}
        """Node -> number of beacons within two periods after the previous one."""
        self._next: set[bytes] = set()
        """Nodes with at least one beacon that was in time and had the successor of the previous beacon's number."""
        self.lost: dict[bytes, int] = {}
        """Node -> number of missing beacons."""

    def feed(self, seen: Seen) -> None:
        """Compare with the previous number of the sender."""
        if self._begin is None:
            self._begin = seen.time
        number, sender = seen.heard.seqno, seen.sender
        if number is None:
            return
        last = self._last.get(sender)
        if last is None:
            if len(self._last) >= MOST_SENDERS:
                return
            self._last[sender] = seen.trace
            if number == self.context.profile.behaviour.first_beacon_seqno and seen.time > self._begin:
                self.exercised("BP-HDR-08")
            return
        before = last.seqno or 0
        step = (number - before) % BP_SEQNO_MODULUS
        self._beacons[sender] = self._beacons.get(sender, 1) + 1
        missing = self._missing.get(sender) if self._missing else None
        if missing and number in missing:
            missing.remove(number)
            self.lost[seen.sender] -= 1
            text = f"{name(seen.sender)}: {number} after {before}"
            self.note("beacons that were recorded out of order", text, [last, seen])
            return
        self._last[sender] = seen.trace
        self._count(seen, last, step)
        if step == 1:
            self._of_all += 1
        else:
            self._judge(seen, last, step)

    def _judge(self, seen: Seen, last: Trace, step: int) -> None:
        """Judge a number that is not the successor of the previous one."""
        number, before = seen.heard.seqno or 0, last.seqno or 0
        text = f"{name(seen.sender)}: {number} after {before}"
        restarts, beacons = self._restarts.get(seen.sender, 0), self._beacons[seen.sender]
        if step == 0 and seen.heard.octets == last.octets and self._same.get(seen.sender, 1) < _STUCK:
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
            # Beacons from before the restart will not follow any more.
            self._missing.pop(seen.sender, None)
            self._restarts[seen.sender] = restarts
            if restarts >= _RESTARTS and beacons < _LIVED * restarts:
                self.violated(
                    f"{text}; it has restarted {restarts} times",
                    [last, seen],
                    "BP-HDR-08",
                    once=(seen.sender, "again"),
                )
            else:
                self.note("a restarted sender", text, [last, seen])
        else:
            self.violated(text, [last, seen], "BP-HDR-08", once=(seen.sender, step if step < 2 else "back"))

    def _narrow(self, seen: Seen, before: int, pause: int) -> bool:
        """Whether the number 0 after ``before``, ``pause`` ns later, shows a counter of fewer than 32 bits."""
        if seen.heard.seqno != 0 or before not in NARROW or not 0 <= pause < 2 * self._period:
            return False
        return narrow_counter(self._wraps, name(seen.sender), before, restarts_known=self.context.restarts_known)

    def _count(self, seen: Seen, last: Trace, step: int) -> None:
        """Count equal numbers and steps, which show a fault only over many beacons."""
        pause = seen.time - last.time
        # A much shorter pause is a copy of the same frame in the recording.
        if step == 0 and pause >= self._period / 2:
            self._same[seen.sender] = self._same.get(seen.sender, 1) + 1
        elif step != 0 and self._same:
            self._same.pop(seen.sender, None)
        if 0 <= pause < 2 * self._period:
            self._soon[seen.sender] = self._soon.get(seen.sender, 0) + 1
            if step == 1:
                self._next.add(seen.sender)

    def interrupted(self) -> None:
        """Forget the previous numbers: they may start again after a restart."""
        self._last.clear()
        self._missing.clear()
        self._same.clear()

    def _restarted(self, number: int, pause: int, step: int) -> bool:
        """Whether a restart during ``pause`` (ns) explains the number ``number``."""
        if step == 0 and pause < 3 * self._period:
            return False
        return number <= _RESTART + 2 * pause / self._period

    def finish(self) -> None:
        """Report counters that never step by one, and the missing beacons; the recorder may have lost these."""
        for sender, soon in self._soon.items():
            if soon >= _JUMPS and sender not in self._next:
                text = f"{name(sender)}: none of {soon} beacons has the successor of the previous beacon's number"
                self.violated(text, [], "BP-HDR-08", once=(sender, "jumps"))
        for sender, count in self.lost.items():
            if count:
                self.note("beacons missing in the recording", f"{name(sender)}: {count}", [])
