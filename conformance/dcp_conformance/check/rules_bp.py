"""dcp-bp.md: what every beacon shows, and every sequence of beacons of one sender."""

from __future__ import annotations

import math
import statistics
from collections import deque

from dcp_spec.constants import BP_SEQNO_MODULUS

from dcp_conformance.broken import broken_by
from dcp_conformance.header_rules import judge
from dcp_conformance.results import Mark
from dcp_conformance.verdict import Verdict

from .base import MOST_SENDERS, Context, Invariant, Seen, Trace, name

MS = 1_000_000
BROADCAST = b"\xff" * 6
#: A sender that has been restarted has sent so many beacons at most, or two in each period since it was last heard.
_RESTART = 3
#: So many restarts, each after less than so many beacons on the average, are none.
_RESTARTS, _LIVED = 5, 10
#: Numbers that were missing, by sender, that may still come: the recorder has them out of order.
_MISSING = 16
#: A parameter may be changed; so many changes are no choice of anybody.
_CHANGES = 3
#: Intervals of a sender that statistics are made of.
_INTERVALS = 20_000


class BeaconFormat(Invariant):
    """Octets that are no beacon of the profile."""

    id = "CK_BP_FORMAT"
    section = "dcp-bp.md: Packet Format"
    purpose = "Every frame is a beacon of the profile, to its last octet"
    requirements = (
        "DATA-02", "DATA-03", "BP-HDR-01", "BP-HDR-02", "BP-HDR-06", "BP-HDR-07", "BP-HDR-10", "BP-HDR-11", "BP-FMT-01",
    )  # fmt: skip
    expect = "a beacon as the profile lays it out"

    def feed(self, seen: Seen) -> None:
        """Report what the octets break, by requirement."""
        self.exercised()
        if seen.heard.problem is None:
            return
        for each in judge(seen.heard.octets, self.context.codec):
            mark = Mark(seen.number, seen.start + each.offset, each.length, each.path)
            self.violated(
                f"{name(seen.sender)}: {each}", [mark], *each.requirements, once=(seen.sender, each.requirements)
            )


class RecordRules(Invariant):
    """What is well formed and still against a rule."""

    id = "CK_VD_RECORDS"
    section = "dcp-vardis.md: Instruction Records"
    purpose = "No record breaks a rule that can be seen in it alone"
    requirements = ("VD-PAY-03", "VD-TYP-02", "VD-TYP-07", "DATA-08")
    expect = "records as the specification wants them sent"

    def feed(self, seen: Seen) -> None:
        """Report the dissector's warnings."""
        if seen.heard.containers:
            self.exercised()
        for problem in seen.dissection.warnings:
            if problem.reason == "foreign-node-id":
                # CK_SRP_OWN looks at that.
                continue
            if problem.reason == "empty-description":
                # Where an application may have it so, and everybody refuses it, nobody is to blame (X21).
                text = f"{name(seen.sender)}: {problem}"
                self.note("an empty description, which no node takes (X21)", text, [Mark(seen.number)], "VD-CRE-15")
                continue
            mark = Mark(seen.number, problem.offset, 1, problem.path)
            self.violated(
                f"{name(seen.sender)}: {problem}",
                [mark],
                *broken_by(problem),
                once=(seen.sender, problem.reason),
            )


class Broadcast(Invariant):
    """Beacons go to everybody."""

    id = "CK_UWB_BROADCAST"
    section = "dcp-architecture.md: UWB"
    purpose = "Beacons are broadcast"
    requirements = ("UWB-01",)
    expect = "the broadcast address as destination"

    def applies(self) -> str:
        """Only where frames have addresses that mean something."""
        return "" if self.context.profile.link.transport == "ethernet" else "over UDP, the socket decides who hears it"

    def feed(self, seen: Seen) -> None:
        """Look at the destination."""
        if seen.destination is None:
            return
        self.exercised()
        if seen.destination != BROADCAST:
            text = f"{name(seen.sender)} sends to {seen.destination.hex(':')}"
            self.violated(text, [Mark(seen.number, 0, 6)], once=(seen.sender, seen.destination))


