"""Faults of BP in a second registration of an identifier, after refused requests, and while it is inactive."""

from __future__ import annotations

from typing import Any, ClassVar

import msgspec
from dcp_spec.constants import BP_PROTID_SRP, BP_PROTID_VARDIS, SpecVersion
from dcp_spec.parameters import Violation
from dcp_spec.status import BPStatus

from dcp_selftest.mutants.bp.kept import Lists
from dcp_selftest.mutants.bp.services import told
from dcp_selftest.mutants.family import around, assign, attributes, instead
from dcp_selftest.mutants.mutant import mutant
from dcp_selftest.mutants.unseen import BP_ALWAYS_ACTIVE
from dcp_stack.bp.clients import ClientList
from dcp_stack.bp.entity import BeaconingProtocol
from dcp_stack.bp.queue import Client, PayloadQueue
from dcp_stack.bp.services import RegisterConfirm, Registration, StatusConfirm
from dcp_stack.config import MS

OK = StatusConfirm(BPStatus.OK)
V1_1 = SpecVersion.V1_1
SINCE_1_2: Any = {"since": SpecVersion.V1_2, "unseen": BP_ALWAYS_ACTIVE}


# -- a second registration ---------------------------------------------------------------------------------------------


class Remembers(ClientList):
    """Gives a client that registers again something of its first registration."""

    def __init__(self) -> None:
        super().__init__()
        self.former: dict[int, Client] = {}

    def insert(self, client: Client) -> None:
        self.recall(client, self.former.setdefault(client.protocol_id, client))
        super().insert(client)

    def recall(self, client: Client, former: Client) -> None:
        """Change a client like its first registration."""


def _queue_of(client: Client, *, entries: int | None = None, former: Client | None = None) -> PayloadQueue | None:
    """Return an empty queue like that of a client, with other entries or the mode of another client."""
    queue, other = client.queue, client.queue if former is None else former.queue
    if queue is None or other is None:
        return queue
    return PayloadQueue(other.rule, entries or queue._places or 1)


# fmt: off
recall = instead(Remembers, Remembers.recall)
recall("former-entries", "BP-REG-06 BP-QM-01 BP-QM-02 BP-DRG-05",
    "gives a client that registers again the maxEntries of its first registration",
    lambda self, client, former: assign(client, queue=_queue_of(client, entries=former.registration.max_entries)),
    since=V1_1, unseen={"1.0": "1.0 has no maxEntries"})
recall("former-mode", "BP-REG-06 BP-QM-03 BP-QM-04 BP-QM-05 BP-DRG-05",
    "gives a client that registers again the queueing mode of its first registration",
    lambda self, client, former: assign(client, queue=_queue_of(client, former=former)))
recall("former-several", "BP-REG-06 BP-QM-07 BP-DRG-05",
    "gives a client that registers again the allowMultiplePayloads of its first registration",
    lambda self, client, former: assign(client, several=former.several),
    since=V1_1, unseen={"1.0": "1.0 has no allowMultiplePayloads"})
recall("former-size", "BP-REG-06 BP-TXP-02 BP-DRG-05",
    "compares payloads with the maxPayloadSize of the first registration of a client",
    lambda self, client, former: assign(client, registration=msgspec.structs.replace(
        client.registration, max_payload_size=former.registration.max_payload_size)))
# fmt: on


class ListsFirst(Lists):
    """Lists something of the first registration of an identifier."""

    names: ClassVar[tuple[str, ...]]

    def __init__(self, *args: Any, **more: Any) -> None:
        super().__init__(*args, **more)
        self.first: dict[int, Registration] = {}

    def register(self, prot_id: int, *rest: Any, now: int, wall: int) -> RegisterConfirm:
        confirm = super().register(prot_id, *rest, now=now, wall=wall)
        client = self.client(prot_id)
        if client is not None:
            self.first.setdefault(prot_id, client.registration)
        return confirm

    def listed(self, each: Registration) -> Registration:
        first = self.first.get(each.protocol_id, each)
        return msgspec.structs.replace(each, **{name: getattr(first, name) for name in self.names})


# fmt: off
lists_first = attributes(ListsFirst, __name__)
lists_first("first-time", "BP-LST-01 BP-REG-06",
    "lists the time of the first registration of an identifier", names=("time_stamp_registration",))
# fmt: on


@mutant("third-lost", "BP-REG-06 BP-DRG-05", "confirms the third registration of an identifier without storing it")
class ThirdLost(ClientList):
    def insert(self, client: Client) -> None:
        counts: dict[int, int] = self.__dict__.setdefault("counts", {})
        counts[client.protocol_id] = counts.get(client.protocol_id, 0) + 1
        if counts[client.protocol_id] != 3 or client.protocol_id <= 2:
            super().insert(client)


# -- refused requests --------------------------------------------------------------------------------------------------


# -- while BP is inactive ----------------------------------------------------------------------------------------------


def _own(prot_id: int) -> bool:
    return prot_id in (BP_PROTID_SRP, BP_PROTID_VARDIS)


# fmt: off
around(BeaconingProtocol, BeaconingProtocol.clear_buffer)("clears-no-queue", "BP-MGT-04 BP-CLR-02",
    "confirms BP-ClearBuffer while it is inactive, and does not clear queues",
    lambda self, proceed, prot_id: OK if not self._active and (client := self.client(prot_id)) is not None
        and client.queue is not None and client.queue.rule.places.value != "one" else proceed(prot_id))
