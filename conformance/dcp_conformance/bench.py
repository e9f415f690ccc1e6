"""The bench: what a case does and says goes through here.

A case runs straight on, top to bottom: it sends with peers, waits in beacon periods, and asks what was heard. Time
passes only inside of the waiting methods, so that the same case runs in virtual time and on the air. What a case finds
is a *check*; a failed check can stop the case (``require``) or not (``check``). Before a failure is believed, the bench
looks for its own: frames that the kernel dropped and beacons that were not heard turn it into ``inconclusive``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, NoReturn, TypeVar

from dcp_spec.constants import BP_SEQNO_MODULUS, Features, ICType, features
from dcp_spec.parameters import parameter
from dcp_spec.profile import Profile
from dcp_spec.readings import reading as reading_of

from dcp_codec.codec import Codec
from dcp_codec.values import ExtendedSafetyData, VarCreate, VarSpec, VarUpdate

from .case import Case
from .errors import StopCase, UpperTesterError
from .forge import Forge
from .heard import Heard, Instruction
from .lower import LowerTester
from .peers import Peer
from .pics import Pics
from .results import Check, Mark, Table
from .traffic import Traffic
from .upper import Answer, Notification, UpperTester
from .verdict import Verdict, worst

T = TypeVar("T")
MS = 1_000_000


class Session:
    """What lasts from case to case: the way to the implementation, what is known of it, and names not used yet."""

    def __init__(
        self,
        codec: Codec,
        lower: LowerTester,
        upper: UpperTester | None,
        pics: Pics,
        *,
        timing_scale: float = 1.0,
        seed: int = 1,
    ) -> None:
        self.codec = codec
        self.lower = lower
        self.upper = upper
        self.pics = pics
        self.timing_scale = timing_scale
        self.seed = seed
        self.sut_id: bytes | None = None
        """The implementation's node identifier, once it is known."""
        self.parameters: dict[str, Any] = {}
        """Initial values of parameters, as the upper tester told them."""
        self.can_restart = False
        self.restart: Callable[[], None] | None = None
        """Starts the implementation again, from its initial state; None where that cannot be done."""
        self.next_peer = 0
        self.next_var_id = 0
        self.next_protocol = 0
        self.next_unknown = 0
        self.known: set[int] = set()
        """Variables that the implementation has sent something about that only its database can have told it."""
        self.summarised: set[int] = set()
        """Variables that the implementation has summarised, and not said to be deleted since."""
        self.leaving: dict[int, int] = {}
        """Those of them that were deleted and, up to 1.3, leave the database: the time (ns) when they will have."""
        self.creation_time = 0


