"""The contract of an upper tester: methods called and answered, notifications collected."""

from __future__ import annotations

from typing import Any, Protocol

import msgspec


class Answer(msgspec.Struct, frozen=True):
    """What came back: a result with its status, or a JSON-RPC error (``code`` is then not None)."""

    status: str = ""
    """The status in the spelling of the implementation; empty for an error."""
    result: dict[str, Any] = msgspec.field(default_factory=dict)
    code: int | None = None
    message: str = ""
    data: Any = None

    @property
    def ok(self) -> bool:
        """Whether the service reports success."""
        return self.code is None and self.status.replace("_", "-").endswith("-STATUS-OK")

    def __str__(self) -> str:
        return self.status if self.code is None else f"error {self.code}: {self.message}"


class Notification(msgspec.Struct, frozen=True):
    """Something that the implementation told without being asked. ``time`` is ns of the lower tester's clock."""

    method: str
    params: dict[str, Any]
    time: int = 0


class UpperTester(Protocol):
    """A connection to the services of an implementation; one request at a time."""

    name: str
    methods: frozenset[str]
    """What UT-Hello lists; also what a file of commands offers."""
    about: dict[str, Any]
    """The answer to UT-Hello: name, version, specVersion, nodeId, profile, as far as they are there."""

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