around(BeaconingProtocol, BeaconingProtocol._submit)("any-length", "BP-MGT-04 BP-TXP-02",
    "accepts payloads of any length while it is inactive",
    lambda self, proceed, client, payload, now: BPStatus.OK if not self._active and client is not None
        and len(payload) > client.registration.max_payload_size else proceed(client, payload, now))
around(BeaconingProtocol, BeaconingProtocol._submit)("empty-taken", "BP-MGT-04 BP-TXP-03",
    "confirms empty payloads with OK while it is inactive and a queue has payloads",
    lambda self, proceed, client, payload, now: BPStatus.OK if not self._active and client is not None
        and not payload and client.queue else proceed(client, payload, now))
# fmt: on


class Inactive(BeaconingProtocol):
    """Processes some requests of clients outside of the node differently while it is inactive."""

    def register(self, prot_id: int, *rest: Any, now: int, wall: int) -> RegisterConfirm:
        if not self._active and self.client(prot_id) is not None and not _own(prot_id):
            self.registers_twice(prot_id)
        return super().register(prot_id, *rest, now=now, wall=wall)

    def registers_twice(self, prot_id: int) -> None:
        """Handle the registration of a registered identifier."""

    def _submit(self, client: Client | None, payload: bytes, now: int) -> BPStatus:
        if not self._active and client is not None and client.queue is not None and not _own(client.protocol_id):
            queue = client.queue
            if 0 < len(payload) <= client.registration.max_payload_size and len(queue) == (queue._places or 0):
                return self.full(client, payload, now)
        return super()._submit(client, payload, now)

    def full(self, client: Client, payload: bytes, now: int) -> BPStatus:
        """Submit a payload for a full queue or buffer."""
        return super()._submit(client, payload, now)


# fmt: off
instead(Inactive, Inactive.registers_twice)("replaces-registration", "BP-MGT-04 BP-REG-02",
    "replaces the registration of a client while it is inactive",
    lambda self, prot_id: self._clients.remove(prot_id))
full = instead(Inactive, Inactive.full)
full("keeps-oldest", "BP-MGT-04 BP-TXP-05 BP-TXP-06 BP-QM-02 BP-QM-04",
    "discards payloads for full queues and buffers while it is inactive",
    lambda self, client, payload, now: BPStatus.OK)
around(BeaconingProtocol, BeaconingProtocol.set_parameter)("parameters-lost", "BP-MGT-04 BP-PAR-02",
    "confirms new parameters while it is inactive, and does not use them",
    lambda self, proceed, name, value: proceed(name, value) if self._active else None,
    since=SpecVersion.V1_2)
# fmt: on


class DeliversInactive(BeaconingProtocol):
    """Delivers payloads of some protocols while it is inactive."""

    protocols: ClassVar[tuple[int, ...]]

    def handle_beacon(self, octets: bytes, *, now: int, wall: int) -> None:
        if not self._active:
            found = self._wire.parse(octets)
            for block in found.blocks if found.header and self._receiver._for_this_node(found.header) else ():
                if block.protocol_id in self.protocols:
                    self._receiver._deliver(block, found.header.sender_id if found.header else b"")
        super().handle_beacon(octets, now=now, wall=wall)


delivers = attributes(DeliversInactive, __name__)
delivers("state-reports", "BP-RX-13 BP-MGT-03", "delivers state reports while it is inactive",
    protocols=(BP_PROTID_SRP,))  # fmt: skip


@mutant("deregisters-later", "BP-MGT-04 BP-DRG-03", "sends the payload of a client deregistered while it is inactive",
    unseen=BP_ALWAYS_ACTIVE)  # fmt: skip
class DeregistersLater(BeaconingProtocol):
    def deregister(self, prot_id: int) -> StatusConfirm:
        client = self.client(prot_id)
        confirm = super().deregister(prot_id)
        if not self._active and client is not None and client.queue and not _own(prot_id):
            self._clients._order.append(client)
        return confirm


# -- parameters --------------------------------------------------------------------------------------------------------


class Shrinks(BeaconingProtocol):
    """Does something with the queues of clients when a parameter was set."""

    def set_parameter(self, name: str, value: object) -> Violation | None:
        violation = super().set_parameter(name, value)
        if violation is None:
            for client in self._clients:
                if client.queue is not None and not _own(client.protocol_id):
                    self.changed(client, client.queue)
        return violation

    def changed(self, client: Client, queue: PayloadQueue) -> None:
        """Change a client after a parameter has changed."""


# fmt: off
changed = instead(Shrinks, Shrinks.changed)
changed("too-long-dropped", "BP-TX-04 BP-PAR-02",
    "drops queued payloads that no longer fit after BPPAR_MAXIMUM_PACKET_SIZE was lowered",
    lambda self, client, queue: assign(queue, _payloads=type(queue._payloads)(
        each for each in queue._payloads if self._wire.block_size(each) <= self._room())), **SINCE_1_2)
changed("registration-lowered", "BP-TXP-02 BP-PAR-11",
    "lowers the maxPayloadSize of registered clients with BPPAR_MAXIMUM_PACKET_SIZE",
    lambda self, client, queue: assign(client, registration=msgspec.structs.replace(client.registration,
        max_payload_size=min(client.registration.max_payload_size, self._room() - self._wire.block_header_size))),
    **SINCE_1_2)
# fmt: on


told("first-period", "BP-PTI-02 BP-PAR-02",
    "announces the next beacon by the initial beacon period after the period was changed",
    lambda self, effect: [msgspec.structs.replace(effect, next_epoch=effect.next_epoch
        + round(self._config.bp.beacon_period_ms * MS) - self._parameters.period)])  # fmt: skip
