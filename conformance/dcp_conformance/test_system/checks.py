"""The checks of a case, and when a failure is excused by a problem of the tester itself.

A failed check is one of two kinds, and each call says which it is:

* ``shown=True``: what was received proves the fault. Octets that are wrong, a record that must not be sent, one too
  many of something, an answer with the wrong status: a conforming implementation cannot have sent this, whatever was
  lost or late, in either direction.
* otherwise (the default): something was not received, too little of it, or too late. Lost frames can explain that, and
  so can a stimulus that was lost or sent too late.

:meth:`Findings.excuse` is the only place that decides whether a failure counts; a failure with an excuse is
``inconclusive``.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from typing import NoReturn

from dcp_spec.catalogue.readings import reading as reading_of
from dcp_spec.catalogue.requirements import requirement
from dcp_spec.constants import BP_SEQNO_MODULUS, Features, SpecVersion, features
from dcp_spec.profile.definition import Profile

from dcp_codec.views.fields import Field
from dcp_conformance.errors import StopCase
from dcp_conformance.frames.received import Instruction, ReceivedBeacon
from dcp_conformance.impairment import told
from dcp_conformance.lower_tester import Incident
from dcp_conformance.model.case import Case
from dcp_conformance.model.results import Check, Mark, Table
from dcp_conformance.model.verdict import Verdict, worst

from .extraction import OWNERS as EXTRACTION
from .extraction import sent_several
from .misreading import (
    CREATION_OWNERS,
    backwards,
    disordered,
    sent_creation,
    sent_report,
)
from .misreading import OWNERS as LAYOUTS
from .misreading import Field as Misread
from .session import Session
from .traffic import Traffic

MS = 1_000_000


def part_of(found: Iterable[object], whole: Iterable[object]) -> bool:
    """Whether ``found`` is a subsequence of ``whole``: what remains of it after losses."""
    rest = iter(whole)
    return all(any(each == other for other in rest) for each in found)


def in_force(requirements: Sequence[str], version: SpecVersion) -> tuple[str, ...]:
    """Those of the requirements that hold in a version; all of them if none does.

    A case about what several versions have in common names the rules of each.
    """
    return tuple(each for each in requirements if requirement(each).holds_in(version)) or tuple(requirements)


class Checks:
    """The checks of one case, with the excuses for failed ones."""

    def __init__(self, session: Session, case: Case) -> None:
        self.session = session
        self.case = case
        self.codec = session.codec
        self.lower = session.lower
        self.pics = session.pics.pics
        self.pixit = session.pics.pixit
        self.traffic = Traffic()
        self.heard: list[ReceivedBeacon] = []
        """The implementation's frames since the case began."""
        self.checks: list[Check] = []
        self.readings: dict[str, str] = {}
        self.dropped = 0
        self.late_ns = 0
        """The longest delay of the tester before one of its steps in this case, ns; see :meth:`acts`."""
        self.incidents: list[Incident] = []
        """What an impaired link did in this case."""
        self._incident_frames: list[int] = []
        """For each of them the number of the frame in the recording; 0 for one that is not in it."""
        self._relied: set[Misread] = set()
        """The fields on whose values this case depends, see :meth:`relies_on`."""
        self._excused = False
        """Whether a failure of this case had an excuse."""
        self._disturbed: set[int] = set()
        """Places in ``checks`` of those that only the tester's own trouble has left undecided."""
        self._acted: int | None = None
        """When (ns) the last step of the case ended (a wait, call or transmission); None before the first."""
        self.assumptions: dict[str, str] = {}
        """Assumed values that this case depends on, by parameter, in words for the user who can state them."""
        self.doubts: dict[str, str] = {}
        """As ``assumptions``, where only something missing can follow from them: a stimulus that was not accepted."""

    @property
    def profile(self) -> Profile:
        """The wire profile."""
        return self.codec.profile

    @property
    def features(self) -> Features:
        """Features of the profile's version of the specification."""
        return features(self.profile.spec_version)

    @property
    def period(self) -> int:
        """The beacon period in ns; with ``--timing-scale``, longer for every time window."""
        short = self.session.short_period
        milliseconds = self.pixit.beacon_period_ms if short is None else short.milliseconds
        return round(milliseconds * MS * self.session.timing_scale)

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
        frames: Iterable[ReceivedBeacon | Instruction | Mark] = (),
        shown: object = False,
        numbers: bool = False,
        field: Misread | None = None,
    ) -> bool:
        """Record whether something is as it must be. Does not stop the case; returns whether it holds.

        ``requirements``: those decided, by default all of the case. ``frames``: the evidence.

        ``shown``: a failure of this check is proved by what was received (see the module); false: it is about something
        missing. A check that can fail in both ways gives the condition, as in ``shown=len(found) > allowed``. Do not
        set it where a lost or late *stimulus* can have caused what was received, such as an old value.

        ``numbers``: the check is about sequence numbers of beacons: a gap between them is the finding and no excuse;
        only frames that the kernel dropped are one.

        ``field``: the check compares this field, see :meth:`relies_on`.

        A failure that :meth:`excuse` explains is recorded as inconclusive. From then on failures of both kinds are, in
        this case: they may follow from the same loss.
        """
        verdict, disturbed = Verdict.PASS if holds else Verdict.FAIL, False
        if not holds and (why := self.misread(*requirements, shown=bool(shown), field=field)):
            verdict, observed = Verdict.INCONCLUSIVE, f"{observed}; but this follows from another fault: {why}"
        elif (
            not holds and not shown and not numbers and (why := self.unreadable(requirements or self.case.requirements))
        ):
            # The tester has lost nothing: later failures that are proved by received octets still count.
            verdict, observed = Verdict.INCONCLUSIVE, f"{observed}; but {why}"
        elif not holds and (excuse := self.excuse(shown=bool(shown) and not self._excused, numbers=numbers)):
            verdict, observed = Verdict.INCONCLUSIVE, f"{observed}; but {excuse}"
            self._excused = True
            disturbed = self._only_disturbed(numbers=numbers)
        elif not holds and not shown and (excuse := self.out_of_reach(*requirements)):
            verdict, observed = Verdict.INCONCLUSIVE, f"{observed}; but {excuse}"
        proved = bool(shown) and verdict is Verdict.FAIL
        self._add(verdict, expected, "" if holds else observed, requirements, frames, shown=proved, disturbed=disturbed)
        return bool(holds)

    def require(
        self,
        holds: object,
        expected: str,
        observed: str = "",
        /,
        *requirements: str,
        frames: Iterable[ReceivedBeacon | Instruction | Mark] = (),
        shown: object = False,
        numbers: bool = False,
    ) -> None:
        """As :meth:`check`, and stops the case if it does not hold."""
        if not self.check(holds, expected, observed, *requirements, frames=frames, shown=shown, numbers=numbers):
            raise StopCase

    def fail(
        self,
        expected: str,
        observed: str,
        /,
        *requirements: str,
        frames: Iterable[ReceivedBeacon | Instruction | Mark] = (),
        shown: object = False,
        numbers: bool = False,
    ) -> NoReturn:
        """Record a failure as :meth:`check` does, and stop the case."""
        self.check(False, expected, observed, *requirements, frames=frames, shown=shown, numbers=numbers)
        raise StopCase

    def inconclusive(self, expected: str, observed: str, /, *requirements: str) -> NoReturn:
        """The case cannot be decided: stops it."""
        if untold := "; ".join({**self.doubts, **self.assumptions}.values()):
            observed = f"{observed}; {untold}"
        self._add(Verdict.INCONCLUSIVE, expected, observed, requirements, (), disturbed=self._only_disturbed())
        raise StopCase

    def not_applicable(self, reason: str) -> NoReturn:
        """Stop the case, because it does not concern this implementation; what was checked before stays decided."""
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

    def reading(self, identifier: str, observed: str) -> None:
        """Say which reading of a disputed text (A.7) the implementation follows, by its name in the catalogue."""
        entry = reading_of(identifier)
        self.readings[identifier] = observed
        self._add(Verdict.INFO, f"{identifier}: {entry.title}", observed, (), ())

    def all_hold(self) -> bool:
        """Whether no check of this case has failed so far."""
        return not any(each.verdict in (Verdict.FAIL, Verdict.INCONCLUSIVE) for each in self.checks)

    def verdict(self) -> Verdict:
        """The verdict of all checks; ``inconclusive`` for a case without checks."""
        return worst(check.verdict for check in self.checks) or Verdict.INCONCLUSIVE

    def _add(
        self,
        verdict: Verdict,
        expected: str,
        observed: str,
        requirements: Sequence[str],
        frames: Iterable[ReceivedBeacon | Instruction | Mark],
        *,
        shown: bool = False,
        disturbed: bool = False,
    ) -> None:
        table: Table = "robustness" if self.case.robustness else "conformance"
        marks = tuple(self._mark(each) for each in frames)
        decided = in_force(tuple(requirements) or self.case.requirements, self.profile.spec_version)
        checked = Check(verdict, decided, expected, observed, marks, table, shown)
        if disturbed:
            self._disturbed.add(len(self.checks))
        self.checks.append(checked)
        self.traffic.note("note", self.lower.wall(), f"{verdict}: {expected}" + (f": {observed}" if observed else ""))

    def _mark(self, what: ReceivedBeacon | Instruction | Mark) -> Mark:
        if isinstance(what, Mark):
            return what
        if isinstance(what, ReceivedBeacon):
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
        if field is None or event is None or _var_id_in(field) != what.var_id:
            # Where a beacon is damaged, its containers may be others than those that could be read.
            return Mark(what.heard.number)
        return Mark(what.heard.number, event.start + field.offset, field.length, path)

    def assumed(self) -> str:
        """The assumptions of the case in words; empty if there are none."""
        return "; ".join(self.assumptions.values())

    # -- what the tester has missed ------------------------------------------------------------------------------------

    def excuse(self, *, shown: bool = False, numbers: bool = False) -> str:
        """Why a failed check does not count against the implementation, in words; empty if it counts.

        ``shown`` and ``numbers``: see :meth:`check`. A parameter that was assumed excuses both kinds of failure, since
        the expectation itself may be wrong; losses and lateness of the tester, and ``doubts``, excuse only what is
        missing. What an impaired link did to stimuli, and to the order and the times of beacons, excuses both kinds.
        """
        if shown and (misled := self._told(each for each in self._link_incidents() if each.misleads)):
            return misled
        if not shown and (lost := self.own_losses(numbers=numbers)):
            return f"the tester has lost something: {lost}"
        return self.assumed() or ("" if shown else "; ".join(self.doubts.values()))

    def unreadable(self, requirements: Iterable[str]) -> str:
        """Why something that was sent may not be seen: beacons of this case that cannot be read to their end.

        Empty if all can be read that matter for ``requirements``: a bad state report hides nothing but itself. What is
        wrong with such a beacon is for the cases about formats to say.
        """
        reports = all(each.startswith("SRP-") for each in requirements)
        bad = [
            heard
            for heard in self.heard
            if heard.problems
            and (not heard.salvaged.clear or (heard.report_problems if reports else heard.vardis_problems))
        ]
        return f"{len(bad)} of its {len(self.heard)} beacons cannot be read: {bad[0].problem}" if bad else ""

    def relies_on(self, field: Misread) -> None:
        """Say that the expectations of this case, from here on, hang on the value that the implementation sends or
        tells of a field: if it misreads that field, their failures are consequences.
        """
        self._relied.add(field)

    def misread(self, *requirements: str, shown: bool = False, field: Misread | None = None) -> str:
        """Which misread field a failed check follows from, in words; empty if from none.

        ``requirements``: those of the check, by default all of the case. ``shown`` and ``field``: as for :meth:`check`.
        """
        if LAYOUTS & set(requirements or self.case.requirements):
            return ""
        found, events = self.session.misread, self.traffic.events
        relied = self._relied if field is None else {*self._relied, field}
        for each in relied:
            if each in found:
                return found[each]
        if "creationTime" in relied and backwards(self.codec, self.heard, self.session.sut_id, self.lower.wall()):
            return "its own creationTimes are times of today only with their octets swapped (DATA-01)"
        if "creationTime" in found and disordered(self.codec, events):
            return found["creationTime"]
        if shown:
            return ""
        decided = set(requirements or self.case.requirements)
        if "VarCreate" in found and not CREATION_OWNERS & decided and sent_creation(self.codec, events):
            return found["VarCreate"]
        return found["report"] if "report" in found and sent_report(self.codec, events) else ""

    def out_of_reach(self, *requirements: str) -> str:
        """Why something missing follows from what the sanity case found, in words; empty if it counts.

        The start of the run has shown that the implementation does not answer what this case has sent, or that it
        loses a container of the payloads that this case has sent, and other cases fail it for that. ``requirements``:
        those of the failed check, by default all of the case.
        """
        decided = requirements or self.case.requirements
        lost = self.session.lost_container
        if lost and not EXTRACTION & set(decided) and sent_several(self.codec, self.traffic.events):
            return (
                f"it loses the {lost} of two containers in a payload (VD-RX-04), and this case has sent such payloads"
            )
        contact = self.session.contact
        if contact is None or contact.good:
            return ""
        return contact.excuse(self.codec, self.traffic.events, self.heard, self.made, decided)

    @property
    def made(self) -> Collection[int]:
        """The variables that the case has created, or is about to."""
        return ()

    @property
    def disturbed(self) -> str:
        """What the tester did wrong, in words, if that alone has left checks of this case undecided; otherwise empty.

        Such a case is worth another execution.
        """
        undecided = {place for place, each in enumerate(self.checks) if each.verdict is Verdict.INCONCLUSIVE}
        return ", ".join(self._own_trouble()) if undecided and undecided <= self._disturbed else ""

    def _only_disturbed(self, *, numbers: bool = False) -> bool:
        """Whether nothing but the tester's own trouble keeps a check from being decided at this moment."""
        if self.assumptions or self.doubts or not self._own_trouble(numbers=numbers):
            return False
        # Frames that the kernel or an impaired link took explain a gap; lateness does not.
        return bool(self.dropped or self.incidents) or not self.gaps()

    def _own_trouble(self, *, numbers: bool = False) -> list[str]:
        """What the tester or its link did wrong in this case, in words."""
        incidents = self._link_incidents()
        trouble = []
        # A sequence number is missing for no other reason than that its beacon is.
        if link := self._told(each for each in incidents if not (numbers and each.to)):
            trouble.append(link)
        if self.dropped:
            trouble.append(f"the kernel dropped {self.dropped} frames")
        if not numbers and self.late_ns > self.period:
            trouble.append(f"it acted late by {self.late_ns / MS:.0f} ms")
        return trouble

    def take_incidents(self, number: int = 0) -> None:
        """Ask what was lost since the last time, by the kernel or by an impaired link.

        ``number``: of the frame in the recording that has just been sent.
        """
        health = self.lower.health()
        self.dropped += health.dropped
        for incident in health.incidents:
            frame = number if incident.to else 0
            self.incidents.append(incident)
            self._incident_frames.append(frame)
            self.traffic.note("note", self.lower.wall(), told([incident], [frame]))

    @property
    def link_losses(self) -> int:
        """How many beacons of the implementation an impaired link is known to have taken in this case."""
        return sum(not each.to for each in self._link_incidents())

    def _link_incidents(self) -> list[Incident]:
        self.take_incidents()
        return self.incidents

    def _told(self, chosen: Iterable[Incident]) -> str:
        """Some of the incidents in words; empty for none."""
        frames = {id(incident): number for incident, number in zip(self.incidents, self._incident_frames, strict=True)}
        found = list(chosen)
        return told(found, [frames[id(each)] for each in found])

    def own_losses(self, *, numbers: bool = False) -> str:
        """What the tester has missed in this case, in words; empty if nothing is known.

        ``numbers``: only what can explain a gap between the sequence numbers of beacons.
        """
        lost = self._own_trouble(numbers=numbers)
        if not numbers and (gaps := self.gaps()):
            lost.append(f"beacons were not heard ({gaps})")
        return ", ".join(lost)

    def acts(self) -> None:
        """Note that the tester takes its next step now: a transmission, a call, the begin of a wait.

        What passed since its last step ended was its own time, in which it should only have computed. The longest such
        time of a case is its lateness (``late_ns``); more than one beacon period of it is an excuse, since a stimulus
        may then have come too late. How late the tester *reads* a frame does not matter: the kernel's stamp says when
        it came, and no wait ends before everything stamped in time was read.
        """
        now = self.lower.now()
        if self._acted is not None:
            self.late_ns = max(self.late_ns, now - self._acted)
        self._acted = now

    def gaps(self) -> str:
        """Where sequence numbers are missing between the beacons that were heard, in words; empty if none are."""
        before: int | None = None
        unreadable = 0
        for heard in self.heard:
            after = heard.seqno
            if after is None:
                # Received, but without a readable number: not a loss.
                unreadable += 1
                continue
            if before is not None:
                missing = (after - before - 1) % BP_SEQNO_MODULUS
                # Back to the start is a restart; a large jump is the implementation's own.
                if unreadable < missing <= 5 and not self.session.counting.by(missing + 1):
                    return f"sequence number {after} follows {before}"
            before, unreadable = after, 0
        return ""


def _var_id_in(record: Field) -> object:
    """The variable that a dissected record is about."""
    found = (record.child("spec") or record).child("varId")
    return None if found is None else found.value
