"""Upper testers that speak the contract themselves (conformance/UPPER-TESTER.md): JSON-RPC lines over a channel.

An upper tester is believed only after it has refused a method that does not exist. What it says is checked: answers
must belong to requests and have a status. A status that the specification does not have is for the case to judge.
"""

from __future__ import annotations

import secrets
import time
from collections import deque
from collections.abc import Callable
from typing import Any, Final

import msgspec
from dcp_spec.constants import BP_PROTID_SRP, BP_PROTID_VARDIS

from dcp_codec.common.printable import printable
from dcp_conformance.errors import ContractError, CouldNotAskError, NoListenerError, UpperTesterError

from .base import METHOD_NOT_FOUND, NOT_REACHED, Answer, Notification
from .channels import Channel
from .faults import Faults, Violation, shown
from .jsonrpc import answer_of, notification_of, request_line
from .patience import Patience

#: Notifications that wait to be taken; beyond that the oldest are dropped.
MOST_NOTIFICATIONS = 10_000
#: A notification of the tester's own, in the place of dropped ones: ``{"number": how many}``.
DROPPED = "TESTER-NotificationsDropped"
_DEREGISTER: Final = "BP-DeregisterProtocol"
_OWN: Final = (BP_PROTID_SRP, BP_PROTID_VARDIS)
#: Seconds between two looks whether the implementation has ended, and for an attempt to connect after a failed one.
_LOOK, _AGAIN = 0.1, 0.2
_ENDED: Final = "the implementation has ended"
#: Seconds that taking notifications may last.
_POLL = 0.5
#: Members that the result of UT-Hello must have beside its status.
_HELLO = {"name": str, "version": str, "specVersion": str, "methods": list}


