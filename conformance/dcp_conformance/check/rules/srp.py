"""dcp-srp.md: the state reports of each sender."""

from __future__ import annotations

import math
from collections import Counter
from typing import Any, ClassVar, NamedTuple

import msgspec
from dcp_spec.constants import BP_SEQNO_MODULUS, SRP_SEQNO_MODULUS

from dcp_codec.values import ExtendedSafetyData
from dcp_conformance.check.base import MOST_SENDERS, Context, Evidence, Invariant, Seen, Trace, name
from dcp_conformance.definitions.verdict import Verdict

from .counters import NARROW, narrow_counter

#: The number of the first report heard after a restart is at most ``_RESTART``, plus one for each ``_SPACING`` ns.
_RESTART, _SPACING = 3, 10_000_000
#: A restart between two beacons is excluded if their numbers differ by at most ``_BEACONS``, or (for beacons without
#: numbers) if they are less than ``_SOON`` ns apart.
_BEACONS, _SOON = 20, 250_000_000
#: Time stamps are a fault if at least ``_STEPS`` of them, and more than one of ``_RARE`` reports, decrease and the next
#: ones do not continue from there. If they continue from there, the clock was set; but it is not set with more than one
#: of ``_OFTEN`` reports.
_STEPS, _RARE, _OFTEN = 3, 25, 4
#: A step between the numbers of two successive reports is suspicious if it exceeds this plus ten times the largest step
#: so far: an application seldom submits its safety data that often.
_LEAP = 1_000
#: Number of successive different reports with one sequence number that are a stuck counter.
_STUCK = 5
#: Number of reports with one time stamp, and time in ns from the first to the last, that are a stopped clock.
_FROZEN, _FROZEN_FOR = 10, 3_000_000_000
#: One day in ns.
_DAY = 86_400_000_000_000


class OwnReports(Invariant):
    """Check that a node sends only its own state reports."""

    id = "CK_SRP_OWN"
    section = "dcp-srp.md: Data Types"
    purpose = "A node sends only its own state reports, and does not forward those of other nodes"
    requirements: ClassVar[tuple[str, ...]] = ("SRP-TYP-04", "SRP-RX-06")
    expect = "the sender's own nodeId in its state reports"

    def feed(self, seen: Seen) -> None:
        """Compare nodeId of the report with the sender of the beacon."""
        report = seen.heard.report
        if report is None or seen.heard.sender is None:
            return
        self._of_all += 1
        if report.node_id != seen.heard.sender:
            text = f"{name(seen.sender)} sends a report of {name(report.node_id)}"
            self.violated(text, [seen], "SRP-TYP-04", "SRP-RX-06", once=(seen.sender, report.node_id))


class ReportLength(Invariant):
    """Check that SRP payloads have one fixed length."""

    id = "CK_SRP_LENGTH"
    section = "dcp-srp.md: Packet Format"
    purpose = "Every SRP payload is one record of fixed length"
    requirements = ("SRP-FMT-01", "SRP-TYP-02", "SRP-TYP-03")
    expect = "SRP payloads of one length"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._lengths: dict[bytes, tuple[int, Trace]] = {}
        plan = context.codec.report_plan
        self._size = getattr(plan, "size", None)

    def interrupted(self) -> None:
        """Forget the lengths: another program may have been started."""
        self._lengths.clear()

    def feed(self, seen: Seen) -> None:
        """Compare the length with that of earlier reports, and report the errors of the dissector."""
        if seen.sound and seen.heard.report is None:
            return
        if seen.sound and self._size is not None:
            # The strict decoder accepts only this length.
            self._compare(seen, self._size)
            return
        for problem in () if seen.sound else seen.dissection.errors:
            if problem.requirement == "SRP-RX-01":
                self.violated(f"{name(seen.sender)}: {problem}", [seen], once=(seen.sender, problem.reason))
        payloads = seen.dissection.root.child("payloads")
        for payload in payloads.children if payloads is not None else ():
            report = payload.child("srp")
            if report is None:
                continue
            self._compare(seen, report.length)

    def _compare(self, seen: Seen, length: int) -> None:
        """Compare a length in octets with the first one of the sender."""
        before = self._lengths.get(seen.sender)
        if before is None:
            if len(self._lengths) < MOST_SENDERS:
                self._lengths[seen.sender] = (length, seen.trace)
            return
        self._of_all += 1
        if before[0] != length:
            text = f"{name(seen.sender)}: {length} octets after {before[0]}"
            self.violated(text, [before[1], seen], once=(seen.sender, length))


