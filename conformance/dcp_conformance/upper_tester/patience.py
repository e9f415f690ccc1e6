"""How long to wait for an answer: less for a method that was not answered before."""

from __future__ import annotations

import time
from collections import Counter
from typing import Final

from dcp_conformance.errors import NeverAnsweredError, NoAnswerError, UpperTesterError

#: Divisors of the patience after one unanswered call of a method, and after several in succession.
_SHRUNK: Final = (1, 5, 10)
#: Calls in succession after which a method counts as one that is never answered.
_NEVER: Final = 3
NEVER: Final = "is never answered, while other methods are"
#: Minimum of a shortened patience in s, and in durations of the slowest answer.
_LEAST, _SLOWEST = 0.25, 10.0


class Patience:
    """The timeouts of the methods of one upper tester, in seconds."""

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds
        self._missing: Counter[str] = Counter()
        """By method: the number of calls in succession without an answer."""
        self._alone: set[str] = set()
        """Methods that were not answered, while another was answered later."""
        self._slow: set[str] = set()
        """Methods that were answered too late."""
        self._longest = 0.0

    def of(self, method: str) -> float:
        """Return the timeout of a method."""
        missing = 0 if method in self._slow else self._missing[method]
        shrunk = self.seconds / _SHRUNK[min(missing, len(_SHRUNK) - 1)]
        return min(self.seconds, max(shrunk, _LEAST, _SLOWEST * self._longest))

    def answered(self, method: str, begun: float) -> None:
        """Take an answer into account; ``begun``: when the call began, on the monotonic clock."""
        self._missing.pop(method, None)
        # Others are answered: a missing answer does not show that the implementation hangs.
        self._alone.update(self._missing)
        self._longest = max(self._longest, time.monotonic() - begun)

    def unanswered(self, method: str, where: str, waited: float) -> UpperTesterError:
        """Take a missing answer after ``waited`` s into account; return the error. ``where``: start of its message."""
        self._missing[method] += 1
        if self._missing[method] >= _NEVER and method in self._alone and method not in self._slow:
            return NeverAnsweredError(f"{where} {NEVER}; the last {self._missing[method]} calls waited {waited:g} s")
        return NoAnswerError(f"{where} was not answered within {waited:g} s; does the implementation hang?")

    def late(self, method: str) -> None:
        """Take an answer after the timeout into account: the method gets the whole patience from now on."""
        self._slow.add(method)
