"""dcp-bp.md: format, size, addresses and timing of beacons."""

from __future__ import annotations

import math
import statistics

from dcp_spec.constants import BP_SEQNO_MODULUS

from dcp_codec.values import VarCreate
from dcp_conformance.check.base import MOST_SENDERS, Context, Evidence, Invariant, Seen, Trace, name
from dcp_conformance.check.statements import CREATE, UPDATE
from dcp_conformance.check.stations import Origin
from dcp_conformance.definitions.broken_rules import broken_by
from dcp_conformance.definitions.results import Mark
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.frames.header_rules import judge

from .counters import MS, SequenceNumbers

BROADCAST = b"\xff" * 6
#: Number of changes of networkId from which on they are a fault, and not the user's configuration.
_CHANGES = 3
#: Maximum number of intervals between beacons that are kept for each sender.
_INTERVALS = 20_000


class BeaconFormat(Invariant):
    """Check that each frame is a valid beacon of the profile."""

    id = "CK_BP_FORMAT"
    section = "dcp-bp.md: Packet Format"
    purpose = "Every frame is a valid beacon of the profile up to its last octet"
    requirements = (
        "DATA-02", "DATA-03", "BP-HDR-01", "BP-HDR-02", "BP-HDR-06", "BP-HDR-07", "BP-HDR-10", "BP-HDR-11", "BP-FMT-01",
    )  # fmt: skip
    expect = "a beacon in the format of the profile"

    def feed(self, seen: Seen) -> None:
        """Report violations of the format, by requirement."""
        self._of_all += 1
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
    """Check the content of single records in beacons that can be decoded."""

    id = "CK_VD_RECORDS"
    section = "dcp-vardis.md: Instruction Records"
    purpose = "No single record violates the rules for its content"
    requirements = ("VD-PAY-03", "VD-TYP-02", "VD-TYP-07", "DATA-08")
    expect = "records with content that the specification permits"

    def feed(self, seen: Seen) -> None:
        """Report the dissector's warnings."""
        if seen.heard.containers:
            self._of_all += 1
        if seen.sound and not _doubtful(seen):
            return
        for problem in seen.dissection.warnings:
            if problem.reason == "foreign-node-id":
                # CK_SRP_OWN judges this.
                continue
            if problem.reason == "empty-description":
                # No fault of the sender: an application may create such a variable, but receivers reject it (X21).
                text = f"{name(seen.sender)}: {problem}"
                self.note("an empty description, which no node accepts (X21)", text, [Mark(seen.number)], "VD-CRE-15")
                continue
            mark = Mark(seen.number, problem.offset, 1, problem.path)
            self.violated(
                f"{name(seen.sender)}: {problem}",
                [mark],
                *broken_by(problem),
                once=(seen.sender, problem.reason),
            )


def _doubtful(seen: Seen) -> bool:
    """Whether a valid beacon can have warnings (:mod:`dcp_codec.views.lint`), except for reports of other nodes.

    The dissection, which finds the warnings, is expensive and not needed for most beacons.
    """
    beacon = seen.heard.beacon
    assert beacon is not None
    for payload in beacon.payloads:
        if not payload.content:
            return True
    for kind, records, ids, _, stated in seen.parts:
        if len(stated) < len(ids):
            return True
        if kind is CREATE:
            if not all(map(_flawless, records)):
                return True
        elif kind is UPDATE and not all(each.value for each in records):
            return True
    return False


def _flawless(create: VarCreate) -> bool:
    """Whether a create has nothing to warn about."""
    spec, update = create.spec, create.upd
    return bool(spec.rep_cnt and spec.descr and spec.descr.isascii() and update.value and spec.var_id == update.var_id)


class Broadcast(Invariant):
    """Check that beacons are sent to the broadcast address."""

    id = "CK_UWB_BROADCAST"
    section = "dcp-architecture.md: UWB"
    purpose = "Beacons are broadcast"
    requirements = ("UWB-01",)
    expect = "the broadcast address as destination"

    def applies(self) -> str:
        """Exclude links without Ethernet addresses."""
        return "" if self.context.profile.link.transport == "ethernet" else "over UDP, the socket selects the receivers"

    def feed(self, seen: Seen) -> None:
        """Check the destination address."""
        if seen.destination is None:
            return
        self._of_all += 1
        if seen.destination != BROADCAST:
            text = f"{name(seen.sender)} sends to {seen.destination.hex(':')}"
            self.violated(text, [Mark(seen.number, 0, 6)], once=(seen.sender, seen.destination))


class PacketSize(Invariant):
    """Check the length of beacons.

    Whether the BP header counts is open (X04): a beacon that exceeds the limit only by its header is reported as info.
    """

    id = "CK_BP_SIZE"
    section = "dcp-bp.md: Packet Format"
    purpose = "No beacon is longer than the limit in the PIXIT, or than the maximum of the profile's link"
    requirements = ("BP-FMT-02",)
    expect = "a bearer payload within the maximum packet size"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._limit = context.pics.pixit.max_packet_size or context.profile.limits.uwb_max_packet

    def feed(self, seen: Seen) -> None:
        """Compare the length without padding."""
        self._of_all += 1
        size = len(seen.heard.octets)
        if size <= self._limit:
            return
        size -= len(seen.dissection.padding)
        if size <= self._limit:
            return
        text = f"{name(seen.sender)} sends {size} octets; the limit is {self._limit}"
        header = seen.dissection.root.find("bp")
        blocks = size - (0 if header is None else header.length)
        if blocks <= self._limit and size <= self.context.profile.limits.uwb_max_packet:
            self.violated(f"{text} (X04: blocks-only)", [seen], verdict=Verdict.INFO, once=(seen.sender, "header"))
        else:
            self.violated(text, [seen], once=(seen.sender, "size"))


