"""Nodes that are wrong in one thing: the cases about BP must notice, and name the requirement.

Offsets are those of the header of 2.0 with the profile ``dcp-2.0``.
"""

from __future__ import annotations

import random
import re
from typing import Any

import msgspec
import pytest
from dcp_conformance.definitions.verdict import Verdict
from dcp_spec.constants import BP_PROTID_VARDIS, QueueingMode
from dcp_spec.status import BPStatus

from dcp_codec.errors import DecodeError
from dcp_codec.values import Beacon, Payload
from dcp_stack.bp.services import NumberConfirm, RegisterConfirm, StatusConfirm
from dcp_stack.config import NodeConfig
from dcp_stack.effects import Effect, PayloadReceived, PayloadTransmitted, SendBeacon
from dcp_stack.node import Node

from ..rig import one_case

VERSION, MAGIC, SENDER, NETWORK, LENGTH, NUMBER, SEQNO, HEADER = 0, 1, 3, 9, 11, 13, 14, 18
MS = 1_000_000


class Services:
    """The services of BP; those that are not overridden are right."""

    def __init__(self, node: Wrong) -> None:
        self.node = node
        self.right = node.inner.bp

    def __getattr__(self, name: str) -> Any:
        return getattr(self.right, name)


class Wrong:
    """A node whose received and sent frames, and whose effects for clients, can be changed."""

    services: type[Services] = Services

    def __init__(self, config: NodeConfig, rng: random.Random, now: int, wall: int) -> None:
        self.inner = Node(self.configured(config), rng=rng, now=now, wall=wall)
        self.codec = config.codec
        self.beacons = 0

    def configured(self, config: NodeConfig) -> NodeConfig:
        return config

    def __getattr__(self, name: str) -> Any:
        return getattr(self.inner, name)

    @property
    def bp(self) -> Services:
        return self.services(self)

    def handle_frame(self, octets: bytes, *, now: int, wall: int) -> None:
        heard = self.hears(bytearray(octets))
        if heard is not None:
            self.inner.handle_frame(bytes(heard), now=now, wall=wall)

    def take_effects(self) -> list[Effect]:
        effects: list[Effect] = []
        for effect in self.inner.take_effects():
            if isinstance(effect, SendBeacon):
                self.beacons += 1
                octets = bytes(self.says(bytearray(effect.octets)))
                effects.append(msgspec.structs.replace(effect, octets=octets))
            else:
                effects += self.tells(effect)
        return effects

    def hears(self, octets: bytearray) -> bytearray | None:
        return octets

    def says(self, octets: bytearray) -> bytearray:
        return octets

    def tells(self, effect: Effect) -> list[Effect]:
        return [effect]


def put(octets: bytearray, offset: int, value: int, width: int) -> bytearray:
    octets[offset : offset + width] = value.to_bytes(width, "big")
    return octets


def number_at(octets: bytearray, offset: int, width: int) -> int:
    return int.from_bytes(octets[offset : offset + width], "big")


# -- reception ---------------------------------------------------------------------------------------------------------


class AnyVersion(Wrong):
    def hears(self, octets: bytearray) -> bytearray:
        return put(octets, VERSION, 1, 1) if len(octets) > HEADER else octets


class AnyMagic(Wrong):
    def hears(self, octets: bytearray) -> bytearray:
        return put(octets, MAGIC, 0x497E, 2) if len(octets) > HEADER else octets


class ChecksOneOctetOfMagic(Wrong):
    def hears(self, octets: bytearray) -> bytearray:
        return put(octets, MAGIC, 0x497E, 2) if len(octets) > HEADER and octets[MAGIC] == 0x49 else octets


class LengthZeroMeansAll(Wrong):
    def hears(self, octets: bytearray) -> bytearray:
        zero = len(octets) > HEADER and number_at(octets, LENGTH, 2) == 0
        return put(octets, LENGTH, len(octets) - HEADER, 2) if zero else octets


class ZeroPayloadsMeansOne(Wrong):
    def hears(self, octets: bytearray) -> bytearray:
        return put(octets, NUMBER, 1, 1) if len(octets) > HEADER and not octets[NUMBER] else octets