class PacketSize(Invariant):
    """The limit on beacons."""

    id = "CK_BP_SIZE"
    section = "dcp-bp.md: Packet Format"
    purpose = "No beacon is longer than the limit that the PIXIT gives, or than the link of the profile carries"
    requirements = ("BP-FMT-02",)
    expect = "a bearer payload within the maximum packet size"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._limit = context.pics.pixit.max_packet_size or context.profile.limits.uwb_max_packet

    def feed(self, seen: Seen) -> None:
        """Compare, without padding."""
        self.exercised()
        size = len(seen.heard.octets) - len(seen.dissection.padding)
        if size > self._limit:
            text = f"{name(seen.sender)} sends {size} octets, and the limit is {self._limit}"
            self.violated(text, [seen], once=(seen.sender, "size"))


class NetworkIdentifier(Invariant):
    """One network identifier."""

    id = "CK_BP_NETWORK"
    section = "dcp-bp.md: Data Types"
    purpose = "A sender stays in one network"
    requirements = ("BP-HDR-04",)
    expect = "the same networkId in all beacons of a sender"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._known: dict[bytes, tuple[int, Trace]] = {}
        self._changes: dict[bytes, int] = {}

    def applies(self) -> str:
        """Since 2.0."""
        return "" if self.context.profile.has_header_field("networkId") else "beacons of this profile have no networkId"

    def feed(self, seen: Seen) -> None:
        """Compare with the sender's last one."""
        beacon = seen.heard.beacon
        if beacon is None or beacon.bp is None or beacon.bp.network_id is None:
            return
        number = beacon.bp.network_id
        before = self._known.get(seen.sender)
        if before is not None:
            self.exercised()
            if before[0] != number:
                changes = self._changes[seen.sender] = self._changes.get(seen.sender, 0) + 1
                text = f"{name(seen.sender)} changes from {before[0]:#06x} to {number:#06x}"
                if changes >= _CHANGES:
                    self.violated(f"{text}; it has changed {changes} times", [before[1], seen], once=seen.sender)
                else:
                    self.note("a sender goes to another network", text, [before[1], seen])
        if before is not None or len(self._known) < MOST_SENDERS:
            self._known[seen.sender] = (number, seen.trace)


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
        text = f"{name(seen.sender)}: {number} after {before}"
        missing = self._missing.get(seen.sender)
        restarts, beacons = self._restarts.get(seen.sender, (0, 1))
        self._restarts[seen.sender] = (restarts, beacons + 1)
        if missing is not None and number in missing:
            missing.remove(number)
            self.lost[seen.sender] -= 1
            self.note("beacons that were recorded out of order", text, [last, seen])
            return
        self._last[seen.sender] = seen.trace
        if step == 1:
            self.exercised()
        elif step == 0 and seen.heard.octets == last.octets:
            self.note("the same beacon twice", f"{name(seen.sender)}: seqno {number}", [last, seen])
        elif 1 < step < BP_SEQNO_MODULUS // 2:
            self.lost[seen.sender] = self.lost.get(seen.sender, 0) + step - 1
            self._missing.setdefault(seen.sender, deque(maxlen=_MISSING)).extend(
                (before + each) % BP_SEQNO_MODULUS for each in range(1, min(step, _MISSING + 1))
            )
        elif self._restarted(number, seen.time - last.time, step):
            restarts += 1
            self._restarts[seen.sender] = (restarts, beacons + 1)
            if restarts >= _RESTARTS and beacons < _LIVED * restarts:
                self.violated(
                    f"{text}; it has started again {restarts} times", [last, seen], once=(seen.sender, "again")
                )
            else:
                self.note("a sender starts again", text, [last, seen])
        else:
            self.violated(text, [last, seen], once=(seen.sender, step if step < 2 else "back"))

    def _restarted(self, number: int, pause: int, step: int) -> bool:
        """Whether a sender may have been restarted and have come so far since it was last heard."""
        if step == 0 and pause < 3 * self._period:
            return False
        return number <= _RESTART + 2 * pause / self._period

    def finish(self) -> None:
        """Say what was lost: that is the recorder's loss as likely as the sender's fault."""
        for sender, count in self.lost.items():
            if count:
                self.note("beacons that are not in the recording", f"{name(sender)}: {count}", [])


