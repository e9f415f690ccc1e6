"""How long to wait for an answer: less after missing answers, least for a method that is never answered."""

from __future__ import annotations

import time
from collections import Counter
from typing import Final

from dcp_conformance.errors import NeverAnsweredError, NoAnswerError, UpperTesterError

#: Divisors of the patience after one unanswered call, and after several in succession.
_SHRUNK: Final = (1, 5, 10)
#: Calls in succession after which a method counts as one that is never answered.
_NEVER: Final = 3
NEVER: Final = "is never answered, while other methods are"
#: Minimum of a shortened patience in s, and in durations of the slowest answer.
_LEAST, _SLOWEST = 0.25, 10.0
#: The same for a method that is never answered.
_LEAST_OF_NEVER, _SLOWEST_OF_NEVER = 0.1, 2.0
_ON, _OFF = "-MGMT-Activate", "-MGMT-Deactivate"


class Patience:
    """The timeouts of the methods of one upper tester, in seconds."""

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds
        self._missing: Counter[str] = Counter()
        """By method: the number of calls in succession without an answer."""
        self._in_succession = 0
        """The number of calls of any method in succession without an answer."""
        self._alone: set[str] = set()
        """Methods that were not answered, while another was answered later."""
        self._slow: set[str] = set()
        """Methods that were answered too late."""
        self._longest = 0.0

    def of(self, method: str, seconds: float | None = None) -> float:
        """Return the timeout of a method. ``seconds``: its timeout without missing answers, if it has its own."""
        whole = self.seconds if seconds is None else seconds
        if method in self._slow:
            return whole
        if self.never(method):
            return min(whole, max(_LEAST_OF_NEVER, _SLOWEST_OF_NEVER * self._longest))
        missing = max(self._missing[method], self._in_succession)
        shrunk = whole / _SHRUNK[min(missing, len(_SHRUNK) - 1)]
        return min(whole, max(shrunk, _LEAST, _SLOWEST * self._longest))

    def never(self, method: str) -> bool:
        """Return whether a method is never answered, while others are."""
        return self._missing[method] >= _NEVER and method in self._alone and method not in self._slow

    def refused(self, method: str) -> str:
        """Return why a method must not be called, because its effect could not be undone; empty if it may be."""
        undo = method.removesuffix(_OFF) + _ON
        return f"{undo} {NEVER}: it could not undo {method}" if method.endswith(_OFF) and self.never(undo) else ""

    def renew(self) -> None:
        """Forget missing answers of an implementation that has been started again, but not what is never answered."""
        self._in_succession = 0
        self._missing = Counter({each: count for each, count in self._missing.items() if self.never(each)})

    def answered(self, method: str, begun: float) -> None:
        """Take an answer into account; ``begun``: when the call began, on the monotonic clock."""
        self._missing.pop(method, None)
        self._in_succession = 0
        # Others are answered: a missing answer does not show that the implementation hangs.
        self._alone.update(self._missing)
        if not method.startswith("UT-"):
            # Methods of the contract itself, such as a reset by a restart, may take longer than any service.
            self._longest = max(self._longest, time.monotonic() - begun)

    def unanswered(self, method: str, where: str, waited: float) -> UpperTesterError:
        """Take a missing answer after ``waited`` s into account; return the error. ``where``: start of its message."""
        self._missing[method] += 1
        self._in_succession += 1
        if self.never(method):
            return NeverAnsweredError(f"{where} {NEVER}; the last {self._missing[method]} calls waited {waited:g} s")
        return NoAnswerError(f"{where} was not answered within {waited:g} s; does the implementation hang?")

    def late(self, method: str) -> None:
        """Take an answer after the timeout into account: the method gets the whole patience from now on."""
        self._slow.add(method)
