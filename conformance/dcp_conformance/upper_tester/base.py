"""The contract of an upper tester: methods called and answered, notifications collected."""

from __future__ import annotations

import re
from typing import Any, Final, Protocol

import msgspec
from dcp_spec.status import BPStatus, SRPStatus, VardisStatus

METHOD_NOT_FOUND: Final = -32601
INTERNAL_ERROR: Final = -32603
NOT_A_VALUE: Final = -32001
NO_RESPONSE: Final = -32002
NOT_REACHED: Final = -32003
#: Errors with which the implementation itself has answered: it made a mistake, refuses a value, or keeps silent.
_OF_THE_IMPLEMENTATION: Final = frozenset({INTERNAL_ERROR, NOT_A_VALUE, NO_RESPONSE})

_OK: Final = {"BP": BPStatus.OK, "SRP": SRPStatus.OK, "RTDB": VardisStatus.OK, "VD": VardisStatus.OK}
#: Messages of exceptions that a JSON-RPC library sends with -32603 for an adapter that cannot reach its implementation.
_UNREACHABLE: Final = re.compile(
    r"connect|refused|broken pipe|reset by peer|no such file|unreachable|timed? ?out|\bEOF\b|ECONN|EPIPE|not running",
    re.IGNORECASE,
)


def status_of_success(method: str) -> str:
    """The OK of the protocol that a method belongs to."""
    return str(_OK.get(method.partition("-")[0], "UT-STATUS-OK"))


def known_status(status: str) -> bool:
    """Whether a status is spelt as in the specification, or with underscores instead of hyphens."""
    if status.replace("_", "-") == "UT-STATUS-OK":
        return True
    for kind in (BPStatus, SRPStatus, VardisStatus):
        try:
            kind.parse(status)
        except ValueError:
            continue
        return True
    return False


class Answer(msgspec.Struct, frozen=True):
    """The answer to a call: a result with its status, or a JSON-RPC error (then ``code`` is not None)."""

    status: str = ""
    """The status in the spelling of the implementation, also one that the specification lacks; empty for an error."""
    result: dict[str, Any] = msgspec.field(default_factory=dict)
    code: int | None = None
    message: str = ""
    data: Any = None

    @property
    def ok(self) -> bool:
        """Whether the service reports success."""
        return self.known and self.status.replace("_", "-").endswith("-STATUS-OK")

    @property
    def known(self) -> bool:
        """Whether there is a status, and one that the specification has."""
        return self.code is None and known_status(self.status)

    @property
    def asked(self) -> bool:
        """Whether the implementation itself has answered, and not the upper tester, which could not ask it."""
        return self.code is None or (self.code in _OF_THE_IMPLEMENTATION and not self.unreachable)

    @property
    def unreachable(self) -> bool:
        """Whether an internal error shows only that the adapter cannot reach the implementation."""
        return self.code == INTERNAL_ERROR and _UNREACHABLE.search(self.message) is not None

    def is_status(self, status: str) -> bool:
        """Whether this is the status; hyphens and underscores are equal."""
        return self.code is None and self.status.replace("_", "-") == status.replace("_", "-")

    def __str__(self) -> str:
        if self.code is not None:
            return f"error {self.code}: {self.message}"
        return self.status if self.known else f"{self.status!r}, a status that the specification does not have"


class Notification(msgspec.Struct, frozen=True):
    """Something that the implementation told without being asked. ``time`` is ns of the lower tester's clock."""

    method: str
    params: dict[str, Any]
    time: int = 0


class UpperTester(Protocol):
    """A connection to the services of an implementation; one request at a time."""

    name: str
    methods: frozenset[str]
    """The methods that UT-Hello lists, or that a file of commands has."""
    about: dict[str, Any]
    """Members of the answer to UT-Hello: name, version, specVersion, nodeId, profile; each may be missing."""

    def call(self, method: str, params: dict[str, Any]) -> Answer:
        """Call a method and wait for its answer. Raises ``UpperTesterError`` if there is none or it makes no sense."""
        ...

    def poll(self) -> list[Notification]:
        """The notifications since the last call, in order. Does not wait. Raises ``UpperTesterError``."""
        ...

    def filenos(self) -> tuple[int, ...]:
        """Descriptors that become readable when there may be notifications."""
        ...

    def another(self) -> UpperTester | None:
        """A second connection at the same time, or None where there can be only one. Raises ``UpperTesterError``."""
        ...

    def close(self) -> None:
        """End the connection; may be called twice."""
        ...


class Reconnecting(UpperTester, Protocol):
    """One that can be used again after the implementation was restarted."""

    def reconnect(self) -> None:
        """Open the connection again. Raises ``UpperTesterError`` or ``UsageError``."""
        ...
