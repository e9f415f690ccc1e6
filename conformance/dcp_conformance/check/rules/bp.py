"""dcp-bp.md: what every beacon shows, and every sequence of beacons of one sender."""

from __future__ import annotations

import math
import statistics

from dcp_spec.constants import BP_SEQNO_MODULUS

from dcp_codec.values import VarCreate
from dcp_conformance.check.base import MOST_SENDERS, Context, Evidence, Invariant, Seen, Trace, name
from dcp_conformance.check.statements import CREATE, UPDATE
from dcp_conformance.check.stations import Origin
from dcp_conformance.frames.header_rules import judge
from dcp_conformance.model.broken_rules import broken_by
from dcp_conformance.model.results import Mark
from dcp_conformance.model.verdict import Verdict

from .counters import SequenceNumbers

MS = 1_000_000
BROADCAST = b"\xff" * 6
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
        if seen.sound:
            return
        for each in judge(seen.heard.octets, self.context.codec):
            mark = Mark(seen.number, seen.start + each.offset, each.length, each.path)
            self.violated(
                f"{name(seen.sender)}: {each}",
                [mark],
                *each.requirements,
                once=(seen.sender, each.requirements),
                cite=3,
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
        if seen.sound and not _doubtful(seen):
            return
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


def _doubtful(seen: Seen) -> bool:
    """Warnings about a sound beacon (:mod:`dcp_codec.views.lint`), apart from state reports of other nodes."""
    beacon = seen.heard.beacon
    assert beacon is not None
    for payload in beacon.payloads:
        if not payload.content:
            return True
    for kind, records, ids in seen.parts:
        if len(set(ids)) < len(ids):
            return True
        if kind is CREATE:
            if not all(map(_flawless, records)):
                return True
        elif kind is UPDATE and not all(each.value for each in records):
            return True
    return False


def _flawless(create: VarCreate) -> bool:
    spec, update = create.spec, create.upd
    return bool(spec.rep_cnt and spec.descr and spec.descr.isascii() and update.value and spec.var_id == update.var_id)


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
    """The limit on beacons. Whether the header of BP counts is open (X04), as long as the link carries it."""

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
        size = len(seen.heard.octets)
        if size <= self._limit:
            return
        size -= len(seen.dissection.padding)
        if size <= self._limit:
            return
        text = f"{name(seen.sender)} sends {size} octets, and the limit is {self._limit}"
        header = seen.dissection.root.find("bp")
        blocks = size - (0 if header is None else header.length)
        if blocks <= self._limit and size <= self.context.profile.limits.uwb_max_packet:
            self.violated(f"{text} (X04: blocks-only)", [seen], verdict=Verdict.INFO, once=(seen.sender, "header"))
        else:
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

    def interrupted(self) -> None:
        """It may have been put into another network."""
        self._known.clear()

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


#: Of the normal distribution, for 99.999 %: a recording has many stations, and campaigns judge thousands of recordings.
_QUANTILE = 4.417


class BeaconPeriod(Invariant):
    """When beacons come."""

    id = "CK_BP_PERIOD"
    section = "dcp-bp.md: Transmit Path"
    purpose = "In the long run there is one beacon in each period"
    requirements = ("BP-TX-01",)
    expect = "a mean interval that agrees with the beacon period"
    enough = 1

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._last: dict[bytes, Trace] = {}
        self._intervals: dict[bytes, list[float]] = {}

    def interrupted(self) -> None:
        """The next interval is none."""
        self._last.clear()

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
            error = _QUANTILE * spread / math.sqrt(len(intervals))
            size = f"n = {len(intervals)}, jitter {spread:.1f} ms"
            text = f"{name(sender)}: {mean:.2f} ms +/- {error:.2f} (99.999 %), {size}"
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
    """The node identifier in the header against the station that the frame comes from."""

    id = "CK_BP_SENDER"
    section = "dcp-bp.md: Data Types"
    purpose = "A station sends under its own node identifier"
    requirements = ("BP-HDR-03", "BP-PAR-09", "DATA-04")
    expect = "the same senderId in all beacons of a station, and in those of no other station"

    def feed(self, seen: Seen) -> None:
        """Compare by source address; :mod:`.stations` has found out what it says."""
        sender, source = seen.heard.sender, seen.heard.source
        if sender is None or seen.heard.beacon is None or not any(source):
            return
        if seen.origin is Origin.USUAL:
            # The first beacon of a station has nothing to be compared with.
            known = self.context.senders.get(seen.sender)
            if known is not None and known.beacons > 1:
                self.exercised()
            return
        self.exercised()
        frames: list[Evidence] = [*([Mark(seen.origin_frame)] if seen.origin_frame is not None else []), seen]
        address = source.hex(":")
        if seen.origin is Origin.WRONG:
            text = f"{address} sends a beacon as {name(sender)} that continues the numbers of its own beacons"
            self.violated(text, frames, "BP-HDR-03", once=(source, sender), cite=3)
        elif seen.origin is Origin.FORGED:
            text = f"{address} sends beacons as {name(sender)}, which is another station with other numbers"
            self.violated(text, frames, "BP-HDR-03", once=(source, sender), cite=3)
        else:
            # A gateway may carry the beacons of others.
            text = f"frames from {address} also carry the identifier {name(sender)}"
            self.violated(text, frames, once=(source, sender), verdict=Verdict.INFO)


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
