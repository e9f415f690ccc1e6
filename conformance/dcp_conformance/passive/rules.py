"""Invariants that every beacon of an implementation under test must satisfy, whatever the tester sends.

During a run the tester violates the protocol on purpose: it sends malformed beacons, forged senders, impossible
sequence numbers, and records of variables that no node has created. It also resets and restarts the implementation and
sets its parameters. Only properties that no stimulus can excuse are therefore judged: the octets that the
implementation sends, its own counters, and the payloads that it composes from one state of its database. Of the
invariants of ``check``:

* Used unchanged: ``CK_BP_FORMAT``, ``CK_UWB_BROADCAST``, ``CK_BP_NETWORK``, ``CK_BP_SEQNO``,
  ``CK_VD_ORDER``, ``CK_VD_PAYLOAD``.
* Used with a change: ``CK_BP_PERIOD`` (pauses are frequent in a run, so that only short intervals are judged, and the
  implementation may have reported its period), ``CK_BP_SIZE`` (the implementation may have reported its limit),
  ``CK_DATA_ORDER`` (only time stamps of the implementation's own state reports; peers send creation times of any kind),
  ``CK_SRP_SEQNO`` (only reports with the implementation's own identifier), ``CK_SRP_OWN`` (if nodeId of the report is
  the source address of the frame, the senderId is wrong).
* Not used: ``CK_DATA_PACKED`` (the profile itself declares the octets that belong to no field), ``CK_BP_SENDER``
  (frames of another sender are never attributed to the implementation), ``CK_VD_RECORDS`` (most of its findings would
  be records forwarded from the tester; ``CK_VD_DISTINCT`` and ``CK_BP_EMPTY`` judge the others), ``CK_SRP_TIME`` and
  ``CK_SRP_VALUES`` (they only report; test cases judge these values), ``CK_SRP_LENGTH`` (``CK_BP_FORMAT`` finds reports
  of another length).
* Not used, since their occasions come from invalid beacons of peers: ``CK_VD_SEQNO``, ``CK_VD_VALUE``, ``CK_VD_SPEC``,
  ``CK_VD_DELETED``, ``CK_VD_CREATION``, ``CK_VD_REPEAT``, ``CK_VD_REQUEST``, ``CK_VD_ANSWER_UPDATE``,
  ``CK_VD_ANSWER_CREATE``, ``CK_VD_TAKES_CREATE``, ``CK_VD_TAKES_UPDATE``, ``CK_VD_TAKES_DELETE``, ``CK_VD_ASK_UPDATE``,
  ``CK_VD_ASK_CREATE``, ``CK_VD_TEACH``, ``CK_VD_BACKED``, ``CK_VD_ENDLESS``.
* Not used, since they compare several nodes, and a run has only one: ``CK_NET_HEARS``, ``CK_NET_AGREES``,
  ``CK_NET_SILENT``.
"""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from typing import Final

from dcp_spec.constants import ICType

from dcp_conformance.check.base import Context, Invariant, Seen, name
from dcp_conformance.check.rules.bp import (
    BeaconFormat,
    BeaconPeriod,
    Broadcast,
    NetworkIdentifier,
    PacketSize,
)
from dcp_conformance.check.rules.counters import MS, SequenceNumbers
from dcp_conformance.check.rules.data import ByteOrder
from dcp_conformance.check.rules.srp import OwnReports, ReportNumbers
from dcp_conformance.check.rules.vardis import ContainerOrder, PayloadConsistency
from dcp_conformance.definitions.verdict import Verdict

#: Number of intervals after a start that are compared, and the maximum difference in ms of equal ones.
_INTERVALS, _ALIKE = 6, 0.3
#: Maximum number of starts whose intervals are kept.
_STARTS = 256


class OwnByteOrder(ByteOrder):
    """Check the byte order of time stamps in the implementation's own state reports."""

    def applies(self) -> str:
        """Exclude profiles that declare little-endian time stamps, and those without a known epoch."""
        if self._stamp.byte_order != "big":
            return "the profile declares little-endian time stamps"
        return super().applies()

    def feed(self, seen: Seen) -> None:
        """Compare the time stamp in both byte orders with the time of the recording."""
        report = seen.heard.report
        if report is None:
            return
        little = int.from_bytes(report.t_stamp.to_bytes(self._stamp.width, "big"), "little")
        if self._near(report.t_stamp, seen.time) != self._near(little, seen.time):
            self.exercised()
            if self._near(little, seen.time):
                text = f"{name(seen.sender)}: tStamp is near the time of the recording only if read as little-endian"
                self.violated(text, [seen], once=seen.sender, cite=3)


class OwnNodeId(OwnReports):
    """Check that the BP header and the state report have the same node identifier."""

    requirements = ("SRP-TYP-04", "SRP-RX-06", "BP-HDR-03")

    def feed(self, seen: Seen) -> None:
        """Compare both; if the report has the source address of the frame, report the senderId as wrong."""
        report = seen.heard.report
        if report is None or report.node_id != seen.heard.source or report.node_id == seen.heard.sender:
            super().feed(seen)
            return
        text = f"{name(report.node_id)} sends beacons as {name(seen.sender)}"
        self.violated(text, [seen], "BP-HDR-03", once=(seen.sender, report.node_id), cite=3)


