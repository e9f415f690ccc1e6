"""Which invariants hold for an implementation under test, whatever it is sent.

During a run the peers lie on purpose: malformed beacons, forged senders, impossible sequence numbers, variables that
nobody ever created. The tester also resets and restarts the implementation and sets its parameters. What remains to be
judged is what no stimulus can excuse: the octets that the implementation sends, its own counters, and what it composes
from one state of its database. Of the invariants of ``check``:

* Used as they are: ``CK_BP_FORMAT``, ``CK_UWB_BROADCAST``, ``CK_BP_NETWORK``, ``CK_BP_SEQNO``,
  ``CK_VD_ORDER``, ``CK_VD_PAYLOAD``.
* Used with a change: ``CK_BP_PERIOD`` (pauses are frequent in a run, so that only short intervals are judged, and the
  implementation may have told its period), ``CK_BP_SIZE`` (it may have told its limit),
  ``CK_DATA_ORDER`` (only time stamps of the implementation's own state reports; peers send creation times of any kind),
  ``CK_SRP_SEQNO`` (only reports under the implementation's own name), ``CK_SRP_OWN`` (where the address of the station
  is that of the report, the header is wrong).
* Not used: ``CK_DATA_PACKED`` (the profile itself declares the octets that belong to no field), ``CK_BP_SENDER``
  (frames of another sender are never attributed to the implementation), ``CK_VD_RECORDS`` (most of what it finds is
  forwarded from a lying peer; what is not is judged by ``CK_VD_DISTINCT`` and ``CK_BP_EMPTY``), ``CK_SRP_TIME``
  and ``CK_SRP_VALUES`` (they judge nothing, and cases look at that), ``CK_SRP_LENGTH`` (a report of another length is
  what ``CK_BP_FORMAT`` finds).
* Not used, since their occasions come from peers that lie: ``CK_VD_SEQNO``, ``CK_VD_VALUE``, ``CK_VD_SPEC``,
  ``CK_VD_DELETED``, ``CK_VD_CREATION``, ``CK_VD_REPEAT``, ``CK_VD_REQUEST``, ``CK_VD_ANSWER_UPDATE``,
  ``CK_VD_ANSWER_CREATE``, ``CK_VD_TAKES_CREATE``, ``CK_VD_TAKES_UPDATE``, ``CK_VD_TAKES_DELETE``, ``CK_VD_ASK_UPDATE``,
  ``CK_VD_ASK_CREATE``, ``CK_VD_TEACH``, ``CK_VD_BACKED``, ``CK_VD_ENDLESS``.
* Not used, since they are about several nodes, of which a run has one: ``CK_NET_HEARS``, ``CK_NET_AGREES``,
  ``CK_NET_SILENT``.
"""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from typing import Final

from dcp_spec.constants import ICType

from dcp_conformance.check.base import Context, Invariant, Seen, name
from dcp_conformance.check.rules.bp import (
    MS,
    BeaconFormat,
    BeaconPeriod,
    Broadcast,
    NetworkIdentifier,
    PacketSize,
)
from dcp_conformance.check.rules.counters import SequenceNumbers
from dcp_conformance.check.rules.data import ByteOrder
from dcp_conformance.check.rules.srp import OwnReports, ReportNumbers
from dcp_conformance.check.rules.vardis import ContainerOrder, PayloadConsistency
from dcp_conformance.model.verdict import Verdict

#: Intervals after a start that are compared, and how close (ms) they must be to be the same.
_INTERVALS, _ALIKE = 6, 0.3
#: Starts that are remembered.
_STARTS = 256


class OwnByteOrder(ByteOrder):
    """Network byte order in the implementation's own state reports."""

    def applies(self) -> str:
        """Only where the profile does not itself declare another order."""
        if self._stamp.byte_order != "big":
            return "the profile declares time stamps with the least significant octet first"
        return super().applies()

    def feed(self, seen: Seen) -> None:
        """Read the time stamp in both orders."""
        report = seen.heard.report
        if report is None:
            return
        little = int.from_bytes(report.t_stamp.to_bytes(self._stamp.width, "big"), "little")
        if self._near(report.t_stamp, seen.time) != self._near(little, seen.time):
            self.exercised()
            if self._near(little, seen.time):
                text = f"{name(seen.sender)}: tStamp is such a time only when read least significant octet first"
                self.violated(text, [seen], once=seen.sender, cite=3)


class OwnNodeId(OwnReports):
    """One identifier in the header and in state reports."""

    requirements = ("SRP-TYP-04", "SRP-RX-06", "BP-HDR-03")

    def feed(self, seen: Seen) -> None:
        """Compare; where the station's address agrees with the report, the header is wrong."""
        report = seen.heard.report
        if report is None or report.node_id != seen.heard.source or report.node_id == seen.heard.sender:
            super().feed(seen)
            return
        text = f"{name(report.node_id)} sends beacons as {name(seen.sender)}"
        self.violated(text, [seen], "BP-HDR-03", once=(seen.sender, report.node_id), cite=3)


