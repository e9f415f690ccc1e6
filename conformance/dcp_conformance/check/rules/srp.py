"""dcp-srp.md: state reports of each sender."""

from __future__ import annotations

import math
from typing import ClassVar, NamedTuple

from dcp_spec.constants import BP_SEQNO_MODULUS, SRP_SEQNO_MODULUS

from dcp_codec.values import ExtendedSafetyData
from dcp_conformance.check.base import MOST_SENDERS, Context, Evidence, Invariant, Seen, Trace, name
from dcp_conformance.model.verdict import Verdict

from .counters import NARROW, narrow_counter

#: A node whose state reports have started again has made so many at most, or one in so many ns.
_RESTART, _SPACING = 3, 10_000_000
#: A node that was not restarted in between has sent so many beacons at most, or after so many ns at most.
_BEACONS, _SOON = 20, 250_000_000
#: A clock may be set back; so often it is not a clock.
_STEPS = 3
#: A step of the numbers between two beacons in a row that is larger than this, and than ten times what is usual, is
#: seldom an application that hands its data down so often.
_LEAP = 1_000
#: So many different reports in a row with one number show a counter that stands still.
_STUCK = 5
#: So many reports with one time, the last sent so many ns after the first, show a clock that stands still.
_FROZEN, _FROZEN_FOR = 10, 3_000_000_000
_DAY = 86_400_000_000_000


class OwnReports(Invariant):
    """State reports are about who sends them."""

    id = "CK_SRP_OWN"
    section = "dcp-srp.md: Data Types"
    purpose = "State reports are about the node that sends them, and never forwarded"
    requirements: ClassVar[tuple[str, ...]] = ("SRP-TYP-04", "SRP-RX-06")
    expect = "the sender's own nodeId in its state reports"

    def feed(self, seen: Seen) -> None:
        """Compare with the sender."""
        report = seen.heard.report
        if report is None or seen.heard.sender is None:
            return
        self.exercised()
        if report.node_id != seen.heard.sender:
            text = f"{name(seen.sender)} sends a report of {name(report.node_id)}"
            self.violated(text, [seen], "SRP-TYP-04", "SRP-RX-06", once=(seen.sender, report.node_id))


class ReportLength(Invariant):
    """One record of a fixed size."""

    id = "CK_SRP_LENGTH"
    section = "dcp-srp.md: Packet Format"
    purpose = "Every SRP payload is one record, always of the same length"
    requirements = ("SRP-FMT-01", "SRP-TYP-02", "SRP-TYP-03")
    expect = "SRP payloads of one length"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._lengths: dict[bytes, tuple[int, Trace]] = {}
        plan = context.codec.report_plan
        self._size = getattr(plan, "size", None)

    def interrupted(self) -> None:
        """Another program may have been started."""
        self._lengths.clear()

    def feed(self, seen: Seen) -> None:
        """Compare lengths; a wrong one is an error of the dissector already."""
        if seen.sound and seen.heard.report is None:
            return
        for problem in () if seen.sound else seen.dissection.errors:
            if problem.requirement == "SRP-RX-01":
                self.violated(f"{name(seen.sender)}: {problem}", [seen], once=(seen.sender, problem.reason))
        if seen.sound and self._size is not None:
            # The strict decoder takes no report of another length.
            self._compare(seen, self._size)
            return
        payloads = seen.dissection.root.child("payloads")
        for payload in payloads.children if payloads is not None else ():
            report = payload.child("srp")
            if report is None:
                continue
            self._compare(seen, report.length)

    def _compare(self, seen: Seen, length: int) -> None:
        before = self._lengths.get(seen.sender)
        if before is None:
            if len(self._lengths) < MOST_SENDERS:
                self._lengths[seen.sender] = (length, seen.trace)
            return
        self.exercised()
        if before[0] != length:
            text = f"{name(seen.sender)}: {length} octets after {before[0]}"
            self.violated(text, [before[1], seen], once=(seen.sender, length))


class _Last(NamedTuple):
    report: ExtendedSafetyData
    seen: Trace


