"""State reports that the tester hands down, told from those of an application on the node.

An application may hand down safety data at any time. SRP sends only the newest, so that the tester's may be replaced
before a beacon leaves, and sequence numbers count the hand-downs of both. The tester recognises its own reports by
their safety data, repeats a hand-down that an application has replaced, and judges sequence numbers exactly only
where it is the only one that hands safety data down.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple, NoReturn

from dcp_spec.constants import SRP_SEQNO_MODULUS

from dcp_codec.values import ExtendedSafetyData

from .bench import Bench
from .heard import Heard
from .services import Moment, safety_data, timed, told, until_report

_UPDATE: Final = "SRP-UpdateSafetyData"
#: Different safety data that there are; the last one is for hand-downs that nobody waits for.
_DIFFERENT: Final = 99
#: Hand-downs in a row, and the fraction of a beacon period between them, where an application replaces them.
_BURST: Final = 90
_PAUSE: Final = 16
#: Beacon periods in which an application is listened for, and reports that show it.
_LISTEN: Final = 40
_SHOWN: Final = 2


class Sent(NamedTuple):
    """A report of the tester's on the air."""

    heard: Heard
    report: ExtendedSafetyData
    values: dict[str, Any]
    moment: Moment
    """When it was handed down."""
    hand_downs: int
    """Hand-downs of the tester's until then, this one included."""


class Reporter:
    """Hands safety data down, and finds them in the beacons of the implementation."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.count = 0
        """Hand-downs so far."""
        self._handed: list[dict[str, Any]] = []
        self._moments: list[tuple[Moment, int]] = []
        self._application: bool | None = None

    def next_values(self) -> dict[str, Any]:
        """Safety data that were not handed down recently."""
        return safety_data(self.bench, len(self._handed) % _DIFFERENT)

    def hand_down(self) -> dict[str, Any]:
        """Hand new safety data down; stops as inconclusive if that is refused."""
        values = self.next_values()
        self.noted(values, timed(self.bench, _UPDATE, sData=values))
        return values

    def noted(self, values: dict[str, Any], moment: Moment) -> None:
        """Take a hand-down that somebody else made for the tester into account."""
        self.count += 1
        self._handed.append(values)
        self._moments.append((moment, self.count))

    def fill(self, count: int) -> None:
        """Make so many hand-downs of the same safety data, which nobody waits for."""
        values = safety_data(self.bench, _DIFFERENT)
        for _ in range(count):
            self.bench.must(_UPDATE, sData=values)
            self.count += 1

    def is_own(self, heard: Heard) -> bool:
        """Whether a beacon has a report that the tester handed down."""
        if heard.report is None:
            return False
        values = told(self.bench, heard.report)
        return values in self._handed or values == safety_data(self.bench, _DIFFERENT)

    def application(self) -> bool:
        """Whether an application hands safety data down: new reports come while the tester hands nothing down.

        Takes some seconds when it is asked first.
        """
        if self._application is None:
            bench = self.bench
            # What was handed down last may still be on its way.
            bench.wait(2)
            start = bench.mark()
            known = {each.report.seqno for each in bench.heard if each.report is not None}
            bench.wait(_LISTEN)
            seen = {
                each.report.seqno for each in bench.heard[start:] if each.report is not None and not self.is_own(each)
            }
            self._application = len(seen - known) >= _SHOWN
        return self._application

    def sent(self, *requirements: str, what: str = "a beacon with the safety data") -> Sent:
        """Hand safety data down and wait for the beacon that carries them first; stops as failed if none comes.

        Stops as inconclusive if an application replaces them each time.
        """
        values = self.hand_down()
        return self.awaited(values, *requirements, what=what)

    def awaited(
        self,
        values: dict[str, Any],
        *requirements: str,
        what: str = "a beacon with the safety data",
        insist: bool = True,
    ) -> Sent:
        """As :meth:`sent`, for safety data that were handed down last; see :meth:`find`."""
        found = self.find(values, insist=insist)
        if found is None:
            self.lost(what, *requirements)
        return found

    def find(self, values: dict[str, Any], *, insist: bool = True) -> Sent | None:
        """Wait for a report of safety data that were handed down last.

        ``insist``: if an application seems to have replaced them, hand new ones down until some are heard.
        """
        # What came during the call has not been looked at yet.
        start = len(self.bench.heard)
        heard = until_report(self.bench, values)
        if heard is None and insist:
            heard = self._insist(start)
        if heard is None or heard.report is None:
            return None
        found = told(self.bench, heard.report)
        index = len(self._handed) - 1 - self._handed[::-1].index(found)
        moment, count = self._moments[index]
        return Sent(heard, heard.report, found, moment, count)

    def lost(self, what: str, *requirements: str) -> NoReturn:
        """Stop the case as failed because a report is not heard; as inconclusive if an application replaces it."""
        if self.application():
            self.bench.inconclusive(what, "an application on the node replaces them by its own", *requirements)
        self.bench.fail(what, "they do not", *requirements)

    def _insist(self, since: int) -> Heard | None:
        """Hand down again and again until a beacon leaves before an application has replaced it."""
        bench = self.bench
        if not any(each.report is not None and not self.is_own(each) for each in bench.heard[since:]):
            return None
        wanted: list[dict[str, Any]] = []
        start = bench.mark()
        for _ in range(_BURST):
            wanted.append(self.hand_down())
            bench.wait_ns(bench.period // _PAUSE)
            for each in bench.heard[start:]:
                if each.report is not None and told(bench, each.report) in wanted:
                    return each
            start = len(bench.heard)
        return None

    def check_grown(self, first: Sent, last: Sent, *requirements: str) -> bool:
        """Check that the sequence number has grown by one for each hand-down between two reports.

        An application makes hand-downs that the tester does not know: then by no fewer than the tester's.
        """
        grown = (last.report.seqno - first.report.seqno) % SRP_SEQNO_MODULUS
        count = last.hand_downs - first.hand_downs
        exact = grown == count or not self.application()
        right = grown == count if exact else count <= grown < 1 << 16
        return self.bench.check(
            right,
            f"the number grows by {'' if exact else 'at least '}{count}",
            f"it went from {first.report.seqno} to {last.report.seqno}",
            *requirements,
            frames=[first.heard, last.heard],
            shown=True,
        )