class OwnReportNumbers(ReportNumbers):
    """The counter of the implementation's own reports; ``CK_SRP_OWN`` finds those under another name."""

    def feed(self, seen: Seen) -> None:
        """Compare reports of the sender with its last one."""
        report = seen.heard.report
        if report is not None and report.node_id == seen.sender:
            super().feed(seen)


class UndisturbedPeriod(BeaconPeriod):
    """The mean interval between beacons, of those between which there was something to send all the time.

    Where calls of the upper tester are slow, most intervals may be pauses: there is less to send than a beacon in each
    period. Those that are no longer than the period allows are judged then.
    """

    #: Of the period. Two intervals in a row without anything to send in between are longer, unless jitter is large.
    _LONGEST = 1.6
    #: Intervals that are enough for a mean, and the share of all that has to be short if the others are pauses.
    _ENOUGH, _PAUSING = 100, 0.02

    def finish(self) -> None:
        """Compare mean and median; both are off if the period is."""
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
                    # An implementation on this machine waits for its turn in every period.
                    self.violated(f"{text}; but {why}", [], once=sender, verdict=Verdict.INCONCLUSIVE)
                else:
                    self.violated(text, [], once=sender)

    def _without_pauses(self, intervals: Sequence[float], period: float) -> tuple[float, list[float]]:
        """The median and the intervals to judge, in ms; few or none if it is open what the others are."""
        # Of all of them: with much jitter the mean of those that are kept is too low.
        usual = statistics.median(intervals)
        if usual >= self._LONGEST * period:
            short = [each for each in intervals if 0 <= each < self._LONGEST * period]
            if len(short) > self._PAUSING * len(intervals):
                return statistics.median(short), short
        return usual, [each for each in intervals if 0 <= each < self._LONGEST * usual]


class RepeatedJitter(Invariant):
    """Draws that begins again with the same numbers."""

    id = "CK_BP_JITTER"
    section = "dcp-bp.md: Transmit Path"
    purpose = "Jittered beacon intervals differ from start to start"
    requirements = ("BP-TX-02",)
    expect = "other intervals after each start"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._first = context.profile.behaviour.first_beacon_seqno
        self._last: tuple[int, int] | None = None
        self._run: list[float] | None = None
        """Intervals since the last start, None once one is missing."""
        self._starts: dict[int, list[tuple[float, ...]]] = {}
        """The intervals after earlier starts, by the first of them in units of what counts as the same."""

    def interrupted(self) -> None:
        """The implementation may start again."""
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
        self.exercised()
        if max(run) - min(run) < 10 * _ALIKE:
            # Strictly periodic: there is no chance to repeat.
            return
        if len({round(each / _ALIKE) for each in run}) < _INTERVALS - 1:
            # A coarse clock: intervals of few different lengths repeat by chance.
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
    """The limit on beacons that the implementation has told, or that the PIXIT gives."""

    def feed(self, seen: Seen) -> None:
        """Compare with what is known of the limit by now."""
        told = self.context.parameters.get("BPPAR_MAXIMUM_PACKET_SIZE")
        if isinstance(told, int):
            self._limit = told
        super().feed(seen)


class DistinctVariables(Invariant):
    """One record for each variable in a container."""

    id = "CK_VD_DISTINCT"
    section = "dcp-vardis.md: Payload Construction"
    purpose = "No variable appears twice in a container"
    requirements = ("VD-PAY-03",)
    expect = "distinct variables in each container"

    def feed(self, seen: Seen) -> None:
        """Count the identifiers of each container with several records."""
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
    """Payloads with something in them."""

    id = "CK_BP_EMPTY"
    section = "dcp-bp.md: Packet Format"
    purpose = "No payload block is empty"
    requirements = ("VD-PAY-04", "BP-TXP-03")
    expect = "at least one octet in each payload block"

    def feed(self, seen: Seen) -> None:
        """Look at what a sound beacon carries."""
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
    """The maximum of summaries, where the PIXIT states it."""

    id = "CK_VD_SUMMARIES"
    section = "dcp-vardis.md: Payload Construction"
    purpose = "No payload has more summaries than VARDISPAR_MAX_SUMMARIES"
    requirements = ("VD-CMP-02",)
    expect = "at most VARDISPAR_MAX_SUMMARIES summaries in a payload"

    def applies(self) -> str:
        """Only with a maximum that somebody has stated: what a profile assumes blames nobody."""
        return "" if self._most() is not None else "nobody has stated VARDISPAR_MAX_SUMMARIES (pixit.max_summaries)"

    def _most(self) -> int | None:
        told = self.context.parameters.get("VARDISPAR_MAX_SUMMARIES")
        return int(told) if isinstance(told, int) else self.context.pics.pixit.max_summaries

    def feed(self, seen: Seen) -> None:
        """Count."""
        count, most = len(seen.heard.instructions(ICType.SUMMARIES)), self._most()
        if most is None or not count:
            return
        self.exercised()
        if count > most:
            text = f"{name(seen.sender)} sends {count} summaries in a beacon, and {most} is the maximum"
            self.violated(text, [seen], once=seen.sender)


#: Rules that look at nothing but state reports, or at nothing but instructions of VarDis.
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