class _Last(msgspec.Struct, frozen=True, gc=False):
    """A state report and the trace of its frame."""

    report: ExtendedSafetyData
    seen: Trace


class _Fall(NamedTuple):
    """A decrease of the time stamp from one report to the next."""

    by: int
    """Difference to the expected time stamp, ns."""
    text: str
    frames: list[Evidence]


class ReportNumbers(Invariant):
    """Check sequence numbers and time stamps of successive state reports."""

    id = "CK_SRP_SEQNO"
    section = "dcp-srp.md: The Sequence Number"
    purpose = "Each new state report has the next sequence number and is not older than the previous one"
    requirements = ("SRP-SEQ-01", "SRP-TYP-05", "SRP-TYP-06")
    expect = "a seqno that increases by one with each new report, and a tStamp that does not decrease"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._last: dict[bytes, _Last] = {}
        self._lost: dict[bytes, int] = {}
        self._back: dict[bytes, int] = {}
        """Node -> number of decreasing time stamps."""
        self._brief: dict[bytes, int] = {}
        """Node -> the part of them from which the next time stamp did not continue."""
        self._fell: dict[bytes, _Fall] = {}
        """Node -> the decrease in its last report."""
        self._reports: Counter[bytes] = Counter()
        self._same: dict[bytes, int] = {}
        """Node -> number of successive different reports with the same sequence number."""
        self._narrow: dict[tuple[str, int], int] = {}
        """(node, number) -> how often 0 followed this number."""
        self._frozen: dict[bytes, tuple[int, int, Trace]] = {}
        """Node -> time stamp, number of successive reports with it, and the first of them."""
        self._odd: dict[bytes, tuple[_Last, _Last]] = {}
        """Node -> the last regular report, and one after it whose number restarts or jumps. The next report decides
        whether the number was wrong."""
        self._jumps: Counter[bytes] = Counter()
        """Node -> number of jumps to numbers from which its numbers continue."""
        self._first_jump: dict[bytes, tuple[str, list[Evidence]]] = {}
        """Node -> the first of them, with its frames."""
        self._usual: dict[bytes, int] = {}
        """Node -> the largest step between the numbers of successive reports that was not a jump."""

    def interrupted(self) -> None:
        """Forget the previous reports: numbers may start again after a restart."""
        self._last.clear()
        self._same.clear()
        self._frozen.clear()
        self._fell.clear()
        self._odd.clear()

    def feed(self, seen: Seen) -> None:
        """Compare with the node's previous report."""
        report = seen.heard.report
        if report is None or (seen.heard.sender is not None and report.node_id != seen.sender):
            # A report of another node is not evidence about that node; CK_SRP_OWN reports its sender.
            return
        node = report.node_id
        last = self._last.get(node)
        if last is None and len(self._last) >= MOST_SENDERS:
            return
        self._last[node] = _Last(report, seen.trace)
        if last is None:
            return
        step = (report.seqno - last.report.seqno) % SRP_SEQNO_MODULUS
        if step == 1 and report.t_stamp > last.report.t_stamp and not self._odd:
            # The regular case: the next number, and a later time stamp.
            if self._same:
                self._same.pop(node, None)
            self._frozen[node] = (report.t_stamp, 1, seen.trace)
            self._of_all += 1
            self._reports[node] += 1
            return
        self._judge(report, last, seen, step)

    def _judge(self, report: ExtendedSafetyData, last: _Last, seen: Seen, step: int) -> None:
        """Compare a report with the node's previous one; ``step``: difference of their numbers."""
        who = name(report.node_id)
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
            # A restarted node may have come to the same number.
            least = _RESTART if _continues(last.seen, seen) else _RESTART + (seen.time - last.seen.time) / _SPACING
            if not same and report.t_stamp != last.report.t_stamp and report.seqno > least:
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
                self.note("a node that restarts its reports", who, both)
            return
        self.exercised()
        self._reports[report.node_id] += 1
        if step >= SRP_SEQNO_MODULUS // 2:
            text = f"{who}: {report.seqno} after {last.report.seqno}"
            self.violated(text, both, "SRP-SEQ-01", once=(who, "back"))
        elif step > 1:
            if _continues(last.seen, seen) and step > _LEAP + 10 * self._usual.get(report.node_id, 1):
                self._odd[report.node_id] = (last, self._last[report.node_id])
                return
            self._usual[report.node_id] = max(step, self._usual.get(report.node_id, 1))
            self._lost[report.node_id] = self._lost.get(report.node_id, 0) + step - 1
        self._compare_times(last, report, seen, step)

    def _compare_times(self, last: _Last, report: ExtendedSafetyData, seen: Seen, step: int) -> None:
        """Compare the time stamps of two successive reports, and tell a faulty stamp from a clock that is set."""
        node, who = report.node_id, name(report.node_id)
        change = report.t_stamp - last.report.t_stamp
        excess = change - (seen.time - last.seen.time)
        fell = self._fell.pop(node, None)
        if fell is not None and excess > fell.by / 2:
            brief = self._brief[node] = self._brief.get(node, 0) + 1
            if brief >= _STEPS and brief * _RARE > self._reports[node]:
                self.violated(f"{fell.text}; {brief} times", fell.frames, "SRP-TYP-05", once=(who, "time"))
        if change < 0 and step < SRP_SEQNO_MODULUS // 2:
            text = f"{who}: tStamp decreases by {-change} with seqno {report.seqno}"
            both: list[Evidence] = [last.seen, seen.trace]
            self._fell[node] = _Fall(-excess, text, both)
            steps = self._back[node] = self._back.get(node, 0) + 1
            if steps >= _STEPS and steps * _OFTEN > self._reports[node]:
                self.violated(f"{text}; it has decreased {steps} times", both, "SRP-TYP-05", once=(who, "time"))
            else:
                self.note("a clock that was set back", text, both, "SRP-TYP-05")

    def _was_odd(self, report: ExtendedSafetyData, seen: Seen, who: str) -> bool:
        """Judge a report with an unexpected number by the next report; return whether that continues the old ones."""
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
            self.note("a node that restarts its reports", who, frames[:2])
        else:
            text = f"{who}: {between.report.seqno} after {before.report.seqno}"
            self._jumps[report.node_id] += 1
            self._first_jump.setdefault(report.node_id, (text, frames[:2]))
        return False

    def _clock(self, report: ExtendedSafetyData, seen: Seen, who: str, step: int) -> None:
        """Report time stamps that do not change from one new report to the next."""
        stamp, count, first = self._frozen.get(report.node_id, (None, 0, seen.trace))
        if stamp != report.t_stamp:
            self._frozen[report.node_id] = (report.t_stamp, 1, seen.trace)
            return
        self._frozen[report.node_id] = (report.t_stamp, count + (step != 0), first)
        if count >= _FROZEN and seen.time - first.time >= _FROZEN_FOR:
            text = f"{who}: {count} reports in {(seen.time - first.time) / 1e9:.1f} s with the same tStamp"
            self.violated(text, [first, seen], "SRP-TYP-05", once=(who, "frozen"))

    def finish(self) -> None:
        """Report restarts, and missing reports: these were replaced before they were sent, or lost."""
        for node_id, (before, last) in self._odd.items():
            if last.report.seqno <= _RESTART:
                self.note("a node that restarts its reports", name(node_id), [before.seen, last.seen])
        for node_id, (text, frames) in self._first_jump.items():
            count = self._jumps[node_id]
            again = f"; {count} jumps in all" if count > 1 else ""
            self.note("a jump of the numbers of state reports", f"{text}{again}", frames, "SRP-SEQ-01")
        for node_id, count in self._lost.items():
            self.note("state reports missing in the recording", f"{name(node_id)}: {count}", [])


