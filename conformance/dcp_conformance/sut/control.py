"""Handling the implementation as a process or program: is it alive, start it again."""

from __future__ import annotations

from typing import Protocol, runtime_checkable


class SutControl(Protocol):
    """Control of the implementation as a process: is it alive, restart it."""

    can_restart: bool

    def alive(self) -> bool | None:
        """Whether it runs; None if that cannot be known."""
        ...

    def why_dead(self) -> str:
        """How it ended (exit status, signal, last lines of its output), in words; empty if it is not known."""
        ...

    def restart(self) -> None:
        """Start it again, from its initial state. Raises ``ConformanceError`` if that does not work."""
        ...

    def close(self) -> None:
        """End what was started here; may be called twice."""
        ...


@runtime_checkable
class SeesSockets(Protocol):
    """Control of an implementation on the tester's machine, whose sockets are visible."""

    def on_link(self) -> bool:
        """Whether one of its processes has a socket open for the link: it is ready to receive.

        False also if that cannot be seen.
        """
        ...
