"""Faults of BP in state that must not change, and in lists, confirms and indications."""

from __future__ import annotations

from typing import Any

import msgspec
from dcp_spec.constants import BP_PROTID_SRP, QueueingMode, SpecVersion
from dcp_spec.status import BPStatus

from dcp_selftest.mutants.bp.receive import Blocks
from dcp_selftest.mutants.family import after, around, before, instead, skips, then
from dcp_selftest.mutants.mutant import mutant
from dcp_selftest.mutants.unseen import BP_ALWAYS_ACTIVE
from dcp_stack.bp.clients import ClientList
from dcp_stack.bp.entity import BeaconingProtocol
from dcp_stack.bp.queue import Client
from dcp_stack.bp.receive import Receiver
from dcp_stack.bp.services import ListConfirm, RegisterConfirm, Registration, StatusConfirm
from dcp_stack.bp.wire import Block


def _others(clients: ClientList) -> list[Client]:
    """Return the clients other than the node's own protocols."""
    return [client for client in clients if client.protocol_id > 2]


def _empty(clients: ClientList) -> None:
    for client in _others(clients):
        if client.queue is not None:
            client.queue.clear()


# fmt: off
before(BeaconingProtocol, BeaconingProtocol.deregister)("others-too", "BP-DRG-02 BP-QM-05",
    "clears all buffers when a client is deregistered",
    lambda self, prot_id: _empty(self._clients))
then(BeaconingProtocol, BeaconingProtocol.deregister)("unknown-empties", "BP-DRG-01 BP-QM-05",
    "clears all buffers when an unknown client is deregistered",
    lambda self, confirm, prot_id: _empty(self._clients) if confirm.status is not BPStatus.OK else None)
before(BeaconingProtocol, BeaconingProtocol.clear_buffer)("all", "BP-CLR-03 BP-QM-05",
    "clears the buffers of all clients",
    lambda self, prot_id: _empty(self._clients))
then(BeaconingProtocol, BeaconingProtocol._submit)("refused-empties", "BP-TXP-02 BP-QM-05",
    "clears the buffer of a client whose payload is too large",
    lambda self, status, client, payload, now: (
        client.queue.clear()
        if status is BPStatus.PAYLOAD_TOO_LARGE and client is not None and client.queue is not None else None))
# fmt: on


@mutant("received-empties", "BP-QM-05", "clears the buffer of a client that receives a payload")
class ReceivedEmpties(Receiver):
    def _deliver(self, block: Block, sender: bytes) -> None:
        client = self._clients.get(block.protocol_id)
        if client is not None and client.queue is not None and block.protocol_id > 2:
            client.queue.clear()
        super()._deliver(block, sender)


class Lists(BeaconingProtocol):
    """Changes the list of clients."""

    def listed(self, each: Registration) -> Registration:
        """Return the entry to be listed."""
        return each

    def list_registered(self) -> ListConfirm:
        confirm = super().list_registered()
        return ListConfirm(confirm.status, tuple(map(self.listed, confirm.protocols)))


# fmt: off
listed = instead(Lists, Lists.listed)
listed("entries", "BP-LST-01", "lists maxEntries as 4 for every client",
    lambda self, each: msgspec.structs.replace(each, max_entries=4), since=SpecVersion.V1_1)
listed("several", "BP-LST-01", "lists allowMultiplePayloads as false for every client",
    lambda self, each: msgspec.structs.replace(each, allow_multiple_payloads=False), since=SpecVersion.V1_1)
listed("names", "BP-LST-01", "lists only the first three characters of a name",
    lambda self, each: msgspec.structs.replace(each, protocol_name=each.protocol_name[:3]), since=SpecVersion.V1_1)
# fmt: on


@mutant("one-time", "BP-LST-01 BP-REG-06", "lists the time of the first registration for every client")
class OneTime(Lists):
    def list_registered(self) -> ListConfirm:
        confirm = super().list_registered()
        first = min((each.time_stamp_registration for each in confirm.protocols), default=0)
        same = (msgspec.structs.replace(each, time_stamp_registration=first) for each in confirm.protocols)
        return ListConfirm(confirm.status, tuple(same))


after(BeaconingProtocol, BeaconingProtocol.register)("refused-without-id", "BP-REG-13",
    "returns its node identifier only in the confirms of successful registrations",
    lambda self, confirm, prot_id, *rest, now, wall: (
        confirm if confirm.status is BPStatus.OK else RegisterConfirm(confirm.status, None)))  # fmt: skip