class NetworkIdentifier(Invariant):
    """Check that a sender keeps its network identifier."""

    id = "CK_BP_NETWORK"
    section = "dcp-bp.md: Data Types"
    purpose = "A sender does not change its network identifier"
    requirements = ("BP-HDR-04",)
    expect = "the same networkId in all beacons of a sender"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._known: dict[bytes, tuple[int, Trace]] = {}
        self._changes: dict[bytes, int] = {}

    def applies(self) -> str:
        """Exclude profiles without networkId (versions before 2.0)."""
        return "" if self.context.profile.has_header_field("networkId") else "beacons of this profile have no networkId"

    def interrupted(self) -> None:
        """Forget the identifiers: a restarted node may have another configuration."""
        self._known.clear()

    def feed(self, seen: Seen) -> None:
        """Compare with the previous networkId of the sender."""
        beacon = seen.heard.beacon
        if beacon is None or beacon.bp is None or beacon.bp.network_id is None:
            return
        number = beacon.bp.network_id
        before = self._known.get(seen.sender)
        if before is not None:
            self._of_all += 1
            if before[0] != number:
                changes = self._changes[seen.sender] = self._changes.get(seen.sender, 0) + 1
                text = f"{name(seen.sender)} changes from {before[0]:#06x} to {number:#06x}"
                if changes >= _CHANGES:
                    self.violated(f"{text}; it has changed {changes} times", [before[1], seen], once=seen.sender)
                else:
                    self.note("a sender that changes to another network", text, [before[1], seen])
        if before is not None or len(self._known) < MOST_SENDERS:
            self._known[seen.sender] = (number, seen.trace)


#: Of the normal distribution, for 99.999 %: a recording has many stations, and campaigns judge thousands of recordings.
_QUANTILE = 4.417


class BeaconPeriod(Invariant):
    """Check the mean interval between beacons."""

    id = "CK_BP_PERIOD"
    section = "dcp-bp.md: Transmit Path"
    purpose = "On average there is one beacon in each period"
    requirements = ("BP-TX-01",)
    expect = "a mean interval that agrees with the beacon period"
    enough = 1

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._last: dict[bytes, Trace] = {}
        self._intervals: dict[bytes, list[float]] = {}

    def interrupted(self) -> None:
        """Exclude the interval to the next beacon."""
        self._last.clear()

    def feed(self, seen: Seen) -> None:
        """Collect the intervals between beacons with successive numbers."""
        sender, trace = seen.sender, seen.trace
        last = self._last.get(sender)
        if last is None and len(self._last) >= MOST_SENDERS:
            return
        self._last[sender] = trace
        if last is None or trace.seqno is None or last.seqno is None:
            return
        if (trace.seqno - last.seqno) % BP_SEQNO_MODULUS == 1:
            intervals = self._intervals.get(sender)
            if intervals is None:
                intervals = self._intervals[sender] = []
            if len(intervals) < _INTERVALS:
                intervals.append((trace.time - last.time) / MS)

    def finish(self) -> None:
        """Compare the mean interval of each sender with the period, if there are at least 30 intervals."""
        pixit = self.context.pics.pixit
        for sender, all_intervals in self._intervals.items():
            median = statistics.median(all_intervals)
            # A node without payloads sends no beacon: a long pause is not a late beacon. A negative interval is a step
            # of the recorder's clock.
            intervals = [each for each in all_intervals if 0 <= each < 2.5 * median]
            if len(intervals) < 30:
                continue
            mean = statistics.fmean(intervals)
            spread = math.sqrt(statistics.fmean([(each - mean) ** 2 for each in intervals]))
            error = _QUANTILE * spread / math.sqrt(len(intervals))
            size = f"n = {len(intervals)}, jitter {spread:.1f} ms"
            text = f"{name(sender)}: {mean:.2f} ms +/- {error:.2f} (99.999 %), {size}"
            if not self.context.period_known:
                self.note("mean interval between beacons", f"{text}; the period is not specified", [])
                continue
            self.exercised()
            period, tolerance = pixit.beacon_period_ms, pixit.period_tolerance * pixit.beacon_period_ms
            if mean - error > period + tolerance or mean + error < period - tolerance:
                self.violated(f"{text}; the period is {period:g} ms (PIXIT)", [], once=sender)
            else:
                self.note("mean interval between beacons", text, [])


class SenderIdentifier(Invariant):
    """Compare senderId with the source address of the frame."""

    id = "CK_BP_SENDER"
    section = "dcp-bp.md: Data Types"
    purpose = "A station sends its own node identifier"
    requirements = ("BP-HDR-03", "BP-PAR-09", "DATA-04")
    expect = "the same senderId in all beacons of a station, and no other station with this senderId"

    def feed(self, seen: Seen) -> None:
        """Report differences that :mod:`dcp_conformance.check.stations` has found."""
        sender, source = seen.heard.sender, seen.heard.source
        if sender is None or seen.heard.beacon is None or not any(source):
            return
        if seen.origin is Origin.USUAL:
            # The first beacon of a station cannot be compared with anything.
            known = self.context.senders.get(seen.sender)
            if known is not None and known.beacons > 1:
                self._of_all += 1
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
            # A gateway may forward the beacons of other nodes.
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
