"""Faults of the daemon by name: each makes a subclass of a node with one thing wrong.

``FAULTS`` has them all. A name that begins with ``M-`` is that of a mutant of the self-test.
"""

from __future__ import annotations

import importlib
from collections import deque
from collections.abc import Callable, Iterable
from typing import Any, Protocol

import msgspec
from dcp_spec.constants import BP_PROTID_SRP, BP_PROTID_VARDIS, ICType, QueueingMode

from dcp_codec.errors import DecodeError
from dcp_codec.values import Beacon, Payload
from dcp_stack.bp.wire import BPWire, Reception
from dcp_stack.effects import SendBeacon
from dcp_stack.node import Node

NodeClass = type[Node]
#: Octets of a state report that is none: as much as a report of the public implementation has, all wrong.
GARBAGE = bytes.fromhex("deadbeef") * 10


class Victim(Protocol):
    """A process that a fault can end."""

    def die(self, words: str, after: float = 0.0) -> None:
        """Die for this reason, ``after`` so many s and what the switches add to it."""
        ...


Fault = Callable[[NodeClass, Victim], NodeClass]


def with_faults(names: Iterable[str], victim: Victim, *, poll_ms: float | None = None) -> NodeClass:
    """The class of a node with these faults. Raises ``KeyError`` for a name that there is not."""
    made: NodeClass = Node
    for name in sorted(names, key=lambda name: not name.startswith("M-")):
        # Mutants are subclasses of the unchanged node: they come first.
        made = mutant(name) if name.startswith("M-") else FAULTS[name](made, victim)
    return made if poll_ms is None else polling(made, round(poll_ms * 1e6))


def mutant(name: str) -> NodeClass:
    """The class of a node that is a mutant of the self-test."""
    node_with = importlib.import_module("dcp_selftest.mutants.mutant").node_with
    modules_of = importlib.import_module("dcp_conformance.definitions.registry").modules_of
    for module in modules_of("dcp_selftest.mutants"):
        for value in vars(importlib.import_module(module)).values():
            made = vars(value).get("__dcp_mutant__") if isinstance(value, type) else None
            if made is not None and made.id == name:
                found: NodeClass = node_with(value)
                return found
    raise KeyError(name)


# -- what comes --------------------------------------------------------------------------------------------------------


def crashes_on(words: str, lethal: Callable[[Reception, bytes, int], bool]) -> Fault:
    """Crash on a frame. ``lethal`` gets the decoded frame, its octets and the size of a BP header."""

    def apply(base: NodeClass, victim: Victim) -> NodeClass:
        class Dying(base):  # type: ignore[valid-type, misc]
            def handle_frame(self, octets: bytes, *, now: int, wall: int) -> None:
                wire = BPWire(self.config)
                if lethal(wire.parse(octets), octets, wire.header_size):
                    victim.die(words)
                super().handle_frame(octets, now=now, wall=wall)

        return Dying

    return apply


def has_empty_vardis(reception: Reception, _octets: bytes, _header: int) -> bool:
    """A VarDis block of length 0."""
    return any(each.protocol_id == BP_PROTID_VARDIS and not each.payload for each in reception.blocks)


def is_overrun(reception: Reception, _octets: bytes, _header: int) -> bool:
    """``length`` in the header reaches beyond the frame."""
    return reception.fault is not None and reception.fault.reason == "beacon-overrun"


def is_short(_reception: Reception, octets: bytes, header: int) -> bool:
    """Shorter than a header."""
    return len(octets) < header


def never_answers(base: NodeClass, _victim: Victim) -> NodeClass:
    """Hears nothing; what it has to say by itself it says."""

    class Deaf(base):  # type: ignore[valid-type, misc]
        def handle_frame(self, octets: bytes, *, now: int, wall: int) -> None:
            return

    return Deaf


def deaf_to(*kinds: ICType) -> Fault:
    """Does not take instruction containers of some kinds; all the rest it does."""

    def apply(base: NodeClass, _victim: Victim) -> NodeClass:
        class Selective(base):  # type: ignore[valid-type, misc]
            def handle_frame(self, octets: bytes, *, now: int, wall: int) -> None:
                super().handle_frame(self._without(octets), now=now, wall=wall)

            def _without(self, octets: bytes) -> bytes:
                codec = self.config.codec
                numbers = self.config.profile.vardis.container_types.by_name()
                unheard = {numbers[kind.label] for kind in kinds}
                try:
                    beacon = codec.decode(octets)
                except DecodeError:
                    return octets
                blocks = []
                for block in beacon.payloads:
                    content: Any = block.content
                    if isinstance(content, tuple):
                        content = tuple(each for each in content if each.ic_type not in unheard)
                    if content:
                        blocks.append(Payload(block.protocol_id, content, block.extra))
                return codec.encode(Beacon(beacon.bp, tuple(blocks))) if blocks else b""

        return Selective

    return apply