@mutant("one-place", "BP-QM-01", "keeps no payload in a DROPTAIL queue of one entry", since=SpecVersion.V1_1)
class NothingInOnePlace(BeaconingProtocol):
    def _submit(self, client: Client | None, payload: bytes, now: int) -> BPStatus:
        if (
            client is not None
            and client.registration.max_entries == 1
            and client.protocol_id > 2
            and client.several is False
        ):
            mode = str(client.registration.queue_mode)
            if mode.endswith("DROPTAIL") and client.queue is not None and len(client.queue):
                client.queue.clear()
        return super()._submit(client, payload, now)


@mutant(
    "arrears",
    "BP-TX-01 BP-MGT-05",
    "sends the beacons omitted while it was inactive when it is activated",
    unseen=BP_ALWAYS_ACTIVE,
)
class Arrears(BeaconingProtocol):
    debt = 0

    def deactivate(self) -> StatusConfirm:
        self.debt = 30
        return super().deactivate()

    def poll_timeout(self) -> int | None:
        due = super().poll_timeout()
        return due if due is None or not self.debt else due - self._parameters.period * 3 // 4

    def handle_timeout(self, now: int, wall: int) -> None:
        due = self.poll_timeout()
        if self.debt and due is not None and now >= due:
            self.debt -= 1
            super().handle_timeout(max(now, self._schedule.due), wall)
            self._schedule.restart(now - self._parameters.period // 8)
            return
        super().handle_timeout(now, wall)


instead(Blocks, Blocks.chosen)("thirty", "BP-RX-07", "processes at most 30 blocks of a beacon",
    lambda self, blocks: blocks[:30])  # fmt: skip
skips(Receiver, Receiver._deliver)("limited-1000", "BP-RXP-01 UWB-06", "delivers no payload of more than 900 octets",
    lambda self, block, sender: len(block.payload) > 900)  # fmt: skip
before(BeaconingProtocol, BeaconingProtocol.deactivate)("once-outdated", "BP-MGT-04 BP-QM-04",
    "clears the buffers of mode ONCE when it is deactivated",
    lambda self: [
        client.queue.clear() for client in _others(self._clients)
        if client.queue is not None and client.registration.queue_mode is QueueingMode.ONCE])  # fmt: skip
before(BeaconingProtocol, BeaconingProtocol.activate)("paused-empties", "BP-MGT-05 BP-QM-03",
    "clears queues when it is activated",
    lambda self, now: _empty(self._clients))  # fmt: skip


@mutant("deaf", "BP-MGT-04 BP-REG-06", "delivers nothing to clients that were registered while it was inactive")
class Deaf(BeaconingProtocol):
    def register(self, prot_id: int, *args: Any, now: int, wall: int) -> RegisterConfirm:
        confirm = super().register(prot_id, *args, now=now, wall=wall)
        deaf: set[int] = self.__dict__.setdefault("deaf", set())
        if confirm.status is BPStatus.OK:
            (deaf.discard if self._active else deaf.add)(prot_id)
        deliver = self._receiver._deliver
        if not self._active:
            self._receiver._deliver = (  # type: ignore[method-assign]
                lambda block, sender: None if block.protocol_id in deaf else deliver(block, sender))  # fmt: skip
        return confirm


@mutant("given-up", "BP-HDR-09 BP-HDR-08", "uses a sequence number for a beacon into which no waiting payload fits")
class GivenUp(BeaconingProtocol):
    def handle_timeout(self, now: int, wall: int) -> None:
        due, before = self._active and now >= self._schedule.due, self._seqno
        waiting = any(len(client.queue or ()) for client in self._clients)
        super().handle_timeout(now, wall)
        if due and waiting and self._seqno == before:
            self._seqno += 1


around(BeaconingProtocol, BeaconingProtocol.register)("size-of-16-bits", "BP-REG-04",
    "checks only the low 16 bits of maxPayloadSize",
    lambda self, register, prot_id, name, size, *rest, now, wall: (
        register(prot_id, name, size & 0xFFFF, *rest, now=now, wall=wall)))  # fmt: skip


@mutant("unknown-empties-all", "BP-CLR-01 SRP-SRV-04", "clears the buffer of SRP for an unknown protocol")
class UnknownEmptiesAll(BeaconingProtocol):
    def clear_buffer(self, prot_id: int) -> StatusConfirm:
        confirm = super().clear_buffer(prot_id)
        if confirm.status is BPStatus.UNKNOWN_PROTOCOL:
            super().clear_buffer(BP_PROTID_SRP)
        return confirm


# fmt: off
then(BeaconingProtocol, BeaconingProtocol._submit)("postponed", "BP-TX-01 BP-QM-04",
    "waits for a whole period again after each payload that is submitted",
    lambda self, status, client, payload, now: (
        self._schedule.restart(now)
        if self._active and status is BPStatus.OK and now < self._schedule.due else None))
# fmt: on
