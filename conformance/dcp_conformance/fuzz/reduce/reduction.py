"""The ways in which a finding is made small, confirmed and explained, the cheap ones first."""

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
    """What is left of an effect."""

    steps: list[Step]
    effect: Effect
    minimised: bool
    confirmed: bool
    """Whether it was seen again from the beginning."""
    cause: Cause | None = None
    """Why it shows; None for what is no sequence of frames."""


def as_it_was(steps: list[Step], effect: Effect, codec: Codec | None = None) -> Finding:
    """An effect that was not made small. With a codec, its cause is told as far as the steps show it."""
    # What came after it cannot have been it.
    shown = steps[: effect.step + 1]
    cause = explained(codec, shown, effect) if codec is not None else None
    return Finding(shown, effect, minimised=False, confirmed=False, cause=cause)


class Reduction:
    """One finding on its way to its smallest form. What it has come to is there also after an interruption.

    ``run`` carries steps out on the target. ``fresh`` does so on a target that was just restarted, where ``run`` does
    not always; ``model`` on something fast, on which findings may show, too. ``budget`` (attempts) and ``seconds`` are
    for one way; ways that restart before each attempt have four times the seconds. ``codec`` is None for octets that
    are no beacons. ``own_id`` is the identifier of the node.
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
        """What has made it small in the end."""
        self._culprit = ""
        self.confirmed = False
        """Whether what is left was seen again from the beginning."""

    @property
    def found(self) -> Minimised | None:
        """The smallest so far; None if the effect was not seen again."""
        return (self._minimiser.found if self._minimiser is not None else None) or self._found

    def outcome(self, steps: list[Step], effect: Effect) -> Finding:
        """What there is to keep of an effect of ``steps``, however far it has come."""
        found = self.found
        if found is None:
            return as_it_was(steps, effect, self._codec)
        cause = None
        if self._codec is not None:
            judge = self._judge or self._minimiser
            proven = judge is not None and judge.is_proven()
            first = judge.whole if judge is not None else []
            cause = explained(self._codec, found.steps, found.effect, first, proven=proven, culprit=self._culprit)
        return Finding(found.steps, found.effect, minimised=True, confirmed=self.confirmed, cause=cause)

    def reduce(self, steps: list[Step], effect: Effect, history: Sequence[Step] = ()) -> None:
        """Try one way after the other until one is confirmed, and find out which rule is broken.

        ``history``: what was sent before the steps. Raises what the target raises.
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
        # What was sent before had a part in it: each attempt needs a beginning of its own, which takes its time.
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
        """Minimised on the model, if it shows there and the result shows on the target itself."""
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
        """Once more, from the beginning; not for what is known."""
        if self._fresh is None or (self._known is not None and self._known(found.steps, found.effect)):
            return True
        again = self._fresh(found.steps)
        return again is not None and again.signature == found.effect.signature

    def _broken_rule(self, codec: Codec, found: Minimised) -> str:
        """The requirement that an experiment finds to be broken; empty if the effect's own stands."""
        try:
            return broken_rule(codec, found.steps, found.effect, self._fresh or self._run, self._own_id)
        except (ConformanceError, CodecError):
            # The finding stays what it is.
            return ""


__all__ = ["Finding", "Reduction", "as_it_was"]
