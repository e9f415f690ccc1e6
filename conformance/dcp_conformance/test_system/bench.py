"""The bench: the interface of a case to the tester.

A case is a straight sequence of steps: it sends with peers, waits in beacon periods, and queries received frames. Time
passes only within the waiting methods, so the same case runs in virtual time and on a real link. The result of a case
are *checks*; a failed check stops the case (``require``) or not (``check``).
"""

from __future__ import annotations

from functools import partial

from dcp_spec.constants import Features
from dcp_spec.profile.definition import Profile

from dcp_conformance.definitions.case import Case
from dcp_conformance.frames.builder import FrameBuilder
from dcp_conformance.frames.received import ReceivedBeacon

from .assumptions import Assumptions
from .control import Control
from .identifiers.allocation import Identifiers
from .judgement.excuses import Excuses
from .judgement.losses import Losses
from .judgement.matchers import Matchers
from .judgement.verdicts import Verdicts
from .probes import Probes, Teaching
from .reception.receiver import Receiver
from .reception.waiting import Repetitions, Waiting
from .sending.peers import Peers
from .sending.records import Records
from .sending.transmission import Transmission
from .services.calls import Services
from .services.changes import Changes, Restoration
from .session import Session
from .steps import Steps
from .sut_properties import MS, SutProperties
from .traffic import Traffic

__all__ = ["MS", "Bench", "Session"]


class Bench:
    """The view that one case has of the session.

    It connects parts, and names the steps that most cases consist of. A case reaches everything else through the
    part, as in ``bench.records.value(b"long value")``.
    """

    def __init__(self, session: Session, case: Case) -> None:
        self.case = case
        self.session = session
        self.codec = codec = session.codec
        self.lower = lower = session.lower
        self.traffic = traffic = Traffic()
        """The recording of the case."""
        self.heard: list[ReceivedBeacon] = []
        """The implementation's frames since the case began."""
        self.clients = 0
        """Number of clients of BP that the case has registered, and not deregistered."""

        # The parts. Each knows only the parts before it.
        created: set[int] = set()
        self.steps = Steps(lower)
        self.assumptions = Assumptions()
        self.sut = SutProperties(session, lower, self.assumptions)
        self.losses = Losses(lower, traffic, self.heard, self.sut, self.steps, session.counting)
        self.excuses = Excuses(codec, lower, traffic, self.heard, created, session, self.losses, self.assumptions)
        self.verdicts = Verdicts(case, codec, lower, traffic, self.excuses, session.pics.readings)
        self.matchers = matchers = Matchers(self.verdicts)
        self.identifiers = Identifiers(session, lower, self.sut, self.verdicts, created)
        self.records = Records(codec, lower, session, self.sut, self.identifiers, self.verdicts)
        self.builder = FrameBuilder(codec, sized=partial(self.excuses.relies_on, "size"))
        self.transmission = Transmission(lower, traffic, self.steps, self.losses, self.sut)
        self.receiver = Receiver(session, case.id, lower, traffic, self.steps, self.identifiers, self.heard)
        self.waiting = Waiting(self.receiver, lower, self.sut, self.losses)
        self.peers = Peers(self.transmission, self.builder, self.records, self.sut, self.identifiers, self.waiting)
        self.repetitions = Repetitions(self.waiting, self.verdicts)
        changes = Changes(self.sut.initial)
        self.services = Services(
            session, case.id, lower, traffic, self.steps, self.identifiers, self.receiver, self.verdicts, changes
        )
        self.restoration = Restoration(changes, self.services, session.held_protocols)
        self.probes = Probes(session, self.peers, self.identifiers, self.waiting, self.verdicts)
        self.teaching = Teaching(self.builder, self.records, self.sut, self.receiver, self.waiting, self.verdicts)
        self.control = Control(
            session, lower, traffic, self.steps, self.sut, self.verdicts, changes, self.receiver, self.waiting,
            self.probes,
        )  # fmt: skip

        # The steps of most cases. Checks:
        self.inconclusive = self.verdicts.inconclusive
        self.info = self.verdicts.info
        self.reading = self.verdicts.reading
        self.require_alive = self.probes.require_alive
        self.require_processed = self.probes.require_processed
        self.check_repeated = self.repetitions.check
        self.some = matchers.some
        self.required = matchers.required
        self.needed = matchers.needed
        self.complete = matchers.complete
        self.none = matchers.none
        self.every = matchers.every
        self.answered = matchers.answered
        self.fields = matchers.fields
        self.present = matchers.present
        self.proved = matchers.proved
        self.equal = matchers.equal
        self.only = matchers.only
        self.in_order = matchers.in_order
        self.repeated = matchers.repeated
        self.one_each = matchers.one_each
        self.within = matchers.within
        self.successive = matchers.successive
        self.passed = matchers.passed
        self.missing = matchers.missing
        self.wrong = matchers.wrong
        # Stimuli:
        self.peer = self.peers.new
        self.var_id = self.identifiers.var_id
        self.unknown_id = self.identifiers.unknown_id
        self.learn = self.teaching.learn
        self.learnt = self.teaching.learnt
        self.call = self.services.call
        self.must = self.services.must
        self.expect_status = self.services.expect_status
        # Reactions:
        self.mark = self.waiting.mark
        self.wait = self.waiting.wait
        self.until = self.waiting.until
        self.until_instruction = self.waiting.until_instruction
        self.until_quiet = self.waiting.until_quiet
        self.beacons = self.waiting.beacons
        self.instructions = self.receiver.instructions
        self.now = lower.now

    @property
    def profile(self) -> Profile:
        """The wire profile."""
        return self.sut.profile

    @property
    def features(self) -> Features:
        """Features of the profile's version of the specification."""
        return self.sut.features

    @property
    def period(self) -> int:
        """The beacon period in ns; with ``--timing-scale``, longer for every time window."""
        return self.sut.period