class ReportNumbers(Invariant):
    """The report counter and what it counts."""

    id = "CK_SRP_SEQNO"
    section = "dcp-srp.md: The Sequence Number"
    purpose = "Each new state report has the next sequence number and is not older than the one before"
    requirements = ("SRP-SEQ-01", "SRP-TYP-05", "SRP-TYP-06")
    expect = "seqno plus one for each new report, tStamp not going back"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._last: dict[bytes, _Last] = {}
        self._lost: dict[bytes, int] = {}
        self._back: dict[bytes, int] = {}
        self._same: dict[bytes, int] = {}
        """How many different reports in a row have had the number of the last one."""
        self._narrow: dict[tuple[str, int], int] = {}
        self._frozen: dict[bytes, tuple[int, int, Trace]] = {}
        """A time stamp, how many reports in a row have had it, and the first of them."""
        self._odd: dict[bytes, tuple[_Last, _Last]] = {}
        """A report that starts again or leaps, until the next one shows whether that is true; and the one before it."""
        self._usual: dict[bytes, int] = {}
        """The largest step of the numbers between two reports in a row that was no leap."""

    def interrupted(self) -> None:
        """Numbers may start again."""
        self._last.clear()
        self._same.clear()
        self._frozen.clear()
        self._odd.clear()

    def feed(self, seen: Seen) -> None:
        """Compare with the node's last report."""
        report = seen.heard.report
        if report is None or (seen.heard.sender is not None and report.node_id != seen.sender):
            # A report under another name shows nothing of the node that has it: CK_SRP_OWN blames the sender.
            return
        last = self._last.get(report.node_id)
        if last is None and len(self._last) >= MOST_SENDERS:
            return
        self._last[report.node_id] = _Last(report, seen.trace)
        if last is None:
            return
        step, who = (report.seqno - last.report.seqno) % SRP_SEQNO_MODULUS, name(report.node_id)
        same = report.t_stamp == last.report.t_stamp and report.s_data == last.report.s_data
        both = [last.seen, seen.trace]
        self._clock(report, seen, who, step)
        if self._was_odd(report, seen, who):
            return
        if step == 0:
            self.exercised("SRP-TYP-06")
            if not same and _continues(last.seen, seen):
                count = self._same[report.node_id] = self._same.get(report.node_id, 1) + 1
                if count == _STUCK:
                    text = f"{who}: {count} different reports with seqno {report.seqno}"
                    self.violated(text, both, "SRP-TYP-06", "SRP-SEQ-01", once=(who, "stuck"))
            if not same and report.t_stamp != last.report.t_stamp and report.seqno > _RESTART:
                self.violated(
                    f"{who}: another report with seqno {report.seqno}", both, "SRP-TYP-06", once=(who, "same")
                )
            return
        self._same.pop(report.node_id, None)
        pause = seen.time - last.seen.time
        if report.seqno == 0 and last.report.seqno in NARROW and _continues(last.seen, seen):
            if narrow_counter(self._narrow, who, last.report.seqno, restarts_known=self.context.restarts_known):
                bits = last.report.seqno.bit_length()
                text = f"{who}: 0 after {last.report.seqno}: a counter of {bits} bits"
                self.violated(text, both, "SRP-SEQ-01", "SRP-TYP-01", once=(who, bits))
            return
        if step >= SRP_SEQNO_MODULUS // 2 and report.seqno <= _RESTART + pause / _SPACING:
            if _continues(last.seen, seen):
                self._odd[report.node_id] = (last, self._last[report.node_id])
            else:
                self.note("a node starts its reports again", who, both)
            return
        self.exercised()
        if step >= SRP_SEQNO_MODULUS // 2:
            text = f"{who}: {report.seqno} after {last.report.seqno}"
            self.violated(text, both, "SRP-SEQ-01", once=(who, "back"))
        elif step > 1:
            if _continues(last.seen, seen) and step > _LEAP + 10 * self._usual.get(report.node_id, 1):
                self._odd[report.node_id] = (last, self._last[report.node_id])
                return
            self._usual[report.node_id] = max(step, self._usual.get(report.node_id, 1))
            self._lost[report.node_id] = self._lost.get(report.node_id, 0) + step - 1
        if report.t_stamp < last.report.t_stamp and step < SRP_SEQNO_MODULUS // 2:
            text = f"{who}: tStamp goes back by {last.report.t_stamp - report.t_stamp} with seqno {report.seqno}"
            steps = self._back[report.node_id] = self._back.get(report.node_id, 0) + 1
            if steps >= _STEPS:
                self.violated(f"{text}; it has gone back {steps} times", both, "SRP-TYP-05", once=(who, "time"))
            else:
                self.note("a clock that was set back", text, both, "SRP-TYP-05")

    def _was_odd(self, report: ExtendedSafetyData, seen: Seen, who: str) -> bool:
        """Judge a report that did not fit, by the one after it; whether that one goes on where the others were."""
        if (odd := self._odd.pop(report.node_id, None)) is None:
            return False
        before, between = odd
        frames: list[Evidence] = [before.seen, between.seen, seen]
        numbers = f"{between.report.seqno} between {before.report.seqno} and {report.seqno}"
        if 0 < (report.seqno - before.report.seqno) % SRP_SEQNO_MODULUS <= _BEACONS and _continues(before.seen, seen):
            self.exercised()
            self.violated(f"{who}: {numbers}", frames, "SRP-SEQ-01", once=(who, "odd"))
            return True
        if between.report.seqno <= _RESTART:
            self.note("a node starts its reports again", who, frames[:2])
        else:
            text = f"{who}: {between.report.seqno} after {before.report.seqno}"
            self.note("the numbers of state reports leap", text, frames[:2], "SRP-SEQ-01")
        return False

    def _clock(self, report: ExtendedSafetyData, seen: Seen, who: str, step: int) -> None:
        """Whether the time stamps of new reports stand still."""
        stamp, count, first = self._frozen.get(report.node_id, (None, 0, seen.trace))
        if stamp != report.t_stamp:
            self._frozen[report.node_id] = (report.t_stamp, 1, seen.trace)
            return
        self._frozen[report.node_id] = (report.t_stamp, count + (step != 0), first)
        if count >= _FROZEN and seen.time - first.time >= _FROZEN_FOR:
            text = f"{who}: {count} reports in {(seen.time - first.time) / 1e9:.1f} s with the same tStamp"
            self.violated(text, [first, seen], "SRP-TYP-05", once=(who, "frozen"))

    def finish(self) -> None:
        """Reports that were never seen: replaced before they were sent, or lost."""
        for node_id, (before, last) in self._odd.items():
            if last.report.seqno <= _RESTART:
                self.note("a node starts its reports again", name(node_id), [before.seen, last.seen])
        for node_id, count in self._lost.items():
            self.note("state reports that are not in the recording", f"{name(node_id)}: {count}", [])