def polling(base: NodeClass, period: int) -> NodeClass:
    """VarDis takes one received payload every ``period`` ns; nothing is lost."""

    class Polling(base):  # type: ignore[valid-type, misc]
        def _build(self, now: int, wall: int) -> None:
            self._waiting: deque[bytes] = deque()
            self._next_poll = now
            super()._build(now, wall)

        def _received(self, effect: Any, now: int, wall: int) -> bool:
            if effect.protocol_id == BP_PROTID_VARDIS and self.vardis is not None and self._vardis_port.holds:
                self._waiting.append(effect.payload)
                return True
            return bool(super()._received(effect, now, wall))

        def handle_timeout(self, now: int, wall: int) -> None:
            if now >= self._next_poll:
                # The polls continue in the same rhythm, whether there is something or not.
                self._next_poll += ((now - self._next_poll) // period + 1) * period
                if self._waiting and self.vardis is not None:
                    self.vardis.handle_payload(self._waiting.popleft(), now=now, wall=wall)
            super().handle_timeout(now, wall)

        def poll_timeout(self) -> int | None:
            due: int | None = super().poll_timeout()
            if not self._waiting:
                return due
            return self._next_poll if due is None else min(due, self._next_poll)

    return Polling


# -- services ----------------------------------------------------------------------------------------------------------


def crashes_on_clear_buffer(base: NodeClass, victim: Victim) -> NodeClass:
    """Confirms that the buffer of a client with mode REPEAT is cleared; dies when it looks into it for a beacon."""

    class Dying(base):  # type: ignore[valid-type, misc]
        def _build(self, now: int, wall: int) -> None:
            super()._build(now, wall)
            clear = self.bp.clear_buffer

            def clear_buffer(prot_id: int) -> Any:
                confirm = clear(prot_id)
                client = self.bp.client(prot_id)
                if client is not None and client.registration.queue_mode is QueueingMode.REPEAT:
                    victim.die("trying to peek from an empty buffer", self.config.bp.beacon_period_ms / 1000)
                return confirm

            self.bp.clear_buffer = clear_buffer

    return Dying


# -- what goes ---------------------------------------------------------------------------------------------------------


def sends(change: Callable[[bytes, BPWire], bytes]) -> Fault:
    """Other octets in every beacon."""

    def apply(base: NodeClass, _victim: Victim) -> NodeClass:
        class Sending(base):  # type: ignore[valid-type, misc]
            def take_effects(self) -> list[Any]:
                wire = BPWire(self.config)
                return [
                    msgspec.structs.replace(effect, octets=change(effect.octets, wire))
                    if isinstance(effect, SendBeacon)
                    else effect
                    for effect in super().take_effects()
                ]

        return Sending

    return apply


def header_number(field: str, change: Callable[[int, BPWire], int], width: int) -> Callable[[bytes, BPWire], bytes]:
    """Another number in a field of the header, big-endian."""

    def changed(octets: bytes, wire: BPWire) -> bytes:
        start = wire.offset(field)
        if start < 0:
            return octets
        number = change(int.from_bytes(octets[start : start + width]), wire) % (1 << (8 * width))
        return octets[:start] + number.to_bytes(width) + octets[start + width :]

    return changed


def swapped_magic(octets: bytes, wire: BPWire) -> bytes:
    """The magic number in little-endian order."""
    start = wire.offset("magicNo")
    return octets[:start] + octets[start : start + 2][::-1] + octets[start + 2 :]


def blocks_count_headers(octets: bytes, wire: BPWire) -> bytes:
    """The length of each block counts the header of the block."""
    changed = bytearray(octets)
    for block in wire.parse(octets).blocks:
        length = len(block.payload) + wire.block_header_size
        changed[block.offset + 2 : block.offset + 4] = length.to_bytes(2)
    return bytes(changed)


def garbage_report(octets: bytes, wire: BPWire) -> bytes:
    """An SRP block first in each beacon that is not a state report, in the place of any that is one."""
    reception = wire.parse(octets)
    if reception.header is None:
        return octets
    others = [(each.protocol_id, each.payload) for each in reception.blocks if each.protocol_id != BP_PROTID_SRP]
    header = reception.header
    return wire.build(header.seqno, header.network_id, [(BP_PROTID_SRP, GARBAGE), *others])


FAULTS: dict[str, Fault] = {
    "crashes-on-empty-vardis": crashes_on("PDU not found", has_empty_vardis),
    "crashes-on-overrun": crashes_on("AreaException not enough space", is_overrun),
    "crashes-on-short-frame": crashes_on("PDU shorter than a header", is_short),
    "crashes-on-clear-buffer": crashes_on_clear_buffer,
    "never-answers": never_answers,
    "no-requests-for-summaries": deaf_to(ICType.SUMMARIES),
    "no-creates": deaf_to(ICType.CREATE_VARIABLES),
    "magic-swapped": sends(swapped_magic),
    "length-with-header": sends(header_number("length", lambda length, wire: length + wire.header_size, 2)),
    "one-payload-more": sends(header_number("numPayloads", lambda count, _: count + 1, 1)),
    "block-length-with-header": sends(blocks_count_headers),
    "garbage-srp": sends(garbage_report),
}
