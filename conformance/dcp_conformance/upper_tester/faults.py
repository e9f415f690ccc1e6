"""The faults of an adapter: messages that break the contract of the upper tester."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any, Final, Protocol, runtime_checkable

import msgspec

_NUMBERS: Final = re.compile(r"\[\d+\]|\d+|'[^']*'|\"[^\"]*\"")
_SHOWN: Final = 160


class Violation(msgspec.Struct, frozen=True):
    """A message that breaks the contract."""

    method: str
    """The method that was answered, or the notification."""
    what: str
    """The fault, and its place in the message."""
    place: str
    """The section of UPPER-TESTER.md that says how it must be."""
    message: str = ""
    """The message, shortened."""
    usable: bool = False
    """Whether the message can be used all the same."""

    @property
    def kind(self) -> tuple[str, str]:
        """Equal for messages that break the contract in the same way."""
        return self.method, _NUMBERS.sub("#", self.what)

    def __str__(self) -> str:
        shown = f": {self.message}" if self.message else ""
        return f"the adapter, not the implementation: {self.method}: {self.what} (UPPER-TESTER.md, {self.place}){shown}"


class Faults:
    """The faults of an adapter, over all its connections; each kind is reported when it is observed first."""

    def __init__(self) -> None:
        self.found: dict[tuple[str, str], Violation] = {}
        """The first violation of each kind."""
        self.unusable = 0
        """Number of messages that could not be used."""
        self.forgets_protocols = ""
        """Why SRP or VarDis must not be deregistered: UT-Reset does not register them again; empty if it does."""
        self.unused: set[str] = set()
        """Methods that the tester does without, although UT-Hello lists them."""
        self.forgets_parameters = False
        """Whether UT-Reset does not restore parameters."""
        self.report: Callable[[str], None] = lambda _: None

    def lost_registration(self, protocol: str) -> None:
        """Record that UT-Reset does not register a protocol of the implementation again."""
        self.forgets_protocols = (
            f"UT-Reset does not register {protocol} with BP again (UPPER-TESTER.md, Methods), so that {protocol} must "
            "not be deregistered"
        )
        what = f"it does not restore {protocol}: BP-ListRegisteredProtocols does not list it after 2 s"
        self.add(Violation("UT-Reset", what, "Methods", usable=True))

    def add(self, violation: Violation) -> None:
        """Record a violation."""
        self.unusable += not violation.usable
        if violation.kind not in self.found:
            self.found[violation.kind] = violation
            self.report(str(violation))


@runtime_checkable
class Checked(Protocol):
    """An upper tester whose messages are checked against the contract."""

    faults: Faults


def shown(message: Any) -> str:
    """Return a message as JSON, shortened."""
    text = msgspec.json.encode(message).decode()
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."
