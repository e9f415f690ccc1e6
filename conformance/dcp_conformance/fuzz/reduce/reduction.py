"""Minimise, confirm and explain a finding by several strategies, the fastest first."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from dcp_codec.codec import Codec
from dcp_codec.errors import CodecError
from dcp_conformance.errors import ConformanceError
from dcp_conformance.fuzz.steps import Effect, Step

from .causes import Cause, explained
from .experiments import broken_rule
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


class Reduction:
    """Minimisation of one finding. Its best result is available also after an interruption.

    ``run`` executes steps on the target. ``fresh`` does so after a restart, if ``run`` does not always restart.
    ``model`` executes steps on a fast target that may show the same effect. ``budget`` (executions) and ``seconds``
    limit each strategy; strategies that restart before each execution have four times the seconds. ``codec`` is None
    for inputs that are not beacons. ``own_id`` is the identifier of the node.
    """

    def __init__(
        self,
        run: Run,
        codec: Codec | None,
        *,
        fresh: Run | None = None,
        model: Run | None = None,
        budget: int = 600,
        seconds: float | None = None,
        known: Known | None = None,
        own_id: bytes = b"",
    ) -> None:
        self._run = run
        self._codec = codec
        self._fresh = fresh
        self._model = model
        self._budget = budget
        self._seconds = seconds
        self._known = known
        self._own_id = own_id
        self._minimiser: Minimiser | None = None
        self._found: Minimised | None = None
        self._judge: Minimiser | None = None
        """The minimiser that produced the final result."""
        self._culprit = ""
        self.confirmed = False
        """Whether the result showed the effect again from the initial state."""

    @property
    def found(self) -> Minimised | None:
        """The best result so far; None if the effect did not occur again."""
        return (self._minimiser.found if self._minimiser is not None else None) or self._found

    def outcome(self, steps: list[Step], effect: Effect) -> Finding:
        """Return the finding with the best result so far; with the original ``steps`` if there is none."""
        found = self.found
        if found is None:
            return not_minimised(steps, effect, self._codec)
        cause = None
        if self._codec is not None:
            judge = self._judge or self._minimiser
            proven = judge is not None and judge.is_proven()
            first = judge.whole if judge is not None else []
            cause = explained(self._codec, found.steps, found.effect, first, proven=proven, culprit=self._culprit)
        return Finding(found.steps, found.effect, minimised=True, confirmed=self.confirmed, cause=cause)

    def reduce(self, steps: list[Step], effect: Effect, history: Sequence[Step] = ()) -> None:
        """Try the strategies until one is confirmed, then determine the violated requirement by experiments.

        ``history``: the steps before. Forwards exceptions of the target.
        """
        self._make_small(steps, effect, history)
        found = self.found
        if self.confirmed and found is not None and self._codec is not None and found.effect.kind in ("said", "state"):
            self._culprit = self._broken_rule(self._codec, found)

    def _make_small(self, steps: list[Step], effect: Effect, history: Sequence[Step]) -> None:
        if self._model is not None and self._in_process(self._model, steps, effect):
            return
        if self._by_itself(self._run, steps, effect, self._seconds) or self._fresh is None:
            return
        # Earlier frames may be part of the cause, so each execution needs a restart, which takes time.
        seconds = None if self._seconds is None else 4 * self._seconds
        if self.found is not None and self._by_itself(self._fresh, steps, effect, seconds):
            return
        if history:
            both = [*history, *steps]
            shown = effect._replace(step=len(history) + effect.step)
            self._by_itself(self._fresh, both, shown, seconds, least=2 * len(steps))

    def _by_itself(self, run: Run, steps: list[Step], effect: Effect, seconds: float | None, least: int = 1) -> bool:
        self._found = self.found
        self._minimiser = Minimiser(run, effect, self._codec, budget=self._budget, seconds=seconds, known=self._known)
        found = self._minimiser.minimise(steps, least)
        self.confirmed = found is not None and self._shows_again(found)
        return self.confirmed

    def _in_process(self, model: Run, steps: list[Step], effect: Effect) -> bool:
        """Minimise on the model. Returns whether the model and the target show the effect with the result."""
        like = model(steps)
        if like is None:
            return False
        minimiser = Minimiser(model, like, self._codec, budget=self._budget)
        found = minimiser.minimise(steps)
        again = self._run(found.steps) if found is not None else None
        if found is None or again is None or again.signature != effect.signature:
            return False
        self._found = Minimised(found.steps, again, found.tries + 1)
        self._judge = minimiser
        self.confirmed = True
        return True

    def _shows_again(self, found: Minimised) -> bool:
        """Return whether the effect occurs again after a restart. Known findings are not repeated."""
        if self._fresh is None or (self._known is not None and self._known(found.steps, found.effect)):
            return True
        again = self._fresh(found.steps)
        return again is not None and again.signature == found.effect.signature

    def _broken_rule(self, codec: Codec, found: Minimised) -> str:
        """Return the requirement that is violated according to experiments; empty if the effect itself names it."""
        try:
            return broken_rule(codec, found.steps, found.effect, self._fresh or self._run, self._own_id)
        except (ConformanceError, CodecError):
            # The experiment failed; the finding keeps the requirements of its effect.
            return ""


__all__ = ["Finding", "Reduction", "not_minimised"]
