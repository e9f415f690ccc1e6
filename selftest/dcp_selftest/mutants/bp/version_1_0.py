"""Faults of BP against rules that exist in earlier versions only."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from dcp_spec.parameters import Violation
from dcp_spec.status import BPStatus

from dcp_selftest.mutants.bp.management import TOO_LARGE, Unbound
from dcp_selftest.mutants.family import after, around, attributes, before
from dcp_selftest.mutants.mutant import mutant
from dcp_stack.bp.clients import Chosen, ClientList
from dcp_stack.bp.entity import BeaconingProtocol
from dcp_stack.bp.parameters import MAX_PACKET, BPParameters
from dcp_stack.bp.queue import Client
from dcp_stack.bp.services import ListConfirm, RegisterConfirm

after(BeaconingProtocol, BeaconingProtocol._submit)("queue-ok", "BP-TXP-12",
    "confirms an empty payload for a queue with OK",
    lambda self, status, client, payload, now: BPStatus.OK if status is BPStatus.EMPTY_PAYLOAD else status)  # fmt: skip
before(BeaconingProtocol, BeaconingProtocol._submit)("queue-cleared", "BP-TXP-12",
    "clears a queue when an empty payload is submitted",
    lambda self, client, payload, now: (
        client.queue.clear() if client is not None and client.queue is not None and not payload else None))  # fmt: skip
around(BeaconingProtocol, BeaconingProtocol._submit)("kept", "BP-TXP-13",
    "confirms an empty payload with OK, but keeps the buffered one",
    lambda self, proceed, client, payload, now: (
        BPStatus.OK if client is not None and not payload else proceed(client, payload, now)))  # fmt: skip


@mutant("several", "BP-QM-10", "sends all payloads of a queue that fit in one beacon")
class WholeQueue(ClientList):
    def insert(self, client: Client) -> None:
        client.several = client.queue is not None and client.queue.rule.when_sent == "remove"
        super().insert(client)

    def take(self, room: int, size: Callable[[bytes], int], most: int) -> Chosen:
        return super().take(room, size, most)


around(BeaconingProtocol, BeaconingProtocol.register)("whole-header", "BP-REG-11",
    "counts the whole header in the limit for registrations, as later versions do",
    lambda self, proceed, prot_id, *rest, now, wall: (
        RegisterConfirm(BPStatus.ILLEGAL_MAX_PAYLOAD_SIZE, None)
        if rest[1] > (self._parameters.max_packet_size - self._wire.block_header_size - self._wire.header_size)
        and prot_id > 2 else proceed(prot_id, *rest, now=now, wall=wall)))  # fmt: skip


@mutant("as-once", "BP-REG-12", "registers every client with mode ONCE")
class AllOnce(BeaconingProtocol):
    def register(self, prot_id: int, *rest: Any, now: int, wall: int) -> RegisterConfirm:
        changed: list[Any] = [*rest]
        if prot_id > 2:
            changed[2] = "BP_QMODE_ONCE"
        return super().register(prot_id, *changed, now=now, wall=wall)


after(BeaconingProtocol, BeaconingProtocol.list_registered)("one-missing", "BP-LST-03",
    "omits the client that registered last from the list",
    lambda self, confirm: ListConfirm(confirm.status, confirm.protocols[:-1]))  # fmt: skip


@mutant("size-ignored", "BP-PAR-11", "uses the initial maximum packet size in the limit for registrations")
class FirstSizeBounds(BeaconingProtocol):
    def register(self, prot_id: int, *rest: Any, now: int, wall: int) -> RegisterConfirm:
        size = self._parameters._values[MAX_PACKET]
        first = self.__dict__.setdefault("first_size", size)
        self._parameters._values[MAX_PACKET] = first
        try:
            return super().register(prot_id, *rest, now=now, wall=wall)
        finally:
            self._parameters._values[MAX_PACKET] = size


@mutant("ignored", "BP-PAR-12 BP-PAR-02", "confirms new parameter values, but keeps using the old ones")
class NothingSet(BPParameters):
    def set(self, name: str, value: object) -> Violation | None:
        old = dict(self._values)
        violation = super().set(name, value)
        self._values = old
        return violation


attributes(Unbound, __name__)("no-upper-bound", "BP-PAR-13", "accepts a maximum packet size larger than the bearer's",
    wrong=TOO_LARGE)  # fmt: skip