class OwnReportNumbers(ReportNumbers):
    """Check the counter of the implementation's own reports; ``CK_SRP_OWN`` finds those with another identifier."""

    def feed(self, seen: Seen) -> None:
        """Compare a report of the sender with its previous one."""
        report = seen.heard.report
        if report is not None and report.node_id == seen.sender:
            super().feed(seen)


class UndisturbedPeriod(BeaconPeriod):
    """Check the mean interval between beacons, without pauses in which the node had nothing to send.

    If calls of the upper tester are slow, most intervals may be pauses: there is less to send than one beacon in each
    period. Then only intervals up to ``_LONGEST`` periods are judged.
    """

    #: Longest interval that is not a pause, in periods. A skipped beacon makes a longer one, unless jitter is large.
    _LONGEST = 1.6
    #: Minimum number of intervals, and minimum share of short intervals if the others are pauses.
    _ENOUGH, _PAUSING = 100, 0.02

    def finish(self) -> None:
        """Compare mean and median with the period; both differ from it if the period is wrong."""
        period = float(self.context.parameters.get("BPPAR_BEACON_PERIOD", self.context.pics.pixit.beacon_period_ms))
        tolerance = self.context.pics.pixit.period_tolerance * period
        for sender, intervals in self._intervals.items():
            median, kept = self._without_pauses(intervals, period)
            if len(kept) < self._ENOUGH:
                continue
            self.exercised()
            mean = statistics.fmean(kept)
            error = 2.576 * statistics.pstdev(kept) / len(kept) ** 0.5
            off = (min(mean, median) - error - tolerance > period, max(mean, median) + error + tolerance < period)
            if any(off):
                text = f"{name(sender)}: {mean:.2f} ms +/- {error:.2f} (99 %), median {median:.2f} ms, n = {len(kept)}"
                text += f"; the period is {period:g} ms"
                if mean > period and (why := self.context.overload()):
                    # On an overloaded machine, an implementation that runs on it waits in every period.
                    self.violated(f"{text}; but {why}", [], once=sender, verdict=Verdict.INCONCLUSIVE)
                else:
                    self.violated(text, [], once=sender)

    def _without_pauses(self, intervals: Sequence[float], period: float) -> tuple[float, list[float]]:
        """Return the median and the intervals to judge, in ms; few or none if pauses cannot be recognised."""
        # The median of all intervals: with much jitter, the mean of the selected ones is too low.
        usual = statistics.median(intervals)
        if usual >= self._LONGEST * period:
            short = [each for each in intervals if 0 <= each < self._LONGEST * period]
            if len(short) > self._PAUSING * len(intervals):
                return statistics.median(short), short
        return usual, [each for each in intervals if 0 <= each < self._LONGEST * usual]


class RepeatedJitter(Invariant):
    """Find jitter that repeats after each start, as from a random number generator with a fixed seed."""

    id = "CK_BP_JITTER"
    section = "dcp-bp.md: Transmit Path"
    purpose = "Jittered beacon intervals differ from start to start"
    requirements = ("BP-TX-02",)
    expect = "different intervals after each start"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._first = context.profile.behaviour.first_beacon_seqno
        self._last: tuple[int, int] | None = None
        self._run: list[float] | None = None
        """Intervals in ms since the last start; None if a beacon is missing, or if there are enough intervals."""
        self._starts: dict[int, list[tuple[float, ...]]] = {}
        """The intervals after earlier starts, by the first of them in units of ``_ALIKE``."""

    def interrupted(self) -> None:
        """Forget the intervals: the implementation may restart."""
        self._last = self._run = None

    def feed(self, seen: Seen) -> None:
        """Collect the first intervals after each start."""
        number = seen.heard.seqno
        last, self._last = self._last, None if number is None else (number, seen.time)
        if number is None or (last is None and number != self._first):
            self._run = None
        elif last is None:
            self._run = []
        elif self._run is not None and number == last[0] + 1:
            self._run.append((seen.time - last[1]) / MS)
            if len(self._run) == _INTERVALS:
                self._compare(tuple(self._run), seen)
                self._run = None
        else:
            self._run = None

    def _compare(self, run: tuple[float, ...], seen: Seen) -> None:
        """Compare the intervals (ms) after a start with those after earlier starts, and store them."""
        self.exercised()
        if max(run) - min(run) < 10 * _ALIKE:
            # Beacons without jitter are always alike.
            return
        if len({round(each / _ALIKE) for each in run}) < _INTERVALS - 1:
            # With a coarse clock there are few different intervals, and they repeat by chance.
            return
        unit = round(run[0] / _ALIKE)
        alike = [each for near in (unit - 1, unit, unit + 1) for each in self._starts.get(near, ())]
        if any(all(abs(a - b) <= _ALIKE for a, b in zip(run, before, strict=True)) for before in alike):
            shown = ", ".join(f"{each:.1f}" for each in run)
            text = f"{name(seen.sender)} repeats the intervals of an earlier start: {shown} ms"
            self.violated(text, [seen], verdict=Verdict.INFO, once=seen.sender)
        elif len(self._starts) < _STARTS:
            self._starts.setdefault(unit, []).append(run)