class StreamUpperTester:
    """One connection. A call that fails leaves it usable, if the other side is still there.

    When the other side has ended, the call or :meth:`poll` that notices raises; the next call connects again.
    """

    def __init__(
        self,
        name: str,
        connect: Callable[[float], Channel],
        patience: float | Patience,
        *,
        several: bool = True,
        connecting: float | None = None,
        faults: Faults | None = None,
    ) -> None:
        """``connect`` opens a channel, trying for so many s; ``several``: there can be more than one at a time.

        ``patience``: timeout of an answer in s, or the timeouts that a connection to the same adapter has learnt.
        ``connecting``: s to try the first time, by default the patience. ``faults``: those of the adapter, which all of
        its connections share.

        Raises ``UpperTesterError`` and ``UsageError``.
        """
        # Imported here, because no other module of an upper tester needs the types of all messages.
        from .contract import Contract

        self.name = name
        self.faults = Faults() if faults is None else faults
        self._contract = Contract(self.faults)
        self.about: dict[str, Any] = {}
        self.methods: frozenset[str] = frozenset()
        self._connect = connect
        self._patience = patience if isinstance(patience, Patience) else Patience(patience)
        self.gone: Callable[[], bool] | None = None
        """Tells whether the implementation is known to have ended, so that nothing is waited for; None: unknown."""
        self._unreachable = False
        """Whether the last attempt to connect again failed."""
        self._several = several
        self._channel: Channel | None = None
        self._last_id = 0
        self._given_up: dict[int, str] = {}
        """The methods of requests whose answers are not waited for any more, by their numbers."""
        self._notifications: deque[Notification] = deque()
        self._dropped = 0
        self._closed = False
        self._open(self._patience.seconds if connecting is None else connecting)

    # -- the contract of an upper tester -----------------------------------------------------------------------

    def call(self, method: str, params: dict[str, Any]) -> Answer:
        """Call a method, and wait for its answer as long as the patience lasts."""
        if self._closed:
            raise UpperTesterError(f"{self.name}: it has been closed")
        if self._channel is None:
            # Calls that wait while nothing listens fail together.
            self.reconnect(_AGAIN if self._unreachable else None)
        if self.faults.forgets_protocols and method == _DEREGISTER and params.get("protId") in _OWN:
            raise CouldNotAskError(f"{self.name}: {self.faults.forgets_protocols}")
        if why := self._patience.refused(method):
            raise CouldNotAskError(f"{self.name}: {why}")
        return self._call(method, params)

    def poll(self) -> list[Notification]:
        """The notifications that have come, in order; in front the number of those that were dropped, if any were."""
        if self._channel is not None:
            # Not for ever, even if it talks without end.
            deadline = time.monotonic() + _POLL
            while (message := self._message(self._channel, 0)) is not None:
                self._stray(message)
                if self._channel is None or time.monotonic() > deadline:
                    break
        taken = list(self._notifications)
        self._notifications.clear()
        if self._dropped:
            taken.insert(0, Notification(DROPPED, {"number": self._dropped}, taken[0].time if taken else 0))
            self._dropped = 0
        return taken

    def filenos(self) -> tuple[int, ...]:
        """The descriptors of the channel while it is open."""
        return self._channel.filenos() if self._channel is not None else ()

    def another(self) -> StreamUpperTester | None:
        """A second connection; None for standard streams."""
        if not self._several:
            return None
        other = StreamUpperTester(self.name, self._connect, self._patience, faults=self.faults)
        other.gone = self.gone
        return other

    def close(self) -> None:
        """End the connection."""
        self._closed = True
        self._drop()

    # -- connecting --------------------------------------------------------------------------------------------

    def reconnect(self, seconds: float | None = None) -> None:
        """Open the channel, also after a restart of the implementation, and identify the peer.

        ``seconds``: time to try, by default the patience. Raises ``UpperTesterError`` and ``UsageError``.
        """
        self._unreachable = True
        self._patience.renew()
        self._open(self._patience.seconds if seconds is None else seconds)
        self._unreachable = False

    def _opened(self, seconds: float) -> Channel:
        """Open a channel, trying for so many seconds at the most, while the implementation runs."""
        if self.gone is None:
            return self._connect(seconds)
        deadline = time.monotonic() + seconds
        while True:
            if self.gone():
                raise UpperTesterError(f"{self.name}: {_ENDED}")
            left = deadline - time.monotonic()
            try:
                return self._connect(max(0.0, min(_AGAIN, left)))
            except UpperTesterError:
                if left <= 0:
                    raise

    def _open(self, connecting: float) -> None:
        self._drop()
        deadline = time.monotonic() + connecting
        self._channel = self._opened(connecting)
        try:
            while True:
                try:
                    self._ask_nonsense()
                    self._greet()
                    return
                except NoListenerError:
                    # An adapter that is there before the implementation.
                    if time.monotonic() >= deadline or (self.gone is not None and self.gone()):
                        raise
                    time.sleep(_AGAIN)
        except UpperTesterError:
            self._drop()
            raise

    def _ask_nonsense(self) -> None:
        """Check that an unknown method is refused: a peer that answers OK to any method proves nothing."""
        method = f"UT-NoSuchMethod-{secrets.token_hex(4)}"
        answer = self._call(method, {})
        self._require_reached(answer)
        if answer.code != METHOD_NOT_FOUND:
            raise UpperTesterError(
                f"{self.name}: the method {method}, which does not exist, is answered with {answer} instead of error "
                f"{METHOD_NOT_FOUND}; nothing that it says can be believed. See conformance/UPPER-TESTER.md, Errors"
            )

    def _greet(self) -> None:
        answer = self._call("UT-Hello", {})
        self._require_reached(answer)
        if not answer.ok:
            raise UpperTesterError(f"{self.name}: UT-Hello is answered with {answer}; it must always succeed")
        for member, kind in _HELLO.items():
            if not isinstance(answer.result.get(member), kind):
                what = "text" if kind is str else "a list of names"
                raise UpperTesterError(f"{self.name}: the answer to UT-Hello has no {member}, which must be {what}")
        methods = answer.result["methods"]
        if not all(isinstance(each, str) for each in methods):
            raise UpperTesterError(f"{self.name}: the answer to UT-Hello lists a method that is not text")
        self.about = answer.result
        self.methods = frozenset(methods) - self.faults.unused

    def _require_reached(self, answer: Answer) -> None:
        if answer.code == NOT_REACHED or answer.unreachable:
            raise NoListenerError(f"{self.name}: the adapter cannot reach the implementation: {answer}")

    def _drop(self) -> None:
        old, self._channel = self._channel, None
        self._given_up.clear()
        if old is not None:
            old.close()

    # -- messages ----------------------------------------------------------------------------------------------

    def _call(self, method: str, params: dict[str, Any]) -> Answer:
        channel = self._channel
        assert channel is not None
        self._last_id += 1
        begun, patience = time.monotonic(), self._patience.of(method)
        deadline = begun + patience
        try:
            channel.send(request_line(self._last_id, method, params), deadline)
        except UpperTesterError:
            self._drop()
            raise
        while True:
            # Notifications without end do not extend the timeout.
            message = self._message(channel, deadline) if time.monotonic() < deadline else None
            if message is None:
                self._given_up[self._last_id] = method
                raise self._patience.unanswered(method, f"{self.name}: {method}", patience)
            if message.get("id") != self._last_id or "method" in message:
                self._stray(message)
                if self._notifications and "method" in message:
                    self._contract.early(method, params, self._notifications[-1])
                continue
            self._patience.answered(method, begun)
            try:
                answer = answer_of(message)
                if method.startswith("UT-") and answer.code is None and not answer.known:
                    # Methods of the contract itself, which an adapter answers.
                    raise UpperTesterError(f"answers with the status {answer.status!r}; UT-STATUS-OK is the only one")
            except UpperTesterError as error:
                # Not a lost connection: the next answer may be right.
                self.faults.add(Violation(method, str(error), "Values"))
                raise ContractError(f"{self.name}: {method}: {error}") from None
            try:
                return self._contract.answer(method, params, message, answer)
            except ContractError as error:
                raise ContractError(f"{self.name}: {error}") from None

    def _message(self, channel: Channel, deadline: float) -> dict[str, Any] | None:
        """The next message; None at the deadline. Raises ``UpperTesterError`` for what is none."""
        try:
            line = channel.line(min(deadline, time.monotonic() + _LOOK))
            while line is None and time.monotonic() < deadline:
                if self.gone is not None and self.gone():
                    raise UpperTesterError(f"{self.name}: {_ENDED}")
                line = channel.line(min(deadline, time.monotonic() + _LOOK))
        except UpperTesterError:
            # Ended, or out of step for good.
            self._drop()
            raise
        if line is None:
            return None
        try:
            message = msgspec.json.decode(line)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            text = printable(line[:200].decode(errors="replace"))
            raise UpperTesterError(
                f"{self.name}: sends a line that is not JSON ({error}): {text}; only messages may stand on its output"
            ) from None
        if not isinstance(message, dict):
            raise UpperTesterError(f"{self.name}: sends JSON that is not a message: {shown(message)}")
        return message

    def _stray(self, message: dict[str, Any]) -> None:
        """Process a message other than the expected answer: a notification, or a late answer to an abandoned request.

        Raises ``UpperTesterError`` for any other message.
        """
        if "method" not in message:
            number = message.get("id")
            if isinstance(number, int) and number in self._given_up:
                self._patience.late(self._given_up.pop(number))
                return
            raise UpperTesterError(
                f"{self.name}: answers with the id {shown(number)}, which no request that waits has: {shown(message)}"
            )
        if message.get("id") is not None:
            raise UpperTesterError(
                f"{self.name}: sends a request instead of answering one: {shown(message)}; is it an echo, as of a "
                "terminal (ssh -t)?"
            )
        now = time.monotonic_ns()
        try:
            notification = notification_of(message, now)
        except UpperTesterError as error:
            raise UpperTesterError(f"{self.name}: {error}") from None
        checked = self._contract.notification(notification.method, notification.params, message)
        notification = msgspec.structs.replace(checked, time=now)
        if len(self._notifications) >= MOST_NOTIFICATIONS:
            self._notifications.popleft()
            self._dropped += 1
        self._notifications.append(notification)
