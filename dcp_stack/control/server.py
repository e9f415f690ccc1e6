"""The control interface without sockets: sessions take octets of their clients and have octets for them.

Who asks gets the confirm. Indications about a protocol go to the session that registered it, and to those that asked
for them with UT-Subscribe. A registration outlives its session, as the specification expects of clients that restart
(BP-REC-01): what then arrives for it is told to subscribers only. UT-Reset takes back all registrations, and leaves
sessions with their subscriptions alone.
"""

from __future__ import annotations

import logging
from collections import defaultdict
from collections.abc import Callable, Iterable
from typing import Any, Final

import msgspec
from msgspec import UNSET

from dcp_codec.common.lines import LineBuffer, LineTooLongError
from dcp_stack.effects import (
    Dropped,
    Effect,
    NeighbourExpired,
    NeighbourSeen,
    PayloadReceived,
    PayloadTransmitted,
    VariableChanged,
)
from dcp_stack.node import Node

from . import messages as m
from .jsonrpc import (
    INTERNAL_ERROR,
    INVALID_PARAMS,
    INVALID_REQUEST,
    MAX_LINE,
    METHOD_NOT_FOUND,
    TOO_MUCH,
    Call,
    RpcError,
    error_message,
    id_of,
    notification_message,
    parse,
    read_call,
    result_message,
)
from .methods import METHODS
from .services import Times, perform, plain_number

log = logging.getLogger(__name__)

MAX_BATCH: Final = 256
"""Requests in one batch."""
MAX_BATCH_ANSWER: Final = 16 << 20
"""Octets of the answer to one batch, beyond which the rest is not carried out."""
HIGH_WATER: Final = 256 << 10
"""Octets that wait for a client, beyond which its requests are not looked at."""
MAX_BACKLOG: Final = 4 << 20
"""Octets that wait for a client, beyond which a notification is one too many and the client is given up."""


class ControlSession:
    """One client. :meth:`feed` is all a transport needs that has no limits of its own.

    Otherwise: :meth:`receive` what it says, :meth:`process` until it returns False, send from :attr:`output` and say
    how much with :meth:`sent`, and do not read while :attr:`wants_input` is False.
    """

    def __init__(self, server: ControlServer) -> None:
        self._server = server
        self._lines = LineBuffer(MAX_LINE)
        self.output = bytearray()
        self.overrun = False
        """The client does not read what it asked to be told: give it up."""
        self.subscription = m.Subscribe()
        self._ended = False

    @property
    def wants_input(self) -> bool:
        """Whether reading makes sense: earlier answers are on their way, and requests do not pile up."""
        return not self._ended and len(self.output) <= HIGH_WATER and len(self._lines) <= HIGH_WATER * 8

    @property
    def finished(self) -> bool:
        """Whether the client has ended its side and all that it asked for is answered and taken away."""
        return self._ended and not self.output and not len(self._lines)

    def feed(self, data: bytes, *, now: int, wall: int) -> bytes:
        """Take octets and return everything there is for the client, notifications that waited included."""
        self.receive(data)
        answers = bytearray()
        while True:
            more = self.process(now=now, wall=wall)
            answers += self.output
            self.output.clear()
            if not more:
                return bytes(answers)

    def receive(self, data: bytes) -> None:
        """Take octets of the client."""
        self._lines.add(data)

    def end_of_input(self) -> None:
        """The client says nothing more; what it said last is a line also without its end."""
        self._ended = True
        self._lines.end()

    def process(self, *, now: int, wall: int, most: int = 64) -> bool:
        """Answer up to ``most`` lines; whether there may be more to do right now. Never raises."""
        for _ in range(most):
            if len(self.output) > HIGH_WATER:
                return False
            try:
                line = self._lines.next()
            except LineTooLongError as error:
                self._write(error_message(None, RpcError(INVALID_REQUEST, str(error))))
                continue
            if line is None:
                return False
            if not line.isspace() and line:
                self._write(self._answer(line, Times(now, wall)))
        return True

    def sent(self, count: int) -> None:
        """The first ``count`` octets of ``output`` are on their way."""
        del self.output[:count]

    def notify(self, message: bytes) -> None:
        """Append a notification; a client with too much waiting is marked as overrun instead."""
        if self.overrun:
            return
        if len(self.output) > MAX_BACKLOG:
            self.overrun = True
            return
        self._write(message)
        if len(self.output) > HIGH_WATER:
            self._server.pressing = True

    def close(self) -> None:
        """The client is gone; its registrations stay."""
        self._server.forget(self)

    def _write(self, message: bytes) -> None:
        if message:
            self.output += message
            self.output += b"\n"

    def _answer(self, line: bytes, times: Times) -> bytes:
        """The answer to a line, empty if it wants none."""
        try:
            message = parse(line)
            if not isinstance(message, list):
                return self._answer_one(message, times)
            if not message:
                raise RpcError(INVALID_REQUEST, "the batch is empty")
            if len(message) > MAX_BATCH:
                raise RpcError(INVALID_REQUEST, f"the batch has {len(message)} requests, more than {MAX_BATCH}")
        except RpcError as error:
            return error_message(None, error)
        answers: list[bytes] = []
        size = 0
        for each in message:
            if size > MAX_BATCH_ANSWER:
                answer = error_message(id_of(each), RpcError(TOO_MUCH, "not carried out: the batch answers too much"))
            else:
                answer = self._answer_one(each, times)
            size += len(answer)
            if answer:
                answers.append(answer)
        return b"[" + b",".join(answers) + b"]" if answers else b""

    def _answer_one(self, message: Any, times: Times) -> bytes:
        try:
            call = read_call(message)
        except RpcError as error:
            return error_message(id_of(message), error)
        try:
            answer = self._server.perform(self, call, times)
            return b"" if call.id is UNSET else result_message(call.id, answer)
        except RpcError as error:
            return b"" if call.id is UNSET else error_message(call.id, error)
        except Exception as error:
            # A mistake of ours must not take the node down; the client learns that it was none of its own.
            log.exception("%s failed", call.method)
            shown = RpcError(INTERNAL_ERROR, f"{type(error).__name__}: {error}")
            return b"" if call.id is UNSET else error_message(call.id, shown)


