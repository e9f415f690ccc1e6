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

from . import jsonrpc
from . import messages as m
from .jsonrpc import ErrorCode, RpcError
from .services import Times, parameters_of, perform, plain_number

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
        self._lines = LineBuffer(jsonrpc.MAX_LINE)
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
                self._write(jsonrpc.error_message(None, RpcError(ErrorCode.INVALID_REQUEST, str(error))))
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
            message = jsonrpc.parse(line)
            if not isinstance(message, list):
                return self._answer_one(message, times)
            if not message:
                raise RpcError(ErrorCode.INVALID_REQUEST, "the batch is empty")
            if len(message) > MAX_BATCH:
                reason = f"the batch has {len(message)} requests, more than {MAX_BATCH}"
                raise RpcError(ErrorCode.INVALID_REQUEST, reason)
        except RpcError as error:
            return jsonrpc.error_message(None, error)
        answers: list[bytes] = []
        size = 0
        too_much = RpcError(ErrorCode.TOO_MUCH, "not carried out: the answers are too long")
        for each in message:
            if size > MAX_BATCH_ANSWER:
                answer = jsonrpc.error_message(jsonrpc.id_of(each), too_much)
            else:
                answer = self._answer_one(each, times)
            size += len(answer)
            if answer:
                answers.append(answer)
        return b"[" + b",".join(answers) + b"]" if answers else b""

    def _answer_one(self, message: Any, times: Times) -> bytes:
        """Return the answer to one request; empty for notifications."""
        try:
            call = jsonrpc.read_call(message)
        except RpcError as error:
            return jsonrpc.error_message(jsonrpc.id_of(message), error)
        try:
            answer = self._server.perform(self, call, times)
            return b"" if call.id is UNSET else jsonrpc.result_message(call.id, answer)
        except RpcError as error:
            return b"" if call.id is UNSET else jsonrpc.error_message(call.id, error)
        except Exception as error:
            # An internal error must not end the node; the client gets an error that shows it was not its fault.
            log.exception("%s failed", call.method)
            shown = RpcError(ErrorCode.INTERNAL_ERROR, f"{type(error).__name__}: {error}")
            return b"" if call.id is UNSET else jsonrpc.error_message(call.id, shown)


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
        return bool(self._owners) or any(each.subscription != m.Subscribe() for each in self._sessions)

    def open(self) -> ControlSession:
        """Open a session for a new client."""
        session = ControlSession(self)
        self._sessions[session] = None
        return session

    def forget(self, session: ControlSession) -> None:
        """Remove the session of a client that has gone."""
        self._sessions.pop(session, None)
        self._owners = {prot_id: owner for prot_id, owner in self._owners.items() if owner is not session}

    def perform(self, session: ControlSession, call: jsonrpc.Call, times: Times) -> m.Result:
        """Carry out one request of a client. Raises RpcError for unknown methods, invalid parameters and refusals."""
        params = parameters_of(call.method, call.params)
        if isinstance(params, m.Subscribe):
            session.subscription = params
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
            elif self._sessions and (listeners := self._listeners(effect)):
                message = jsonrpc.notification_message(*_notification(effect, wall - now))
                for session in listeners:
                    session.notify(message)

    def _listeners(self, effect: Effect) -> list[ControlSession]:
        """Return the sessions that are notified of an effect."""
        match effect:
            case PayloadReceived() | PayloadTransmitted():
                prot_id, owner = effect.protocol_id, self._owners.get(effect.protocol_id)
                return [each for each in self._sessions if each is owner or prot_id in each.subscription.prot_ids]
            case VariableChanged():
                return [each for each in self._sessions if each.subscription.variables]
            case NeighbourSeen() | NeighbourExpired():
                return [each for each in self._sessions if each.subscription.neighbours]
        return []

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


def _notification(effect: Effect, offset: int) -> tuple[str, m.Result]:
    """Return name and parameters of the notification of an effect; ``offset``: wall time minus monotonic time in ns."""
    match effect:
        case PayloadReceived(prot_id, payload, sender_id):
            return "BP-ReceivePayload.indication", m.ReceivePayloadIndication(
                prot_id=prot_id, length=len(payload), payload=payload.hex(), sender_id=sender_id.hex(":")
            )
        case PayloadTransmitted(prot_id, next_epoch):
            return "BP-PayloadTransmitted.indication", m.PayloadTransmittedIndication(
                prot_id=prot_id, next_beacon_generation_epoch=next_epoch + offset
            )
        case VariableChanged(event, var_id, seqno, value, prod_id):
            return "UT-VariableChanged", m.VariableChangedNotification(
                event=event,
                var_id=var_id,
                prod_id=prod_id.hex(":"),
                seqno=seqno,
                value=UNSET if event == "deleted" else value.hex(),
            )
        case NeighbourSeen(node_id, new):
            return "UT-NeighbourSeen", m.NeighbourSeenNotification(node_id=node_id.hex(":"), new=new)
        case NeighbourExpired(node_id):
            return "UT-NeighbourExpired", m.NeighbourExpiredNotification(node_id=node_id.hex(":"))
    raise TypeError(f"clients are not notified of {effect}")


def _finite(value: Any) -> Any:
    """Convert snapshots for JSON, with text for non-finite floats."""
    if isinstance(value, dict):
        return {str(key): _finite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(each) for each in value]
    return plain_number(value)
