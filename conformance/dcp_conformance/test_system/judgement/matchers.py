"""Matchers: the forms of statement about an implementation that cases check.

A failed statement is *shown* (received octets or an answer prove the fault) or something is *missing*, which losses and
lateness of the tester may explain (:mod:`.excuses`). Which of the two follows from the form of the statement:

* what was not received is missing: :meth:`.Missing.some`, :meth:`.Missing.required`, :meth:`.Missing.complete`,
  :meth:`.Missing.missing`;
* what must not be there, or has the wrong value, is shown: :meth:`.Shown.none`, :meth:`.Shown.every`,
  :meth:`.Shown.one_each`, :meth:`.Shown.answered`, :meth:`.Shown.fields`, :meth:`.Shown.present`,
  :meth:`.Shown.proved`, :meth:`.Shown.wrong`;
* others can fail in both ways: :meth:`.Matchers.equal`, :meth:`.Matchers.only`, :meth:`.Matchers.in_order`,
  :meth:`.Matchers.repeated`, :meth:`.Matchers.within`;
* without what :meth:`.Missing.needed` looks for, the case is inconclusive.

Each states its expectation and its observation, and attaches the received frames as evidence. Requirement identifiers
may be one string, separated by spaces; without any, the check decides all requirements of the case.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Any, Final, Literal, NoReturn, TypeVar

from dcp_spec.constants import BP_SEQNO_MODULUS

from dcp_conformance.errors import StopCase
from dcp_conformance.frames.received import Instruction, ReceivedBeacon
from dcp_conformance.test_system.known import Misread

from .verdicts import Verdicts
from .wording import Evidence, beacons_of, content, described, evidence_in

T = TypeVar("T")
Late = Literal["above", "below", "either", "neither"]
"""The sides of an interval on which lateness or losses can explain a value."""

NOTHING: Final = "none in time"
#: Maximum number of frames that a check marks.
_FRAMES: Final = 32


class Statements:
    """The checks of one case. All return whether the statement holds, except those that stop the case without a value.

    Keywords that several matchers have:

    ``seen``: the observation, if the matcher cannot describe it. ``frames``: the evidence, if the subject does not
    consist of frames.

    ``given``: evidence that the implementation has received the stimulus without which the statement need not hold, or
    that no delay can explain the failure (:attr:`.Verdicts.in_time`). Without it (false) a failure is not shown.

    ``field`` and ``patience``: see :meth:`.Verdicts.check`. ``stop``: stop the case if the statement does not hold.
    """

    def __init__(self, verdicts: Verdicts) -> None:
        self._verdicts = verdicts

    def _check(
        self,
        holds: object,
        expected: str,
        observed: str,
        requirements: Sequence[str],
        *,
        frames: Iterable[Evidence],
        shown: object = False,
        patience: float = 1.0,
        field: Misread | None = None,
        stop: bool = False,
        several: bool = False,
        turned: bool = False,
    ) -> bool:
        evidence = [*frames][:_FRAMES]
        good = self._verdicts.check(
            holds, expected, observed, *requirements, frames=evidence, shown=shown, patience=patience, field=field,
            on_air=several or bool(evidence), turned=turned,
        )  # fmt: skip
        if stop and not good:
            raise StopCase
        return good

    def _compare(
        self,
        observed: object,
        right: object,
        what: str,
        requirements: Sequence[str],
        *,
        frames: Iterable[Evidence],
        shown: object,
        stop: bool,
        field: Misread | None = None,
        seen: str = "",
    ) -> bool:
        holds = observed == right
        return self._check(
            holds, f"{what}: {content(right)}", seen or content(observed), requirements, frames=frames, shown=shown,
            field=field, stop=stop, turned=not holds and only_swapped(observed, right),
        )  # fmt: skip


class Missing(Statements):
    """Statements that fail because something was not received."""

    def some(
        self,
        found: object,
        expected: str,
        /,
        *requirements: str,
        seen: object = NOTHING,
        frames: Iterable[Evidence] = (),
        patience: float = 1.0,
    ) -> bool:
        """Check that something was received, or that a condition came about."""
        return self._check(found, expected, content(seen), requirements, frames=frames, patience=patience)

    def required(
        self,
        found: T | None,
        expected: str,
        /,
        *requirements: str,
        seen: object = NOTHING,
        frames: Iterable[Evidence] = (),
    ) -> T:
        """As :meth:`some`; return what was found, and stop the case if there is nothing."""
        if not self.some(found, expected, *requirements, seen=seen, frames=frames) or found is None:
            raise StopCase
        return found

    def needed(self, found: T | None, what: str, observed: str = NOTHING, /, *requirements: str) -> T:
        """Return what was found; stop the case as inconclusive if there is nothing, since it needs it."""
        if not found:
            self._verdicts.inconclusive(what, observed, *requirements)
        return found

    def complete(
        self, missing: Collection[object], expected: str, /, *requirements: str, frames: Iterable[Evidence] = ()
    ) -> bool:
        """Check that nothing is missing of what must have been received."""
        return self._check(not missing, expected, f"missing: {described(missing)}", requirements, frames=frames)

    def missing(
        self,
        expected: str,
        seen: object = NOTHING,
        /,
        *requirements: str,
        patience: float = 1.0,
        turned: bool = False,
    ) -> NoReturn:
        """Stop the case because something was not received. ``turned``: see :meth:`.Verdicts.check`."""
        self._check(False, expected, content(seen), requirements, frames=(), patience=patience, turned=turned)
        raise StopCase


class Shown(Statements):
    """Statements that fail because of what was received."""

    def none(
        self,
        surplus: Any,
        expected: str,
        /,
        *requirements: str,
        seen: object = "",
        frames: Iterable[Evidence] | None = None,
        given: object = True,
        stop: bool = False,
    ) -> bool:
        """Check that there are no such frames, records or values. ``expected`` names what is right: "no VarDelete"."""
        observed = content(seen) or described(surplus)
        evidence = evidence_in(surplus) if frames is None else frames
        return self._check(
            not surplus, expected, observed, requirements, frames=evidence, shown=given, stop=stop, several=True
        )

    def every(
        self,
        found: Iterable[T],
        right: Callable[[T], object] | object,
        expected: str,
        /,
        *requirements: str,
        seen: object = "",
        given: object = True,
    ) -> bool:
        """Check that each of these received frames, records or values is right; true for none of them.

        ``right``: a predicate, or the record or value that each of them must be.
        """
        if callable(right):
            wrong = [each for each in found if not right(each)]
        else:
            wrong = [each for each in found if (each.record if isinstance(each, Instruction) else each) != right]
            expected = f"{expected}: {content(right)}"
        observed = seen or (f"{content(wrong[0])} ({described(wrong)})" if wrong else "")
        return self.none(wrong, expected, *requirements, seen=observed, given=given)

    def answered(
        self,
        observed: object,
        right: object,
        what: str,
        /,
        *requirements: str,
        frames: Iterable[Evidence] = (),
        field: Misread | None = None,
        stop: bool = False,
    ) -> bool:
        """Check a value in an answer or in a frame that was received: any difference is shown, also its absence."""
        return self._compare(observed, right, what, requirements, frames=frames, shown=True, field=field, stop=stop)

    def fields(self, answer: Mapping[str, object], /, *requirements: str, **right: object) -> bool:
        """As :meth:`answered` for several fields of an answer, in one check each."""
        good = [self.answered(answer.get(name), value, name, *requirements) for name, value in right.items()]
        return all(good)

    def present(self, found: T | None, expected: str, /, *requirements: str, seen: object = "none") -> T:
        """Return what an answer must have, without a check; its absence is shown, and stops the case."""
        if found is None:
            self.wrong(expected, seen, *requirements)
        return found

    def proved(
        self,
        holds: object,
        expected: str,
        seen: object = "",
        /,
        *requirements: str,
        frames: Iterable[Evidence] = (),
        stop: bool = False,
    ) -> bool:
        """Check any other property of received data. ``seen``: the data."""
        return self._check(holds, expected, content(seen), requirements, frames=frames, shown=True, stop=stop)

    def wrong(self, expected: str, seen: object, /, *requirements: str, frames: Iterable[Evidence] = ()) -> NoReturn:
        """Stop the case because received data are wrong."""
        self._check(False, expected, content(seen), requirements, frames=frames, shown=True)
        raise StopCase


class Matchers(Missing, Shown):
    """All statements; those here can fail in both ways."""

    def equal(
        self,
        observed: object,
        right: object,
        what: str,
        /,
        *requirements: str,
        frames: Iterable[Evidence] = (),
        given: object = True,
        stop: bool = False,
    ) -> bool:
        """Check a value that may not have been received (None): then it is missing; another value is shown."""
        shown = observed is not None and given
        seen = NOTHING if observed is None else ""
        return self._compare(observed, right, what, requirements, frames=frames, shown=shown, stop=stop, seen=seen)

    def only(
        self,
        found: Iterable[object],
        right: Iterable[object],
        expected: str,
        /,
        *requirements: str,
        seen: object = "",
        frames: Iterable[Evidence] = (),
    ) -> bool:
        """Check that exactly these values were received, each as often as here, in any order; others are shown."""
        came, lacking = [*found], [*right]
        surplus = []
        for each in came:
            if each in lacking:
                lacking.remove(each)
            else:
                surplus.append(each)
        observed = content(seen) or described(came)
        return self._check(
            not surplus + lacking, expected, observed, requirements, frames=frames, shown=surplus, several=True
        )

    def in_order(
        self,
        found: Iterable[object],
        right: Iterable[object],
        expected: str,
        /,
        *requirements: str,
        seen: object = "",
        frames: Iterable[Evidence] = (),
    ) -> bool:
        """Check that exactly this sequence was received; a wrong order, a repetition or another value is shown."""
        came, wanted = [*found], [*right]
        observed = content(seen) or described(came)
        shown = not part_of(came, wanted)
        return self._check(came == wanted, expected, observed, requirements, frames=frames, shown=shown, several=True)

    def repeated(
        self,
        found: Collection[object] | int,
        count: int,
        what: str,
        /,
        *requirements: str,
        most: float | None = None,
        frames: Iterable[Evidence] | None = None,
    ) -> bool:
        """Check the number of frames, records or notifications: too few are missing, too many are shown.

        Not after a delay of tester or implementation: then a stimulus or a record may have had its effect twice
        (:attr:`.Verdicts.in_time`). ``what`` is a plural: "beacons with the VarUpdate". ``most``: the largest number,
        if it is not ``count``.
        """
        number = found if isinstance(found, int) else len(found)
        limit = count if most is None else most
        right = {count: f"{count}", math.inf: f"at least {count}"}.get(limit, f"{count} to {limit}")
        return self._check(
            count <= number <= limit,
            f"{what}: {right}",
            f"{number}",
            requirements,
            frames=evidence_in(found) if frames is None else frames,
            shown=number > limit and self._verdicts.in_time,
            several=True,
        )

    def one_each(self, found: Collection[Instruction], expected: str, /, *requirements: str) -> bool:
        """Check that no beacon has two of these records: others are shown."""
        numbers = Counter(id(each.heard) for each in found)
        twice = [each for each in found if numbers[id(each.heard)] > 1]
        return self.none(twice, expected, *requirements, seen=f"{described(twice)} in {beacons_of(twice)}")

    def within(
        self,
        value: float,
        least: float,
        most: float,
        what: str,
        /,
        *requirements: str,
        late: Late,
        unit: str = "",
        frames: Iterable[Evidence] = (),
        given: object = True,
    ) -> bool:
        """Check that a number is in an interval; ``late``: the sides that lateness or losses can explain.

        ``unit`` "ms": the numbers are ns, and are stated in ms.
        """
        scale, end = (1e6, " ms") if unit == "ms" else (1, f" {unit}" if unit else "")
        low, high, seen = (f"{each / scale:.6g}" if each != math.inf else "" for each in (least, most, value))
        bounds = f"{low} to {high}" if least > -math.inf and high else f"at most {high}" if high else f"at least {low}"
        shown = (value < least and late in ("above", "neither")) or (value > most and late in ("below", "neither"))
        return self._check(
            least <= value <= most, f"{what}: {bounds}{end}", f"{seen}{end}", requirements,
            frames=frames, shown=shown and given,
        )  # fmt: skip

    def successive(self, before: ReceivedBeacon, after: ReceivedBeacon, /, *requirements: str, when: str = "") -> bool:
        """Check that the sequence number of a beacon follows that of another; a gap is a failure, not an excuse.

        Inconclusive if one of them cannot be read.
        """
        if before.seqno is None or after.seqno is None:
            self._verdicts.inconclusive("decodable beacons", f"{before.problem or after.problem}")
        right = (before.seqno + 1) % BP_SEQNO_MODULUS
        expected = f"seqno {right} after {before.seqno}{when}"
        return self._verdicts.check(
            after.seqno == right, expected, f"seqno {after.seqno}", *requirements, frames=[before, after],
            numbers=True,
        )  # fmt: skip

    def passed(self, expected: str, /, *requirements: str, frames: Iterable[Evidence] = ()) -> None:
        """Record a statement that has already been established."""
        self._check(True, expected, "", requirements, frames=frames)


def only_swapped(observed: object, right: object) -> bool:
    """Return whether two values are equal, except numbers of 2, 4 or 8 octets whose octets are in the other order.

    A number below 256 must have moved by at least three octets. By one octet, it may be a fault of counting.
    """
    if observed == right:
        return True
    if isinstance(observed, int) and isinstance(right, int):
        widths = (2, 4, 8) if min(observed, right) > 0xFF else (4, 8)
        return any(
            min(observed, right) >= 0 and max(observed, right) < 1 << 8 * width
            and right.to_bytes(width, "big") == observed.to_bytes(width, "little")
            for width in widths
        )  # fmt: skip
    if isinstance(observed, tuple | list) and isinstance(right, tuple | list):
        return len(observed) == len(right) and all(map(only_swapped, observed, right))
    return False


def part_of(found: Iterable[object], whole: Iterable[object]) -> bool:
    """Return whether ``found`` is a subsequence of ``whole``, as after losses."""
    rest = iter(whole)
    return all(any(each == other for other in rest) for each in found)