class Bench:
    """One case's view of the session."""

    def __init__(self, session: Session, case: Case) -> None:
        self.session = session
        self.case = case
        self.codec = session.codec
        self.lower = session.lower
        self.pics = session.pics.pics
        self.pixit = session.pics.pixit
        self.forge = Forge(session.codec)
        self.traffic = Traffic()
        self.heard: list[Heard] = []
        """The implementation's frames since the case began."""
        self.others: list[Heard] = []
        """Frames with another sender's identifier that the tester has not sent."""
        self.notifications: list[Notification] = []
        self.checks: list[Check] = []
        self.readings: dict[str, str] = {}
        self.peers_made: list[Peer] = []
        self.created: set[int] = set()
        self.produced: set[int] = set()
        """Those of the variables that the implementation's application has created."""
        self.dropped = 0
        self.late_ns = 0

    # -- what is known -----------------------------------------------------------------------------------------

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

    @property
    def reaction(self) -> float:
        """Beacon periods within which a reaction must show (PIXIT)."""
        return self.pixit.reaction_periods

    @property
    def sut_id(self) -> bytes:
        """The implementation's node identifier. Stops the case as inconclusive if it is not known yet."""
        if self.session.sut_id is None:
            self.inconclusive("the node identifier of the implementation", "no beacon of it was heard so far")
        return self.session.sut_id

    def parameter(self, name: str) -> int:
        """The value of a parameter of the implementation: as it said itself, else from PIXIT or profile.

        Names are the specification's (``VARDISPAR_MAX_SUMMARIES``), periods in ms.
        """
        if name in self.session.parameters:
            return int(self.session.parameters[name])
        limits, pixit = self.profile.limits, self.pixit
        known: dict[str, float | int | None] = {
            "BPPAR_BEACON_PERIOD": pixit.beacon_period_ms,
            "BPPAR_NETWORK_ID": pixit.network_id if pixit.network_id is not None else self.profile.bp.network_id,
            "BPPAR_MAXIMUM_PACKET_SIZE": pixit.max_packet_size or limits.max_beacon_size,
            "SRPPAR_NEIGHBOUR_TABLE_TIMEOUT": pixit.neighbour_timeout_ms,
            "VARDISPAR_MAX_VALUE_LENGTH": pixit.max_value_length or limits.max_value_length,
            "VARDISPAR_MAX_DESCRIPTION_LENGTH": pixit.max_description_length or limits.max_description_length,
            "VARDISPAR_MAX_REPETITIONS": pixit.max_repetitions or limits.max_repetitions,
            "VARDISPAR_MAX_PAYLOAD_SIZE": pixit.max_payload_size or limits.max_vardis_payload,
            "VARDISPAR_MAX_SUMMARIES": limits.max_summaries if pixit.max_summaries is None else pixit.max_summaries,
            "VARDISPAR_SCRUBBING_PERIOD": pixit.scrubbing_period_ms,
            "VARDISPAR_BUFFER_CHECK_PERIOD": pixit.buffer_check_period_ms,
        }
        parameter(name)
        value = known[name]
        return int(value or 0)

    # -- names and values that nobody else uses ----------------------------------------------------------------

    def peer(self) -> Peer:
        """A virtual station that has not spoken before."""
        self.session.next_peer += 1
        number = self.session.next_peer
        peer = Peer(self, self._node_id(number), _address(number))
        self.peers_made.append(peer)
        return peer

    def node_id(self) -> bytes:
        """The identifier of a node that does not exist: a producer far away, or a neighbour of somebody else."""
        self.session.next_peer += 1
        return self._node_id(self.session.next_peer)

    def _node_id(self, number: int) -> bytes:
        layout = self.profile.types.node_id
        octets = _address(number)
        if layout.representation == "text":
            return octets.hex(":").encode()
        return octets[-layout.width :].rjust(layout.width, b"\x02")

    def var_id(self) -> int:
        """A variable identifier that this case has not used, and others least recently."""
        top = (1 << (8 * self.profile.types.var_id.width)) - 1
        first, last = self.pixit.var_ids or (0, min(top, 0xFFFF))
        size = last - first + 1
        # Since 2.0 nothing is ever forgotten: the upper half is for those that must be unknown.
        usable = size // 2 if size >= 128 else size
        number = first
        for _ in range(usable):
            number = first + self.session.next_var_id % usable
            self.session.next_var_id += 1
            # One that is on its way out of the database cannot be created; nor, up to 1.3, one that is in it.
            leaving = self.session.leaving.get(number, 0) > self.now()
            there = number in self.session.summarised and not self.features.creation_time
            if not leaving and not there and number not in self.created:
                break
        self.created.add(number)
        return number

    def unknown_ids(self, count: int) -> list[int]:
        """Identifiers that the implementation has never shown to know, descending from the top of the range.

        They may have been used before: what is requested and never answered stays unknown. Stops the case as
        inconclusive when there are not enough of them, which only a reset can bring back.
        """
        top = (1 << (8 * self.profile.types.var_id.width)) - 1
        first, last = self.pixit.var_ids or (0, min(top, 0xFFFF))
        size = last - first + 1
        found: list[int] = []
        for _ in range(size):
            if len(found) == count:
                return found
            number = last - self.session.next_unknown % size
            self.session.next_unknown += 1
            gone = self.session.leaving.get(number)
            if gone is not None and gone <= self.now():
                del self.session.leaving[number]
                self.session.known.discard(number)
            if number not in self.session.known and number not in self.created:
                found.append(number)
        if len(found) < count:
            self.inconclusive(
                f"{count} identifiers of variables that the implementation does not know",
                f"{len(found)} are left of {size}; it needs a way to be reset (--ut, --restart)",
            )
        return found

    def unknown_id(self) -> int:
        """One of them."""
        return self.unknown_ids(1)[0]

    def own_var_id(self) -> int:
        """An identifier for a variable of the implementation's application: one that no other node ever had (X20)."""
        number = self.unknown_id()
        self.created.add(number)
        return number

    def var_ids(self, count: int) -> list[int]:
        """Several of them, ascending unless the range ends in between."""
        return [self.var_id() for _ in range(count)]

    def creation_time(self) -> int:
        """A time stamp as on the air: now, and later than any that was handed out before."""
        stamp = self.profile.types.timestamp
        since = self.lower.now() if stamp.epoch_ns is None else self.lower.wall() - stamp.epoch_ns
        ticks = since * stamp.per_second // 1_000_000_000
        self.session.creation_time = max(self.session.creation_time + 1, ticks)
        return self.session.creation_time

    def spec(
        self,
        var_id: int,
        producer: bytes,
        *,
        rep_cnt: int = 1,
        descr: bytes = b"tester",
        creation_time: int | None = None,
        timeout: int = 0,
    ) -> VarSpec:
        """A VarSpec with what the profile's layout has; ``creation_time`` is a fresh one unless given."""
        names = self.profile.vardis.var_spec
        return VarSpec(
            var_id,
            producer,
            rep_cnt,
            descr,
            (self.creation_time() if creation_time is None else creation_time) if "creationTime" in names else None,
            timeout if "timeout" in names else None,
        )

    def create(
        self,
        var_id: int,
        producer: bytes,
        *,
        value: bytes = b"value",
        seqno: int = 0,
        rep_cnt: int = 1,
        descr: bytes = b"tester",
        creation_time: int | None = None,
        timeout: int = 0,
    ) -> VarCreate:
        """A VarCreate record."""
        spec = self.spec(var_id, producer, rep_cnt=rep_cnt, descr=descr, creation_time=creation_time, timeout=timeout)
        return VarCreate(spec, VarUpdate(var_id, seqno, value))

    def report(self, node_id: bytes, seqno: int, *, t_stamp: int | None = None, **fields: float) -> ExtendedSafetyData:
        """A state report; the fields of the safety data that are not given are zero."""
        kind = self.codec.safety_data_type
        zeros: dict[str, Any] = {
            each.name: b"\0" * each.octets if each.type == "opaque" else 0.0 if each.type.startswith("f") else 0
            for each in self.profile.srp.safety_data
        }
        data = kind(**{_attribute(kind, name): value for name, value in {**zeros, **fields}.items()})
        return ExtendedSafetyData(data, node_id, self.creation_time() if t_stamp is None else t_stamp, seqno)

    # -- waiting -----------------------------------------------------------------------------------------------

    def now(self) -> int:
        """ns of the lower tester's clock."""
        return self.lower.now()

    def mark(self) -> int:
        """A place in ``heard``: what comes from now on is ``heard[mark:]``; what has arrived already lies before it."""
        self.wait_ns(0)
        return len(self.heard)

    def wait(self, periods: float) -> list[Heard]:
        """Let time pass; what was heard meanwhile."""
        return self.wait_ns(round(periods * self.period))

    def wait_ns(self, duration: int) -> list[Heard]:
        """As :meth:`wait`, in ns."""
        before = len(self.heard)
        deadline = self.now() + duration
        for _ in self._listen(deadline):
            pass
        return self.heard[before:]

    def until(self, wanted: Callable[[Heard], T], periods: float | None = None) -> T | None:
        """Wait for a frame for which ``wanted`` says something true, and return that; None if none comes in time.

        Frames that came before are not asked. ``periods`` is :attr:`reaction` unless given.
        """
        deadline = self.now() + self._patience(self.reaction if periods is None else periods)
        for heard in self._listen(deadline):
            if found := wanted(heard):
                return found
        return None

    def until_instruction(self, kind: ICType, var_id: int, periods: float | None = None) -> Any | None:
        """Wait for a record of this kind about a variable, and return it; None if none comes in time."""
        return self.until(lambda heard: heard.about(kind, var_id), periods)

    def beacons(self, count: int, periods: float | None = None) -> list[Heard]:
        """Wait for so many beacons; those that came, which may be fewer at the end of the time."""
        before = len(self.heard)
        deadline = self.now() + self._patience(2 * count + self.reaction if periods is None else periods)
        if count > 0:
            for _ in self._listen(deadline):
                if len(self.heard) - before >= count:
                    break
        return self.heard[before:]

    def _patience(self, periods: float) -> int:
        """How long to wait, in ns, for what ends the wait when it comes: never less than a busy machine may sleep."""
        return max(round(periods * self.period), round(self.pixit.least_patience_ms * MS))

    def until_quiet(
        self, present: Callable[[Heard], object], periods: float = 60, since: int | None = None
    ) -> list[Heard]:
        """Wait until what is ``present`` has stopped: the frames that had it, from ``since`` (a mark) on.

        It has stopped when ``quiet_beacons`` beacons in a row (PIXIT) do not have it, or when no beacons come at all
        for the time of :attr:`reaction`. Gives up after ``periods``; then what came until then is returned.
        """
        start = len(self.heard) if since is None else since
        deadline = self.now() + round(periods * self.period)
        while self.now() < deadline:
            frames = self.heard[start:]
            having = [index for index, heard in enumerate(frames) if present(heard)]
            behind = len(frames) - 1 - having[-1] if having else 0
            if behind >= self.pixit.quiet_beacons:
                break
            before = len(self.heard)
            self.beacons(1, self.reaction)
            if len(self.heard) == before:
                break
        return [heard for heard in self.heard[start:] if present(heard)]

    def repeated(self, kind: ICType, var_id: int, since: int, periods: float = 60) -> list[Instruction]:
        """Wait until the records of a kind about a variable have stopped; those that came from a mark on."""
        self.until_quiet(lambda heard: heard.instructions(kind, var_id), periods, since)
        return self.instructions(kind, var_id, since)

    def check_repeated(
        self, kind: ICType, var_id: int, count: int, since: int, /, *requirements: str
    ) -> list[Instruction]:
        """Check that exactly so many distinct beacons from a mark on have one record of this kind about a variable."""
        found = self.repeated(kind, var_id, since)
        beacons = {id(each.heard) for each in found}
        what = f"exactly {count} beacon{'s' if count != 1 else ''} with one {kind.label} record of variable {var_id}"
        came = f"{len(found)} records in {len(beacons)} beacons"
        self.check(len(found) == len(beacons) == count, what, came, *requirements, frames=found[:32])
        return found

    def learn(self, peer: Peer, *creates: VarCreate) -> None:
        """Let the implementation learn variables, and wait until it has passed them on as often as it must.

        Stops the case as inconclusive if it does not pass one of them on.
        """
        start = self.mark()
        wanted = {create.spec.var_id for create in creates}
        peer.send_all(creates)

        def present(heard: Heard) -> bool:
            return any(each.var_id in wanted for each in heard.instructions(ICType.CREATE_VARIABLES))

        self.until_quiet(present, since=start)
        if missing := wanted - {each.var_id for each in self.instructions(ICType.CREATE_VARIABLES, since=start)}:
            names = ", ".join(map(str, sorted(missing)))
            self.inconclusive("the implementation learns variables, which this case needs", f"not {names}")

    def rep_cnt(self, wanted: int) -> int:
        """A repetition count that the implementation accepts: the wanted one, or the largest."""
        return max(1, min(wanted, self.parameter("VARDISPAR_MAX_REPETITIONS") or wanted))

    def _listen(self, deadline: int) -> Iterator[Heard]:
        """The implementation's frames as they come in, until the deadline."""
        lower, upper = self.lower, self.session.upper
        also = upper.filenos() if upper is not None else ()
        while True:
            arrival = lower.receive(deadline, also)
            self._take_notifications()
            if arrival is None:
                if lower.now() >= deadline:
                    return
                continue
            heard = Heard(self.codec, 0, arrival.time, arrival.wall, arrival.octets, arrival.source)
            ours = self._is_sut(heard)
            start = len(arrival.frame) - len(arrival.octets)
            who = (heard.sender or arrival.source).hex(":")
            heard.number = self.traffic.frame("heard" if ours else "other", arrival.wall, who, arrival.frame, start)
            if ours:
                self.heard.append(heard)
                self.session.summarised.update(each.var_id for each in heard.instructions(ICType.SUMMARIES))
                self.session.summarised.difference_update(
                    each.var_id for each in heard.instructions(ICType.DELETE_VARIABLES)
                )
                for var_id in heard.known:
                    self.session.known.add(var_id)
                    if heard.about(ICType.DELETE_VARIABLES, var_id) is None:
                        self.session.leaving.pop(var_id, None)
                yield heard
            else:
                self.others.append(heard)

    def _take_notifications(self) -> None:
        upper = self.session.upper
        if upper is None:
            return
        for notification in upper.poll():
            self.traffic.note("notified", self.lower.wall(), notification.method, notification.params)
            self.notifications.append(notification)

    def _is_sut(self, heard: Heard) -> bool:
        known, sender = self.session.sut_id, heard.sender
        if sender is None:
            # Too short to say who sent it, or a profile without senders: whoever else is there is not ours either.
            return known is None or known == heard.source or not self.profile.bp.header
        if known is None:
            self.session.sut_id = sender
            return True
        return sender == known

    # -- sending -----------------------------------------------------------------------------------------------

    def transmit(self, octets: bytes, source: bytes) -> int:
        """Put a bearer payload on the air; the number of its frame in the recording."""
        frame = self.lower.send(octets, source)
        return self.traffic.frame("sent", self.lower.wall(), source.hex(":"), frame, len(frame) - len(octets))

    def transmit_frame(self, frame: bytes, start: int) -> int:
        """Put a whole link-layer frame on the air, whose bearer payload begins at ``start``; its number."""
        self.lower.send_frame(frame)
        return self.traffic.frame("sent", self.lower.wall(), "", frame, start)

    def probe(self, periods: float | None = None) -> bool:
        """Whether VarDis answers: a summary of an unknown variable must bring a request for it (VD-PS-01)."""
        peer, var_id = self.peer(), self.unknown_id()
        peer.send(peer.summary(var_id, 1))
        return self.until_instruction(ICType.REQUEST_VARCREATES, var_id, periods) is not None

    def require_alive(self, after: str, *requirements: str) -> None:
        """Stop as failed unless VarDis still answers."""
        alive = self.probe() or self.probe()
        self.require(alive, f"VarDis still answers after {after}", "no answer to two probes", *requirements)

    # -- services ----------------------------------------------------------------------------------------------

    @property
    def ut(self) -> UpperTester:
        """The upper tester. Cases that use it say so in their needs."""
        if self.session.upper is None:
            raise UpperTesterError("this case needs an upper tester, and there is none")
        return self.session.upper

    def call(self, method: str, /, **params: Any) -> Answer:
        """Call a service of the implementation; the answer may be an error."""
        return self.call_on(self.ut, method, **params)

    def call_on(self, upper: UpperTester, method: str, /, **params: Any) -> Answer:
        """As :meth:`call` on another connection."""
        self.traffic.note("call", self.lower.wall(), method, params, upper.name)
        answer = upper.call(method, params)
        data = answer.result if answer.code is None else {"code": answer.code, "message": answer.message}
        self.traffic.note("answer", self.lower.wall(), f"{method}: {answer}", data, upper.name)
        if method == "RTDB-Create" and answer.ok:
            self.produced.add(params["varId"])
        self._take_notifications()
        return answer

    def restart(self) -> None:
        """Start the implementation again and wait until it takes part; for cases whose needs say ``restart``."""
        if self.session.restart is None:
            self.inconclusive("the implementation is started again", "there is no command to restart it")
        self.traffic.note("note", self.lower.wall(), "restart of the implementation")
        self.session.restart()
        if not any(self.probe(self.reaction) for _ in range(5)):
            self.inconclusive("the implementation takes part again after its restart", "no answer to five probes")

    def expect_status(self, status: str, method: str, /, *requirements: str, **params: Any) -> Answer:
        """Call a service that must answer with this status; a check, which does not stop the case."""
        answer = self.call(method, **params)
        matches = answer.code is None and answer.status.replace("_", "-") == status.replace("_", "-")
        self.check(matches, f"{method} answers {status}", f"{answer}", *requirements)
        return answer

    def must(self, method: str, /, **params: Any) -> Answer:
        """Call a service whose success the case needs, but does not judge; stops as inconclusive without it."""
        answer = self.call(method, **params)
        if not answer.ok:
            self.inconclusive(f"{method} succeeds, which this case needs", str(answer))
        return answer

    # -- saying what was found ---------------------------------------------------------------------------------

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

        A failure with losses of the tester's own in this case counts as inconclusive. Does not stop the case.
        """
        verdict = Verdict.PASS if holds else Verdict.FAIL
        if not holds and (lost := self.own_losses()):
            verdict, observed = Verdict.INCONCLUSIVE, f"{observed}; but the tester has lost something: {lost}"
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

    # -- looking back ------------------------------------------------------------------------------------------

    def instructions(self, kind: ICType, var_id: int | None = None, since: int = 0) -> list[Instruction]:
        """All records of a kind that were heard from a mark on, about one variable or any."""
        return [each for heard in self.heard[since:] for each in heard.instructions(kind, var_id)]

    def frames_with(self, kind: ICType, var_id: int, since: int = 0) -> list[Heard]:
        """The beacons with a record of this kind about a variable."""
        return [heard for heard in self.heard[since:] if heard.instructions(kind, var_id)]

    def verdict(self) -> Verdict:
        """What the checks come to; ``inconclusive`` for a case that has checked nothing."""
        return worst(check.verdict for check in self.checks) or Verdict.INCONCLUSIVE


def _address(number: int) -> bytes:
    """A locally administered address that says whose it is: 02:dc:9n:..."""
    return bytes((0x02, 0xDC, 0x90)) + number.to_bytes(3, "big")


def _attribute(kind: type[Any], name: str) -> str:
    """The attribute of a safety data class for a field's name."""
    from dcp_codec.plan import snake

    return snake(name) if snake(name) in kind.__struct_fields__ else name