def _continues(last: Trace, seen: Seen) -> bool:
    """Whether a node was not restarted between two of its beacons: their numbers go on."""
    if last.seqno is None or seen.heard.seqno is None:
        return seen.time - last.time < _SOON
    return 0 < (seen.heard.seqno - last.seqno) % BP_SEQNO_MODULUS <= _BEACONS


class ReportTime(Invariant):
    """When a report was made."""

    id = "CK_SRP_TIME"
    section = "dcp-srp.md: SRP-UpdateSafetyData"
    purpose = "A state report was made before it was sent, and not long before"
    requirements = ("SRP-TYP-05", "DATA-05")
    expect = "a tStamp within the clock tolerance of the recording's time"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._stamp = context.profile.types.timestamp
        self._tolerance = round(context.pics.pixit.clock_tolerance_ms * 1_000_000)

    def applies(self) -> str:
        """Only where stamps are comparable with the recording."""
        return "" if self._stamp.epoch == "unix" and self._stamp.unit != "ps" else "its time stamps have no known epoch"

    def feed(self, seen: Seen) -> None:
        """Compare with the recording's clock. A clock that is off is the clock's fault: reported, not judged."""
        report = seen.heard.report
        if report is None or (seen.heard.sender is not None and report.node_id != seen.sender):
            return
        made = self._stamp.nanoseconds(report.t_stamp)
        ahead = made - seen.time
        self.exercised()
        if ahead > self._tolerance:
            text = f"{name(report.node_id)}: made {ahead / 1e9:.1f} s after it was recorded"
            self.violated(text, [seen], once=(report.node_id, "ahead"), verdict=Verdict.INFO)
        elif -ahead > self._tolerance + 60_000_000_000:
            text = f"{name(report.node_id)}: {-ahead / 1e9:.0f} s old when recorded"
            self.violated(text, [seen], once=(report.node_id, "behind"), verdict=Verdict.INFO)


class ReportValues(Invariant):
    """What the safety data says."""

    id = "CK_SRP_VALUES"
    section = "dcp-srp.md: Data Types"
    purpose = "Safety data consists of numbers, and time stamps follow each other"
    requirements = ("SRP-TYP-02", "SRP-TYP-05")
    expect = "finite numbers, and a tStamp near that of the report before"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._stamp = context.profile.types.timestamp
        self._last: dict[bytes, tuple[int, Trace]] = {}

    def applies(self) -> str:
        """Only where there are reports."""
        return "" if self.context.profile.srp.record else "the profile has no octets for a state report"

    def feed(self, seen: Seen) -> None:
        """Look at each number, and compare the steps of both clocks: neither is judged, an application may be wrong."""
        report = seen.heard.report
        if report is None or report.node_id != seen.sender:
            return
        self.exercised("SRP-TYP-02")
        data = report.s_data
        for field in getattr(data, "__struct_fields__", ()):
            value = getattr(data, field)
            if isinstance(value, float) and not math.isfinite(value):
                self._observe(f"{name(seen.sender)}: {field} is {value}", [seen], (seen.sender, field))
        before = self._last.get(seen.sender)
        if before is None and len(self._last) >= MOST_SENDERS:
            return
        self._last[seen.sender] = (report.t_stamp, seen.trace)
        if before is None:
            return
        made = self._stamp.nanoseconds(report.t_stamp) - self._stamp.nanoseconds(before[0])
        self.exercised("SRP-TYP-05")
        if abs(made) > _DAY and abs(seen.time - before[1].time) < _SOON * 20:
            text = f"{name(seen.sender)}: tStamp leaps by {made / 1e9:+.1f} s between two reports"
            self._observe(text, [before[1], seen], (seen.sender, "leap"))

    def _observe(self, text: str, frames: list[Evidence], key: object) -> None:
        expected = "a value that no application means"
        self.violated(text, frames, expected=expected, verdict=Verdict.INFO, once=key, cite=3)


RULES: tuple[type[Invariant], ...] = (OwnReports, ReportLength, ReportNumbers, ReportTime, ReportValues)
