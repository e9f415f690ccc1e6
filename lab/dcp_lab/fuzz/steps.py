"""Steps and effects: the common types of generators, executors and the minimiser."""

from __future__ import annotations

import re
from typing import Any, Final, Literal, NamedTuple, Protocol

import msgspec

EffectKind = Literal[
    "raised", "hang", "dead", "mute", "bad-beacon", "unbounded", "disagrees", "model"
]  # fmt: skip
"""Kind of effect:

``raised``: an exception was raised; ``hang``: no return within the time limit; ``dead``: the process has ended;
``mute``: the process runs but does not answer; ``bad-beacon``: it sends a beacon that its profile does not allow;
``unbounded``: a queue grows without limit; ``disagrees``: two decoders of the same octets differ; ``model``: an
observation that the model of a node forbids (``fuzz model``).
"""

ROBUSTNESS: Final = ("BP-RX-16", "VD-ROB-01")
"""Requirements of every test: no received frame may stop an implementation."""
#: Effects after which the implementation no longer works.
STOPPED: Final = ("raised", "hang", "dead", "mute")


class Frame(msgspec.Struct, frozen=True, gc=False, tag="frame"):
    """Send a bearer payload. ``valid`` is the valid message that it was mutated from; empty if unknown."""

    octets: bytes
    valid: bytes = b""
    note: str = ""
    source: bytes = b"\x02\xdc\x90\x00\x00\x01"
    """Link-layer source address."""


class Call(msgspec.Struct, frozen=True, tag="call"):
    """Call a service of the upper interface. Skipped if the upper tester does not offer it."""

    method: str
    params: dict[str, Any]


class Wait(msgspec.Struct, frozen=True, gc=False, tag="wait"):
    """Wait for a number of beacon periods."""

    periods: float


Step = Frame | Call | Wait
NUMBERS: Final = re.compile(r"0x[0-9a-f]+|\d+|'[^']*'|b\"[^\"]*\"")


class Effect(NamedTuple):
    """A wrong behaviour: its kind, its description, and the step (from 0) after which it was observed.

    ``place`` distinguishes effects of one kind; without it, ``detail`` does.
    """

    kind: EffectKind
    detail: str
    step: int
    place: str = ""

    @property
    def signature(self) -> str:
        """A text that is equal for effects with probably the same cause: numbers in ``detail`` are ignored."""
        return f"{self.kind}: {self.place or NUMBERS.sub('#', self.detail)}"


class Generator(Protocol):
    """Source of tests."""

    kinds: tuple[str, ...]
    """Names of the elements of the last test, for statistics."""

    def draw(self) -> list[Step]:
        """Return the next test."""
        ...

    def keep(self, steps: list[Step]) -> None:
        """Add a test to those that are mutated, because it reached something new."""
        ...


class Target(Protocol):
    """An implementation, or a function, on which steps are executed."""

    name: str

    def run(self, steps: list[Step]) -> Effect | None:
        """Execute the steps from the initial state. Returns the first effect, or None if nothing was wrong.

        Raises ``ConformanceError`` if the target cannot be used at all.
        """
        ...