class AnyNetwork(Wrong):
    def hears(self, octets: bytearray) -> bytearray:
        network = self.inner.bp.parameters()["BPPAR_NETWORK_ID"]
        return put(octets, NETWORK, network, 2) if len(octets) > HEADER else octets


class OneOctetOfNetwork(Wrong):
    def hears(self, octets: bytearray) -> bytearray:
        network = self.inner.bp.parameters()["BPPAR_NETWORK_ID"]
        return put(octets, NETWORK, network >> 8, 1) if len(octets) > HEADER else octets


class HearsItself(Wrong):
    def hears(self, octets: bytearray) -> bytearray:
        own = bytes(octets[SENDER:NETWORK]) == self.inner.config.node_id
        return put(octets, SENDER, 0x02FFFFFFFFFF, 6) if own else octets


class RefusesZeroIdentifiers(Wrong):
    def hears(self, octets: bytearray) -> bytearray | None:
        return octets if any(octets[SENDER:NETWORK]) else None


class Rebuilds(Wrong):
    """Changes the blocks of a beacon that can be read."""

    def blocks(self, blocks: list[Payload]) -> list[Payload]:
        return blocks

    def hears(self, octets: bytearray) -> bytearray | None:
        try:
            envelope, end = self.codec.decode_envelope(bytes(octets))
        except DecodeError:
            return octets
        blocks = self.blocks(list(envelope.payloads))
        return bytearray(self.codec.encode_envelope(Beacon(envelope.bp, tuple(blocks)))) + octets[end:]


class FirstBlockOnly(Rebuilds):
    def blocks(self, blocks: list[Payload]) -> list[Payload]:
        return blocks[:1]


class StopsAtUnknown(Rebuilds):
    def blocks(self, blocks: list[Payload]) -> list[Payload]:
        for index, block in enumerate(blocks):
            if block.protocol_id > BP_PROTID_VARDIS:
                return blocks[: index or 1]
        return blocks


class EightBitProtocols(Rebuilds):
    def blocks(self, blocks: list[Payload]) -> list[Payload]:
        return [msgspec.structs.replace(each, protocol_id=each.protocol_id & 0xFF) for each in blocks]


class NoPadding(Wrong):
    def hears(self, octets: bytearray) -> bytearray | None:
        return octets if len(octets) < HEADER or number_at(octets, LENGTH, 2) + HEADER >= len(octets) else None


class CutsLongBlocks(Wrong):
    """Delivers what is left of a block that is too long."""

    def hears(self, octets: bytearray) -> bytearray:
        index = HEADER
        while index + 4 <= len(octets):
            rest = len(octets) - index - 4
            if number_at(octets, index + 2, 2) > rest:
                put(octets, index + 2, rest, 2)
            index += 4 + number_at(octets, index + 2, 2)
        return octets


class LittleEndianLengths(Wrong):
    def hears(self, octets: bytearray) -> bytearray:
        # As if only the second octet counted.
        if len(octets) > HEADER + 4 and number_at(octets, HEADER, 2) > BP_PROTID_VARDIS:
            put(octets, HEADER + 2, octets[HEADER + 3], 2)
        return octets


class NoRepeatedNumbers(Wrong):
    """Takes only what has a larger number than all before it."""

    def __init__(self, config: NodeConfig, rng: random.Random, now: int, wall: int) -> None:
        super().__init__(config, rng, now, wall)
        self.last: dict[bytes, int] = {}

    def hears(self, octets: bytearray) -> bytearray | None:
        number, sender = number_at(octets, SEQNO, 4), bytes(octets[SENDER:NETWORK])
        if number <= self.last.get(sender, -1):
            return None
        self.last[sender] = number
        return octets


class CrashesOnShortFrames(Wrong):
    def hears(self, octets: bytearray) -> bytearray:
        octets[HEADER - 1]
        return octets


class CrashesOnLongLengths(Wrong):
    def hears(self, octets: bytearray) -> bytearray:
        if len(octets) >= HEADER and number_at(octets, LENGTH, 2) + HEADER > len(octets):
            raise BufferError("read beyond the end")
        return octets