def _continues(last: Trace, seen: Seen) -> bool:
    """Whether the beacon numbers exclude a restart of a node between two of its beacons."""
    if last.seqno is None or seen.heard.seqno is None:
        return seen.time - last.time < _SOON
    return 0 < (seen.heard.seqno - last.seqno) % BP_SEQNO_MODULUS <= _BEACONS


class ReportTime(Invariant):
    """Compare the time stamps of state reports with the clock of the recording."""

    id = "CK_SRP_TIME"
    section = "dcp-srp.md: SRP-UpdateSafetyData"
    purpose = "A state report is generated shortly before it is sent"
    requirements = ("SRP-TYP-05", "DATA-05")
    expect = "a tStamp within the clock tolerance of the recording's time"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._stamp = context.profile.types.timestamp
        self._per_second = self._stamp.per_second
        self._tolerance = round(context.pics.pixit.clock_tolerance_ms * 1_000_000)

    def applies(self) -> str:
        """Exclude profiles whose time stamps cannot be compared with the recording's clock."""
        return "" if self._stamp.epoch == "unix" and self._stamp.unit != "ps" else "its time stamps have no known epoch"

    def feed(self, seen: Seen) -> None:
        """Compare with the recording's clock; a difference is reported as info, since a clock may be wrong."""
        report = seen.heard.report
        if report is None or (seen.heard.sender is not None and report.node_id != seen.sender):
            return
        made = report.t_stamp * 10**9 // self._per_second
        ahead = made - seen.time
        self._of_all += 1
        if ahead > self._tolerance:
            text = f"{name(report.node_id)}: generated {ahead / 1e9:.1f} s after it was recorded"
            self.violated(text, [seen], once=(report.node_id, "ahead"), verdict=Verdict.INFO)
        elif -ahead > self._tolerance + 60_000_000_000:
            text = f"{name(report.node_id)}: {-ahead / 1e9:.0f} s old when recorded"
            self.violated(text, [seen], once=(report.node_id, "behind"), verdict=Verdict.INFO)


