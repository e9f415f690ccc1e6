"""Minimise findings: first the number of steps, then the contents of each step.

The minimiser executes smaller and smaller variants of the steps by a function that it receives. Its result showed the
effect with the same signature in its last execution.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from functools import partial
from typing import Final, NamedTuple

import msgspec

from dcp_codec.codec import Codec
from dcp_lab.fuzz.steps import STOPPED, Effect, Frame, Step, Wait

from .anomalies import anomalies
from .shrinking import shrinker_of

#: Number of attempts that a hang counts as, in addition: it takes the whole time limit of a test.
_HANGING: Final = 20
#: Maximum number of damaged frames that are tried alone.
_ALONE: Final = 20

Run = Callable[[list[Step]], Effect | None]
Known = Callable[[list[Step], Effect], bool]


class Minimised(NamedTuple):
    """Minimised steps, their effect, and the number of executions."""

    steps: list[Step]
    effect: Effect
    tries: int


class _Spent(Exception):  # noqa: N818 - not an error
    """The budget is used up."""


class Minimiser:
    """Minimiser of one finding."""

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
        """``budget``: maximum number of executions. ``seconds``: maximum time. ``codec``: decodes frames; without it,
        octets have no structure. ``known``: returns whether steps and effect are a known finding, whose frames need not
        be minimised.
        """
        self._run = run
        self._first = effect
        self._signature = effect.signature
        self._shrinker = shrinker_of(codec) if codec is not None else None
        self._budget = budget
        self._deadline = None if seconds is None else time.monotonic() + seconds
        self._known = known
        self._tries = self._hangs = 0
        """Number of executions, and of those that hung."""
        self._in_vain: set[int] = set()
        """Hashes of the steps that did not show the effect."""
        self._best: tuple[list[Step], Effect] | None = None
        self.whole: list[Step] = []
        """The minimised list of steps with unchanged frames; empty until it is known."""

    def minimise(self, steps: list[Step], least: int = 1) -> Minimised | None:
        """Return the smallest steps that show the effect; None if the effect does not occur again.

        ``least``: number of last steps that are tried first.
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
                # Without waits the following attempts are faster.
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
        """The best result so far, also after an interruption; None if the effect did not occur again."""
        return None if self._best is None else Minimised(self._steps, self._effect, self._tries)

    def is_proven(self) -> bool:
        """Return whether the repair of any one anomaly makes the effect disappear."""
        repaired = self._repaired()
        return bool(repaired) and all(hash(repr(steps)) in self._in_vain for steps in repaired)

    def _repaired(self) -> list[list[Step]]:
        """Return the steps with one anomaly repaired, for each anomaly that can be repaired."""
        if self._shrinker is None or self._best is None:
            return []
        return [
            [msgspec.structs.replace(each, octets=octets) if each == frame else each for each in self._steps]
            for frame in dict.fromkeys(step for step in self._steps if isinstance(step, Frame))
            for octets in self._shrinker.sound_forms(frame.octets)
        ]

    def _prove(self) -> None:
        """Try again to repair each anomaly: other frames may have changed since the last attempt."""
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
        """Return whether these steps show the effect, and store them as the best result if they do."""
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
        """Try single damaged frames, which cause most crashes. A frame that is survived needs no restart."""
        if self._shrinker is None or self._first.kind not in STOPPED:
            return False
        frames = dict.fromkeys(step for step in reversed(steps) if isinstance(step, Frame))
        damaged = (frame for frame in frames if anomalies(self._shrinker.codec, frame.octets))
        return any(self._shows([frame]) for frame in itertools.islice(damaged, _ALONE))

    def _last(self, steps: list[Step], least: int) -> bool:
        """Try the last steps, doubling their number until the effect occurs: the cause is most often near the end."""
        size = least
        while size < len(steps) // 2:
            if self._shows(steps[-size:]):
                return True
            size *= 2
        return False

    def _fewer(self) -> None:
        """Remove parts by delta debugging, from halves down to single steps."""
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
        """Remove single steps, from the end."""
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
            elif isinstance(step, Frame) and self._shrinker is None:
                self._shorter(at)
            elif isinstance(step, Frame) and self._shrinker is not None:
                self._shrinker.shrink(step.octets, partial(self._with, at), step.valid)

    def _replaced(self, at: int, step: Step) -> bool:
        """Try to replace a step, and all steps that are equal to it, by another step."""
        before = self._steps[at]
        return self._shows([step if each == before else each for each in self._steps])

    def _with(self, at: int, octets: bytes) -> bool:
        """Try to replace the octets of a frame."""
        frame = self._frame(at)
        return octets != frame.octets and self._replaced(at, msgspec.structs.replace(frame, octets=octets))

    def _frame(self, at: int) -> Frame:
        frame = self._steps[at]
        assert isinstance(frame, Frame)
        return frame

    def _shorter(self, at: int) -> None:
        """Remove octets, from half of them down to single ones; in short messages also in the middle."""
        size = max(1, len(self._frame(at).octets) // 2)
        while size:
            octets = self._frame(at).octets
            if len(octets) > size and self._with(at, octets[:-size]):
                continue
            for start in range(0, len(octets) - size, size) if len(octets) <= 64 * size else ():
                if self._with(at, octets[:start] + octets[start + size :]):
                    break
            else:
                size //= 2
