"""The checks of a case, and the verdict that follows from them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NoReturn

from dcp_spec.catalogue.readings import reading as reading_of
from dcp_spec.catalogue.requirements import requirement
from dcp_spec.constants import SpecVersion

from dcp_codec.codec import Codec
from dcp_codec.views.fields import Field
from dcp_conformance.definitions.case import Case
from dcp_conformance.definitions.results import Check, Mark, Table
from dcp_conformance.definitions.verdict import Verdict, worst
from dcp_conformance.errors import NamesUsedUp, StopCase
from dcp_conformance.frames.received import Instruction, ReceivedBeacon
from dcp_conformance.test_system.known import Misread
from dcp_conformance.test_system.steps import Clock
from dcp_conformance.test_system.traffic import Traffic

from .excuses import Excuses


def in_force(requirements: Sequence[str], version: SpecVersion) -> tuple[str, ...]:
    """Return the requirements that apply to a version; all of them if none does.

    A case about common behaviour of several versions names the requirements of each.
    """
    return tuple(each for each in requirements if requirement(each).holds_in(version)) or tuple(requirements)


def _ids(requirements: Sequence[str]) -> tuple[str, ...]:
    return tuple([identifier for each in requirements for identifier in each.split()])


@dataclass(eq=False)
class Verdicts:
    """Records the checks of one case; a failed check with an excuse is inconclusive (:mod:`.excuses`)."""

    _case: Case
    _codec: Codec
    _clock: Clock
    _traffic: Traffic
    _excuses: Excuses
    _declared_readings: Mapping[str, str] = field(default_factory=dict)
    checks: list[Check] = field(default_factory=list, init=False)
    """All checks so far."""
    readings: dict[str, str] = field(default_factory=dict, init=False)
    """Observed readings of disputed text, by identifier in the catalogue."""
    _disturbances: dict[int, str] = field(default_factory=dict, init=False)
    """The faults of the tester by the index of the check that only they have left undecided."""
    _proved: bool = field(default=False, init=False)
    """Whether received octets or sequence numbers prove a failure of this case."""

    def check(
        self,
        holds: object,
        expected: str,
        observed: str = "",
        /,
        *requirements: str,
        frames: Iterable[ReceivedBeacon | Instruction | Mark] = (),
        shown: object = False,
        numbers: bool = False,
        patience: float = 1.0,
        field: Misread | None = None,
        on_air: bool = False,
        turned: bool = False,
    ) -> bool:
        """Record whether a condition holds, and return it. Does not stop the case.

        ``requirements``: the decided ones, one or several in each string, by default all of the case. ``frames``: the
        evidence.

        ``shown``: whether received octets prove a failure of this check; false: something is missing (see
        :mod:`.excuses`). A check that can fail in both ways gives the condition, as in ``shown=len(found) > allowed``.
        Do not set it if a lost or late *stimulus* can be the cause, for example of an old value.

        ``numbers``: the check is about sequence numbers of beacons. A gap between them is a failure and not an excuse;
        only frames that the kernel dropped are an excuse.

        ``patience``: number of beacon periods by which the tester may be late without an effect on this check. More
        than one if the stimuli have the same effect at any time, or were repeated.

        ``field``: the check compares this field, see :meth:`.Excuses.relies_on`. ``on_air``: it is about frames.

        ``turned``: the observation is a number with its octets swapped. That violates DATA-01, whatever the case is
        about.
        """
        if holds:
            self._add(Verdict.PASS, expected, "", requirements, frames)
            return True
        decided = _ids(requirements) or self._case.requirements
        excuse = self._excuses.find(
            decided, shown=bool(shown), numbers=numbers, patience=patience, field=field, on_air=on_air
        )
        if excuse is None:
            # After a missing reaction, the next one may be a late answer to the earlier stimulus.
            first = all(each.verdict is not Verdict.FAIL for each in self.checks)
            self._proved = self._proved or (first and (bool(shown) or numbers))
            if turned:
                requirements, observed = ("DATA-01",), f"{observed}, a number with its octets swapped"
            self._add(Verdict.FAIL, expected, observed, requirements, frames, shown=bool(shown))
        else:
            text = f"{observed}; but {excuse.text}"
            self._add(Verdict.INCONCLUSIVE, expected, text, requirements, frames, disturbance=excuse.disturbance)
        return False

    def inconclusive(self, expected: str, observed: str, /, *requirements: str, overload: str = "") -> NoReturn:
        """Stop the case because it cannot be decided.

        ``overload``: why the machine of the tester is the reason. For this reason, and after losses and delays of the
        tester, the case is executed again.
        """
        losses = self._excuses.losses
        disturbance = overload or self._excuses.only_disturbance() or losses.held_up() or losses.declared
        if assumed := self._excuses.assumptions.text_of_all():
            observed, disturbance = f"{observed}; {assumed}", ""
        self._add(Verdict.INCONCLUSIVE, expected, observed, requirements, (), disturbance=disturbance)
        raise StopCase

    def used_up(self, expected: str, observed: str, /) -> NoReturn:
        """Stop the case as inconclusive because no identifiers are left. Raises ``NamesUsedUp``."""
        self._add(Verdict.INCONCLUSIVE, expected, observed, (), ())
        raise NamesUsedUp

    def not_applicable(self, reason: str) -> NoReturn:
        """Stop the case because it does not apply to this implementation. Earlier checks remain valid."""
        self._add(Verdict.NOT_APPLICABLE, reason, "", (), ())
        raise StopCase

    def info(
        self,
        question: str,
        observed: str,
        /,
        *requirements: str,
        frames: Iterable[ReceivedBeacon | Instruction | Mark] = (),
    ) -> None:
        """Report a behaviour that the specification leaves open."""
        self._add(Verdict.INFO, question, observed, requirements, frames)

    def reading(self, identifier: str, observed: str, *alike: str) -> None:
        """Report which reading of a disputed text (A.7) the implementation follows, by its name in the catalogue.

        The check fails if the PICS declares another alternative, unless this is one of those that look ``alike`` in
        this case. An observation in free words contradicts no declaration.
        """
        entry = reading_of(identifier)
        self.readings[identifier] = observed
        declared = self._declared_readings.get(identifier, observed)
        if declared not in (observed, *alike) and any(observed == each.name for each in entry.alternatives):
            self.check(False, f"{identifier}: {entry.title}: {declared}, as declared in the PICS", observed)
            return
        self._add(Verdict.INFO, f"{identifier}: {entry.title}", observed, (), ())

    @property
    def may_be_late(self) -> str:
        """Why all failures of this case may follow from delays or losses; empty if one is proved, or there was none.

        A frame that other data have overtaken can be received after the check that it would have changed.
        """
        losses = self._excuses.losses
        return losses.overtaken() or ("" if self._proved else losses.declared or losses.lateness())

    @property
    def in_time(self) -> bool:
        """Whether no delay was observed so far, so that stimuli in succession had their effect in succession.

        For ``shown`` in checks that depend on this: after a delay, a record can be a late repetition of an earlier one,
        or can have been sent between two stimuli.
        """
        return not self._excuses.losses.lateness()

    def all_hold(self) -> bool:
        """Return whether no check of this case has failed so far."""
        return not any(each.verdict in (Verdict.FAIL, Verdict.INCONCLUSIVE) for each in self.checks)

    def verdict(self) -> Verdict:
        """Return the worst verdict of all checks; ``inconclusive`` for a case without checks."""
        return worst(check.verdict for check in self.checks) or Verdict.INCONCLUSIVE

    @property
    def disturbed(self) -> str:
        """The faults of the tester, if they are the only reason for undecided checks of this case; otherwise empty.

        Such a case is worth another execution.
        """
        undecided = {place for place, each in enumerate(self.checks) if each.verdict is Verdict.INCONCLUSIVE}
        known = self._disturbances
        return ", ".join({known[place]: None for place in sorted(undecided)}) if undecided <= known.keys() else ""

    def _add(
        self,
        verdict: Verdict,
        expected: str,
        observed: str,
        requirements: Sequence[str],
        frames: Iterable[ReceivedBeacon | Instruction | Mark],
        *,
        shown: bool = False,
        disturbance: str = "",
    ) -> None:
        table: Table = "robustness" if self._case.robustness else "conformance"
        marks = tuple(self._mark(each) for each in frames)
        decided = in_force(_ids(requirements) or self._case.requirements, self._codec.profile.spec_version)
        if disturbance:
            self._disturbances[len(self.checks)] = disturbance
        self.checks.append(Check(verdict, decided, expected, observed, marks, table, shown))
        text = f"{verdict}: {expected}" + (f": {observed}" if observed else "")
        self._traffic.note("note", self._clock.wall(), text)

    def _mark(self, what: ReceivedBeacon | Instruction | Mark) -> Mark:
        if isinstance(what, Mark):
            return what
        if isinstance(what, ReceivedBeacon):
            return Mark(what.number)
        return self._mark_of_instruction(what)

    def _mark_of_instruction(self, what: Instruction) -> Mark:
        """Return the octets of a record in its frame."""
        found = self._codec.dissect(what.heard.octets)
        event = next((each for each in self._traffic.events if each.number == what.heard.number), None)
        containers = [each for each in found.root.walk() if each.path.endswith("]") and ".vardis[" in each.path]
        whole = [each for each in containers if each.path.count("[") == 2]
        path = f"{whole[what.container].path}.records[{what.position}]" if what.container < len(whole) else ""
        field = found.root.find(path) if path else None
        if field is None or event is None or _var_id_in(field) != what.var_id:
            # In a damaged beacon, the dissected containers may differ from those that could be read.
            return Mark(what.heard.number)
        return Mark(what.heard.number, event.start + field.offset, field.length, path)


def _var_id_in(record: Field) -> object:
    """Return the varId of a dissected record; None if it has none."""
    found = (record.child("spec") or record).child("varId")
    return None if found is None else found.value
