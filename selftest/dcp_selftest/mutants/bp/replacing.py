"""Faults of BP with payloads that are replaced, displaced or alike, and after rejected parameters."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from dcp_spec.constants import QueueingMode, SpecVersion
from dcp_spec.parameters import Violation
from dcp_spec.status import BPStatus

from dcp_selftest.mutants.mutant import mutant
from dcp_selftest.mutants.unseen import NO_MODE
from dcp_stack.bp.clients import Chosen, ClientList
from dcp_stack.bp.entity import BeaconingProtocol
from dcp_stack.bp.parameters import PERIOD
from dcp_stack.bp.queue import Client
from dcp_stack.config import MS
from dcp_stack.effects import PayloadTransmitted


def _is(client: Client | None, mode: QueueingMode) -> bool:
    return client is not None and client.queue is not None and client.registration.queue_mode is mode


@mutant("old-tail", "BP-TXP-06 BP-QM-05 BP-FMT-01", "keeps the length of a longer payload in a buffer of mode REPEAT")
class OldTail(BeaconingProtocol):
    def _submit(self, client: Client | None, payload: bytes, now: int) -> BPStatus:
        former = (
            client.queue.head() if client is not None and client.queue and _is(client, QueueingMode.REPEAT) else b""
        )
        return super()._submit(client, payload + (former or b"")[len(payload) :], now)


@mutant("displaced-told", "BP-PTI-01", "indicates a payload that was displaced as transmitted", unseen=NO_MODE)
class DisplacedTold(BeaconingProtocol):
    def _submit(self, client: Client | None, payload: bytes, now: int) -> BPStatus:
        before = len(client.queue) if client is not None and client.queue is not None else 0
        status = super()._submit(client, payload, now)
        drops = client is not None and _is(client, QueueingMode.QUEUE_DROPHEAD) and status is BPStatus.OK
        if drops and client is not None and before >= client.registration.max_entries:
            self._emit(PayloadTransmitted(client.protocol_id, self._schedule.due))
        return status


@mutant(
    "rejected-default",
    "BP-PAR-06 BP-PAR-03",
    "uses the default period after it has rejected one",
    since=SpecVersion.V1_1,
)
class RejectedDefault(BeaconingProtocol):
    def set_parameter(self, name: str, value: object) -> Violation | None:
        violation = super().set_parameter(name, value)
        if violation is not None and name == PERIOD:
            self._schedule.set_period(100 * MS)
        return violation


@mutant("passes-head", "BP-TX-06 BP-QM-03", "fills a beacon with payloads behind one that does not fit", unseen=NO_MODE)
class PassesHead(ClientList):
    def take(self, room: int, size: Callable[[bytes], int], most: int) -> Chosen:
        chosen = super().take(room, size, most)
        room -= sum(size(payload) for _, payload in chosen)
        for client in self._order:
            waiting = client.queue._payloads if client.several and client.queue is not None else deque[bytes]()
            for payload in list(waiting):
                if size(payload) <= room and len(chosen) < most:
                    room -= size(payload)
                    waiting.remove(payload)
                    chosen.append((client.protocol_id, payload))
        return chosen


@mutant("equal-dropped", "BP-QM-04 BP-TXP-06", "does not send a payload of mode ONCE that equals the one before")
class EqualDropped(BeaconingProtocol):
    def _submit(self, client: Client | None, payload: bytes, now: int) -> BPStatus:
        last: dict[int, bytes] = self.__dict__.setdefault("last", {})
        if client is not None and _is(client, QueueingMode.ONCE):
            if last.get(client.protocol_id) == payload:
                return BPStatus.OK
            last[client.protocol_id] = payload
        return super()._submit(client, payload, now)
