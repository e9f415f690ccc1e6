"""Minimise, confirm and explain a finding by several strategies, the fastest first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from dcp_codec.codec import Codec
from dcp_lab.fuzz.steps import Effect, Step

from .causes import Cause, explained
from .minimise import Known, Minimised, Minimiser, Run


class Finding(NamedTuple):
    """A minimised effect, or one that could not be minimised."""

    steps: list[Step]
    effect: Effect
    minimised: bool
    confirmed: bool
    """Whether the effect occurred again from the initial state."""
    cause: Cause | None = None
    """The probable cause; None for inputs of functions."""


def not_minimised(steps: list[Step], effect: Effect, codec: Codec | None = None) -> Finding:
    """Return a finding that was not minimised. With a codec, its cause is determined from the steps alone."""
    # Steps after the effect cannot have caused it.
    shown = steps[: effect.step + 1]
    cause = explained(codec, shown, effect) if codec is not None else None
    return Finding(shown, effect, minimised=False, confirmed=False, cause=cause)


@dataclass
class Reduction:
    """Minimisation of one finding. Its best result is available also after an interruption.

    ``run`` executes steps on the target. ``fresh`` does so after a restart, if ``run`` does not always restart.
    ``budget`` (executions) and ``seconds`` limit each strategy; strategies that restart before each execution have
    four times the seconds. ``codec`` is None for inputs that are not beacons.
    """

    run: Run
    codec: Codec | None
    fresh: Run | None = None
    budget: int = 600
    seconds: float | None = None
    known: Known | None = None
    confirmed: bool = field(default=False, init=False)
    """Whether a repetition from the initial state had the same effect."""
    _minimiser: Minimiser | None = field(default=None, init=False)
    _found: Minimised | None = field(default=None, init=False)

    @property
    def found(self) -> Minimised | None:
        """The best result so far; None if the effect did not occur again."""
        return (self._minimiser.found if self._minimiser is not None else None) or self._found

    def outcome(self, steps: list[Step], effect: Effect) -> Finding:
        """Return the finding with the best result so far; with the original ``steps`` if there is none."""
        found = self.found
        if found is None:
            return not_minimised(steps, effect, self.codec)
        cause = None
        if self.codec is not None:
            judge = self._minimiser
            proven = judge is not None and judge.is_proven()
            first = judge.whole if judge is not None else []
            cause = explained(self.codec, found.steps, found.effect, first, proven=proven)
        return Finding(found.steps, found.effect, minimised=True, confirmed=self.confirmed, cause=cause)

    def reduce(self, steps: list[Step], effect: Effect, history: Sequence[Step] = ()) -> None:
        """Try the strategies until one is confirmed. ``history``: the steps before.

        Forwards exceptions of the target.
        """
        if self._by_itself(self.run, steps, effect, self.seconds) or self.fresh is None:
            return
        # Earlier frames may be part of the cause, so each execution needs a restart, which takes time.
        seconds = None if self.seconds is None else 4 * self.seconds
        if self.found is not None and self._by_itself(self.fresh, steps, effect, seconds):
            return
        if history:
            both = [*history, *steps]
            shown = effect._replace(step=len(history) + effect.step)
            self._by_itself(self.fresh, both, shown, seconds, least=2 * len(steps))

    def _by_itself(self, run: Run, steps: list[Step], effect: Effect, seconds: float | None, least: int = 1) -> bool:
        self._found = self.found
        self._minimiser = Minimiser(run, effect, self.codec, budget=self.budget, seconds=seconds, known=self.known)
        found = self._minimiser.minimise(steps, least)
        self.confirmed = found is not None and self._shows_again(found)
        return self.confirmed

    def _shows_again(self, found: Minimised) -> bool:
        """Return whether the effect occurs again after a restart. Known findings are not repeated."""
        if self.fresh is None or (self.known is not None and self.known(found.steps, found.effect)):
            return True
        again = self.fresh(found.steps)
        return again is not None and again.signature == found.effect.signature
