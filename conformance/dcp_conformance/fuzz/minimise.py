"""Making findings small: fewer steps first, then less in each of them.

The minimiser knows nothing of how steps are carried out; it is given a function that does, and tries again and again
with less. What it returns has shown the same effect (by its signature) when it was last tried.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any, Final, NamedTuple

import msgspec

from dcp_codec.codec import Codec
from dcp_codec.dissect import Field
from dcp_codec.errors import DecodeError, EncodeError

from .steps import Effect, Frame, Step, Wait

#: What does not come back counts for as many attempts more: it takes all the time that a test may have.
_HANGING: Final = 20

Run = Callable[[list[Step]], Effect | None]
Known = Callable[[list[Step], Effect], bool]
Cause = Callable[[list[Step]], str]


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
        cause: Cause | None = None,
    ) -> None:
        """``budget``, ``seconds``: how often steps may be carried out, and how long. ``codec``: takes beacons apart;
        octets are octets without. ``known``: whether what is left after leaving out steps is worth no more work.
        ``cause``: what octets may be at fault for; effects that look alike must not turn into each other on the way.
        """
        self._run = run
        self._first = effect
        self._signature = effect.signature
        self._codec = codec
        self._budget = budget
        self._deadline = None if seconds is None else time.monotonic() + seconds
        self._known = known
        self._cause = cause
        self._tries = self._hangs = 0
        """Attempts, and those of them that did not come back."""
        self._in_vain: set[int] = set()
        """Steps that have not shown the effect."""
        self._best: tuple[list[Step], Effect] | None = None

    def minimise(self, steps: list[Step], least: int = 1) -> Minimised | None:
        """The smallest that was found; None if the steps do not show the effect at all.

        ``least``: how many of the last steps may be enough.
        """
        try:
            shown = steps[: self._first.step + 1]
            if not (self._last(shown, least) or self._shows(shown) or (len(shown) < len(steps) and self._shows(steps))):
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
                for _ in range(2):
                    self._smaller()
                self._fewer()
        except _Spent:
            pass
        return self.found

    @property
    def found(self) -> Minimised | None:
        """The best so far, also when :meth:`minimise` was interrupted; None if nothing has shown the effect again."""
        return None if self._best is None else Minimised(self._steps, self._effect, self._tries)

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
        steps = self._steps
        return self._shows([*steps[:at], step, *steps[at + 1 :]])

    def _with(self, at: int, octets: bytes, *, other: bool = False) -> bool:
        """Try other octets in a frame. ``other``: the cause may be another one then, but none that is known."""
        frame = self._steps[at]
        assert isinstance(frame, Frame)
        if octets == frame.octets:
            return False
        steps = self._steps
        tried = [*steps[:at], msgspec.structs.replace(frame, octets=octets), *steps[at + 1 :]]
        if self._cause is not None and not other and self._cause(tried) != self._cause(steps):
            return False
        if other and self._known is not None and self._known(tried, self._effect):
            return False
        return self._shows(tried)

    def _octets(self, at: int) -> bytes:
        frame = self._steps[at]
        assert isinstance(frame, Frame)
        return frame.octets

    def _smaller_frame(self, at: int) -> None:
        frame = self._steps[at]
        assert isinstance(frame, Frame)
        if frame.valid and self._with(at, frame.valid, other=True):
            frame = msgspec.structs.replace(frame, octets=frame.valid)
        if frame.valid:
            for octets in self._towards(at, frame.valid):
                self._with(at, octets, other=True)
        going = True
        while going:
            going = any(self._with(at, octets) for octets in self._parts_left_out(self._octets(at)))
        self._shorter(at)

    def _towards(self, at: int, valid: bytes) -> Iterator[bytes]:
        """Each field that differs from the valid message as it is there."""
        if self._codec is None or len(valid) != len(self._octets(at)):
            return
        for field in self._codec.dissect(valid).root.walk():
            octets = self._octets(at)
            stop = field.offset + field.length
            if _is_leaf(field) and octets[field.offset : stop] != valid[field.offset : stop]:
                yield octets[: field.offset] + valid[field.offset : stop] + octets[stop:]

    def _parts_left_out(self, octets: bytes) -> Iterator[bytes]:
        """A beacon that can be decoded, without one of its payloads, containers or records."""
        if self._codec is None:
            return
        try:
            beacon = self._codec.decode(octets)
        except DecodeError:
            return
        replace = msgspec.structs.replace
        for number, payload in enumerate(beacon.payloads):
            others = beacon.payloads[:number], beacon.payloads[number + 1 :]

            def around(content: Any, payload: Any = payload, others: Any = others) -> Any:
                block = replace(payload, content=content)
                return replace(beacon, payloads=(*others[0], block, *others[1]))

            candidates: list[Any] = []
            if len(beacon.payloads) > 1:
                candidates.append(replace(beacon, payloads=others[0] + others[1]))
            if isinstance(payload.content, tuple):
                containers = payload.content
                for place, container in enumerate(containers):
                    if len(containers) > 1:
                        candidates.append(around(containers[:place] + containers[place + 1 :]))
                    for size in (len(container.records) // 2, 1):
                        if not 0 < size < len(container.records):
                            continue
                        for start in range(0, len(container.records), size):
                            records = container.records[:start] + container.records[start + size :]
                            changed = replace(container, records=records)
                            candidates.append(around((*containers[:place], changed, *containers[place + 1 :])))
            for candidate in candidates:
                try:
                    yield self._codec.encode(candidate)
                except EncodeError:
                    continue

    def _shorter(self, at: int) -> None:
        """Octets left out, from half of them down to single ones; in short messages also from the middle."""
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


def _is_leaf(field: Field) -> bool:
    return not field.children and field.length > 0
