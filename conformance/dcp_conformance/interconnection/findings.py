"""The findings about the implementation before the first case, and the failures that follow from them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Final

from dcp_conformance.definitions.case import Case, Kind
from dcp_conformance.definitions.pics import Testing
from dcp_conformance.definitions.results import Check
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.test_system.bench import Bench
from dcp_conformance.test_system.known import UNREADABLE, Cause, Failure, Known, Misread, Question
from dcp_conformance.test_system.session import FLOOR, Session
from dcp_conformance.upper_tester.patience import NEVER

from . import extraction, layouts
from .contact import BEGINNING, Contact
from .reaction import measure, notification_delay

#: A bench needs a case; this one is not part of the suite.
_CASE: Final = Case(
    "measurement", "How the implementation reacts", ("VD-PS-01",), Kind.VALID, "", "", 0, "", __name__, lambda _: None
)


@dataclass
class Findings(Known):
    """The findings of a run, which explain failures of cases that are about something else."""

    contact: Contact | None = None
    """Result of the basic interconnection test; None before it, and if it is omitted."""
    misread: dict[Misread, str] = field(default_factory=dict)
    """The fields that the implementation misreads, each with a text about the observation."""

    @classmethod
    def of(cls, session: Session) -> Findings:
        """Return the findings of a session, which has none before the first call."""
        found = session.known
        if not isinstance(found, Findings):
            session.known = found = cls()
        return found

    @property
    def question(self) -> Question:
        """The kind of stimulus for probes of VarDis: one that it answers, if there is one."""
        return "summary" if self.contact is None else self.contact.question

    def cause(self, failure: Failure) -> Cause | None:
        """Return the finding that a failed check follows from; None if the failure counts."""
        misread = dict(self.misread)
        if self.contact is not None and self.contact.own_records:
            misread.setdefault("VarDis", self.contact.own_records)
        if text := layouts.cause(misread, failure):
            return Cause(f"this follows from another fault: {text}", certain=True)
        if ("size" in failure.relied or failure.on_air) and self.contact and (text := self.contact.resized(failure)):
            return Cause(f"this follows from another fault: {text}", certain=True)
        if failure.shown:
            return None
        text = extraction.excuse(self.lost_container, failure)
        if not text and self.contact is not None:
            text = self.contact.excuse(failure)
        return Cause(text) if text else None

    def notes(self, pixit: Testing) -> Iterator[str]:
        """Yield notes for the results on findings that affect many cases."""
        if pixit.reaction_periods is None and (self.reaction.periods > FLOOR or self.reaction.per_payload):
            yield f"reactions are waited for {self.reaction}; pixit.reaction_periods overrides this"
        if self.lost_container:
            yield (
                f"it loses the {self.lost_container} of two containers in a payload (VD-RX-04): in cases about other "
                "requirements that send such payloads, missing reactions are inconclusive"
            )
        for text in self.misread.values():
            yield f"{text}: consequences of that in other cases are inconclusive"


def stands(session: Session, case: Case, checks: Iterable[Check]) -> bool:
    """Return whether another execution of an inconclusive case cannot decide it.

    That is so if what was missing was missing at the start of the run, or is a service that is never answered, or if
    beacons cannot be read because of a rule that they broke at the start.
    """
    undecided = [check.observed for check in checks if check.verdict is Verdict.INCONCLUSIVE]
    contact = Findings.of(session).contact
    if contact is not None and contact.mute(case.needs.entities):
        return True
    lasting = [*BEGINNING, NEVER]
    if contact is not None and contact.violations:
        lasting.append(UNREADABLE)
    return bool(undecided) and all(any(each in text for each in lasting) for text in undecided)


def prepare(session: Session) -> bool:
    """Measure how fast the implementation reacts; if it answers, find out what it loses and misreads.

    Return whether it has answered now: nothing is done if it has answered before, or if there is no VarDis to ask.
    Raises ``LowerTesterError``.
    """
    found = Findings.of(session)
    if found.reaction.samples or session.pics.pics.vardis is False:
        return False
    found.reaction = measure(Bench(session, _CASE))
    if not found.reaction.samples:
        return False
    session.notifications = notification_delay(Bench(session, _CASE))
    found.lost_container = extraction.lost_container(Bench(session, _CASE))
    found.misread = layouts.misread_fields(Bench(session, _CASE))
    return True
