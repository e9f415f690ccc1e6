"""State reports that an application on the node submits, as seen before the tester has submitted any."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable, Mapping
from typing import Any, Final

from dcp_codec.values import ExtendedSafetyData

#: Number of new reports without a submission of the tester that prove an application: a node may send configured data.
_SHOWN: Final = 2
#: Number of the tester's submissions whose data are remembered.
_REMEMBERED: Final = 256

_Data = frozenset[tuple[Any, int]]


def unordered(values: Iterable[Any]) -> _Data:
    """Return values with their numbers, without their order: a faulty implementation may exchange fields."""
    return frozenset(Counter(each.hex() if isinstance(each, bytes) else each for each in values).items())


class ForeignReports:
    """Reports of the implementation with data that the tester has not submitted; times in ns."""

    def __init__(self, now: int) -> None:
        self.proved = False
        """Whether an application submits safety data: there were new reports before any submission of the tester."""
        self.listened = 0
        """The longest time for which the implementation had no submission of the tester."""
        self._own: deque[_Data] = deque(maxlen=_REMEMBERED)
        self._numbers: set[int] = set()
        self._since: int | None = now
        """Time of the start or reset of the implementation; None: the tester has submitted data since."""

    def heard(self, report: ExtendedSafetyData | None, now: int) -> None:
        """Take the report of a beacon into account."""
        if self._since is None:
            return
        self.listened = max(self.listened, now - self._since)
        if report is not None and unordered(report.s_data.as_dict().values()) not in self._own:
            self._numbers.add(report.seqno)
            self.proved = self.proved or len(self._numbers) >= _SHOWN

    def submitted(self, values: object, now: int) -> None:
        """Take a submission of the tester into account: later reports may follow from it."""
        if isinstance(values, Mapping):
            self._own.append(unordered(values.values()))
        if self._since is not None:
            self.listened = max(self.listened, now - self._since)
            self._since = None

    def forget(self, now: int) -> None:
        """Record that the implementation is in its initial state: what it sends now does not follow from before."""
        self._numbers.clear()
        self._since = now
