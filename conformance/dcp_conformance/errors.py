"""Exceptions that end a command or a test case."""

from __future__ import annotations


class ConformanceError(Exception):
    """Base class of the errors reported to the user; the message names the fault, its place and the remedy."""


class UsageError(ConformanceError):
    """An option, argument or input file of a command is invalid."""


class LowerTesterError(ConformanceError):
    """The lower tester cannot use its link; this is a fault of the test setup, not of the SUT."""


class UpperTesterError(ConformanceError):
    """The upper tester is unreachable, does not answer, or violates its interface."""


class NoAnswerError(UpperTesterError):
    """A request was not answered in time by the SUT or the upper tester."""


class NoListenerError(UpperTesterError):
    """No process listens at the address of the upper tester."""


class CouldNotAskError(UpperTesterError):
    """The upper tester cannot make this request; this allows no conclusion about the SUT."""


class ContractError(CouldNotAskError):
    """An answer of the upper tester breaks its contract: a fault of the adapter, not of the SUT."""


class NeverAnsweredError(CouldNotAskError):
    """A method is never answered, although the SUT answers others: the SUT does not hang."""


class WorkerError(ConformanceError):
    """A worker process of the tester ended before its work was complete."""


class StopCase(Exception):  # noqa: N818 - not an error: the case is decided
    """End a test case early; its verdict is set already."""


class NamesUsedUp(StopCase):
    """The case needs identifiers that the implementation does not know, and none are left until it is reset.

    The verdict ``inconclusive`` and what the user can do are set already. A runner that can restart the implementation
    restarts it and repeats the case.
    """
