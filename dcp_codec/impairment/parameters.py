"""Parameters of a bad link, for one direction."""

from __future__ import annotations

import math
from typing import Final, Literal

import msgspec

Distribution = Literal["uniform", "normal", "exponential"]
#: The delay (ns) of a frame that is held back, unless the user gives ``reorder_delay``.
REORDER_DELAY: Final = 50_000_000
_SHARES: Final = ("loss", "p", "r", "bad", "duplicate", "reorder", "corrupt", "corrupt_frames")
_TIMES: Final = ("delay", "jitter", "reorder_delay")


class ImpairmentError(ValueError):
    """A parameter of a link is wrong; the message names the key and the reason."""


class Outage(msgspec.Struct, frozen=True, order=True):
    """An interval in which the link is down, in ns since the start. ``period`` repeats it; 0: it occurs once."""

    start: int
    duration: int
    period: int = 0

    def covers(self, time: int) -> bool:
        """Return whether the link is down at ``time`` (ns since the start)."""
        since = time - self.start
        if since < 0:
            return False
        return (since % self.period if self.period else since) < self.duration


class Impairment(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The effects of a link on the frames of one direction. Shares are 0..1, times are ns.

    Loss is independent (``loss``), or occurs in bursts (Gilbert-Elliott model): a frame is lost with probability
    ``bad`` in the bad state and never in the good state. ``p`` and ``r`` are the probabilities per frame of the
    transitions from good to bad and back; ``loss`` with ``burst`` (mean number of frames in the bad state) determines
    both.

    The delay of a frame is ``delay`` plus a random part with the given ``distribution``: uniform in 0..``jitter``,
    exponential with the mean ``jitter``, or normal around ``delay`` with the standard deviation ``jitter``, never less
    than 0. A share ``reorder`` of the frames is held back for another ``reorder_delay``; only such a frame is overtaken
    by later ones. A share ``duplicate`` arrives twice; the delay of the second copy is drawn separately.

    ``corrupt`` is the probability, for each octet, that one of its bits is inverted; ``corrupt_frames`` is the share of
    frames in which ``flips`` different bits are inverted.

    Raises ``ImpairmentError`` if a value is out of range or two values contradict each other.
    """

    loss: float = 0.0
    burst: float = 0.0
    """Mean number of frames in a burst, at least 1; 0: losses are independent."""
    p: float = 0.0
    r: float = 0.0
    bad: float = 1.0
    delay: int = 0
    jitter: int = 0
    distribution: Distribution = "uniform"
    duplicate: float = 0.0
    reorder: float = 0.0
    reorder_delay: int = REORDER_DELAY
    corrupt: float = 0.0
    corrupt_frames: float = 0.0
    flips: int = 1
    down: tuple[Outage, ...] = ()

    def __post_init__(self) -> None:
        for name in _SHARES:
            value = getattr(self, name)
            if not 0.0 <= value <= 1.0:
                raise ImpairmentError(f"{name}: {value:g} is not within 0..1")
        for name in _TIMES:
            if getattr(self, name) < 0:
                raise ImpairmentError(f"{name}: a time must not be negative")
        if self.flips < 1:
            raise ImpairmentError(f"flips: {self.flips} is not at least 1")
        for each in self.down:
            _check_outage(each)
        self._check_bursts()

    def _check_bursts(self) -> None:
        if self.burst and not 1 <= self.burst < math.inf:
            raise ImpairmentError(f"burst: {self.burst:g} frames; a burst has at least 1")
        if self.p or self.r:
            if self.loss or self.burst:
                raise ImpairmentError("p: p and r replace loss and burst; give one pair or the other")
            if not (self.p and self.r):
                missing = "r" if self.p else "p"
                raise ImpairmentError(f"{missing}: p and r are given together, both greater than 0")
            return
        if self.bad != 1.0 and not self.burst:
            raise ImpairmentError("bad: the loss in the bad state needs p and r, or loss and burst")
        if not self.burst:
            return
        if not self.loss:
            raise ImpairmentError("burst: without loss there are no bursts; give loss, too")
        if self.loss >= self.bad:
            raise ImpairmentError(
                f"loss: {self.loss:g} is not below the loss in the bad state of bursts ({self.bad:g})"
            )
        if self._entry() > 1.0:
            least = self.loss / (self.bad - self.loss)
            raise ImpairmentError(f"burst: a loss of {self.loss:g} needs bursts of at least {least:.3g} frames")

    def _entry(self) -> float:
        share = self.loss / self.bad
        return share / (1.0 - share) / self.burst

    @property
    def bursts(self) -> tuple[float, float]:
        """Return the transition probabilities ``p`` and ``r``; (0, 0) for independent losses."""
        if self.p:
            return self.p, self.r
        return (self._entry(), 1.0 / self.burst) if self.burst else (0.0, 0.0)

    @property
    def mean_loss(self) -> float:
        """Return the share of frames lost in the long run; outages are not counted."""
        return self.bad * self.p / (self.p + self.r) if self.p else self.loss

    @property
    def perfect(self) -> bool:
        """Return whether frames pass unchanged and without delay."""
        return not (self.mean_loss or self.down or self.alters or self.delays)

    @property
    def alters(self) -> bool:
        """Return whether frames can arrive corrupted, duplicated or in another order."""
        return bool(self.duplicate or self.reorder or self.corrupt or self.corrupt_frames)

    @property
    def delays(self) -> bool:
        """Return whether frames are delayed, apart from frames that are held back for reordering."""
        return bool(self.delay or self.jitter)

    def only_delays(self) -> Impairment:
        """Return an impairment with the same delay and jitter, without all other effects."""
        return Impairment(delay=self.delay, jitter=self.jitter, distribution=self.distribution)


PERFECT: Final = Impairment()


def _check_outage(outage: Outage) -> None:
    if outage.start < 0 or outage.duration <= 0 or outage.period < 0:
        raise ImpairmentError("down: an outage starts at 0 s or later, and lasts longer than 0 s")
    if outage.period and outage.period <= outage.duration:
        raise ImpairmentError("down: the period of an outage is longer than the outage")
