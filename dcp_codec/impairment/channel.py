"""One direction of a bad link: decides the fate of each frame."""

from __future__ import annotations

import hashlib
import math
import random
from collections.abc import Iterator
from typing import Final, Literal, NamedTuple

from .counters import Counters
from .parameters import PERFECT, Impairment

Event = Literal["lost", "down", "corrupted", "duplicated", "reordered"]
#: More octets than any link carries.
_NEVER: Final = 1e18
_NOTHING: Final[frozenset[Event]] = frozenset()
_LOST: Final[frozenset[Event]] = frozenset({"lost"})
_DOWN: Final[frozenset[Event]] = frozenset({"down"})


class Copy(NamedTuple):
    """A frame that arrives: its time (ns) and its octets."""

    time: int
    octets: bytes


class Fate(NamedTuple):
    """The decisions about one frame."""

    number: int
    """Number of the frame on this channel, counted from 1."""
    copies: tuple[Copy, ...]
    """The copies that arrive, in the order of arrival; empty if the frame is lost."""
    events: frozenset[Event]
    """The effects on the frame, apart from delay."""


class Channel:
    """One direction of a link. Call :meth:`offer` for each frame, in the order of sending.

    Each effect has its own random generator, seeded with ``seed``, ``name`` and the name of the effect, so a change of
    the delay does not change which frames are lost. A frame that is sent while the link is up causes these draws:
    *loss* one number, or two with bursts (transition of the state, then loss in the bad state if ``bad`` is below 1).
    If the frame is not lost: *corruption* one number for each inverted bit and one or two more, *delay* one for each
    copy if there is jitter, *reordering* one, *duplication* one. An effect that is switched off draws nothing.
    """

    def __init__(self, impairment: Impairment = PERFECT, seed: int = 1, name: str = "") -> None:
        """``seed`` and ``name`` together determine every decision."""
        self.counters = Counters()
        self._impairment = impairment
        self._loss, self._corruption, self._delay, self._order, self._copying = (
            _generator(seed, name, effect) for effect in ("loss", "corruption", "delay", "order", "duplication")
        )
        self._bad: bool | None = None
        """The state of the Gilbert-Elliott model (true: bad); None before the first frame."""
        self._losing = False
        """Whether the last frame was lost at random."""
        self._last = 0
        """The latest time of arrival of a frame that was not held back."""
        self._gap: int | None = None
        """Octets before the next corrupted octet; None: not drawn yet."""

    @property
    def impairment(self) -> Impairment:
        """Return the current impairment of this channel."""
        return self._impairment

    def change(self, impairment: Impairment) -> None:
        """Replace the impairment for all later frames; frames under way are not affected."""
        if impairment.corrupt != self._impairment.corrupt:
            self._gap = None
        if impairment.bursts != self._impairment.bursts:
            self._bad = None
        self._impairment = impairment

    def offer(self, octets: bytes, now: int, start: int = 0) -> Fate:
        """Decide the fate of a frame that is sent at ``now`` (ns since the start, not before the time of the last
        call).

        Octets before ``start``, such as a header, are not corrupted.
        """
        wanted, counters = self._impairment, self.counters
        counters.offered += 1
        number = counters.offered
        if any(each.covers(now) for each in wanted.down):
            counters.down += 1
            return Fate(number, (), _DOWN)
        lost = self._loses()
        if lost:
            counters.lost += 1
            counters.bursts += not self._losing
        self._losing = lost
        if lost:
            return Fate(number, (), _LOST)
        if not (wanted.alters or wanted.delays):
            # Frames must not overtake those that an earlier impairment with a longer delay still holds.
            self._last = max(self._last, now)
            counters.copies += 1
            counters.delayed += 1
            counters.delay += self._last - now
            return Fate(number, (Copy(self._last, octets),), _NOTHING)
        events: set[Event] = set()
        if changed := self._corrupt(octets, start):
            octets = changed
            events.add("corrupted")
        copies = [Copy(self._arrival(now, events), octets)]
        if wanted.duplicate and self._copying.random() < wanted.duplicate:
            events.add("duplicated")
            counters.duplicated += 1
            copies.append(Copy(self._arrival(now, events), octets))
            copies.sort(key=lambda copy: copy.time)
        counters.copies += len(copies)
        return Fate(number, tuple(copies), frozenset(events))

    def _loses(self) -> bool:
        wanted = self._impairment
        enter, leave = wanted.bursts
        if not enter:
            return bool(wanted.loss) and self._loss.random() < wanted.loss
        draw = self._loss.random()
        if self._bad is None:
            # Initial state: drawn with the stationary probabilities of the two states.
            self._bad = draw < enter / (enter + leave)
        else:
            self._bad = draw >= leave if self._bad else draw < enter
        return self._bad and (wanted.bad >= 1.0 or self._loss.random() < wanted.bad)

    def _arrival(self, now: int, events: set[Event]) -> int:
        """Return the time of arrival of a copy; it overtakes no frame except those that are held back."""
        wanted, counters = self._impairment, self.counters
        time = now + wanted.delay
        if wanted.jitter:
            time = max(now, time + self._jitter())
        if wanted.reorder and self._order.random() < wanted.reorder:
            if "reordered" not in events:
                events.add("reordered")
                counters.reordered += 1
            return time + wanted.reorder_delay
        self._last = max(self._last, time)
        counters.delay += self._last - now
        counters.delayed += 1
        return self._last

    def _jitter(self) -> int:
        jitter, how = self._impairment.jitter, self._impairment.distribution
        if how == "uniform":
            return round(self._delay.random() * jitter)
        if how == "exponential":
            return round(self._delay.expovariate(1.0) * jitter)
        return round(self._delay.gauss(0.0, jitter))

    def _corrupt(self, octets: bytes, start: int) -> bytes | None:
        """Return the octets with inverted bits; None if no bit is inverted."""
        wanted, size = self._impairment, len(octets) - start
        if size <= 0 or not (wanted.corrupt or wanted.corrupt_frames):
            return None
        self.counters.octets += size
        bits = {start * 8 + place for place in self._spread(size)}
        draw = self._corruption
        if wanted.corrupt_frames and draw.random() < wanted.corrupt_frames:
            bits.update(draw.sample(range(start * 8, len(octets) * 8), min(wanted.flips, size * 8)))
        if not bits:
            return None
        self.counters.corrupted += 1
        self.counters.flipped += len(bits)
        found = bytearray(octets)
        for place in bits:
            found[place // 8] ^= 0x80 >> place % 8
        return bytes(found)

    def _spread(self, size: int) -> Iterator[int]:
        """Yield the positions of inverted bits in the next ``size`` octets; the gaps between corrupted octets are
        geometric.
        """
        share, draw = self._impairment.corrupt, self._corruption
        if not share:
            return
        if self._gap is None:
            self._gap = _gap(draw, share)
        place = self._gap
        while place < size:
            yield place * 8 + draw.getrandbits(3)
            place += 1 + _gap(draw, share)
        self._gap = place - size


def _gap(draw: random.Random, share: float) -> int:
    """Draw the number of unchanged octets before the next corrupted one."""
    if share >= 1.0:
        return 0
    # Bounded because the quotient is infinite for a very small share.
    return int(min(math.log(1.0 - draw.random()) / math.log1p(-share), _NEVER))


def _generator(seed: int, name: str, effect: str) -> random.Random:
    # Hashed because similar seeds of Random give similar first numbers.
    digest = hashlib.sha256(f"{seed}/{name}/{effect}".encode()).digest()
    return random.Random(int.from_bytes(digest[:16], "big"))  # noqa: S311 - chance of a simulation
