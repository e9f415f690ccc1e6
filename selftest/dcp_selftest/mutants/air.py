"""A node whose received and sent beacons can be changed between the node and the link."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import msgspec
from dcp_spec.constants import BP_PROTID_VARDIS, ICType

from dcp_codec.errors import DecodeError
from dcp_codec.values import Beacon, Container, ExtendedSafetyData, Payload
from dcp_stack.effects import Effect, SendBeacon
from dcp_stack.node import Node


class Air(Node):
    """Changes nothing; mutants override one of the public methods."""

    wall = 0
    """Wall clock time of the last event, ns since 1970."""

    def handle_frame(self, octets: bytes, *, now: int, wall: int) -> None:
        self.wall = wall
        for each in self.hears(octets):
            super().handle_frame(each, now=now, wall=wall)

    def handle_timeout(self, now: int, wall: int) -> None:
        self.wall = wall
        super().handle_timeout(now, wall)

    def take_effects(self) -> list[Effect]:
        return [changed for effect in super().take_effects() for changed in self._changed(effect)]

    def _changed(self, effect: Effect) -> Iterator[Effect]:
        try:
            beacon = self.config.codec.decode(effect.octets) if isinstance(effect, SendBeacon) else None
        except DecodeError:
            # A client outside of the node may send any octets under its protocol identifier.
            beacon = None
        if beacon is None or not isinstance(effect, SendBeacon):
            yield effect
            return
        blocks = tuple(self._block(block) for block in self.blocks(beacon))
        octets = effect.octets
        if blocks != beacon.payloads:
            blocks = tuple(block for block in blocks if block.content)
            if not blocks:
                return
            octets = self.config.codec.encode_envelope(Beacon(beacon.bp, tuple(map(self._octets, blocks))))
        for each in self.sends(octets):
            yield msgspec.structs.replace(effect, octets=each, num_payloads=len(blocks))

    def _block(self, block: Payload) -> Payload:
        content = block.content
        if isinstance(content, ExtendedSafetyData):
            content = self.report(content)
        elif isinstance(content, tuple):
            content = tuple(self.containers(content))
        return Payload(block.protocol_id, content, block.extra)

    def _octets(self, block: Payload) -> Payload:
        content = block.content
        if isinstance(content, ExtendedSafetyData):
            content = self.config.codec.encode_report(content)
        elif isinstance(content, tuple):
            content = self.config.codec.encode_containers(content)
        return Payload(block.protocol_id, content, block.extra)

    def kind(self, container: Container) -> ICType:
        """Return the type of a container, whatever its number in the profile."""
        numbers = self.config.profile.vardis.container_types.by_name()
        return next(kind for kind in ICType if numbers[kind.label] == container.ic_type)

    # -- what goes ---------------------------------------------------------------------------------------------

    def blocks(self, beacon: Beacon) -> Iterable[Payload]:
        """Return the blocks of a beacon to be sent."""
        return beacon.payloads

    def report(self, report: ExtendedSafetyData) -> ExtendedSafetyData:
        """Return a state report to be sent."""
        return report

    def containers(self, containers: tuple[Container, ...]) -> Iterable[Container]:
        """Return the instruction containers to be sent."""
        return containers

    def sends(self, octets: bytes) -> Iterable[bytes]:
        """Yield the octets of beacons to be sent."""
        yield octets

    # -- what comes --------------------------------------------------------------------------------------------

    def hears(self, octets: bytes) -> Iterable[bytes]:
        """Yield the octets of beacons that the node receives."""
        yield octets

    def instructions(self, octets: bytes) -> tuple[Container, ...]:
        """Return the instruction containers in the octets of a beacon; none if it cannot be decoded."""
        codec = self.config.codec
        found: list[Container] = []
        try:
            for block in codec.decode_envelope(octets)[0].payloads:
                if block.protocol_id == BP_PROTID_VARDIS and isinstance(block.content, bytes):
                    found += codec.decode_containers(block.content)
        except DecodeError:
            return ()
        return tuple(found)
