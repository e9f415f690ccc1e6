"""Nodes that cannot stand some damage, and frames that have several kinds of damage at once."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator

from dcp_conformance.definitions.pics import Pics
from dcp_conformance.execution.runner import Runner
from dcp_conformance.execution.target import Target
from dcp_conformance.reference.inprocess import InProcess, reference_config
from dcp_conformance.test_system.bench import Session
from dcp_lab.fuzz import Frame
from dcp_lab.fuzz.generate.samples import Samples
from dcp_spec.constants import BP_PROTID_VARDIS, ICType

from dcp_codec import Codec
from dcp_codec.values import Beacon, Payload
from dcp_stack.node import Node

CODEC = Codec("dcp-2.0")
#: Fault -> the anomaly on which a node with it crashes, as the fuzzer has to name it.
FAULTS = {
    "length-beyond-the-frame": "beacon-overrun at bp.length",
    "empty-vardis-block": "empty-payload at payloads[].length of VarDis",
    "empty-frame": "empty-frame",
    "unknown-type": "unknown-type at payloads[].vardis[].icType",
    "count-0": "zero-count at payloads[].vardis[].icNumRecords",
    "block-beyond-the-beacon": "block-overrun at payloads[].length of VarDis",
    "cut": "truncated at payloads[].vardis[].records[].",
}


def damage(octets: bytes) -> Iterator[str]:
    """Anomalies of a frame of dcp-2.0, found by hand-written code as in an implementation."""
    if not octets:
        yield "empty-frame"
    if len(octets) < 18:
        return
    end = 18 + int.from_bytes(octets[11:13], "big")
    if end > len(octets):
        yield "length-beyond-the-frame"
        end = len(octets)
    at = 18
    while at + 4 <= end:
        protocol, size = int.from_bytes(octets[at : at + 2], "big"), int.from_bytes(octets[at + 2 : at + 4], "big")
        at += 4
        if protocol == 2 and at + size > end:
            yield "block-beyond-the-beacon"
        if protocol == 2 and not size:
            yield "empty-vardis-block"
        if protocol == 2:
            yield from containers(octets[at : min(at + size, end)])
        at += size


def containers(payload: bytes) -> Iterator[str]:
    """The first anomaly of a VarDis payload; the octets after it cannot be read."""
    at = 0
    while at + 2 <= len(payload):
        kind, count = payload[at], payload[at + 1]
        at += 2
        if not 1 <= kind <= 6:
            yield "unknown-type"
            return
        if not count:
            yield "count-0"
        for _ in range(count):
            at = after_record(kind, payload, at)
            if at > len(payload):
                yield "cut"
                return


def after_record(kind: int, payload: bytes, at: int) -> int:
    """Where the next record is."""
    match kind:
        case 1 | 3:
            return at + 2
        case 4 | 6:
            return at + 1
    if kind == 5:
        # varId, prodId, repCnt, creationTime, timeout, then the description.
        at += 18
        at += 1 + (payload[at] if at < len(payload) else 0)
    return at + 3 + (payload[at + 2] if at + 2 < len(payload) else 0)


class Fragile(Node):
    """Our node, which stops at frames with some damage, wherever in the frame that is, and whatever else is there."""

    deadly: tuple[str, ...] = ()
    silent: tuple[str, ...] = ()
    deaf = False

    def handle_frame(self, octets, *, now, wall):
        found = set(damage(octets))
        for fault in self.deadly:
            if fault in found:
                raise RuntimeError(f"terminate called after throwing {fault} at 0x{now:x}")
        self.deaf |= not found.isdisjoint(self.silent)
        if not self.deaf:
            super().handle_frame(octets, now=now, wall=wall)


def make_of(deadly=(), silent=()):
    kind = type("Made", (Fragile,), {"deadly": tuple(deadly), "silent": tuple(silent)})
    return lambda config, rng, now, wall: kind(config, rng=rng, now=now, wall=wall)


def opened(make) -> Target:
    """Such a node connected to a bench, in virtual time."""
    sut = InProcess(reference_config(CODEC), make=make)
    runner = Runner(Session(CODEC, sut.lower_tester(), sut.upper_tester(), Pics()), sut)
    runner.prepare()
    return Target(CODEC, Pics(), runner, [])


def damages() -> dict[str, Callable[[random.Random], Payload]]:
    """Blocks with one kind of damage each, among ordinary records with long values."""
    samples = Samples(CODEC)

    def vardis(*parts: bytes) -> Payload:
        return Payload(BP_PROTID_VARDIS, b"".join(parts))

    def ballast(rng: random.Random) -> bytes:
        kinds = rng.sample(list(ICType), 2)
        return CODEC.encode_containers(tuple(samples.container(kind, rng.randint(1, 9)) for kind in kinds))

    return {
        "empty-vardis-block": lambda rng: vardis(),
        "unknown-type": lambda rng: vardis(ballast(rng), b"\x09\x01" + rng.randbytes(200)),
        "count-0": lambda rng: vardis(ballast(rng), bytes((rng.randint(1, 6), 0))),
        "cut": lambda rng: vardis(ballast(rng), b"\x02\x01\x05\x06\x20abc"),
        "zero-repetitions": lambda rng: vardis(ballast(rng)),
    }


def mixed(rng: random.Random, fault: str) -> Frame:
    """A frame with a fault and others, in any order; ``valid`` is not told."""
    kinds = damages()
    others = rng.sample([name for name in kinds if name != fault], 2)
    blocks = [kinds[name](rng) for name in others]
    if fault in kinds:
        blocks.append(kinds[fault](rng))
    rng.shuffle(blocks)
    header = CODEC.decode(Samples(CODEC).each()[0]).bp
    octets = CODEC.encode_envelope(Beacon(header, tuple(blocks)))
    if fault == "length-beyond-the-frame":
        octets = octets[:11] + b"\xf0\x00" + octets[13:]
    if fault == "block-beyond-the-beacon":
        # The last block: there is no other after its length.
        size = len(blocks[-1].content)
        place = len(octets) - size - 2
        octets = octets[:place] + (size + 500).to_bytes(2, "big") + octets[place + 2 :]
    return Frame(b"" if fault == "empty-frame" else octets)
