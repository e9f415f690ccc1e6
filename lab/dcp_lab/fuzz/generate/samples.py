"""Make the smallest ordinary messages of a profile, for repairs and for the sweep."""

from __future__ import annotations

from typing import Final

from dcp_conformance.frames.sampling import sampler
from dcp_spec.constants import BP_PROTID_SRP, BP_PROTID_VARDIS, ICType

from dcp_codec.codec import Codec
from dcp_codec.values import Beacon, Container, Payload, VardisRecord

#: Protocol identifier that no node implements.
OTHER_PROTOCOL: Final = 0x77
#: Description and value of variables.
TEXT: Final = b"a"


class Samples:
    """Factory of records, blocks and beacons with the smallest ordinary contents. The default variable is 0."""

    def __init__(self, codec: Codec) -> None:
        self.codec = codec
        self._made = sampler(codec)
        self._numbers = codec.profile.vardis.container_types.by_name()

    def node(self, number: int = 1) -> bytes:
        """Return the node identifier of a station."""
        return self.codec.profile.types.node_id.of(self.address(number))

    def address(self, number: int) -> bytes:
        """Return the link-layer address of a station."""
        return b"\x02\xdc\x90" + number.to_bytes(3, "big")

    def record(self, kind: ICType, var_id: int = 0) -> VardisRecord:
        """Return a record of a kind."""
        if kind is ICType.CREATE_VARIABLES:
            return self._made.create(self._made.spec(var_id, self.node(), 1, TEXT, creation_time=1), 0, TEXT)
        return self._made.record(kind, var_id, 0, TEXT)

    def container(self, kind: ICType, count: int = 1) -> Container:
        """Return a container of ``count`` records of a kind, about different variables as far as possible."""
        top = 1 << (8 * min(2, self.codec.profile.types.var_id.width))
        records = tuple(self.record(kind, number % top) for number in range(count))
        return Container(self._numbers[kind.label], records)

    def vardis(self, *containers: Container) -> Payload:
        """Return a VarDis block."""
        return Payload(BP_PROTID_VARDIS, containers)

    def report(self, number: int = 1, seqno: int = 0) -> Payload:
        """Return an SRP block with the state report of a station. Only for profiles with SRP."""
        return Payload(BP_PROTID_SRP, self._made.report(self.node(number), 0, seqno))

    def other(self, octets: bytes = b"\0") -> Payload:
        """Return a block of an unknown protocol."""
        return Payload(OTHER_PROTOCOL, octets)

    def beacon(self, *blocks: Payload, station: int = 1) -> bytes:
        """Return a beacon of a station. Raises ``EncodeError`` if a value does not fit into a field of the profile."""
        return self.codec.encode(Beacon(self._made.header(self.node(station), 0), blocks))

    def each(self) -> list[bytes]:
        """Return a beacon for each kind of container, one with a state report and one of an unknown protocol."""
        kinds = sorted(ICType, key=lambda kind: kind is not ICType.REQUEST_VARCREATES)
        found = [self.beacon(self.vardis(self.container(kind))) for kind in kinds]
        if self.codec.report_plan is not None:
            found.append(self.beacon(self.report()))
        return [*found, self.beacon(self.other())]
