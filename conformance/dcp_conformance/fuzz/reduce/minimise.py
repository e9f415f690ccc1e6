"""Making findings small: fewer steps first, then less in each of them.

The minimiser knows nothing of how steps are carried out; it is given a function that does, and tries again and again
with less. What it returns has shown the same effect (by its signature) when it was last tried.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from typing import Final, NamedTuple

import msgspec

from dcp_codec.codec import Codec
from dcp_conformance.fuzz.steps import STOPPED, Effect, Frame, Step, Wait

from .shrinking import shrinker_of

#: What does not come back counts for as many attempts more: it takes all the time that a test may have.
_HANGING: Final = 20
#: Damaged frames that are tried alone.
_ALONE: Final = 20

Run = Callable[[list[Step]], Effect | None]
Known = Callable[[list[Step], Effect], bool]


class Minimised(NamedTuple):
    """What is left, the effect that it shows, and how often steps were carried out to find it."""

    steps: list[Step]
    effect: Effect
    tries: int


class _Spent(Exception):  # noqa: N818 - not an error
    """The budget is used up."""


class Minimiser:
    """Minimises one finding."""

    def __init__(
        self,
        run: Run,
        effect: Effect,
        codec: Codec | None = None,
        *,
        budget: int = 600,
        seconds: float | None = None,
        known: Known | None = None,
    ) -> None:
        """``budget``, ``seconds``: how often steps may be carried out, and how long. ``codec``: of frames that are
        beacons; without it, octets have no structure. ``known``: whether what is left after leaving out steps is worth
        no more work.
        """
        self._run = run
        self._first = effect
        self._signature = effect.signature
        self._shrinker = shrinker_of(codec) if codec is not None else None
        self._budget = budget
        self._deadline = None if seconds is None else time.monotonic() + seconds
        self._known = known
        self._tries = self._hangs = 0
        """Attempts, and those of them that did not come back."""
        self._in_vain: set[int] = set()
        """Steps that have not shown the effect."""
        self._best: tuple[list[Step], Effect] | None = None
        self.whole: list[Step] = []
        """The steps that are left, with their frames as they were; empty before that is known."""

    def minimise(self, steps: list[Step], least: int = 1) -> Minimised | None:
        """The smallest that was found; None if the steps do not show the effect at all.

        ``least``: how many of the last steps may be enough.
        """
        try:
            shown = steps[: self._first.step + 1]
            if not (
                self._alone(shown)
                or self._last(shown, least)
                or self._shows(shown)
                or (len(shown) < len(steps) and self._shows(steps))
            ):
                return None
            frames: list[Step] = [step for step in self._steps if isinstance(step, Frame)]
            if 0 < len(frames) < len(self._steps):
                # Without waiting everything else goes faster.
                self._shows(frames)
            before = -1
            while before != len(self._steps):
                before = len(self._steps)
                self._fewer()
                self._single()
            if self._known is None or not self._known(self._steps, self._effect):
                self.whole = self._steps
                self._smaller()
                self._fewer()
                self._prove()
        except _Spent:
            pass
        return self.found

    @property
    def found(self) -> Minimised | None:
        """The best so far, also when :meth:`minimise` was interrupted; None if nothing has shown the effect again."""
        return None if self._best is None else Minimised(self._steps, self._effect, self._tries)

    def is_proven(self) -> bool:
        """Whether no anomaly of what was found can be repaired without the effect being gone."""
        repaired = self._repaired()
        return bool(repaired) and all(hash(repr(steps)) in self._in_vain for steps in repaired)

    def _repaired(self) -> list[list[Step]]:
        """The steps with one anomaly repaired, for each that can be."""
        if self._shrinker is None or self._best is None:
            return []
        return [
            [msgspec.structs.replace(each, octets=octets) if each == frame else each for each in self._steps]
            for frame in dict.fromkeys(step for step in self._steps if isinstance(step, Frame))
            for octets in self._shrinker.sound_forms(frame.octets)
        ]

    def _prove(self) -> None:
        """Try every anomaly that is left once more without it: frames that were made small later may have changed."""
        while any(self._shows(steps) for steps in self._repaired()):
            pass

    @property
    def _steps(self) -> list[Step]:
        assert self._best is not None
        return self._best[0]

    @property
    def _effect(self) -> Effect:
        assert self._best is not None
        return self._best[1]

    def _shows(self, steps: list[Step]) -> bool:
        """Whether these steps show the effect; if so they are the best so far."""
        spent = self._tries + _HANGING * self._hangs
        if spent >= self._budget or (self._deadline is not None and time.monotonic() > self._deadline):
            raise _Spent
        key = hash(repr(steps))
        if key in self._in_vain:
            return False
        self._tries += 1
        effect = self._run(steps)
        self._hangs += effect is not None and effect.kind == "hang"
        if effect is None or effect.signature != self._signature:
            self._in_vain.add(key)
            return False
        self._best = (steps, effect)
        return True

    # -- fewer steps -------------------------------------------------------------------------------------------

    def _alone(self, steps: list[Step]) -> bool:
        """Most deaths are shown by one damaged frame. One that is survived costs a look, and no restart."""
        if self._shrinker is None or self._first.kind not in STOPPED:
            return False
        frames = [step for step in dict.fromkeys(reversed(steps)) if isinstance(step, Frame)]
        damaged = (frame for frame in frames if self._shrinker.is_damaged(frame.octets))
        return any(self._shows([frame]) for frame in itertools.islice(damaged, _ALONE))

    def _last(self, steps: list[Step], least: int) -> bool:
        """What is at fault has most often come last: one step, two, four, as long as nothing is seen of it."""
        size = least
        while size < len(steps) // 2:
            if self._shows(steps[-size:]):
                return True
            size *= 2
        return False

    def _fewer(self) -> None:
        """Delta debugging: leave out parts, from halves down to single steps."""
        parts = 2
        while len(self._steps) > 1:
            steps = self._steps
            size = max(1, len(steps) // parts)
            for start in range(0, len(steps), size):
                left = steps[:start] + steps[start + size :]
                if left and self._shows(left):
                    parts = max(2, parts - 1)
                    break
            else:
                if size == 1:
                    return
                parts *= 2

    def _single(self) -> None:
        """Leave out single steps, from the end."""
        at = len(self._steps) - 1
        while at >= 0 and len(self._steps) > 1:
            self._shows(self._steps[:at] + self._steps[at + 1 :])
            at = min(at, len(self._steps)) - 1

    # -- less in a step ----------------------------------------------------------------------------------------

    def _smaller(self) -> None:
        for at in range(len(self._steps)):
            step = self._steps[at]
            if isinstance(step, Wait) and step.periods > 0.5:
                self._replaced(at, Wait(0.5))
            elif isinstance(step, Frame):
                self._smaller_frame(at)

    def _replaced(self, at: int, step: Step) -> bool:
        """Try another step instead of this one and of all that are like it."""
        before = self._steps[at]
        return self._shows([step if each == before else each for each in self._steps])

    def _with(self, at: int, octets: bytes) -> bool:
        """Try other octets in a frame."""
        frame = self._steps[at]
        assert isinstance(frame, Frame)
        return octets != frame.octets and self._replaced(at, msgspec.structs.replace(frame, octets=octets))

    def _octets(self, at: int) -> bytes:
        frame = self._steps[at]
        assert isinstance(frame, Frame)
        return frame.octets

    def _smaller_frame(self, at: int) -> None:
        frame = self._steps[at]
        assert isinstance(frame, Frame)
        if self._shrinker is None:
            self._shorter(at)
        else:
            self._shrinker.shrink(frame.octets, lambda octets: self._with(at, octets), frame.valid)

    def _shorter(self, at: int) -> None:
        """Leave out octets, from half of them down to single ones; in short messages also from the middle."""
        size = max(1, len(self._octets(at)) // 2)
        while size:
            octets = self._octets(at)
            if len(octets) > size and self._with(at, octets[:-size]):
                continue
            for start in range(0, len(octets) - size, size) if len(octets) <= 64 * size else ():
                if self._with(at, octets[:start] + octets[start + size :]):
                    break
            else:
                size //= 2