def _finite(values: tuple[Any, ...]) -> bool:
    """Return True only if all values are finite numbers. False decides nothing: their sum may overflow."""
    try:
        return math.isfinite(sum(values))
    except TypeError:
        return False


class ReportValues(Invariant):
    """Check the plausibility of safety data and time stamps."""

    id = "CK_SRP_VALUES"
    section = "dcp-srp.md: Data Types"
    purpose = "Safety data has finite values, and successive time stamps are close together"
    requirements = ("SRP-TYP-02", "SRP-TYP-05")
    expect = "finite numbers, and a tStamp near that of the previous report"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._per_second = context.profile.types.timestamp.per_second
        self._last: dict[bytes, tuple[int, Trace]] = {}
        """Node -> time stamp in ns of its last report, and the trace of its frame."""
        self._reports = self._intervals = 0
        """Numbers of reports, and of pairs of successive reports."""

    def applies(self) -> str:
        """Exclude profiles without state reports."""
        return "" if self.context.profile.srp.record else "the profile has no octets for a state report"

    def feed(self, seen: Seen) -> None:
        """Check each number, and the step of tStamp; both are reported as info, since the application may be wrong."""
        report = seen.heard.report
        if report is None or report.node_id != seen.sender:
            return
        self._reports += 1
        data = report.s_data
        if isinstance(data, msgspec.Struct) and not _finite(values := msgspec.structs.astuple(data)):
            for number, value in enumerate(values):
                if isinstance(value, float) and not math.isfinite(value):
                    field = data.__struct_fields__[number]
                    self._observe(f"{name(seen.sender)}: {field} is {value}", [seen], (seen.sender, field))
        before = self._last.get(seen.sender)
        if before is None and len(self._last) >= MOST_SENDERS:
            return
        stamp = report.t_stamp * 10**9 // self._per_second
        self._last[seen.sender] = (stamp, seen.trace)
        if before is None:
            return
        made = stamp - before[0]
        self._intervals += 1
        if abs(made) > _DAY and abs(seen.time - before[1].time) < _SOON * 20:
            text = f"{name(seen.sender)}: tStamp jumps by {made / 1e9:+.1f} s between two reports"
            self._observe(text, [before[1], seen], (seen.sender, "leap"))

    def finish(self) -> None:
        """Count the reports."""
        self.exercised("SRP-TYP-02", times=self._reports)
        self.exercised("SRP-TYP-05", times=self._intervals)

    def _observe(self, text: str, frames: list[Evidence], key: object) -> None:
        """Report an implausible value as info, at most three times for each key."""
        expected = "an implausible value"
        self.violated(text, frames, expected=expected, verdict=Verdict.INFO, once=key, cite=3)


RULES: tuple[type[Invariant], ...] = (OwnReports, ReportLength, ReportNumbers, ReportTime, ReportValues)