class OwnPacketSize(PacketSize):
    """Check the length of beacons against the limit that the implementation reported, or that of the PIXIT."""

    def feed(self, seen: Seen) -> None:
        """Compare with the limit known so far."""
        told = self.context.parameters.get("BPPAR_MAXIMUM_PACKET_SIZE")
        if isinstance(told, int):
            self._limit = told
        super().feed(seen)


class DistinctVariables(Invariant):
    """Check that a container has at most one record of each variable."""

    id = "CK_VD_DISTINCT"
    section = "dcp-vardis.md: Payload Construction"
    purpose = "No variable appears twice in a container"
    requirements = ("VD-PAY-03",)
    expect = "distinct variables in each container"

    def feed(self, seen: Seen) -> None:
        """Compare the variable identifiers in each container."""
        records: dict[int, set[int]] = {}
        instructions = seen.heard.instructions()
        for each in instructions if len(instructions) > 1 else ():
            known = records.setdefault(each.container, set())
            if each.position:
                self.exercised()
            if each.var_id in known:
                text = f"{name(seen.sender)}: variable {each.var_id} appears twice among {each.kind.label}"
                self.violated(text, [each], once=(seen.sender, each.kind))
            known.add(each.var_id)


class EmptyBlocks(Invariant):
    """Check that payload blocks are not empty."""

    id = "CK_BP_EMPTY"
    section = "dcp-bp.md: Packet Format"
    purpose = "No payload block is empty"
    requirements = ("VD-PAY-04", "BP-TXP-03")
    expect = "at least one octet in each payload block"

    def feed(self, seen: Seen) -> None:
        """Check the payloads of a beacon that can be decoded."""
        if seen.heard.beacon is None:
            return
        for payload in seen.heard.beacon.payloads:
            if payload.vardis is not None:
                self.exercised("VD-PAY-04")
                if not payload.vardis:
                    text = f"{name(seen.sender)} sends a VarDis payload without containers"
                    self.violated(text, [seen], "VD-PAY-04", once=(seen.sender, "vardis"))
            elif payload.data is not None:
                self.exercised("BP-TXP-03")
                if not payload.data:
                    text = f"{name(seen.sender)} sends an empty block of protocol {payload.protocol_id}"
                    self.violated(text, [seen], "BP-TXP-03", once=(seen.sender, "data"))


class MostSummaries(Invariant):
    """Check the number of summaries against the maximum that the implementation reported, or that of the PIXIT."""

    id = "CK_VD_SUMMARIES"
    section = "dcp-vardis.md: Payload Construction"
    purpose = "No payload has more summaries than VARDISPAR_MAX_SUMMARIES"
    requirements = ("VD-CMP-02",)
    expect = "at most VARDISPAR_MAX_SUMMARIES summaries in a payload"

    def applies(self) -> str:
        """Require a maximum from the implementation or the PIXIT: the default of a profile is only an assumption."""
        return "" if self._most() is not None else "VARDISPAR_MAX_SUMMARIES is unknown (pixit.max_summaries is not set)"

    def _most(self) -> int | None:
        """Return the maximum; None if it is unknown."""
        told = self.context.parameters.get("VARDISPAR_MAX_SUMMARIES")
        return int(told) if isinstance(told, int) else self.context.pics.pixit.max_summaries

    def feed(self, seen: Seen) -> None:
        """Count the summaries of a beacon."""
        count, most = len(seen.heard.instructions(ICType.SUMMARIES)), self._most()
        if most is None or not count:
            return
        self.exercised()
        if count > most:
            text = f"{name(seen.sender)} sends {count} summaries in a beacon; the maximum is {most}"
            self.violated(text, [seen], once=seen.sender)


#: Rules that need only beacons with state reports, and rules that need only beacons with VarDis records.
OF_REPORTS: Final = frozenset({"CK_DATA_ORDER", "CK_SRP_OWN", "CK_SRP_SEQNO"})
OF_INSTRUCTIONS: Final = frozenset({"CK_VD_ORDER", "CK_VD_PAYLOAD", "CK_VD_DISTINCT", "CK_VD_SUMMARIES"})

RULES: Final[tuple[type[Invariant], ...]] = (
    OwnByteOrder,
    BeaconFormat,
    Broadcast,
    OwnPacketSize,
    NetworkIdentifier,
    SequenceNumbers,
    UndisturbedPeriod,
    RepeatedJitter,
    EmptyBlocks,
    OwnNodeId,
    OwnReportNumbers,
    ContainerOrder,
    PayloadConsistency,
    DistinctVariables,
    MostSummaries,
)