class CrashesOnEmptyBlocks(Wrong):
    def hears(self, octets: bytearray) -> bytearray:
        if len(octets) >= HEADER + 4 and number_at(octets, HEADER + 2, 2) == 0:
            raise BufferError("no octets")
        return octets


# -- transmission ------------------------------------------------------------------------------------------------------


class SaysVersion2(Wrong):
    def says(self, octets: bytearray) -> bytearray:
        return put(octets, VERSION, 2, 1)


class SwappedMagic(Wrong):
    def says(self, octets: bytearray) -> bytearray:
        return put(octets, MAGIC, 0x7E49, 2)


class CountsHeader(Wrong):
    def says(self, octets: bytearray) -> bytearray:
        return put(octets, LENGTH, len(octets), 2)


class ShortLength(Wrong):
    def says(self, octets: bytearray) -> bytearray:
        return put(octets, LENGTH, len(octets) - HEADER - 4 * octets[NUMBER], 2)


class SwappedLength(Wrong):
    def says(self, octets: bytearray) -> bytearray:
        octets[LENGTH : LENGTH + 2] = octets[LENGTH : LENGTH + 2][::-1]
        return octets


class OneBlockTooMany(Wrong):
    def says(self, octets: bytearray) -> bytearray:
        return put(octets, NUMBER, octets[NUMBER] + 1, 1)


class AlwaysOneBlock(Wrong):
    def says(self, octets: bytearray) -> bytearray:
        return put(octets, NUMBER, 1, 1)


class EverySecondNumber(Wrong):
    def says(self, octets: bytearray) -> bytearray:
        return put(octets, SEQNO, 2 * number_at(octets, SEQNO, 4), 4)


class NumberStays(Wrong):
    def says(self, octets: bytearray) -> bytearray:
        return put(octets, SEQNO, 0, 4)


class NumbersContinueAfterReset(Wrong):
    def says(self, octets: bytearray) -> bytearray:
        return put(octets, SEQNO, self.beacons + 1000, 4)


class FixedNetwork(Wrong):
    def says(self, octets: bytearray) -> bytearray:
        return put(octets, NETWORK, 0x1111, 2)


class NetworkInOneOctet(Wrong):
    def says(self, octets: bytearray) -> bytearray:
        return put(octets, NETWORK, 0, 1)


class OtherSender(Wrong):
    def says(self, octets: bytearray) -> bytearray:
        return put(octets, SENDER, 0x020000000009, 6) if self.beacons % 3 == 0 else octets


class Checksum(Wrong):
    def says(self, octets: bytearray) -> bytearray:
        return octets + sum(octets).to_bytes(4, "big")


class CountsTicks(Wrong):
    """Uses up a number for each period, whether there is something to send or not."""

    ticks = 0

    def handle_timeout(self, now: int, wall: int) -> None:
        self.ticks = now // (100 * MS)
        self.inner.handle_timeout(now, wall)

    def says(self, octets: bytearray) -> bytearray:
        return put(octets, SEQNO, self.ticks, 4)


class SlowBeacons(Wrong):
    """Has a period of 110 ms and says 100."""

    def configured(self, config: NodeConfig) -> NodeConfig:
        return msgspec.structs.replace(config, bp=msgspec.structs.replace(config.bp, beacon_period_ms=110))

    class services(Services):  # noqa: N801 - takes the place of an attribute
        def parameters(self) -> dict[str, Any]:
            return {**self.right.parameters(), "BPPAR_BEACON_PERIOD": 100}


# -- indications -------------------------------------------------------------------------------------------------------


class TellsTwice(Wrong):
    def tells(self, effect: Effect) -> list[Effect]:
        return [effect, effect] if isinstance(effect, PayloadReceived) else [effect]


class TellsLess(Wrong):
    def tells(self, effect: Effect) -> list[Effect]:
        if isinstance(effect, PayloadReceived):
            return [msgspec.structs.replace(effect, payload=effect.payload[:255])]
        return [effect]


