"""What a case knows, and what it says it has found.

Before a failure is believed, the tester looks for its own: frames that the kernel dropped and beacons that were not
heard turn it into ``inconclusive``.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NoReturn

from dcp_spec.constants import BP_SEQNO_MODULUS, Features, features
from dcp_spec.profile import Profile
from dcp_spec.readings import reading as reading_of

from .case import Case
from .errors import StopCase
from .heard import Heard, Instruction
from .results import Check, Mark, Table
from .session import Session
from .traffic import Traffic
from .verdict import Verdict, worst

MS = 1_000_000


class Findings:
    """The checks of one case, and what they are held against."""

    def __init__(self, session: Session, case: Case) -> None:
        self.session = session
        self.case = case
        self.codec = session.codec
        self.lower = session.lower
        self.pics = session.pics.pics
        self.pixit = session.pics.pixit
        self.traffic = Traffic()
        self.heard: list[Heard] = []
        """The implementation's frames since the case began."""
        self.checks: list[Check] = []
        self.readings: dict[str, str] = {}
        self.dropped = 0
        self.late_ns = 0
        self.assumptions: dict[str, str] = {}
        """What this case hangs on and nobody has told, by parameter; in words for who can tell."""

    @property
    def profile(self) -> Profile:
        """The wire profile."""
        return self.codec.profile

    @property
    def features(self) -> Features:
        """What the profile's version of the specification has."""
        return features(self.profile.spec_version)

    @property
    def period(self) -> int:
        """The beacon period in ns; with ``--timing-scale``, longer for every time window."""
        return round(self.pixit.beacon_period_ms * MS * self.session.timing_scale)

    def now(self) -> int:
        """ns of the lower tester's clock."""
        return self.lower.now()

    # -- saying what was found -----------------------------------------------------------------------------------------

    def check(
        self,
        holds: object,
        expected: str,
        observed: str = "",
        /,
        *requirements: str,
        frames: Iterable[Heard | Instruction | Mark] = (),
    ) -> bool:
        """Say that something is as it must be, or is not. ``requirements``: those decided, by default all of the case.

        A failure with losses of the tester's own in this case counts as inconclusive, and so does one that hangs on
        what was assumed. Does not stop the case.
        """
        verdict = Verdict.PASS if holds else Verdict.FAIL
        if not holds and (lost := self.own_losses()):
            verdict, observed = Verdict.INCONCLUSIVE, f"{observed}; but the tester has lost something: {lost}"
        elif not holds and self.assumptions:
            verdict, observed = Verdict.INCONCLUSIVE, f"{observed}; but {self.assumed()}"
        self._add(verdict, expected, "" if holds else observed, requirements, frames)
        return bool(holds)

    def require(
        self,
        holds: object,
        expected: str,
        observed: str = "",
        /,
        *requirements: str,
        frames: Iterable[Heard | Instruction | Mark] = (),
    ) -> None:
        """As :meth:`check`, and stops the case if it does not hold."""
        if not self.check(holds, expected, observed, *requirements, frames=frames):
            raise StopCase

    def fail(
        self, expected: str, observed: str, /, *requirements: str, frames: Iterable[Heard | Instruction | Mark] = ()
    ) -> NoReturn:
        """Something is wrong: stops the case."""
        self.check(False, expected, observed, *requirements, frames=frames)
        raise StopCase

    def inconclusive(self, expected: str, observed: str, /, *requirements: str) -> NoReturn:
        """The case cannot be decided: stops it."""
        if self.assumptions:
            observed = f"{observed}; {self.assumed()}"
        self._add(Verdict.INCONCLUSIVE, expected, observed, requirements, ())
        raise StopCase

    def info(
        self, question: str, observed: str, /, *requirements: str, frames: Iterable[Heard | Instruction | Mark] = ()
    ) -> None:
        """The specification leaves it open: say what the implementation does."""
        self._add(Verdict.INFO, question, observed, requirements, frames)

    def reading(self, identifier: str, observed: str) -> None:
        """Say which reading of a disputed text (A.7) the implementation follows, by its name in the catalogue."""
        entry = reading_of(identifier)
        self.readings[identifier] = observed
        self._add(Verdict.INFO, f"{identifier}: {entry.title}", observed, (), ())

    def fail_numbers(
        self, expected: str, observed: str, /, *requirements: str, frames: Iterable[Heard | Instruction | Mark] = ()
    ) -> NoReturn:
        """As :meth:`fail` for a fault of the sequence numbers, where a gap is the finding and no excuse.

        Only frames that the kernel is known to have dropped are one.
        """
        health = self.lower.health()
        self.dropped += health.dropped
        verdict = Verdict.INCONCLUSIVE if self.dropped else Verdict.FAIL
        self._add(verdict, expected, observed, requirements, frames)
        raise StopCase

    def verdict(self) -> Verdict:
        """What the checks come to; ``inconclusive`` for a case that has checked nothing."""
        return worst(check.verdict for check in self.checks) or Verdict.INCONCLUSIVE

    def _add(
        self,
        verdict: Verdict,
        expected: str,
        observed: str,
        requirements: Sequence[str],
        frames: Iterable[Heard | Instruction | Mark],
    ) -> None:
        table: Table = "robustness" if self.case.robustness else "conformance"
        marks = tuple(self._mark(each) for each in frames)
        checked = Check(verdict, tuple(requirements) or self.case.requirements, expected, observed, marks, table)
        self.checks.append(checked)
        self.traffic.note("note", self.lower.wall(), f"{verdict}: {expected}" + (f": {observed}" if observed else ""))

    def _mark(self, what: Heard | Instruction | Mark) -> Mark:
        if isinstance(what, Mark):
            return what
        if isinstance(what, Heard):
            return Mark(what.number)
        return self._mark_of_instruction(what)

    def _mark_of_instruction(self, what: Instruction) -> Mark:
        """The octets of a record in its frame."""
        found = self.codec.dissect(what.heard.octets)
        event = next((each for each in self.traffic.events if each.number == what.heard.number), None)
        containers = [each for each in found.root.walk() if each.path.endswith("]") and ".vardis[" in each.path]
        whole = [each for each in containers if each.path.count("[") == 2]
        path = f"{whole[what.container].path}.records[{what.position}]" if what.container < len(whole) else ""
        field = found.root.find(path) if path else None
        if field is None or event is None:
            return Mark(what.heard.number)
        return Mark(what.heard.number, event.start + field.offset, field.length, path)

    def assumed(self) -> str:
        """What the case hangs on and nobody has told, in words; empty if there is nothing."""
        return "; ".join(self.assumptions.values())

    # -- what the tester has missed ------------------------------------------------------------------------------------

    def own_losses(self) -> str:
        """What the tester has missed in this case, in words; empty if nothing is known."""
        health = self.lower.health()
        self.dropped += health.dropped
        self.late_ns = max(self.late_ns, health.late_ns)
        lost = []
        if self.dropped:
            lost.append(f"the kernel dropped {self.dropped} frames")
        if self.late_ns > self.period:
            lost.append(f"it was late by {self.late_ns / MS:.0f} ms")
        if gaps := self.gaps():
            lost.append(f"beacons were not heard ({gaps})")
        return ", ".join(lost)

    def gaps(self) -> str:
        """Where sequence numbers are missing between the beacons that were heard, in words; empty if none are."""
        before: int | None = None
        unreadable = 0
        for heard in self.heard:
            after = heard.seqno
            if after is None:
                # It was heard; that it is no beacon is the implementation's doing.
                unreadable += 1
                continue
            if before is not None:
                missing = (after - before - 1) % BP_SEQNO_MODULUS
                # Back to the start is a restart; a large jump is the implementation's own.
                if unreadable < missing <= 5:
                    return f"sequence number {after} follows {before}"
            before, unreadable = after, 0
        return ""
