"""Parts of the bench without a session: a link in virtual time, an upper tester with prepared answers, plain facts."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any

from dcp_conformance.definitions.case import Case, Kind
from dcp_conformance.definitions.pics import Pics
from dcp_conformance.errors import UpperTesterError
from dcp_conformance.frames.builder import FrameBuilder
from dcp_conformance.frames.received import ReceivedBeacon
from dcp_conformance.interconnection.findings import Findings
from dcp_conformance.lower_tester import Arrival, Incident, LinkHealth
from dcp_conformance.test_system.assumptions import Assumptions
from dcp_conformance.test_system.control import Control
from dcp_conformance.test_system.identifiers.allocation import Identifiers
from dcp_conformance.test_system.identifiers.pool import IdentifierPool
from dcp_conformance.test_system.judgement.counting import Counting
from dcp_conformance.test_system.judgement.excuses import Excuses
from dcp_conformance.test_system.judgement.losses import Losses
from dcp_conformance.test_system.judgement.verdicts import Verdicts
from dcp_conformance.test_system.probes import Probes, Teaching
from dcp_conformance.test_system.reception.receiver import Receiver
from dcp_conformance.test_system.reception.waiting import Repetitions, Waiting
from dcp_conformance.test_system.sending.peers import Peers
from dcp_conformance.test_system.sending.records import Records
from dcp_conformance.test_system.sending.transmission import Transmission
from dcp_conformance.test_system.services.calls import Services
from dcp_conformance.test_system.services.changes import Changes
from dcp_conformance.test_system.steps import Steps
from dcp_conformance.test_system.sut_properties import PeriodOverride, SutProperties
from dcp_conformance.test_system.traffic import Traffic
from dcp_conformance.upper_tester import Answer, Notification

from dcp_codec import Beacon, BPHeader, Codec, Payload, get_codec
from dcp_codec.values import VardisRecord

PERIOD = 100_000_000
"""The beacon period of the PIXIT by default, in ns."""
EPOCH = 1_767_225_600 * 1_000_000_000
SUT = bytes.fromhex("020000000001")
OTHER = bytes.fromhex("020000000002")
HEADER = b"\xff" * 6 + SUT + b"\x49\x53"


class Link:
    """A lower tester in virtual time, with frames to come."""

    name = "virtual"

    def __init__(self) -> None:
        self.time = 0
        self.sent: list[bytes] = []
        self.on_send: Callable[[], None] = lambda: None
        self.coming: deque[tuple[int, bytes]] = deque()
        """Frames by their times, the earliest first."""
        self.dropped = 0
        self.incidents: list[Incident] = []

    def now(self) -> int:
        return self.time

    def wall(self) -> int:
        return EPOCH + self.time

    def send(self, octets: bytes, source: bytes) -> bytes:
        self.sent.append(octets)
        self.on_send()
        return b"\xff" * 6 + source + b"\x49\x53" + octets

    def send_frame(self, frame: bytes) -> None:
        self.sent.append(frame)

    def receive(self, until: int, also: Sequence[int] = ()) -> Arrival | None:
        if self.coming and self.coming[0][0] <= until:
            time, octets = self.coming.popleft()
            self.time = max(self.time, time)
            return Arrival(time, EPOCH + time, octets, HEADER + octets, SUT)
        self.time = max(self.time, until)
        return None

    def take_in(self) -> None:
        """Nothing to do: frames are kept until they are received."""

    def health(self) -> LinkHealth:
        found = LinkHealth(self.dropped, tuple(self.incidents))
        self.dropped = 0
        self.incidents.clear()
        return found


class Upper:
    """An upper tester with an answer for each method; an exception is raised."""

    name = "prepared"
    methods = frozenset({"RTDB-Create", "RTDB-Delete", "BP-SetParameter"})
    about: Mapping[str, Any] = {}

    def __init__(self, **answers: Answer | UpperTesterError) -> None:
        self.answers = {name.replace("_", "-"): answer for name, answer in answers.items()}
        self.calls: list[tuple[str, dict[str, Any]]] = []
        self.notifications: list[Notification] = []
        self.on_call: Callable[[], None] = lambda: None

    def call(self, method: str, params: dict[str, Any]) -> Answer:
        self.calls.append((method, params))
        self.on_call()
        answer = self.answers.get(method, Answer("VARDIS-STATUS-OK"))
        if isinstance(answer, UpperTesterError):
            raise answer
        return answer

    def poll(self) -> list[Notification]:
        found, self.notifications = self.notifications, []
        return found

    def filenos(self) -> tuple[int, ...]:
        return ()

    def another(self) -> None:
        return None

    def close(self) -> None:
        """Nothing to close."""


class Run:
    """The facts of a run that the parts use, without a session."""

    def __init__(self, codec: Codec, pics: Pics) -> None:
        self.codec = codec
        self.pics = pics
        self.timing_scale = 1.0
        self.parameters: dict[str, Any] = {}
        self.known = Findings()
        self.short_period: PeriodOverride | None = None
        self.busy_until = 0
        self.sut_id: bytes | None = SUT
        self.sut_address: bytes | None = None
        self.identifier_pool = IdentifierPool(0, 15, leave=False, timed=True)
        self.boundaries: Mapping[str, int] = {"lowest": 0, "highest": 15}
        self.renewable = False
        self.next_node = 0
        self.creation_time = 0
        self.upper: Any = None
        self.call_times: deque[int] = deque()
        self.typical_call = 0
        self.restart: Callable[[], None] | None = None
        self.switch_link: Callable[[bool], None] | None = None
        self.log: list[str] = []

    def heard(self, heard: ReceivedBeacon, _arrival: Arrival, case: str, _traffic: object, _departure: int) -> None:
        self.log.append(f"{case} heard {heard.seqno}")

    def called(self, method: str, _params: Mapping[str, Any], case: str) -> None:
        self.log.append(f"{case} called {method}")

    def forget(self) -> None:
        self.log.append("forget")

    def interrupted(self) -> None:
        self.log.append("interrupted")


class Parts:
    """Makes each part, and the parts that it needs, when it is used first."""

    def __init__(
        self, profile: str = "dcp-2.0", pics: Pics | None = None, requirements: tuple[str, ...] = ("BP-RX-07",)
    ) -> None:
        self.codec = get_codec(profile)
        self.link = Link()
        self.run = Run(self.codec, pics or Pics())
        self.case = Case("TC_BP_X_BV_01", "", requirements, Kind.VALID, "", "", 4, "", "", lambda _: None)
        self.heard: list[ReceivedBeacon] = []
        self.created: set[int] = set()
        self.counting = Counting()
        self.traffic = Traffic()
        self.steps = Steps(self.link)
        self.assumptions = Assumptions()
        self.builder = FrameBuilder(self.codec)
        self.sut = SutProperties(self.run, self.link, self.assumptions)

    @cached_property
    def losses(self) -> Losses:
        return Losses(self.link, self.traffic, self.heard, self.sut, self.steps, self.counting)

    @cached_property
    def excuses(self) -> Excuses:
        return Excuses(
            self.codec, self.link, self.traffic, self.heard, self.created, self.run, self.losses, self.assumptions
        )

    @cached_property
    def verdicts(self) -> Verdicts:
        return Verdicts(self.case, self.codec, self.link, self.traffic, self.excuses)

    @cached_property
    def identifiers(self) -> Identifiers:
        return Identifiers(self.run, self.link, self.sut, self.verdicts, self.created)

    @cached_property
    def records(self) -> Records:
        return Records(self.codec, self.link, self.run, self.sut, self.identifiers, self.verdicts)

    @cached_property
    def transmission(self) -> Transmission:
        return Transmission(self.link, self.traffic, self.steps, self.losses, self.sut)

    @cached_property
    def peers(self) -> Peers:
        return Peers(self.transmission, self.builder, self.records, self.sut, self.identifiers, self.waiting)

    @cached_property
    def receiver(self) -> Receiver:
        return Receiver(self.run, self.case.id, self.link, self.traffic, self.steps, self.identifiers, self.heard)

    @cached_property
    def waiting(self) -> Waiting:
        return Waiting(self.receiver, self.link, self.sut, self.losses)

    @cached_property
    def repetitions(self) -> Repetitions:
        return Repetitions(self.waiting, self.verdicts)

    @cached_property
    def changes(self) -> Changes:
        return Changes(self.sut.initial)

    @cached_property
    def services(self) -> Services:
        return Services(
            self.run, self.case.id, self.link, self.traffic, self.steps, self.identifiers, self.receiver,
            self.verdicts, self.changes,
        )  # fmt: skip

    @cached_property
    def probes(self) -> Probes:
        return Probes(self.run, self.peers, self.identifiers, self.waiting, self.verdicts)

    @cached_property
    def teaching(self) -> Teaching:
        return Teaching(self.builder, self.records, self.sut, self.receiver, self.waiting, self.verdicts)

    @cached_property
    def control(self) -> Control:
        return Control(
            self.run, self.link, self.traffic, self.steps, self.sut, self.verdicts, self.changes, self.receiver,
            self.waiting, self.probes,
        )  # fmt: skip

    # -- the implementation --------------------------------------------------------------------------------------------

    def beacon(self, seqno: int, *records: VardisRecord, sender: bytes = SUT) -> bytes:
        """Return a beacon of the implementation with these records, or with a payload for another protocol."""
        if not records:
            return self.codec.encode_envelope(Beacon(BPHeader(sender, seqno, 0x1111), (Payload(0x7000, b"x"),)))
        network = self.codec.profile.bp.network_id
        return self.builder.beacon(sender, seqno, [self.builder.vardis(*records)], network_id=network)

    def sends(self, *records: VardisRecord, at: float | None = None, sender: bytes = SUT) -> None:
        """Let the implementation send a beacon one period after the last one, or at a time in beacon periods."""
        coming = self.link.coming
        time = round(at * PERIOD) if at is not None else (coming[-1][0] if coming else self.link.time) + PERIOD
        coming.append((time, self.beacon(len(coming) + 1, *records, sender=sender)))

    def hear(self, *frames: bytes) -> None:
        """Add frames to the received ones."""
        first = len(self.heard) + 1
        self.heard.extend(
            ReceivedBeacon(self.codec, number, 0, 0, each, SUT) for number, each in enumerate(frames, first)
        )