class TellsNothingOfTransmission(Wrong):
    def tells(self, effect: Effect) -> list[Effect]:
        return [] if isinstance(effect, PayloadTransmitted) else [effect]


class ConfirmsFirstTransmissionOnly(Wrong):
    told = 0

    def tells(self, effect: Effect) -> list[Effect]:
        if isinstance(effect, PayloadTransmitted):
            self.told += 1
            return [effect] if self.told == 1 else []
        return [effect]


class TellsEpochOfThisBeacon(Wrong):
    def tells(self, effect: Effect) -> list[Effect]:
        if isinstance(effect, PayloadTransmitted):
            return [msgspec.structs.replace(effect, next_epoch=effect.next_epoch - 100 * MS)]
        return [effect]


# -- services ----------------------------------------------------------------------------------------------------------


def registering(**changes: Any) -> type[Wrong]:
    """A node that registers clients with something changed."""

    class Changed(Services):
        def register(
            self, prot_id: int, name: str, size: int, mode: Any, entries: int, several: bool, **at: int
        ) -> Any:
            given = {"name": name, "size": size, "mode": mode, "entries": entries, "several": several}
            for key, change in changes.items():
                given[key] = change(given[key])
            return self.right.register(prot_id, *given.values(), **at)  # type: ignore[arg-type]

    return type("Registering", (Wrong,), {"services": Changed})


def instead(wrong: QueueingMode, right: QueueingMode) -> type[Wrong]:
    """A node that does one mode instead of another."""
    return registering(mode=lambda mode: wrong if mode == right else mode)


def serving(**services: Any) -> type[Wrong]:
    """A node with other services; each is given the right ones and the request's arguments."""

    def bound(service: Any) -> Any:
        return lambda self, *args, **named: service(self.right, *args, **named)

    changed = type("Changed", (Services,), {name: bound(service) for name, service in services.items()})
    return type("Serving", (Wrong,), {"services": changed})


def _replaces(bp: Any, prot_id: int, *args: Any, **named: Any) -> RegisterConfirm:
    bp.deregister(prot_id)
    confirm: RegisterConfirm = bp.register(prot_id, *args, **named)
    return confirm


def _queue_size_first(
    bp: Any, prot_id: int, name: str, size: int, mode: Any, entries: int, *rest: Any, **at: Any
) -> Any:
    if entries <= 0 and QueueingMode(mode).is_queue:
        return RegisterConfirm(BPStatus.ILLEGAL_DROPPING_QUEUE_SIZE, None)
    return bp.register(prot_id, name, size, mode, entries, *rest, **at)


def _takes_empty(bp: Any, prot_id: int, payload: bytes, **named: Any) -> StatusConfirm:
    if payload or bp.client(prot_id) is None:
        confirm: StatusConfirm = bp.transmit_payload(prot_id, payload, **named)
        return confirm
    return StatusConfirm(BPStatus.OK)


def _ok(*_: Any, **__: Any) -> StatusConfirm:
    return StatusConfirm(BPStatus.OK)


def _one_more(bp: Any, prot_id: int) -> NumberConfirm:
    confirm: NumberConfirm = bp.query_number_buffered(prot_id)
    return msgspec.structs.replace(confirm, number=(confirm.number or 0) + 1)


def _unlisted(bp: Any) -> Any:
    confirm = bp.list_registered()
    return msgspec.structs.replace(confirm, protocols=confirm.protocols[:2])


def _loses_times(bp: Any) -> Any:
    confirm = bp.list_registered()
    entries = tuple(msgspec.structs.replace(each, time_stamp_registration=0) for each in confirm.protocols)
    return msgspec.structs.replace(confirm, protocols=entries)


def _full_is_an_error(bp: Any, prot_id: int, payload: bytes, **named: Any) -> StatusConfirm:
    client = bp.client(prot_id)
    full = client is not None and len(client.queue or ()) >= client.registration.max_entries > 0
    confirm: StatusConfirm = bp.transmit_payload(prot_id, payload, **named)
    return StatusConfirm(BPStatus.PAYLOAD_TOO_LARGE) if full else confirm


