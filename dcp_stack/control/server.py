"""The control interface without sockets: sessions process octets from clients and produce octets for them.

A confirm is sent to the session of its request. Indications of a protocol are sent to the session that registered it,
and to those that subscribed with UT-Subscribe. A registration outlives its session, as the specification expects of
clients that restart (BP-REC-01); further indications are then sent to subscribers only. UT-Reset cancels all
registrations, but neither sessions nor their subscriptions.
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
"""Maximum number of requests in a batch."""
MAX_BATCH_ANSWER: Final = 16 << 20
"""Octets of the answer to a batch after which the rest of the batch is not carried out."""
HIGH_WATER: Final = 256 << 10
"""Octets of pending output above which no more requests of a client are answered."""
MAX_BACKLOG: Final = 4 << 20
"""Octets of pending output above which a further notification disconnects the client."""


class ControlSession:
    """One client. A transport without limits needs only :meth:`feed`.

    Other transports pass input to :meth:`receive`, call :meth:`process` until it returns False, send from
    :attr:`output` and report the sent octets to :meth:`sent`. They must not read while :attr:`wants_input` is False.
    """

    def __init__(self, server: ControlServer) -> None:
        self._server = server
        self._lines = LineBuffer(MAX_LINE)
        self.output = bytearray()
        self.overrun = False
        """Whether the client does not read its notifications; the transport should then disconnect it."""
        self.subscription = m.Subscribe()
        self._ended = False

    @property
    def wants_input(self) -> bool:
        """Whether to read more input: pending output and waiting requests are below their limits."""
        return not self._ended and len(self.output) <= HIGH_WATER and len(self._lines) <= HIGH_WATER * 8

    @property
    def finished(self) -> bool:
        """Whether the client has ended its input, and all its requests are answered and sent."""
        return self._ended and not self.output and not len(self._lines)

    def feed(self, data: bytes, *, now: int, wall: int) -> bytes:
        """Process octets of the client; return all output for it, including pending notifications."""
        self.receive(data)
        answers = bytearray()
        while True:
            more = self.process(now=now, wall=wall)
            answers += self.output
            self.output.clear()
            if not more:
                return bytes(answers)

    def receive(self, data: bytes) -> None:
        """Add octets from the client."""
        self._lines.add(data)

    def end_of_input(self) -> None:
        """Mark the end of input; a last line without its end is processed as well."""
        self._ended = True
        self._lines.end()

    def process(self, *, now: int, wall: int, most: int = 64) -> bool:
        """Answer up to ``most`` lines; return whether more could be answered at once. Never raises."""
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
        """Remove the first ``count`` octets of ``output``, which the transport has sent."""
        del self.output[:count]

    def notify(self, message: bytes) -> None:
        """Append a notification; a client with too much pending output is marked as overrun instead."""
        if self.overrun:
            return
        if len(self.output) > MAX_BACKLOG:
            self.overrun = True
            return
        self._write(message)
        if len(self.output) > HIGH_WATER:
            self._server.pressing = True

    def close(self) -> None:
        """Remove the session from the server; registrations of the client remain."""
        self._server.forget(self)

    def _write(self, message: bytes) -> None:
        if message:
            self.output += message
            self.output += b"\n"

    def _answer(self, line: bytes, times: Times) -> bytes:
        """Return the answer to a line; empty for notifications."""
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
                answer = error_message(id_of(each), RpcError(TOO_MUCH, "not carried out: the answers are too long"))
            else:
                answer = self._answer_one(each, times)
            size += len(answer)
            if answer:
                answers.append(answer)
        return b"[" + b",".join(answers) + b"]" if answers else b""

    def _answer_one(self, message: Any, times: Times) -> bytes:
        """Return the answer to one request; empty for notifications."""
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
            # An internal error must not end the node; the client gets an error that shows it was not its fault.
            log.exception("%s failed", call.method)
            shown = RpcError(INTERNAL_ERROR, f"{type(error).__name__}: {error}")
            return b"" if call.id is UNSET else error_message(call.id, shown)


class ControlServer:
    """All sessions of one node. The caller drives the node, and passes its effects to :meth:`indicate`."""

    def __init__(self, node: Node, *, runtime: Callable[[], dict[str, Any]] = dict) -> None:
        """``runtime`` returns the member ``runtime`` of UT-Status."""
        self.node = node
        self._dropped: defaultdict[tuple[str, str], int] = defaultdict(int)
        self.pressing = False
        """Whether a client has much pending output. The transport should then send it first, and reset this."""
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
        """Numbers of ignored parts of received frames, by ``layer/reason``."""
        return {f"{layer}/{reason}": number for (layer, reason), number in self._dropped.items()}

    @property
    def listening(self) -> bool:
        """Whether a client waits for indications or notifications."""
        return bool(self._owners) or self._wants_variables or self._wants_neighbours or self._wants_protocols

    def open(self) -> ControlSession:
        """Open a session for a new client."""
        session = ControlSession(self)
        self._sessions[session] = None
        return session

    def forget(self, session: ControlSession) -> None:
        """Remove the session of a client that has gone."""
        self._sessions.pop(session, None)
        self._owners = {prot_id: owner for prot_id, owner in self._owners.items() if owner is not session}
        self._note_wishes()

    def perform(self, session: ControlSession, call: Call, times: Times) -> m.Result:
        """Carry out one request of a client. Raises RpcError for unknown methods, invalid parameters and refusals."""
        method = METHODS.get(call.method)
        if method is None:
            raise RpcError(METHOD_NOT_FOUND, f"no method {call.method[:80]!r}; UT-Hello lists the methods")
        if isinstance(call.params, list):
            raise RpcError(INVALID_PARAMS, "parameters must be given by name, in an object")
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
            # Otherwise the client would report an invalid answer instead of an error of the node.
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
        """Send the effects of the node to the clients that listen for them; count drops.

        ``now`` and ``wall`` are the same time in ns, monotonic and since 1970.
        """
        for effect in effects:
            if type(effect) is Dropped:
                # Checked first because most frequent: any record of a beacon without news is dropped.
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
        """Return the sessions that receive indications of a protocol."""
        owner = self._owners.get(prot_id)
        if not self._wants_protocols:
            return [] if owner is None else [owner]
        return [each for each in self._sessions if each is owner or prot_id in each.subscription.prot_ids]

    def _note_wishes(self) -> None:
        """Store whether any client is subscribed; usually none is, and effects need no further checks."""
        wishes = [session.subscription for session in self._sessions]
        self._wants_variables = any(wish.variables for wish in wishes)
        self._wants_neighbours = any(wish.neighbours for wish in wishes)
        self._wants_protocols = any(wish.prot_ids for wish in wishes)

    def _status(self, times: Times) -> m.StatusConfirm:
        """Return the result of UT-Status."""
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
    """Convert snapshots for JSON, with text for non-finite floats."""
    if isinstance(value, dict):
        return {str(key): _finite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(each) for each in value]
    return plain_number(value)
