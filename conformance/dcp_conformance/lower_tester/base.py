"""The contract of a lower tester: frames out, frames in, and the time that goes with them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple, Protocol, runtime_checkable


class Arrival(NamedTuple):
    """A frame that came in. ``octets`` is the bearer payload, ``frame`` the whole link-layer frame for recordings."""

    time: int
    """When, in ns of the lower tester's clock; the kernel's own stamp where there is one."""
    wall: int
    """The same in ns since 1970."""
    octets: bytes
    frame: bytes
    source: bytes


class LinkHealth(NamedTuple):
    """What the tester has to hold against itself."""

    dropped: int = 0
    """Frames that the kernel dropped since the last time this was asked."""


class LowerTester(Protocol):
    """One link, on which any number of virtual peers speak. Clocks are read here, so that time can be virtual."""

    name: str

    def now(self) -> int:
        """Monotonic ns."""
        ...

    def wall(self) -> int:
        """ns since 1970."""
        ...

    def send(self, octets: bytes, source: bytes) -> bytes:
        """Put a bearer payload on the air as from the station ``source``; the whole frame is returned.

        Raises ``LowerTesterError``.
        """
        ...

    def send_frame(self, frame: bytes) -> None:
        """Put a whole link-layer frame on the air as it is. Raises ``LowerTesterError``."""
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
        """What was lost since the last call."""
        ...

    def close(self) -> None:
        """Let go of the link; may be called twice."""
        ...


@runtime_checkable
class OnThisMachine(Protocol):
    """A lower tester in real time."""

    def overload(self) -> str:
        """Why this machine may have slowed down what it runs in the last minutes, in words; empty if it has not."""
        ...


@runtime_checkable
class HearsEveryType(Protocol):
    """A lower tester whose frames have a type, and that can listen to all types for a moment."""

    @property
    def ether_type(self) -> int:
        """The EtherType of its beacons."""
        ...

    def overhear(self, asked: Iterable[bytes], duration: int) -> list[bytes]:
        """Send whole frames, and listen for ``duration`` ns afterwards; the frames of other types that arrived.

        Frames of :attr:`ether_type` are left for :meth:`LowerTester.receive`. Empty where this is not possible.
        """
        ...
