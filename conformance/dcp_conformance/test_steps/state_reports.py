"""State reports submitted by the tester, as opposed to those of an application on the node.

An application may submit safety data at any time. SRP sends only the newest, so the tester's may be replaced before a
beacon is sent, and sequence numbers count the submissions of both. The tester recognises its own reports by their
safety data, repeats a submission that an application has replaced, and checks sequence numbers exactly only if no
application submits safety data. New reports before any submission of the tester prove an application. Reports after a
submission prove none: a faulty implementation may repeat the tester's data with new numbers, and change them.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple, NoReturn

from dcp_spec.constants import SRP_SEQNO_MODULUS

from dcp_codec.values import ExtendedSafetyData
from dcp_conformance.frames.received import ReceivedBeacon
from dcp_conformance.test_system.bench import Bench
from dcp_conformance.test_system.foreign_reports import unordered

from .services import Moment, reported_safety_data, safety_data, timed, until_report

_UPDATE: Final = "SRP-UpdateSafetyData"
#: Number of different safety data; the last one is for submissions whose report is not awaited.
_DIFFERENT: Final = 99
#: Number of repeated submissions, and the fraction of a beacon period between them, while an application replaces them.
_BURST: Final = 90
_PAUSE: Final = 16
#: Number of beacon periods to listen for an application.
_LISTEN: Final = 40


class Sent(NamedTuple):
    """A report of the tester in a beacon."""

    heard: ReceivedBeacon
    report: ExtendedSafetyData
    values: dict[str, Any]
    moment: Moment
    """When the tester submitted it."""
    submissions: int
    """Number of the tester's submissions so far, including this one."""


class Reporter:
    """Submits safety data and finds them in the beacons of the implementation."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.count = 0
        """Number of submissions so far."""
        self._handed: list[dict[str, Any]] = []
        self._moments: list[tuple[Moment, int]] = []
        self._begun = len(bench.heard)
        """Number of the beacons received before the first submission."""
        self._application: bool | None = None

    def next_values(self) -> dict[str, Any]:
        """Return safety data that were not submitted recently."""
        return safety_data(self.bench, len(self._handed) % _DIFFERENT)

    def submit(self) -> dict[str, Any]:
        """Submit new safety data; inconclusive if the request is rejected."""
        values = self.next_values()
        self.noted(values, timed(self.bench, _UPDATE, sData=values))
        return values

    def noted(self, values: dict[str, Any], moment: Moment) -> None:
        """Record a submission that was made without :meth:`submit`."""
        self.count += 1
        self._handed.append(values)
        self._moments.append((moment, self.count))

    def fill(self, count: int) -> None:
        """Submit the same safety data ``count`` times, without waiting for their reports."""
        values = safety_data(self.bench, _DIFFERENT)
        for _ in range(count):
            self.bench.must(_UPDATE, sData=values)
            self.count += 1

    def is_own(self, heard: ReceivedBeacon) -> bool:
        """Return whether a beacon has a report that the tester submitted."""
        if heard.report is None:
            return False
        values = reported_safety_data(self.bench, heard.report)
        return values in self._handed or values == safety_data(self.bench, _DIFFERENT)

    def _has_values(self, report: ExtendedSafetyData) -> bool:
        """Return whether the data of a report are data that this case has submitted, in any order of the fields."""
        submitted = (*self._handed, safety_data(self.bench, _DIFFERENT))
        return unordered(report.s_data.as_dict().values()) in [unordered(each.values()) for each in submitted]

    def application(self) -> bool:
        """Return whether an application submits safety data.

        If the run has not listened for long enough before the first submission, this takes some seconds and resets the
        implementation. Without UT-Reset, new reports with other data than the tester's count.
        """
        if self._application is None:
            bench, found = self.bench, self.bench.session.foreign_reports
            if not found.proved and found.listened < _LISTEN * bench.period:
                # The report of the last submission may still be in transit.
                bench.wait(2)
                if bench.services.offers("UT-Reset"):
                    bench.must("UT-Reset")
                else:
                    found.forget(bench.now())
                bench.wait(_LISTEN)
            self._application = found.proved
        return self._application

    def foreign(self, heard: ReceivedBeacon) -> bool:
        """Return whether a beacon has a report of an application, which may have replaced the tester's.

        Its data may equal what the tester has submitted in an earlier case.
        """
        return heard.report is not None and not self._has_values(heard.report) and self.application()

    def sent(self, *requirements: str, what: str = "a beacon with the safety data") -> Sent:
        """Submit safety data and wait for the first beacon with them; fails and stops the case if there is none.

        Stops as inconclusive if an application replaces them each time.
        """
        return self.awaited(self.submit(), *requirements, what=what)

    def awaited(
        self,
        values: dict[str, Any],
        *requirements: str,
        what: str = "a beacon with the safety data",
        insist: bool = True,
    ) -> Sent:
        """As :meth:`sent`, for the safety data submitted last; see :meth:`find`."""
        found = self.find(values, insist=insist)
        if found is None:
            self.lost(what, *requirements)
        return found

    def find(self, values: dict[str, Any], *, insist: bool = True) -> Sent | None:
        """Wait for a report with the safety data submitted last.

        ``insist``: if an application seems to have replaced them, submit new ones until some are received.
        """
        # Beacons received during the call have not been checked yet.
        start = len(self.bench.heard)
        heard = until_report(self.bench, values)
        if heard is None and insist:
            heard = self._insist(start)
        if heard is None or heard.report is None:
            return None
        found = reported_safety_data(self.bench, heard.report)
        moment, count = self._moments[(len(self._handed) - 1 - self._handed[::-1].index(found))]
        return Sent(heard, heard.report, found, moment, count)

    def lost(self, what: str, *requirements: str) -> NoReturn:
        """Fail and stop the case because a report is missing; inconclusive if an application has replaced it."""
        if any(self.foreign(each) for each in self.bench.heard[self._begun :]):
            self.bench.inconclusive(what, "an application on the node replaces the data by its own", *requirements)
        since = self.bench.heard[self._begun :]
        mixed = [each for each in since if each.report and self._has_values(each.report) and not self.is_own(each)]
        if mixed:
            self.bench.wrong(what, "values of submitted data in other fields", *requirements, frames=mixed[:4])
        self.bench.missing(what, "none in time", *requirements)

    def _insist(self, since: int) -> ReceivedBeacon | None:
        """Submit safety data repeatedly until a beacon is sent before an application replaces them."""
        bench = self.bench
        if not any(each.report is not None and not self.is_own(each) for each in bench.heard[since:]):
            return None
        wanted: list[dict[str, Any]] = []
        start = bench.mark()
        for _ in range(_BURST):
            wanted.append(self.submit())
            bench.waiting.wait_ns(bench.period // _PAUSE)
            for each in bench.heard[start:]:
                if each.report is not None and reported_safety_data(bench, each.report) in wanted:
                    return each
            start = len(bench.heard)
        return None

    def check_grown(self, first: Sent, last: Sent, *requirements: str) -> bool:
        """Check that the sequence number increased by one for each submission between two reports.

        With an application, whose submissions are unknown, it may increase by more.
        """
        grown = (last.report.seqno - first.report.seqno) % SRP_SEQNO_MODULUS
        count = last.submissions - first.submissions
        exact = grown == count or not self.application()
        return self.bench.proved(
            grown == count if exact else count <= grown < count + (1 << 16),
            f"a sequence number increased by {'' if exact else 'at least '}{count}",
            f"from {first.report.seqno} to {last.report.seqno}",
            *requirements,
            frames=[first.heard, last.heard],
        )