def _keeps_nothing_back(bp: Any, name: str, value: Any) -> Any:
    violation = bp.set_parameter(name, value)
    if violation is not None:
        bp.set_parameter(name, {"BPPAR_BEACON_PERIOD": 1000, "BPPAR_MAXIMUM_PACKET_SIZE": 300}.get(name, 7))
    return violation


RECEPTION: list[tuple[type[Wrong], str, str]] = [
    (AnyVersion, "TC_BP_RX_BI_01-ff", "BP-RX-01"),
    (AnyMagic, "TC_BP_RX_BI_02-7e49", "BP-RX-02"),
    (ChecksOneOctetOfMagic, "TC_BP_RX_BI_02-497f", "BP-RX-02"),
    (LengthZeroMeansAll, "TC_BP_RX_BI_03", "BP-RX-03"),
    (ZeroPayloadsMeansOne, "TC_BP_RX_BI_04", "BP-RX-04"),
    (AnyNetwork, "TC_BP_RX_BI_05-next", "BP-RX-05"),
    (OneOctetOfNetwork, "TC_BP_RX_BI_05-first-bit", "BP-RX-05"),
    (HearsItself, "TC_BP_RX_BI_06", "BP-RX-06"),
    (RefusesZeroIdentifiers, "TC_DCP_DATA_BV_07-zeros", "DATA-04"),
    (FirstBlockOnly, "TC_BP_RX_BV_01-2", "BP-RX-07"),
    (FirstBlockOnly, "TC_BP_RXP_BV_03-1-2-1", "BP-RX-07"),
    (StopsAtUnknown, "TC_BP_RX_BV_03-first", "BP-RX-08"),
    (StopsAtUnknown, "TC_BP_RX_BV_03-between", "BP-RX-08"),
    (EightBitProtocols, "TC_BP_RX_BI_08-0102", "BP-HDR-11"),
    (NoPadding, "TC_BP_RX_BV_06-1-zeros", "BP-RX-14"),
    (CutsLongBlocks, "TC_BP_RX_BI_09-one-octet-too-many", "BP-RX-09"),
    (CutsLongBlocks, "TC_BP_RX_BI_10-by-1000", "BP-RX-09"),
    (LittleEndianLengths, "TC_DCP_DATA_BV_02", "DATA-01"),
    (NoRepeatedNumbers, "TC_BP_RX_BV_05-repeated", "BP-RX-10"),
    (NoRepeatedNumbers, "TC_BP_RX_BV_05-decreasing", "BP-RX-10"),
    (NoRepeatedNumbers, "TC_BP_RX_BV_05-wrapping", "BP-RX-10"),
    (CrashesOnShortFrames, "TC_BP_RX_BI_24", "BP-RX-16"),
    (CrashesOnLongLengths, "TC_BP_RX_BI_13-1-octet", "BP-RX-15"),
    (CrashesOnEmptyBlocks, "TC_BP_RX_BV_04-vardis", "BP-RX-16"),
]
TRANSMISSION: list[tuple[type[Wrong], str, str]] = [
    (SaysVersion2, "TC_BP_HDR_BV_01", "BP-HDR-01"),
    (SwappedMagic, "TC_BP_HDR_BV_01", "BP-HDR-02"),
    (SwappedMagic, "TC_DCP_DATA_BV_01", "DATA-01"),
    (CountsHeader, "TC_BP_HDR_BV_06", "BP-HDR-06"),
    (ShortLength, "TC_BP_HDR_BV_06", "BP-HDR-06"),
    (SwappedLength, "TC_DCP_DATA_BV_01", "DATA-01"),
    (OneBlockTooMany, "TC_BP_HDR_BV_07", "BP-HDR-07"),
    (AlwaysOneBlock, "TC_BP_HDR_BV_07", "BP-HDR-07"),
    (EverySecondNumber, "TC_BP_HDR_BV_08", "BP-HDR-08"),
    (NumberStays, "TC_BP_HDR_BV_08", "BP-HDR-08"),
    (NumbersContinueAfterReset, "TC_BP_INI_BV_01", "BP-INI-02"),
    (CountsTicks, "TC_BP_HDR_BV_09", "BP-HDR-09"),
    (FixedNetwork, "TC_BP_PAR_BV_04", "BP-HDR-04"),
    (NetworkInOneOctet, "TC_BP_HDR_BV_05", "BP-HDR-04"),
    (OtherSender, "TC_BP_HDR_BV_04", "BP-HDR-03"),
    (Checksum, "TC_DCP_DATA_BV_06", "UWB-04"),
    (SlowBeacons, "TC_BP_TX_TI_01", "BP-TX-01"),
]
INDICATIONS: list[tuple[type[Wrong], str, str]] = [
    (TellsTwice, "TC_BP_RXP_BV_01-37", "BP-RXP-02"),
    (TellsLess, "TC_BP_RXP_BV_01-256", "BP-RXP-01"),
    (TellsNothingOfTransmission, "TC_BP_PTI_BV_01-once", "BP-PTI-01"),
    (ConfirmsFirstTransmissionOnly, "TC_BP_PTI_BV_02", "BP-PTI-03"),
    (TellsEpochOfThisBeacon, "TC_BP_PTI_TI_01", "BP-PTI-02"),
]
SERVICES: list[tuple[type[Wrong], str, str]] = [
    (instead(QueueingMode.QUEUE_DROPHEAD, QueueingMode.QUEUE_DROPTAIL), "TC_BP_QM_BV_01", "BP-QM-01"),
    (instead(QueueingMode.QUEUE_DROPTAIL, QueueingMode.QUEUE_DROPHEAD), "TC_BP_QM_BV_02", "BP-QM-02"),
    (instead(QueueingMode.ONCE, QueueingMode.QUEUE_DROPTAIL), "TC_BP_QM_BV_03-droptail", "BP-QM-03"),
    (instead(QueueingMode.REPEAT, QueueingMode.ONCE), "TC_BP_QM_BV_07", "BP-QM-04"),
    (instead(QueueingMode.QUEUE_DROPHEAD, QueueingMode.ONCE), "TC_BP_QM_BV_10-once", "BP-QRY-03"),
    (instead(QueueingMode.ONCE, QueueingMode.REPEAT), "TC_BP_QM_BV_08", "BP-QM-05"),
    (instead(QueueingMode.ONCE, QueueingMode.REPEAT), "TC_BP_QM_BV_10-repeat", "BP-TX-05"),
    (registering(several=lambda _: True), "TC_BP_QM_BV_05-droptail", "BP-QM-07"),
    (registering(entries=lambda entries: entries + 1), "TC_BP_QM_BV_01", "BP-QM-01"),
    (registering(entries=lambda entries: entries + 1), "TC_BP_QM_BV_04-drophead", "BP-QRY-02"),
    (registering(entries=lambda entries: max(entries, 1)), "TC_BP_REG_BI_03-droptail", "BP-REG-05"),
    (registering(size=lambda size: max(size, 1)), "TC_BP_REG_BI_01", "BP-REG-03"),
    (registering(size=lambda size: size - (size > 1)), "TC_BP_REG_BI_02-by-one", "BP-REG-04"),
    (registering(size=lambda size: size + 1), "TC_BP_REG_BV_03", "BP-REG-04"),
    (registering(size=lambda size: size + 1), "TC_BP_TXP_BI_01-1", "BP-TXP-02"),
    (registering(size=lambda size: size - (size > 1)), "TC_BP_TXP_BV_01-64", "BP-TXP-02"),
    (registering(name=lambda _: ""), "TC_BP_REG_BV_01-once", "BP-LST-01"),
    (
        registering(mode=lambda mode: mode if mode in set(QueueingMode) else "BP_QMODE_ONCE"),
        "TC_BP_REG_BI_05-BP_QMODE_LIFO",
        "BP-CLR-04",
    ),
    (serving(register=_replaces), "TC_BP_REG_BO_01", "BP-REG-02"),
    (serving(register=_replaces), "TC_BP_REG_BI_04-duplicate-and-size-0", "BP-REG-09"),
    (serving(register=_queue_size_first), "TC_BP_REG_BI_04-size-0-and-no-entries", "BP-REG-09"),
    (serving(deregister=_ok), "TC_BP_DRG_BV_01", "BP-DRG-02"),
    (serving(deregister=_ok), "TC_BP_DRG_BV_02-repeat", "BP-DRG-03"),
    (serving(deregister=_ok), "TC_BP_DRG_BO_01", "BP-DRG-01"),
    (serving(deregister=_ok), "TC_BP_RXP_BO_01", "BP-DRG-04"),
    (serving(list_registered=_unlisted), "TC_BP_LST_BV_01", "BP-LST-01"),
    (serving(list_registered=_loses_times), "TC_BP_REG_BV_01-repeat", "BP-REG-06"),
    (serving(transmit_payload=_takes_empty), "TC_BP_TXP_BI_02-repeat", "BP-TXP-03"),
    (serving(transmit_payload=_full_is_an_error), "TC_BP_QM_BV_02", "BP-TXP-05"),
    (serving(clear_buffer=_ok), "TC_BP_CLR_BV_01-drophead", "BP-CLR-02"),
    (serving(clear_buffer=_ok), "TC_BP_CLR_BV_01-repeat", "BP-CLR-03"),
    (serving(clear_buffer=_ok), "TC_BP_CLR_BO_01", "BP-CLR-01"),
    (serving(query_number_buffered=_one_more), "TC_BP_QM_BV_10-once", "BP-QRY-03"),
    (serving(query_number_buffered=_one_more), "TC_BP_DRG_BV_03-once", "BP-DRG-05"),
    (serving(deactivate=_ok), "TC_BP_MGT_BV_01", "BP-MGT-02"),
    (serving(deactivate=_ok), "TC_BP_MGT_BV_02", "BP-MGT-03"),
    (serving(activate=_ok), "TC_BP_MGT_BO_02", "BP-MGT-05"),
    (serving(set_parameter=_keeps_nothing_back), "TC_BP_PAR_BI_01-size-0", "BP-PAR-06"),
    (serving(set_parameter=_keeps_nothing_back), "TC_BP_PAR_BI_01-network-too-large", "BP-PAR-06"),
    (serving(set_parameter=lambda *_: None), "TC_BP_PAR_BV_01-period", "BP-PAR-01"),
    (serving(set_parameter=lambda *_: None), "TC_BP_PAR_BV_03", "BP-PAR-02"),
    (serving(set_parameter=lambda *_: None), "TC_BP_TX_TI_02-2", "BP-PAR-02"),
]


