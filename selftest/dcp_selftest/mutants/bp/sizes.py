"""Faults of BP with numbers, names and queues beyond those of usual clients, and heuristics of its receiver."""

from __future__ import annotations

from typing import Any

import msgspec
from dcp_spec.constants import BP_MAX_PAYLOADS, SpecVersion

from dcp_selftest.mutants.bp.kept import listed
from dcp_selftest.mutants.bp.queueing import OwnQueue, places
from dcp_selftest.mutants.bp.receive import chosen, repaired
from dcp_selftest.mutants.family import assign, before
from dcp_selftest.mutants.mutant import mutant
from dcp_selftest.mutants.unseen import BP_ALWAYS_ACTIVE
from dcp_stack.bp.clients import ClientList
from dcp_stack.bp.entity import BeaconingProtocol
from dcp_stack.bp.queue import PayloadQueue, Submission
from dcp_stack.bp.receive import Receiver

V1_1, V1_2 = SpecVersion.V1_1, SpecVersion.V1_2

# fmt: off
before(BeaconingProtocol, BeaconingProtocol.handle_timeout)("sixteen-bits", "BP-HDR-08",
    "counts beacons modulo 65,536",
    lambda self, now, wall: assign(self, _seqno=self._seqno % 65_536))
repaired("low-bits", "BP-RX-01", "compares only the low four bits of version",
    lambda self, octets: self.put(octets, "version", 1) if self.number(octets, "version") & 15 == 1 else octets)
places("at-most-255", "BP-QM-01 BP-QM-02 BP-QM-03", "treats maxEntries above 255 as 255",
    lambda self, entries: min(entries, 255), unseen=BP_ALWAYS_ACTIVE, since=V1_2)
places("eight-bits", "BP-QM-01 BP-QM-02 BP-QM-03", "uses maxEntries modulo 256",
    lambda self, entries: entries % 256 or 1, unseen=BP_ALWAYS_ACTIVE, since=V1_2)
listed("cut-at-31", "BP-LST-01", "lists at most 31 characters of a name",
    lambda self, each: msgspec.structs.replace(each, protocol_name=each.protocol_name[:31]), since=V1_1)
listed("cut-at-63", "BP-LST-01", "lists at most 63 octets of a name",
    lambda self, each: msgspec.structs.replace(each, protocol_name=each.protocol_name.encode()[:63].decode(
        errors="ignore")), since=V1_1)
listed("entries-as-octet", "BP-LST-01", "lists maxEntries modulo 256",
    lambda self, each: msgspec.structs.replace(each, max_entries=each.max_entries % 256), since=V1_1)
chosen("signed", "BP-RX-07 BP-HDR-07", "reads numPayloads as a signed number",
    lambda self, blocks: blocks if len(blocks) < 128 else ())
# fmt: on


@mutant("counts-on", "BP-TX-08 BP-HDR-07", "puts more than 255 blocks into a beacon, and counts them modulo 256")
class CountsOn(BeaconingProtocol):
    def __init__(self, *args: Any, **more: Any) -> None:
        super().__init__(*args, **more)
        clients: Any = self._clients
        wire: Any = self._wire
        take, build = clients.take, wire.build

        def built(seqno: int, network_id: int | None, blocks: list[tuple[int, bytes]]) -> bytes:
            octets = bytearray(build(seqno, network_id, blocks[:BP_MAX_PAYLOADS]))
            for protocol_id, payload in blocks[BP_MAX_PAYLOADS:]:
                octets += protocol_id.to_bytes(2, "big") + len(payload).to_bytes(2, "big") + payload
            octets[wire._places["numPayloads"]] = bytes((len(blocks) % 256,))
            if "length" in wire._places:
                octets[wire._places["length"]] = (len(octets) - wire.header_size).to_bytes(2, "big")
            return bytes(octets)

        clients.take = lambda room, size, most: take(room, size, 1 << 16 if most > 1 else most)
        wire.build = built


@mutant("sixteen-clients", "BP-REG-06", "loses the oldest of more than 16 clients")
class SixteenClients(ClientList):
    def insert(self, client: Any) -> None:
        outside = [each for each in self if each.protocol_id > 2]
        if len(outside) >= 14:
            self.remove(outside[0].protocol_id)
        super().insert(client)


@mutant("ignores-noisy", "BP-RX-16 BP-RX-07", "ignores a sender after ten damaged beacons of it")
class IgnoresNoisy(Receiver):
    def receive(self, octets: bytes, now: int) -> None:
        bad: dict[bytes, int] = self.__dict__.setdefault("bad", {})
        found = self._wire.parse(octets)
        sender = b"" if found.header is None else found.header.sender_id
        if found.header is not None and found.fault is not None:
            bad[sender] = bad.get(sender, 0) + 1
        if bad.get(sender, 0) < 10:
            super().receive(octets, now)


@mutant("equal-dropped", "BP-QM-03", "discards a payload that equals the last one in a queue")
class EqualDropped(OwnQueue):
    class queue(PayloadQueue):  # noqa: N801 - as above
        def submit(self, payload: bytes) -> Submission:
            if self._payloads and self._payloads[-1] == payload:
                return "discarded"
            return super().submit(payload)
