"""The bench: the interface of a case to the tester.

A case is a straight sequence of steps: it sends with peers, waits in beacon periods, and queries received frames. Time
passes only within the waiting methods, so the same case runs in virtual time and on a real link. The result of a case
are *checks*; a failed check stops the case (``require``) or not (``check``).

The bench is built in four layers: :class:`~dcp_conformance.test_system.checks.Findings` (checks),
:class:`~dcp_conformance.test_system.allocation.Allocation` (identifiers and values),
:class:`~dcp_conformance.test_system.waiting.Waiting` (waiting
and receiving), and, in this module, sending and service calls.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any

from dcp_spec.constants import ICType

from dcp_codec.values import VarCreate
from dcp_conformance.errors import ConformanceError, UpperTesterError
from dcp_conformance.frames.builder import FrameBuilder
from dcp_conformance.frames.received import ReceivedBeacon
from dcp_conformance.lower_tester import Impairs
from dcp_conformance.model.case import Case
from dcp_conformance.upper_tester import Answer, UpperTester

from .allocation import address_of
from .changes import Changes
from .checks import MS
from .contact import Question
from .peers import Peer
from .session import Session
from .waiting import Waiting

__all__ = ["MS", "Bench", "Session"]

#: Number of calls without an answer after which :meth:`Bench.restore` stops trying.
_GIVEN_UP = 3


class Bench(Waiting):
    """The view that one case has of the session."""

    def __init__(self, session: Session, case: Case) -> None:
        super().__init__(session, case)
        self.builder = FrameBuilder(session.codec)
        self.peers_made: list[Peer] = []
        self.changes = Changes(self._initial_value)
        self.not_restored = ""
        """Why :meth:`restore` failed; empty if it succeeded."""

    # -- sending -------------------------------------------------------------------------------------------------------

    def peer(self) -> Peer:
        """Return a virtual node that has not sent anything before."""
        number = self.next_node()
        peer = Peer(self, self._node_id(number), address_of(number))
        self.peers_made.append(peer)
        return peer

    def transmit(self, octets: bytes, source: bytes, payloads: int = 1) -> int:
        """Send a bearer payload and return the number of its frame in the recording.

        ``payloads``: number of its blocks that an implementation may process one at a time.
        """
        self.acts()
        self.take_incidents()
        frame = self.lower.send(octets, source)
        self.acts()
        session = self.session
        if session.reaction is not None and session.reaction.per_payload:
            busy = round(payloads * session.reaction.per_payload * self.period)
            session.busy_until = max(session.busy_until, self.now()) + busy
        self.stimulated()
        number = self.traffic.frame("sent", self.lower.wall(), source.hex(":"), frame, len(frame) - len(octets))
        self.take_incidents(number)
        return number

    def transmit_frame(self, frame: bytes, start: int) -> int:
        """Send a whole link-layer frame with its bearer payload at offset ``start``; return its number."""
        self.acts()
        self.take_incidents()
        self.lower.send_frame(frame)
        self.acts()
        self.stimulated()
        number = self.traffic.frame("sent", self.lower.wall(), "", frame, start)
        self.take_incidents(number)
        return number

    def learn(self, peer: Peer, *creates: VarCreate) -> None:
        """Teach the implementation variables, and wait for the last repetition of their VarCreates.

        Stops as inconclusive if it does not forward one of them.
        """
        start = self.mark()
        wanted = {create.spec.var_id for create in creates}
        peer.send_all(creates)

        def present(heard: ReceivedBeacon) -> bool:
            return any(each.var_id in wanted for each in heard.instructions(ICType.CREATE_VARIABLES))

        def complete() -> bool:
            seen = Counter(each.var_id for each in self.instructions(ICType.CREATE_VARIABLES, since=start))
            return all(seen[create.spec.var_id] >= create.spec.rep_cnt for create in creates)

        self.until_quiet(present, since=start, complete=complete)
        if missing := wanted - {each.var_id for each in self.instructions(ICType.CREATE_VARIABLES, since=start)}:
            self.not_learnt(missing)

    def sending(self, count: int) -> float:
        """Return the maximum number of beacon periods in which the implementation sends ``count`` VarCreates of usual
        length.

        As :attr:`reaction`, and longer if they do not fit into one payload.
        """
        header = self.builder.container_header_size
        room = self.parameter("VARDISPAR_MAX_PAYLOAD_SIZE") - header
        each = max(1, room // self.builder.record_size(self.sample()))
        return self.reaction + math.ceil(count / each) - 1

    def probe(self, periods: float | None = None) -> bool:
        """Send a stimulus that VarDis must answer, and return whether it does.

        The stimulus is a summary of an unknown variable, unless the implementation did not answer summaries at the
        start of the run: then it is a kind that it answered.
        """
        return self.ask(self.session.contact.question if self.session.contact is not None else "summary", periods)

    def ask(self, kind: Question, periods: float | None = None) -> bool:
        """Send a stimulus of this kind to VarDis, and return whether the answer comes in time.

        ``summary`` of an unknown variable: a request for it (VD-PS-01). ``create`` of a variable: it is forwarded
        (VD-PC-09); a request for an older one is not an answer. ``request``: the VarCreate of a variable that the
        tester has created, or a request for an unknown one (VD-RC-01, VD-RC-03).
        """
        peer = self.peer()
        if kind == "summary":
            var_id = self.unknown_id()
            peer.send(peer.summary(var_id, 1))
            return self.until_instruction(ICType.REQUEST_VARCREATES, var_id, periods) is not None
        if kind == "create":
            peer.send(peer.create(self.var_id()))
            return self.until(self._passed_on, periods) is not None
        wanted = [*sorted(self.created)[:1], *(self.unknown_ids(1) if self.has_unknown_ids() else ())]
        peer.send(*map(peer.request_create, wanted))

        def answered(heard: ReceivedBeacon) -> bool:
            return self._passed_on(heard) or any(heard.about(ICType.REQUEST_VARCREATES, each) for each in wanted)

        return bool(wanted) and self.until(answered, periods) is not None

    def _passed_on(self, heard: ReceivedBeacon) -> bool:
        """Return whether a beacon has a VarCreate of one of the case's peers."""
        ours = [peer.node_id for peer in self.peers_made]
        return any(each.record.spec.prod_id in ours for each in heard.instructions(ICType.CREATE_VARIABLES))

    def require_alive(self, after: str, *requirements: str) -> None:
        """Fail and stop the case unless VarDis still answers."""
        alive = self.probe() or self.probe()
        self.require(alive, f"VarDis still answers after {after}", "no answer to two probes", *requirements)

    # -- services ------------------------------------------------------------------------------------------------------

    @property
    def ut(self) -> UpperTester:
        """The upper tester. The needs of cases that use it name its methods."""
        if self.session.upper is None:
            raise UpperTesterError("this case needs an upper tester, but none is configured")
        return self.session.upper

    def call(self, method: str, /, **params: Any) -> Answer:
        """Call a service of the implementation; the answer may be an error."""
        return self.call_on(self.ut, method, **params)

    def call_on(self, upper: UpperTester, method: str, /, **params: Any) -> Answer:
        """As :meth:`call`, on another connection."""
        self.acts()
        self.traffic.note("call", self.lower.wall(), method, params, upper.name)
        self.changes.asked(method, params)
        self.session.passive.called(method, params, self.case.id)
        if isinstance(self.lower, Impairs):
            # A call does not overtake what was sent before it.
            self.lower.settle()
        begun = self.now()
        try:
            answer = upper.call(method, params)
        except UpperTesterError:
            self._carried_out(method, params)
            raise
        self.changes.answered(method, params, answer)
        if answer.ok and method == "UT-Reset":
            self.session.forget()
        elif answer.ok:
            self._carried_out(method, params)
        # Beacons received during the call are not the tester's delay.
        self.lower.take_in()
        self._acted = self.now()
        if answer.ok:
            self.session.call_times.append(self._acted - begun)
        self.stimulated()
        data = answer.result if answer.code is None else {"code": answer.code, "message": answer.message}
        self.traffic.note("answer", self.lower.wall(), f"{method}: {answer}", data, upper.name)
        self.take_notifications()
        return answer

    def _carried_out(self, method: str, params: Mapping[str, Any]) -> None:
        """Record the effect of a call that succeeded, or may have."""
        if method == "RTDB-Create" and isinstance(params.get("varId"), int):
            self.produced.add(params["varId"])
            self.session.identifiers.offered(params["varId"], by_peer=False)

    def restart(self) -> None:
        """Restart the implementation and wait until it answers; for cases whose needs say ``restart``."""
        if self.session.restart is None:
            self.inconclusive("a restart of the implementation", "no command to restart it")
        self.traffic.note("note", self.lower.wall(), "restart of the implementation")
        self.session.restart()
        self.changes.forget()
        self.session.forget()
        self._acted = None
        if self.pics.vardis is False:
            # Without VarDis no beacon is answered.
            self.wait(self.reaction)
            return
        for _ in range(5):
            if self.probe(self.reaction):
                return
            self.take_newcomer()
        self.inconclusive("an answer of the implementation after its restart", "no answer to five probes")

    def expect_status(self, status: str, method: str, /, *requirements: str, **params: Any) -> Answer:
        """Call a service that must answer with this status; a check that does not stop the case."""
        answer = self.call(method, **params)
        self.check_status(answer, (status,), method, *requirements)
        return answer

    def check_status(self, answer: Answer, statuses: Collection[str], method: str, /, *requirements: str) -> bool:
        """Check that the answer to a service has one of these statuses; an unknown status fails.

        Stops as inconclusive if the upper tester could not ask the implementation.
        """
        expected = f"{method} answers {' or '.join(statuses)}"
        self.require_asked(answer, expected, *requirements)
        matches = any(map(answer.is_status, statuses))
        return self.check(matches, expected, f"{answer}", *requirements, shown=True)

    def require_asked(self, answer: Answer, expected: str, /, *requirements: str) -> None:
        """Stop as inconclusive unless the answer is that of the implementation."""
        if not answer.asked:
            self.inconclusive(expected, f"the upper tester could not ask: {answer}", *requirements)

    def must(self, method: str, /, **params: Any) -> Answer:
        """Call a service that the case needs but does not test; inconclusive if it does not succeed."""
        answer = self.call(method, **params)
        expected = f"{method} succeeds, which this case needs"
        self.require_asked(answer, expected)
        if not answer.ok:
            self.inconclusive(expected, str(answer))
        return answer

    @contextmanager
    def deactivated(self, entity: str) -> Iterator[None]:
        """Deactivate ``BP`` or ``VD`` within the block; inconclusive if one of the calls does not succeed.

        The entity is activated again however the block ends.
        """
        self.must(f"{entity}-MGMT-Deactivate")
        try:
            yield
        except BaseException:
            with suppress(ConformanceError):
                self.call(f"{entity}-MGMT-Activate")
            raise
        self.must(f"{entity}-MGMT-Activate")

    @contextmanager
    def link_down(self) -> Iterator[None]:
        """Take the implementation's link down within the block, for cases whose needs say ``link``.

        Stops as inconclusive if the tester cannot do that. The link is up again however the block ends.
        """
        self._switch_link(False)
        try:
            yield
        finally:
            self._switch_link(True)

    def _switch_link(self, up: bool) -> None:
        how = "up" if up else "down"
        self.traffic.note("note", self.lower.wall(), f"the implementation's link is taken {how}")
        try:
            if self.session.switch_link is None:
                raise ConformanceError("no commands for it (pixit.link_down, pixit.link_up)")
            self.session.switch_link(up)
        except ConformanceError as error:
            self.inconclusive(f"the implementation's link is taken {how}", str(error))
        self.session.passive.interrupted(self.now())

    def restore(self) -> None:
        """Undo changes of the case: activity, parameters, registrations, subscriptions.

        Called after each case, however it ended. Does not raise: :attr:`not_restored` describes what could not be
        undone.
        """
        self._restore()
        left = (params.get("protId") for method, params in self.changes.due() if method == "BP-DeregisterProtocol")
        self.session.held_protocols.update(each for each in left if isinstance(each, int))

    @property
    def spoilt(self) -> str:
        """Why a change that can affect later cases is still in force after :meth:`restore`; empty if there is none.

        Remaining registrations and subscriptions do not affect them.
        """
        harmless = ("BP-DeregisterProtocol", "UT-Subscribe")
        lasting = any(method not in harmless for method, _ in self.changes.due())
        return self.not_restored if lasting else ""

    def _restore(self) -> None:
        self.not_restored, failures = "", 0
        # The limits of some parameters depend on others: a value rejected first may be accepted later.
        for _ in range(2):
            for method, params in self.changes.due():
                try:
                    answer = self.call(method, **params)
                except ConformanceError as error:
                    self.not_restored, failures = f"{method}: {error}", failures + 1
                    # Give up on an implementation that does not answer: each call takes the whole time limit.
                    if failures == _GIVEN_UP:
                        return
                else:
                    self.not_restored = "" if answer.ok else f"{method}: {answer}"
            if not self.changes.due():
                self.not_restored = ""
                return

    def _initial_value(self, parameter: str) -> Any:
        if parameter in self.session.parameters:
            return self.session.parameters[parameter]
        try:
            value = self.parameter(parameter)
        except KeyError:
            return None
        # Only the number of summaries may be 0; for others 0 means that the value is unknown.
        return value if value or parameter == "VARDISPAR_MAX_SUMMARIES" else None