@pytest.mark.part("suite")
@pytest.mark.parametrize(
    ("wrong", "case_id", "requirement"),
    [
        pytest.param(*each, id=f"{each[0].__name__}-{each[1]}-{each[2]}")
        for each in (*RECEPTION, *TRANSMISSION, *INDICATIONS, *SERVICES)
    ],
)
def test_each_mutant_is_detected(wrong: type[Wrong], case_id: str, requirement: str) -> None:
    assert one_case(case_id).verdict is not Verdict.FAIL
    result = one_case(case_id, make=wrong)
    failed = {each for check in result.checks if check.verdict is Verdict.FAIL for each in check.requirements}
    assert requirement in failed, f"{result.verdict}: {result.reason} {result.error_detail}"


class LosesOneBlock(Rebuilds):
    """Has no room for the last block of one beacon, as a receiver on a busy machine."""

    def blocks(self, blocks: list[Payload]) -> list[Payload]:
        if len(blocks) == 4 and not vars(self).get("has_lost"):
            vars(self)["has_lost"] = True
            return blocks[:3]
        return blocks


def test_a_block_that_is_lost_once_is_sent_again() -> None:
    assert one_case("TC_BP_RXP_BV_03-1-1-1-1", make=LosesOneBlock).verdict is Verdict.PASS


def test_a_wrong_period_is_described_in_words() -> None:
    result = one_case("TC_BP_TX_TI_01", "dcp-2.0", SlowBeacons)
    assert re.search(r": a mean of \d+\.\d\d ms ± \d+\.\d\d ms \(\d+ intervals, 99 % confidence\)", result.reason)