class ControlServer:
    """All sessions of one node. The node is driven by somebody else, who hands its effects to :meth:`indicate`."""

    def __init__(self, node: Node, *, runtime: Callable[[], dict[str, Any]] = dict) -> None:
        """``runtime`` tells UT-Status about what is around the node."""
        self.node = node
        self._dropped: defaultdict[tuple[str, str], int] = defaultdict(int)
        self.pressing = False
        """Much waits for a client. The transport should send before it lets more happen, and set this back."""
        self._runtime = runtime
        self._sessions: dict[ControlSession, None] = {}
        self._owners: dict[int, ControlSession] = {}
        self._wants_variables = self._wants_neighbours = self._wants_protocols = False

    @property
    def sessions(self) -> tuple[ControlSession, ...]:
        """The open sessions."""
        return tuple(self._sessions)

    @property
    def drops(self) -> dict[str, int]:
        """How often something received was ignored, by ``layer/reason``."""
        return {f"{layer}/{reason}": number for (layer, reason), number in self._dropped.items()}

    @property
    def listening(self) -> bool:
        """Whether somebody is to be told of what arrives."""
        return bool(self._owners) or self._wants_variables or self._wants_neighbours or self._wants_protocols

    def open(self) -> ControlSession:
        """A client has come."""
        session = ControlSession(self)
        self._sessions[session] = None
        return session

    def forget(self, session: ControlSession) -> None:
        """A client is gone."""
        self._sessions.pop(session, None)
        self._owners = {prot_id: owner for prot_id, owner in self._owners.items() if owner is not session}
        self._note_wishes()

    def perform(self, session: ControlSession, call: Call, times: Times) -> m.Result:
        """Carry out one request of a client. Raises RpcError."""
        method = METHODS.get(call.method)
        if method is None:
            raise RpcError(METHOD_NOT_FOUND, f"no method {call.method[:80]!r}; UT-Hello lists those there are")
        if isinstance(call.params, list):
            raise RpcError(INVALID_PARAMS, "parameters are given by name, in an object")
        try:
            params = msgspec.convert(call.params, method.params)
        except msgspec.ValidationError as error:
            raise RpcError(INVALID_PARAMS, f"{call.method}: {error}") from None
        if isinstance(params, m.Subscribe):
            session.subscription = params
            self._note_wishes()
            return m.UTConfirm(status=m.UT_OK)
        if call.method == "UT-Status":
            return self._status(times)
        result = perform(self.node, call.method, params, times)
        if getattr(result, "status", None) is None:
            # A client would take it for a mistake of the connection, not of the node.
            raise TypeError(f"{call.method} was confirmed without a status")
        if isinstance(params, m.RegisterProtocol) and result.status.is_ok:  # type: ignore[attr-defined]
            self._owners[params.prot_id] = session
        elif call.method == "BP-DeregisterProtocol" and isinstance(params, m.ForProtocol):
            self._owners.pop(params.prot_id, None)
        elif call.method == "UT-Reset":
            self._owners.clear()
            self._dropped.clear()
        self.node.settle(times.now, times.wall)
        return result

    def indicate(self, effects: Iterable[Effect], *, now: int, wall: int) -> None:
        """Tell those whom it concerns what the node did; drops are counted."""
        for effect in effects:
            if type(effect) is Dropped:
                # Most of what there is: each record of a beacon that says nothing new.
                self._dropped[effect.layer, effect.reason] += 1
                continue
            if not self._sessions:
                continue
            match effect:
                case PayloadReceived():
                    self._indicate_reception(effect)
                case PayloadTransmitted():
                    self._indicate_transmission(effect, wall - now)
                case VariableChanged() if self._wants_variables:
                    self._tell_variable(effect)
                case NeighbourSeen() if self._wants_neighbours:
                    seen = m.NeighbourSeenNotification(node_id=effect.node_id.hex(":"), new=effect.new)
                    self._tell_neighbours("UT-NeighbourSeen", seen)
                case NeighbourExpired() if self._wants_neighbours:
                    expired = m.NeighbourExpiredNotification(node_id=effect.node_id.hex(":"))
                    self._tell_neighbours("UT-NeighbourExpired", expired)
                case _:
                    pass

    def _indicate_reception(self, effect: PayloadReceived) -> None:
        listeners = self._listeners(effect.protocol_id)
        if listeners:
            indication = m.ReceivePayloadIndication(
                prot_id=effect.protocol_id,
                length=len(effect.payload),
                payload=effect.payload.hex(),
                sender_id=effect.sender_id.hex(":"),
            )
            _tell(listeners, "BP-ReceivePayload.indication", indication)

    def _indicate_transmission(self, effect: PayloadTransmitted, offset: int) -> None:
        listeners = self._listeners(effect.protocol_id)
        if listeners:
            indication = m.PayloadTransmittedIndication(
                prot_id=effect.protocol_id, next_beacon_generation_epoch=effect.next_epoch + offset
            )
            _tell(listeners, "BP-PayloadTransmitted.indication", indication)

    def _tell_variable(self, effect: VariableChanged) -> None:
        changed = m.VariableChangedNotification(
            event=effect.event,
            var_id=effect.var_id,
            prod_id=effect.prod_id.hex(":"),
            seqno=effect.seqno,
            value=UNSET if effect.event == "deleted" else effect.value.hex(),
        )
        _tell([each for each in self._sessions if each.subscription.variables], "UT-VariableChanged", changed)

    def _tell_neighbours(self, name: str, notification: m.Result) -> None:
        _tell([each for each in self._sessions if each.subscription.neighbours], name, notification)

    def _listeners(self, prot_id: int) -> list[ControlSession]:
        """Who is to hear of a protocol, each once."""
        owner = self._owners.get(prot_id)
        if not self._wants_protocols:
            return [] if owner is None else [owner]
        return [each for each in self._sessions if each is owner or prot_id in each.subscription.prot_ids]

    def _note_wishes(self) -> None:
        """Remember whether anybody wants to be told at all: most of the time nobody does."""
        wishes = [session.subscription for session in self._sessions]
        self._wants_variables = any(wish.variables for wish in wishes)
        self._wants_neighbours = any(wish.neighbours for wish in wishes)
        self._wants_protocols = any(wish.prot_ids for wish in wishes)

    def _status(self, times: Times) -> m.StatusConfirm:
        config = self.node.config
        return m.StatusConfirm(
            status=m.UT_OK,
            node_id=config.node_id.hex(":"),
            profile=config.profile.name,
            spec_version=str(config.profile.spec_version),
            now=times.now,
            wall=times.wall,
            node=_finite(self.node.snapshot()),
            drops=dict(sorted(self.drops.items())),
            obstacles=[
                {**msgspec.to_builtins(each), "text": str(each)}
                for each in (() if self.node.vardis is None else self.node.vardis.obstacles(times.now))
            ],
            runtime={"sessions": len(self._sessions), **self._runtime()},
        )


def _tell(sessions: Iterable[ControlSession], name: str, params: m.Result) -> None:
    message = notification_message(name, params)
    for session in sessions:
        session.notify(message)


def _finite(value: Any) -> Any:
    """Plain data with texts for the floats that JSON has no number for."""
    if isinstance(value, dict):
        return {str(key): _finite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(each) for each in value]
    return plain_number(value)
