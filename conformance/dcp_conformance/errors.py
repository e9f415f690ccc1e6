"""What stops a command, or a case."""

from __future__ import annotations


class ConformanceError(Exception):
    """Base of what this package raises for people to read; the message says what, where, and what to do."""


class UsageError(ConformanceError):
    """The command was given something that makes no sense."""


class LowerTesterError(ConformanceError):
    """The link cannot be used: the tester's own trouble."""


class UpperTesterError(ConformanceError):
    """The upper tester cannot be reached, does not answer, or does not keep to its contract."""


class NoAnswerError(UpperTesterError):
    """A request was made, and no answer came in time: the implementation or the upper tester is silent."""


class CouldNotAskError(UpperTesterError):
    """The upper tester has no way to make this request: it says nothing of the implementation."""


class WorkerError(ConformanceError):
    """A process that works for the tester has ended before its work was done."""


class StopCase(Exception):  # noqa: N818 - not an error: the case is decided
    """Raised inside of a case when going on makes no sense; its verdict is set already."""


class NamesUsedUp(StopCase):
    """The case needs identifiers that the implementation does not know, and none are left until it is reset.

    The verdict ``inconclusive`` and what the user can do are set already. A runner that can restart the implementation
    restarts it and repeats the case.
    """
