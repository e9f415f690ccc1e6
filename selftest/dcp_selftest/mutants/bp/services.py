"""Faults in the services of BP: registration, payloads and indications."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import msgspec
from dcp_spec.constants import SpecVersion
from dcp_spec.status import BPStatus

from dcp_selftest.mutants.bp.kept import Lists
from dcp_selftest.mutants.family import after, around, assign, attributes, instead, then
from dcp_selftest.mutants.mutant import mutant
from dcp_selftest.mutants.unseen import RIGHT_SINCE_1_1
from dcp_stack.bp.clients import ClientList
from dcp_stack.bp.entity import BeaconingProtocol
from dcp_stack.bp.queue import QUEUEING, Client
from dcp_stack.bp.receive import Receiver
from dcp_stack.bp.services import ListConfirm, NumberConfirm, RegisterConfirm, Registration, StatusConfirm
from dcp_stack.bp.wire import Block
from dcp_stack.config import NodeConfig
from dcp_stack.effects import Effect, PayloadTransmitted

OK = StatusConfirm(BPStatus.OK)
QUEUES = {mode for mode, rule in QUEUEING.items() if rule.several}


class Registrations(BeaconingProtocol):
    """Changes the status of registrations, except those of SRP and VarDis."""

    def _registrable(self, registration: Registration, *, known: bool) -> BPStatus:
        status = super()._registrable(registration, known=known)
        return status if registration.protocol_id <= 2 else self.judged(status, registration)

    def judged(self, status: BPStatus, registration: Registration) -> BPStatus:
        """Return the status to be confirmed."""
        return status


# fmt: off
registrations_judged = instead(Registrations, Registrations.judged)
registrations_judged("signed", "BP-REG-01", "rejects protocol identifiers with the first bit set",
    lambda self, status, registration: BPStatus.UNKNOWN_PROTOCOL if registration.protocol_id > 0x7FFF else status)
# fmt: on


@mutant("replaces", "BP-REG-02", "lets a second registration replace the first")
class Replaces(Registrations):
    def judged(self, status: BPStatus, registration: Registration) -> BPStatus:
        if status is BPStatus.PROTOCOL_ALREADY_REGISTERED:
            self._clients.remove(registration.protocol_id)
            return BPStatus.OK
        return status


@mutant("forgets", "BP-REG-02", "clears the queue of a client that is registered a second time")
class Forgets(Registrations):
    def judged(self, status: BPStatus, registration: Registration) -> BPStatus:
        client = self.client(registration.protocol_id)
        if status is BPStatus.PROTOCOL_ALREADY_REGISTERED and client is not None and client.queue is not None:
            client.queue.clear()
        return status


# fmt: off
registrations_judged("nothing", "BP-REG-03", "registers clients with a maximum payload size of 0",
    lambda self, status, registration: BPStatus.OK if not registration.max_payload_size else status,
    since=SpecVersion.V1_1)
registrations_judged("something", "BP-REG-06", "rejects a maximum payload size of 0, which 1.0 allows",
    lambda self, status, registration: status if registration.max_payload_size else BPStatus.ILLEGAL_MAX_PAYLOAD_SIZE,
    until=SpecVersion.V1_0, unseen=RIGHT_SINCE_1_1)
registrations_judged("no-bound", "BP-REG-04", "registers clients whose payloads do not fit into a beacon",
    lambda self, status, registration: (
        BPStatus.OK if status is BPStatus.ILLEGAL_MAX_PAYLOAD_SIZE and (registration.max_payload_size > 0) else status))
# fmt: on


class Bound(Registrations):
    """Changes the limit of the maximum payload size."""

    more = 0

    def judged(self, status: BPStatus, registration: Registration) -> BPStatus:
        if status not in (BPStatus.OK, BPStatus.ILLEGAL_MAX_PAYLOAD_SIZE) or registration.max_payload_size <= 0:
            return status
        overhead = self._wire.header_size if self._features.registration_counts_bp_header else 4
        bound = self._parameters.max_packet_size - self._wire.block_header_size - overhead + self.more
        return BPStatus.ILLEGAL_MAX_PAYLOAD_SIZE if registration.max_payload_size > bound else BPStatus.OK


# fmt: off
bound = attributes(Bound, __name__)
bound("one-more", "BP-REG-04", "registers clients with one octet more than fits", more=1)
bound("one-less", "BP-REG-04", "rejects clients with exactly as many octets as fit", more=-1)
bound("block-only", "BP-REG-04", "ignores the header of the beacon in the limit for registrations",
    since=SpecVersion.V1_1, more=18)
registrations_judged("no-entries", "BP-REG-05", "registers queues without entries",
    lambda self, status, registration: BPStatus.OK if status is BPStatus.ILLEGAL_DROPPING_QUEUE_SIZE else status,
    since=SpecVersion.V1_1)
registrations_judged("at-most-32", "BP-REG-05", "registers no queues of more than 32 entries",
    lambda self, status, registration: (
        BPStatus.ILLEGAL_DROPPING_QUEUE_SIZE if registration.max_entries > 32 else status), since=SpecVersion.V1_1)
listed = instead(Lists, Lists.listed)
listed("time", "BP-REG-06 BP-LST-01", "lists no registration time of clients",
    lambda self, each: msgspec.structs.replace(each, time_stamp_registration=0))
after(BeaconingProtocol, BeaconingProtocol.register)("no-own-id", "BP-REG-07",
    "omits its node identifier from the confirms of registrations",
    lambda self, confirm, prot_id, *rest, now, wall: confirm if prot_id <= 2 else RegisterConfirm(confirm.status, None))
# fmt: on


@mutant("other-id", "BP-REG-07", "confirms registrations with the identifier of another node")
class OtherIdentifier(BeaconingProtocol):
    def register(self, prot_id: int, *rest: Any, now: int, wall: int) -> RegisterConfirm:
        confirm = super().register(prot_id, *rest, now=now, wall=wall)
        own = confirm.own_node_identifier
        return confirm if prot_id <= 2 or own is None else RegisterConfirm(confirm.status, own[:-1] + b"\x77")


registrations_judged("size-first", "BP-REG-09", "checks the size in a registration before it checks for a duplicate",
    lambda self, status, registration: (
        BPStatus.ILLEGAL_MAX_PAYLOAD_SIZE
        if registration.max_payload_size <= 0 and self._features.version >= SpecVersion.V1_1 else status),
    unseen={"1.0": "1.0 rejects neither a size of 0 nor 0 entries"})  # fmt: skip
registrations_judged("queue-first", "BP-REG-09", "checks maxEntries in a registration before it checks the size",
    lambda self, status, registration: (
        BPStatus.ILLEGAL_DROPPING_QUEUE_SIZE
        if registration.max_entries <= 0 and registration.queue_mode in QUEUES else status),
    unseen={"1.0": "1.0 rejects neither a size of 0 nor 0 entries"})  # fmt: skip
after(BeaconingProtocol, BeaconingProtocol.deregister)("ok", "BP-DRG-01",
    "confirms the deregistration of an unknown client with OK",
    lambda self, confirm, prot_id: OK)  # fmt: skip


@mutant("stays-listed", "BP-DRG-02", "continues to list a client that was deregistered")
class StaysListed(BeaconingProtocol):
    gone: tuple[Registration, ...] = ()

    def deregister(self, prot_id: int) -> StatusConfirm:
        client = self.client(prot_id)
        if client is not None:
            self.gone = (*self.gone, client.registration)
        return super().deregister(prot_id)

    def list_registered(self) -> ListConfirm:
        confirm = super().list_registered()
        gone = tuple(each for each in self.gone if each.protocol_id not in self._clients)
        return ListConfirm(confirm.status, (*confirm.protocols, *gone))


instead(ClientList, ClientList.remove)("still-sends", "BP-DRG-03",
    "sends the buffered payloads of a client that was deregistered",
    lambda self, protocol_id: assign(self._clients.pop(protocol_id), stands=False))  # fmt: skip


@mutant("still-delivers", "BP-DRG-04 BP-REG-10 BP-RX-08", "delivers payloads to clients that were deregistered")
class StillDelivers(Receiver):
    known: tuple[int, ...] = ()

    def _deliver(self, block: Block, sender: bytes) -> None:
        if block.protocol_id in self._clients:
            self.known = (*self.known, block.protocol_id)
            super()._deliver(block, sender)
        elif block.protocol_id in self.known:
            from dcp_stack.effects import PayloadReceived

            self._emit(PayloadReceived(block.protocol_id, block.payload, sender))


@mutant("old-queue", "BP-DRG-05 BP-REG-06", "gives a client that registers again its old queue")
class OldQueue(ClientList):
    def __init__(self) -> None:
        super().__init__()
        self._gone: dict[int, Client] = {}

    def remove(self, protocol_id: int) -> None:
        self._gone[protocol_id] = self._clients[protocol_id]
        super().remove(protocol_id)

    def insert(self, client: Client) -> None:
        old = self._gone.pop(client.protocol_id, client)
        client.queue = old.queue
        super().insert(client)


@mutant(
    "stays-ours",
    "BP-RXP-03 BP-DRG-05",
    "does not deliver payloads to a client that registered the identifier of SRP or VarDis",
)
class StaysOurs(ClientList):
    def remove(self, protocol_id: int) -> None:
        client = self._clients[protocol_id]
        super().remove(protocol_id)
        client.stands = True


@mutant("fails", "BP-QM-06", "fails with an internal error on an unknown queueing mode", since=SpecVersion.V1_1)
class StumblesOverMode(BeaconingProtocol):
    def _registrable(self, registration: Registration, *, known: bool) -> BPStatus:
        if not known:
            raise RuntimeError(f"no rule for {registration.queue_mode!r}")
        return super()._registrable(registration, known=known)


after_list_registered = after(BeaconingProtocol, BeaconingProtocol.list_registered)
after_list_registered("one-missing", "BP-LST-01", "omits the client that registered last from the list",
    lambda self, confirm: ListConfirm(confirm.status, confirm.protocols[:-1]))  # fmt: skip
listed("wrong-size", "BP-LST-01", "includes the header of the block in the maximum payload size that it lists",
    lambda self, each: msgspec.structs.replace(each, max_payload_size=each.max_payload_size + 4))  # fmt: skip


# -- payloads ----------------------------------------------------------------------------------------------------------


after_submit = after(BeaconingProtocol, BeaconingProtocol._submit)
after_submit("ok", "BP-TXP-01 BP-REG-10", "confirms a payload for an unregistered identifier with OK",
    lambda self, status, client, payload, now: BPStatus.OK if client is None else status)  # fmt: skip


@mutant("no-limit", "BP-TXP-02", "accepts payloads longer than the client registered")
class AnyLength(BeaconingProtocol):
    def _submit(self, client: Client | None, payload: bytes, now: int) -> BPStatus:
        if client is not None and client.queue is not None and len(payload) > client.registration.max_payload_size:
            client.queue.submit(payload)
            return BPStatus.OK
        return super()._submit(client, payload, now)


@mutant("in-an-octet", "BP-TXP-02", "compares the low octet of the length of a payload with maxPayloadSize")
class LengthInAnOctet(BeaconingProtocol):
    def _submit(self, client: Client | None, payload: bytes, now: int) -> BPStatus:
        status = super()._submit(client, payload, now)
        if status is not BPStatus.PAYLOAD_TOO_LARGE or client is None or client.queue is None:
            return status
        if len(payload) % 256 > client.registration.max_payload_size:
            return status
        client.queue.submit(payload)
        return BPStatus.OK


# fmt: off
around_submit = around(BeaconingProtocol, BeaconingProtocol._submit)
around_submit("one-less", "BP-TXP-02", "rejects payloads of exactly the length that the client registered",
    lambda self, proceed, client, payload, now: (
        BPStatus.PAYLOAD_TOO_LARGE if client is not None and client.protocol_id > 2
        and len(payload) >= client.registration.max_payload_size else proceed(client, payload, now)))
around_submit("truncates", "BP-TXP-02", "truncates a payload that is too long, and confirms it with OK",
    lambda self, proceed, client, payload, now: (
        proceed(client, payload[:(len(payload) if client is None else client.registration.max_payload_size)], now)))
after_submit("ok", "BP-TXP-03", "confirms an empty payload with OK",
    lambda self, status, client, payload, now: BPStatus.OK if status is BPStatus.EMPTY_PAYLOAD else status,
    since=SpecVersion.V1_1)
then(BeaconingProtocol, BeaconingProtocol._submit)("clears", "BP-TXP-03",
    "clears the buffer when an empty payload is submitted",
    lambda self, status, client, payload, now: (
        client.queue.clear()
        if status is BPStatus.EMPTY_PAYLOAD and client is not None and client.queue is not None else None),
    since=SpecVersion.V1_1)
around_submit("empty-refused", "BP-TXP-13", "rejects an empty payload, which in 1.0 clears a buffer",
    lambda self, proceed, client, payload, now: (
        BPStatus.EMPTY_PAYLOAD if client is not None and not payload else proceed(client, payload, now)))
# fmt: on


@mutant(
    "empty-clears",
    "BP-QM-03",
    "clears a queue when an empty payload is submitted, which in 1.0 clears buffers only",
    until=SpecVersion.V1_0,
    unseen={"1.1 1.2 1.3 2.0": "an empty payload is rejected since 1.1"},
)
class EmptyClearsQueues(BeaconingProtocol):
    def _submit(self, client: Client | None, payload: bytes, now: int) -> BPStatus:
        if client is not None and client.queue is not None and not payload:
            client.queue.clear()
            return BPStatus.OK
        return super()._submit(client, payload, now)


@mutant("status", "BP-TXP-04", "confirms a payload that a full DROPTAIL queue drops as too large")
class FullIsAnError(BeaconingProtocol):
    def _submit(self, client: Client | None, payload: bytes, now: int) -> BPStatus:
        before = 0 if client is None or client.queue is None else len(client.queue)
        status = super()._submit(client, payload, now)
        rule = None if client is None or client.queue is None else client.queue.rule
        if status is BPStatus.OK and client is not None and rule is not None and rule.when_full == "discard-new":
            return BPStatus.OK if before < client.registration.max_entries else BPStatus.PAYLOAD_TOO_LARGE
        return status


after_submit("empty-first", "BP-TXP-10", "checks for an empty payload before it checks for the client",
    lambda self, status, client, payload, now: BPStatus.EMPTY_PAYLOAD if not payload else status)  # fmt: skip
after(BeaconingProtocol, BeaconingProtocol.clear_buffer)("ok", "BP-CLR-01",
    "confirms clearing the buffer of an unknown client with OK",
    lambda self, confirm, prot_id: OK)  # fmt: skip


@mutant("nothing", "BP-CLR-02", "does not clear queues")
class QueuesStay(BeaconingProtocol):
    def clear_buffer(self, prot_id: int) -> StatusConfirm:
        client = self.client(prot_id)
        queue = client is not None and client.queue is not None and client.queue.rule.several
        return OK if queue else super().clear_buffer(prot_id)


@mutant("head-only", "BP-CLR-02", "removes only the first payload from a queue that is to be cleared")
class HeadOnly(BeaconingProtocol):
    def clear_buffer(self, prot_id: int) -> StatusConfirm:
        client = self.client(prot_id)
        if client is None or client.queue is None or not client.queue.rule.several or not len(client.queue):
            return super().clear_buffer(prot_id)
        client.queue.sent()
        return OK


@mutant("nothing", "BP-CLR-03", "does not clear buffers")
class BuffersStay(BeaconingProtocol):
    def clear_buffer(self, prot_id: int) -> StatusConfirm:
        client = self.client(prot_id)
        buffer = client is not None and client.queue is not None and not client.queue.rule.several
        return OK if buffer else super().clear_buffer(prot_id)


after(BeaconingProtocol, BeaconingProtocol.query_number_buffered)("ok", "BP-QRY-01",
    "returns 0 payloads for an unknown client",
    lambda self, confirm, prot_id: confirm if confirm.status.is_ok else NumberConfirm(BPStatus.OK, 0))  # fmt: skip


class Indications(BeaconingProtocol):
    """Changes the indications of transmitted payloads to clients outside of the node."""

    def __init__(self, config: NodeConfig, *, rng: Any, emit: Callable[[Effect], None], now: int, wall: int) -> None:
        def changed(effect: Effect) -> None:
            if isinstance(effect, PayloadTransmitted) and effect.protocol_id > 2:
                for each in self.told(effect):
                    emit(each)
            else:
                emit(effect)

        super().__init__(config, rng=rng, emit=changed, now=now, wall=wall)
        self.seen: set[int] = set()

    def told(self, effect: PayloadTransmitted) -> list[Effect]:
        """Return the indications to be sent instead of this one."""
        return [effect]


told = instead(Indications, Indications.told)
told("missing", "BP-PTI-01", "sends no indication when a payload was transmitted", lambda self, effect: [])
told("twice", "BP-PTI-01", "sends two indications when a payload was transmitted",
    lambda self, effect: [effect, effect])  # fmt: skip


@mutant("epoch-passed", "BP-PTI-02", "indicates the time of the beacon just sent as that of the next one")
class EpochPassed(Indications):
    def handle_timeout(self, now: int, wall: int) -> None:
        self.at = now
        super().handle_timeout(now, wall)

    def told(self, effect: PayloadTransmitted) -> list[Effect]:
        return [msgspec.structs.replace(effect, next_epoch=self.at)]


told("epoch-zero", "BP-PTI-02", "indicates time 0 for the next beacon",
    lambda self, effect: [msgspec.structs.replace(effect, next_epoch=0)])  # fmt: skip


@mutant("first-only", "BP-PTI-03", "indicates only the first transmission of a REPEAT buffer")
class FirstOnly(Indications):
    def told(self, effect: PayloadTransmitted) -> list[Effect]:
        client = self.client(effect.protocol_id)
        if client is None or client.queue is None or client.queue.rule.when_sent != "keep":
            return [effect]
        head = hash((effect.protocol_id, client.queue.head()))
        known = head in self.seen
        self.seen.add(head)
        return [] if known else [effect]
