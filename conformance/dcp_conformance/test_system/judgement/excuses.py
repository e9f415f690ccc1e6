"""Excuses for failed checks: reasons why a failure does not count against the requirements of a case.

A failed check is one of two kinds:

* *shown*: received octets prove the fault. A wrong field, a record that must not be sent, too many records, or a wrong
  status cannot come from a conforming implementation, whatever was lost or late in either direction.
* *missing*: something was not received, too little of it, or too late. Lost frames can explain that, and so can a
  stimulus that was lost or sent too late.

:meth:`Excuses.find` is the only place that decides whether a failure counts. A failure with an excuse is inconclusive.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from dcp_codec.codec import Codec
from dcp_conformance.frames.received import ReceivedBeacon
from dcp_conformance.test_system.assumptions import Assumptions
from dcp_conformance.test_system.known import Failure, Misread, RunFindings
from dcp_conformance.test_system.steps import Clock
from dcp_conformance.test_system.traffic import Traffic

from .losses import Losses


class Excuse(NamedTuple):
    """A reason why a failed check does not count."""

    text: str
    disturbance: str = ""
    """The faults of the tester, if they are the only reason, so that another execution may decide the check."""


@dataclass(eq=False)
class Excuses:
    """Finds the excuses of one case."""

    _codec: Codec
    _clock: Clock
    _traffic: Traffic
    _heard: Sequence[ReceivedBeacon]
    """The beacons of the case."""
    _created: Collection[int]
    """Identifiers of the variables that the case creates."""
    _run: RunFindings
    losses: Losses
    assumptions: Assumptions
    _relied: set[Misread] = field(default_factory=set, init=False)
    about_layout: bool = field(default=False, init=False)
    """Whether the case tests that beacons can be decoded. It reports another layout; no other case does."""
    _disturbed: bool = field(default=False, init=False)
    """Whether a failure of this case was excused by losses or assumptions."""

    def relies_on(self, field: Misread) -> None:
        """Record that the expectations of the case, from now on, depend on how the implementation reads this field.

        If it misreads the field, failures of these expectations follow from that.
        """
        self._relied.add(field)

    def find(
        self,
        requirements: Collection[str],
        *,
        shown: bool = False,
        numbers: bool = False,
        patience: float = 1.0,
        field: Misread | None = None,
        on_air: bool = False,
    ) -> Excuse | None:
        """Return an excuse for a failed check that decides these requirements; None if the failure counts.

        ``shown``, ``numbers``, ``patience``, ``field``: see :meth:`~.verdicts.Verdicts.check`. ``on_air``: whether
        the check is about received frames. Once losses or assumptions have excused a failure, they excuse failures of
        both kinds: later ones may follow from it.
        """
        relied = self._relied if field is None else self._relied | {field}
        failure = Failure(
            frozenset(requirements), shown, frozenset(relied), on_air, self._codec, self._traffic.events, self._heard,
            self._created, self._run.sut_id, self._clock.wall(),
        )  # fmt: skip
        cause = None if self.about_layout else self._run.known.cause(failure)
        if cause is not None and cause.certain:
            return Excuse(cause.text)
        # The tester has lost nothing: later failures that are proved by received octets still count.
        if not shown and not numbers and (fault := self.unreadable(requirements)):
            return Excuse(fault)
        if text := self.disturbance(shown=shown and not self._disturbed, numbers=numbers, patience=patience):
            self._disturbed = True
            return Excuse(text, self.only_disturbance(numbers=numbers))
        return None if cause is None else Excuse(cause.text)

    def disturbance(self, *, shown: bool = False, numbers: bool = False, patience: float = 1.0) -> str:
        """Describe losses and assumptions that excuse a failure; empty if there are none.

        An assumed parameter excuses both kinds of failure, because the expectation itself may be wrong. Losses and
        lateness of the tester, and assumptions about stimuli, excuse only something missing. Effects of an impaired
        link on stimuli, and on the order and the times of beacons, excuse both kinds.
        """
        if shown and (misled := self.losses.misleading()):
            return misled
        if not shown and (lost := self.losses.own(numbers=numbers, patience=patience)):
            return f"the tester has lost something: {lost}"
        return self.assumptions.text() or ("" if shown else "; ".join(self.assumptions.stimuli.values()))

    def only_disturbance(self, *, numbers: bool = False) -> str:
        """Return the faults of the tester or its link if nothing else keeps a check from being decided at this moment.

        Otherwise empty.
        """
        if self.assumptions.text_of_all() or not self.losses.explain_all(numbers=numbers):
            return ""
        return ", ".join(self.losses.of_tester())

    def unreadable(self, requirements: Iterable[str]) -> str:
        """Describe beacons of this case that cannot be read to their end, so that something in them may be missing.

        Empty if all parts can be read that matter for ``requirements``: a bad state report hides only itself. Cases
        about formats judge such beacons.
        """
        reports = all(each.startswith("SRP-") for each in requirements)
        bad = [
            heard
            for heard in self._heard
            if heard.problems
            and (not heard.salvaged.clear or (heard.report_problems if reports else heard.vardis_problems))
        ]
        return f"{len(bad)} of its {len(self._heard)} beacons cannot be read: {bad[0].problem}" if bad else ""
