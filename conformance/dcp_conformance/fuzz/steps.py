"""What a test consists of, and what it can show: the words that generators, executors and the minimiser share."""

from __future__ import annotations

import re
from typing import Any, Final, Literal, NamedTuple, Protocol

import msgspec

EffectKind = Literal["raised", "hang", "dead", "mute", "bad-beacon", "said", "state", "unbounded", "disagrees"]
"""What can be wrong:

``raised``: an exception got out; ``hang``: it did not come back in time; ``dead``: the process is gone; ``mute``: it
lives and answers nothing; ``bad-beacon``: it sends what is no beacon of its profile; ``said``: it says what the model
does not cover; ``state``: it holds what the model does not hold; ``unbounded``: something grows
without end; ``disagrees``: two views of the same octets differ.
"""

ROBUSTNESS: Final = ("BP-RX-16", "VD-ROB-01")
"""What every finding is about: nothing received may stop an implementation."""
#: Effects of who has stopped.
STOPPED: Final = ("raised", "hang", "dead", "mute")


class Frame(msgspec.Struct, frozen=True, gc=False, tag="frame"):
    """A bearer payload is sent. ``valid`` is the message that it was made from, empty if it is not known."""

    octets: bytes
    valid: bytes = b""
    note: str = ""
    source: bytes = b"\x02\xdc\x90\x00\x00\x01"
    """The address that it is sent from."""


class Call(msgspec.Struct, frozen=True, tag="call"):
    """A service of the upper interface is called; passed over where there is none."""

    method: str
    params: dict[str, Any]


class Wait(msgspec.Struct, frozen=True, gc=False, tag="wait"):
    """Beacon periods pass."""

    periods: float


Step = Frame | Call | Wait
NUMBERS: Final = re.compile(r"0x[0-9a-f]+|\d+|'[^']*'|b\"[^\"]*\"")


class Effect(NamedTuple):
    """What was wrong, and after which step (counted from 0) it showed. ``place`` tells effects of a kind apart."""

    kind: EffectKind
    detail: str
    step: int
    place: str = ""

    @property
    def signature(self) -> str:
        """Equal for effects that have most likely the same cause: numbers in the text do not count."""
        return f"{self.kind}: {self.place or NUMBERS.sub('#', self.detail)}"


class Generator(Protocol):
    """Draws test after test."""

    kinds: tuple[str, ...]
    """What the last one consists of."""

    def draw(self) -> list[Step]:
        """The next one."""
        ...

    def keep(self, steps: list[Step]) -> None:
        """This one is worth going on from."""
        ...


class Target(Protocol):
    """Something that steps are carried out on."""

    name: str

    def run(self, steps: list[Step]) -> Effect | None:
        """Carry out the steps from the initial state, and say what was wrong; None if nothing was.

        Raises ``ConformanceError`` if the target cannot be used at all.
        """
        ...