class BeaconPeriod(Invariant):
    """When beacons come."""

    id = "CK_BP_PERIOD"
    section = "dcp-bp.md: Transmit Path"
    purpose = "In the long run there is one beacon in each period"
    requirements = ("BP-TX-01",)
    expect = "a mean interval that agrees with the beacon period"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._last: dict[bytes, Trace] = {}
        self._intervals: dict[bytes, list[float]] = {}

    def feed(self, seen: Seen) -> None:
        """Collect the intervals between beacons that follow each other."""
        last = self._last.get(seen.sender)
        if last is None and len(self._last) >= MOST_SENDERS:
            return
        self._last[seen.sender] = seen.trace
        if last is None or seen.heard.seqno is None or last.seqno is None:
            return
        if (seen.heard.seqno - last.seqno) % BP_SEQNO_MODULUS == 1:
            intervals = self._intervals.setdefault(seen.sender, [])
            if len(intervals) < _INTERVALS:
                intervals.append((seen.time - last.time) / MS)

    def finish(self) -> None:
        """Compare the mean, as far as the sample allows."""
        pixit = self.context.pics.pixit
        for sender, all_intervals in self._intervals.items():
            median = statistics.median(all_intervals)
            # Without anything to say there is no beacon, so a long pause is no late beacon. Time that goes back is a
            # clock of the recorder that was set.
            intervals = [each for each in all_intervals if 0 <= each < 2.5 * median]
            if len(intervals) < 30:
                continue
            mean, spread = statistics.fmean(intervals), statistics.pstdev(intervals)
            error = 2.576 * spread / math.sqrt(len(intervals))
            text = f"{name(sender)}: {mean:.2f} ms +/- {error:.2f} (99 %), n = {len(intervals)}, jitter {spread:.1f} ms"
            if not self.context.period_known:
                self.note("mean interval between beacons", f"{text}; the period is not stated", [])
                continue
            self.exercised()
            period, tolerance = pixit.beacon_period_ms, pixit.period_tolerance * pixit.beacon_period_ms
            if mean - error > period + tolerance or mean + error < period - tolerance:
                self.violated(f"{text}; the period is {period:g} ms (PIXIT)", [], once=sender)
            else:
                self.note("mean interval between beacons", text, [])


class SenderIdentifier(Invariant):
    """Who sends."""

    id = "CK_BP_SENDER"
    section = "dcp-bp.md: Data Types"
    purpose = "One station sends under one node identifier"
    requirements = ("BP-HDR-03", "BP-PAR-09", "DATA-04")
    expect = "the same senderId in all beacons of a station"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._known: dict[bytes, tuple[bytes, Trace]] = {}

    def feed(self, seen: Seen) -> None:
        """Compare by source address."""
        sender, source = seen.heard.sender, seen.heard.source
        if sender is None or seen.heard.beacon is None or not any(source):
            return
        before = self._known.get(source)
        if before is None:
            if len(self._known) < MOST_SENDERS:
                self._known[source] = (sender, seen.trace)
            return
        self.exercised()
        if before[0] != sender:
            # A gateway may carry the beacons of others.
            text = f"frames from {source.hex(':')} carry {name(before[0])} and {name(sender)}"
            self.violated(text, [before[1], seen], once=(source, sender), verdict=Verdict.INFO)


RULES: tuple[type[Invariant], ...] = (
    BeaconFormat,
    Broadcast,
    PacketSize,
    NetworkIdentifier,
    SenderIdentifier,
    SequenceNumbers,
    BeaconPeriod,
    RecordRules,
)
