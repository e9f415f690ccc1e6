"""The contract of a lower tester: frames out, frames in, and the time that goes with them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager
from typing import Literal, NamedTuple, Protocol, runtime_checkable


class Arrival(NamedTuple):
    """A frame that came in. ``octets`` is the bearer payload, ``frame`` the whole link-layer frame for recordings."""

    time: int
    """When, in ns of the lower tester's clock; the kernel's own stamp where there is one."""
    wall: int
    """The same in ns since 1970."""
    octets: bytes
    frame: bytes
    source: bytes
    disturbed: bool = False
    """Whether its time or its place among other frames is the doing of an impaired link."""


class Incident(NamedTuple):
    """The effect of an impaired link on one frame."""

    to: bool
    """The frame was on its way to the implementation, otherwise to the tester."""
    what: Literal["lost", "down", "corrupted", "duplicated", "reordered", "late"]
    """``down``: lost in an outage; ``reordered``: held back; ``late``: with a delay that is not the usual one."""
    octets: bytes
    """The sent octets: a bearer payload, or a whole frame."""

    @property
    def misleads(self) -> bool:
        """Whether later received data may be wrong because of it, and not only missing.

        Beacons that the tester does not receive are only missing. After a lost stimulus, any assumption of a case about
        the implementation may be wrong.
        """
        return self.to or self.what in ("reordered", "late")


class LinkHealth(NamedTuple):
    """Faults of the tester or of its link."""

    dropped: int = 0
    """Frames that the kernel dropped since the last time this was asked."""
    incidents: tuple[Incident, ...] = ()
    """Effects of an impaired link since the last call, in order. Those on a sent frame come with its transmission."""


class LowerTester(Protocol):
    """One link, on which any number of virtual peers speak. Clocks are read here, so that time can be virtual."""

    name: str

    def now(self) -> int:
        """Monotonic ns."""
        ...

    def wall(self) -> int:
        """ns since 1970."""
        ...

    def framed(self, octets: bytes, source: bytes) -> bytes:
        """Return the whole frame in which :meth:`send` transmits a bearer payload."""
        ...

    def send(self, octets: bytes, source: bytes) -> bytes:
        """Transmit a bearer payload with the source address ``source``. Return the whole frame.

        Raises ``LowerTesterError``.
        """
        ...

    def send_frame(self, frame: bytes) -> None:
        """Transmit a whole link-layer frame unchanged. Raises ``LowerTesterError``."""
        ...

    def receive(self, until: int, also: Sequence[int] = ()) -> Arrival | None:
        """The next frame that arrived before ``until``; None at that time, or earlier if a descriptor of ``also`` is
        readable.

        What counts is when a frame arrived, not when it is read: None at that time means that everything that arrived
        before has been returned. Virtual time passes in here. Raises ``LowerTesterError``.
        """
        ...

    def take_in(self) -> None:
        """Read what has arrived, for :meth:`receive` to return later, so that the kernel has room for more.

        Does not wait. Raises ``LowerTesterError``.
        """
        ...

    def health(self) -> LinkHealth:
        """Return the losses since the last call."""
        ...

    def close(self) -> None:
        """Let go of the link; may be called twice."""
        ...


@runtime_checkable
class OnThisMachine(Protocol):
    """A lower tester in real time."""

    def overload(self) -> str:
        """Return why this machine was probably overloaded in the last minutes; empty if it was not."""
        ...


@runtime_checkable
class ListensToAllTypes(Protocol):
    """A lower tester whose frames have a type, and that can listen to all types for a moment."""

    @property
    def ether_type(self) -> int:
        """The EtherType of its beacons."""
        ...

    def exchange_all_types(self, asked: Iterable[bytes], duration: int) -> list[bytes]:
        """Send whole frames, and listen for ``duration`` ns afterwards; the frames of other types that arrived.

        Frames of :attr:`ether_type` are left for :meth:`LowerTester.receive`. Empty where this is not possible.
        """
        ...


@runtime_checkable
class Impairs(Protocol):
    """A lower tester with an impaired link (:mod:`dcp_conformance.impaired_link`)."""

    def engaged(self) -> AbstractContextManager[None]:
        """A context in which the link is bad; outside of it, it only delays."""
        ...

    def settle(self) -> None:
        """Wait until no frame is under way to the implementation. Raises ``LowerTesterError``."""
        ...

    @property
    def changes_intervals(self) -> bool:
        """Whether the times between beacons are not those at which the implementation sent them."""
        ...

    def summary(self) -> str:
        """Describe the effects of the link in this run."""
        ...
