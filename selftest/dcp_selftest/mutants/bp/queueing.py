"""Faults in the payloads that BP buffers for its clients, and in their selection for a beacon."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

import msgspec
from dcp_spec.constants import BP_MAX_PAYLOADS, BP_PROTID_SRP, QueueingMode, SpecVersion
from dcp_spec.status import BPStatus

from dcp_selftest.mutants.family import around, assign, attributes, before, instead, then
from dcp_selftest.mutants.mutant import mutant, replaced
from dcp_selftest.mutants.unseen import NO_MODE, NO_QUEUE
from dcp_stack.bp.clients import Chosen, ClientList
from dcp_stack.bp.entity import BeaconingProtocol
from dcp_stack.bp.queue import QUEUEING, Client, ModeRule, PayloadQueue, Places, Submission
from dcp_stack.bp.services import NumberConfirm, RegisterConfirm
from dcp_stack.bp.timing import BeaconSchedule
from dcp_stack.bp.wire import BPWire
from dcp_stack.config import MS

DROPTAIL, DROPHEAD = QueueingMode.QUEUE_DROPTAIL, QueueingMode.QUEUE_DROPHEAD
ONCE, REPEAT = QueueingMode.ONCE, QueueingMode.REPEAT


def rule(mode: QueueingMode, **changes: object) -> dict[QueueingMode, ModeRule]:
    """Return the table of modes with a changed row."""
    return {**QUEUEING, mode: msgspec.structs.replace(QUEUEING[mode], **changes)}


class OtherRules(ClientList):
    """Keeps the payloads of clients by a changed table of queueing modes."""

    rules: ClassVar[dict[QueueingMode, ModeRule]]

    def insert(self, client: Client) -> None:
        if client.queue is not None:
            mode = client.registration.queue_mode
            assert isinstance(mode, QueueingMode)
            client.queue = PayloadQueue(self.rules[mode], client.registration.max_entries)
        super().insert(client)


# -- modes -------------------------------------------------------------------------------------------------------------


# fmt: off
other_rules = attributes(OtherRules, __name__)
other_rules("drops-head", "BP-QM-01 BP-TXP-04", "drops the oldest payload of a full DROPTAIL queue",
    rules=rule(DROPTAIL, when_full="displace-oldest"))
other_rules("discards-new", "BP-QM-02 BP-TXP-05", "discards a new payload for a full DROPHEAD queue",
    rules=rule(DROPHEAD, when_full="discard-new"))
other_rules("repeats", "BP-QM-03 BP-TX-06", "sends the head of a DROPTAIL queue repeatedly",
    unseen=NO_MODE, rules=rule(DROPTAIL, when_sent="keep"))
other_rules("drophead-repeats", "BP-QM-03 BP-TX-06", "sends the head of a DROPHEAD queue repeatedly",
    unseen=NO_MODE, rules=rule(DROPHEAD, when_sent="keep"))
other_rules("bounded", "BP-QM-03", "keeps only one payload in a queue of mode QUEUE",
    until=SpecVersion.V1_0, unseen=NO_QUEUE,
    rules=rule(QueueingMode.QUEUE, places=QUEUEING[ONCE].places, when_full="displace-oldest"))
other_rules("queue-repeats", "BP-QM-03", "sends the head of a queue of mode QUEUE repeatedly",
    until=SpecVersion.V1_0, unseen=NO_QUEUE, rules=rule(QueueingMode.QUEUE, when_sent="keep"))
other_rules("bounded-by-entries", "BP-QM-03", "drops payloads in excess of maxEntries, which 1.0 does not have",
    until=SpecVersion.V1_0, unseen=NO_QUEUE,
    rules=rule(QueueingMode.QUEUE, places=Places.MAX_ENTRIES, when_full="discard-new"))
other_rules("keeps-oldest", "BP-QM-04 BP-TXP-06", "keeps the first payload in a ONCE buffer until it is sent",
    rules=rule(ONCE, when_full="discard-new"))
other_rules("repeats", "BP-QM-04 BP-TX-05 BP-QRY-03", "keeps the payload of a ONCE buffer after it was sent",
    rules=rule(ONCE, when_sent="keep"))
other_rules("forgets", "BP-QM-05 BP-TX-05 BP-QRY-03", "clears a REPEAT buffer after its payload was sent",
    rules=rule(REPEAT, when_sent="remove"))
other_rules("keeps-oldest", "BP-QM-05 BP-TXP-06", "never replaces the payload of a REPEAT buffer",
    rules=rule(REPEAT, when_full="discard-new"))
# fmt: on


class OwnQueue(ClientList):
    """Gives clients a changed queue."""

    queue: ClassVar[type[PayloadQueue]] = PayloadQueue

    def insert(self, client: Client) -> None:
        if client.queue is not None:
            client.queue = self.queue(client.queue.rule, self.places(client.registration.max_entries))
        super().insert(client)

    def places(self, entries: int) -> int:
        """Return the number of places of a queue with this maxEntries."""
        return entries


@mutant("newest-first", "BP-QM-03 BP-QM-02", "sends the newest payload of a queue first")
class NewestFirst(OwnQueue):
    class queue(PayloadQueue):  # noqa: N801 - takes the place of an attribute
        def head(self) -> bytes | None:
            return self._payloads[-1] if self._payloads else None

        def sent(self) -> None:
            if self.rule.when_sent == "remove":
                self._payloads.pop()


places = instead(OwnQueue, OwnQueue.places)
places("one-place-more", "BP-QM-01 BP-QM-02 BP-QRY-02", "keeps one payload more than maxEntries",
    lambda self, entries: entries + 1, since=SpecVersion.V1_1)  # fmt: skip
places("at-most-16", "BP-QM-01 BP-QM-02 BP-QM-03", "limits queues to fewer payloads than maxEntries, such as 16",
    lambda self, entries: min(entries, 16), since=SpecVersion.V1_1)  # fmt: skip
places("six-bits", "BP-QM-02 BP-QM-01 BP-QM-03", "uses the length of a queue modulo 64",
    lambda self, entries: entries % 64 or 1, since=SpecVersion.V1_1)  # fmt: skip


@mutant("wraps-at-32", "BP-QM-03", "sends the 33rd and later payloads of a queue first")
class WrapsAt32(OwnQueue):
    class queue(PayloadQueue):  # noqa: N801 - as above
        def submit(self, payload: bytes) -> Submission:
            outcome = super().submit(payload)
            if outcome != "discarded" and len(self) > 32:
                self._payloads.rotate(1)
            return outcome


places("one-place-less", "BP-QM-02 BP-QM-01 BP-QRY-02", "keeps one payload less than maxEntries",
    lambda self, entries: max(entries - 1, 1))  # fmt: skip


@mutant("forgets-all", "BP-TXP-05 BP-QM-02", "clears a full DROPHEAD queue when a new payload is submitted")
class ForgetsAll(OwnQueue):
    class queue(PayloadQueue):  # noqa: N801 - as above
        def submit(self, payload: bytes) -> Submission:
            outcome = super().submit(payload)
            if outcome == "displaced":
                self._payloads.clear()
                self._payloads.append(payload)
            return outcome


before(ClientList, ClientList.insert)("several", "BP-QM-07",
    "sends several payloads of a client in one beacon although the client allows one",
    lambda self, client: assign(client, several=client.queue is not None and client.queue.rule.several))  # fmt: skip


@mutant("entries-for-buffers", "BP-QM-09", "rejects registrations of modes without a queue if maxEntries is 0")
class EntriesForBuffers(BeaconingProtocol):
    def register(self, prot_id: int, *rest: object, now: int, wall: int) -> RegisterConfirm:
        confirm = super().register(prot_id, *rest, now=now, wall=wall)  # type: ignore[arg-type]
        client = self.client(prot_id)
        if confirm.status.is_ok and client is not None and client.registration.max_entries <= 0:
            self.deregister(prot_id)
            return RegisterConfirm(BPStatus.ILLEGAL_DROPPING_QUEUE_SIZE, confirm.own_node_identifier)
        return confirm


@mutant("any", "BP-QM-06", "accepts registrations with an unknown mode, and treats them as ONCE")
class AnyMode(BeaconingProtocol):
    def register(self, prot_id: int, *rest: object, now: int, wall: int) -> RegisterConfirm:
        name, size, mode, entries, several = rest
        known = mode if mode in set(QUEUEING) else ONCE
        return super().register(prot_id, name, size, known, entries, several, now=now, wall=wall)  # type: ignore[arg-type]


# -- taking payloads ---------------------------------------------------------------------------------------------------


@mutant("loses", "BP-TX-04", "loses a payload that does not fit into the next beacon")
class Loses(ClientList):
    def take(self, room: int, size: Callable[[bytes], int], most: int) -> Chosen:
        waiting = [client for client in self if client.queue is not None and client.queue.head() is not None]
        chosen = super().take(room, size, most)
        served = {protocol_id for protocol_id, _ in chosen}
        for client in waiting:
            if chosen and client.queue is not None and client.protocol_id not in served:
                client.queue.clear()
        return chosen


@mutant("cuts", "BP-TX-04 BP-FMT-01", "truncates a payload to the room in the beacon")
class Cuts(ClientList):
    def take(self, room: int, size: Callable[[bytes], int], most: int) -> Chosen:
        chosen: Chosen = []
        for client in [*self][:most]:
            payload = None if client.queue is None else client.queue.head()
            if client.queue is None or payload is None or room < size(b"\0"):
                continue
            part = payload[: room - size(b"")]
            chosen.append((client.protocol_id, part))
            room -= size(part)
            client.queue.sent()
        return chosen


@mutant("hangs", "BP-TX-04 BP-FMT-02 BP-TXP-09",
    "stops sending when the payloads for a beacon fit into it and their blocks, with headers, do not")  # fmt: skip
class Hangs(ClientList):
    _hung = False

    def take(self, room: int, size: Callable[[bytes], int], most: int) -> Chosen:
        if self._hung:
            return []
        chosen = super().take(room, len, most)
        self._hung = sum(size(payload) for _, payload in chosen) > room
        return [] if self._hung else chosen


@mutant("dies-of-overflow", "BP-TX-04 BP-FMT-02 BP-TXP-06 BP-TXP-09",
    "crashes when the payloads for a beacon fit into it and their blocks, with headers, do not")  # fmt: skip
class CrashesOnOverflow(ClientList):
    def take(self, room: int, size: Callable[[bytes], int], most: int) -> Chosen:
        chosen = super().take(room, len, most)
        if sum(size(payload) for _, payload in chosen) > room:
            raise IndexError("a write past the end of the beacon")
        return chosen


@mutant(
    "dies-of-full", "BP-QM-01 BP-TXP-04 BP-TXP-09", "crashes on a payload for a full DROPTAIL queue", unseen=NO_MODE
)
class CrashesOnFullQueue(OwnQueue):
    class queue(PayloadQueue):  # noqa: N801 - as above
        refused = False

        def submit(self, payload: bytes) -> Submission:
            outcome = super().submit(payload)
            self.refused = outcome == "discarded" and self.rule.places is Places.MAX_ENTRIES
            return outcome

    def take(self, room: int, size: Callable[[bytes], int], most: int) -> Chosen:
        # An exception in a service would only be an internal error.
        if any(isinstance(client.queue, self.queue) and client.queue.refused for client in self):
            raise IndexError("a push to a full queue")
        return super().take(room, size, most)


@mutant("dies-of-empty", "BP-CLR-03 BP-QM-05 BP-TX-05", "crashes when a beacon is due while a REPEAT buffer is empty")
class CrashesOnEmptyBuffer(ClientList):
    def take(self, room: int, size: Callable[[bytes], int], most: int) -> Chosen:
        for client in self:
            kept = client.queue is not None and client.queue.rule.when_sent == "keep"
            # The buffer of SRP is empty after the start.
            if kept and client.queue is not None and not client.queue and client.protocol_id != BP_PROTID_SRP:
                raise IndexError("a peek into an empty queue")
        return super().take(room, size, most)


class AnyNumber(ClientList):
    """Puts any number of blocks into a beacon."""

    def take(self, room: int, size: Callable[[bytes], int], most: int) -> Chosen:
        return super().take(room, size, 1 << 16 if most == BP_MAX_PAYLOADS else most)


class AnyNumberOfBlocks(BPWire):
    """Encodes any number of blocks, and the last octet of their number."""

    def build(self, seqno: int, network_id: int | None, blocks: Chosen) -> bytes:
        octets = super().build(seqno, network_id, blocks[:BP_MAX_PAYLOADS])
        if len(blocks) > BP_MAX_PAYLOADS:
            octets += super().build(seqno, network_id, blocks[BP_MAX_PAYLOADS:])[self.header_size :]
            for name, value in (("numPayloads", len(blocks) % 256), ("length", len(octets) - self.header_size)):
                if place := self._places.get(name):
                    field = value.to_bytes(place.stop - place.start, "big")
                    octets = octets[: place.start] + field + octets[place.stop :]
        return octets


@mutant("any-number", "BP-TX-08", "puts more than 255 blocks into a beacon")
class ManyBlocks(BeaconingProtocol):
    def __init__(self, *args: Any, **kwargs: Any) -> None:
        with replaced({ClientList: AnyNumber, BPWire: AnyNumberOfBlocks}):
            super().__init__(*args, **kwargs)


@mutant("overtakes", "BP-TX-06", "sends a later payload of a queue if the head does not fit")
class Overtakes(OwnQueue):
    def take(self, room: int, size: Callable[[bytes], int], most: int) -> Chosen:
        used = 0
        for client in self:
            queue = client.queue
            head = None if queue is None else queue.head()
            if queue is None or head is None:
                continue
            if used + size(head) > room:
                fitting = [each for each in queue._payloads if used + size(each) <= room]
                if fitting:
                    queue._payloads.remove(fitting[0])
                    queue._payloads.appendleft(fitting[0])
            used += size(queue.head() or b"")
        return super().take(room, size, most)


# -- the number of payloads --------------------------------------------------------------------------------------------


class Query(BeaconingProtocol):
    """Changes answers to queries for the number of payloads."""

    def query_number_buffered(self, prot_id: int) -> NumberConfirm:
        confirm = super().query_number_buffered(prot_id)
        client = self.client(prot_id)
        if confirm.number is None or client is None or client.queue is None:
            return confirm
        return NumberConfirm(confirm.status, self.number(confirm.number, client.queue))

    def number(self, number: int, queue: PayloadQueue) -> int:
        """Return the number to be returned."""
        return number


# fmt: off
number = instead(Query, Query.number)
number("one-at-most", "BP-QRY-02", "answers 1 for a queue with several payloads",
    lambda self, number, queue: min(number, 1))
number("one-more", "BP-QRY-02 BP-QRY-03", "counts the payload that was sent last as buffered",
    lambda self, number, queue: number + (queue.rule not in (QUEUEING[ONCE], QUEUEING[REPEAT]) and number > 0))
number("repeat-empty", "BP-QRY-03", "answers 0 for a REPEAT buffer that is occupied",
    lambda self, number, queue: 0 if queue.rule == QUEUEING[REPEAT] else number)
# fmt: on


# -- timing ------------------------------------------------------------------------------------------------------------


@mutant("slow", "BP-TX-01", "sends beacons with a period one tenth longer than the parameter")
class Slow(BeaconSchedule):
    def _place(self) -> None:
        period, self._period = self._period, self._period * 11 // 10
        super()._place()
        self._period = period


@mutant("jitter-added", "BP-TX-01", "adds its jitter to the period instead of varying around it")
class JitterAdded(BeaconSchedule):
    def _plan(self) -> None:
        self._factor = self._rng.uniform(1, 1 + 2 * self._jitter)
        self._place()


# fmt: off
around(BeaconSchedule, BeaconSchedule.set_period)("period-ticks", "BP-TX-01 BP-PAR-02",
    "rounds a changed beacon period down to ticks of 10 ms, and reports the value that was set",
    lambda self, proceed, period: proceed(max(period // (10 * MS), 1) * 10 * MS))
then(BeaconSchedule, BeaconSchedule.passed)("bursts", "BP-TX-01",
    "prepares the next beacon soon after each one that it sends",
    lambda self, left_out, now, *, sent: assign(self, due=min(self.due, now + self._gap)) if sent else None)
# fmt: on
