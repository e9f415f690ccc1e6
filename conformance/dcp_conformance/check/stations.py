"""Attribute frames to nodes by the source address of the frame and the senderId of the beacon.

A node must not be blamed for forged beacons that carry its identifier. A beacon from another source address than the
earlier beacons with this identifier is attributed to the node only if it continues the node's sequence numbers (a
gateway may forward beacons). Otherwise it is attributed to a separate sender.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto

from dcp_spec.constants import BP_SEQNO_MODULUS

from dcp_conformance.frames.received import ReceivedBeacon

from .statements import speaker

#: A beacon continues a sequence if its number is at most this much larger than the last one.
_CONTINUES = 20
#: Number of beacons with one identifier after which it is the usual one of a station.
_USUAL = 3


class Origin(Enum):
    """The relation between the source address of a frame and the senderId of its beacon."""

    USUAL = auto()
    """This station uses this identifier, and no other station does."""
    ANOTHER = auto()
    """The station has used another identifier before: it has several nodes, is a gateway, or was reconfigured."""
    WRONG = auto()
    """The beacon continues the sequence numbers of the station, but has another identifier."""
    FORGED = auto()
    """The identifier belongs to another station, and the beacon does not continue the sequence numbers of that one."""


@dataclass(slots=True)
class _Station:
    """A source address with the node identifier that it usually sends."""

    node: bytes
    frame: int
    """Number of the first frame with this identifier."""
    seqno: int | None
    """Sequence number of the last beacon attributed to the station."""
    beacons: int = 1
    """Number of beacons with this identifier."""


class Stations:
    """All stations of a recording, by the source address of their frames."""

    def __init__(self, most: int) -> None:
        """``most``: maximum number of stations to follow."""
        self._most = most
        self._stations: dict[bytes, _Station] = {}
        self._owners: dict[bytes, bytes] = {}
        """Node identifier -> source address that used it first."""
        self._last: dict[bytes, int | None] = {}
        """Node identifier -> sequence number of its last beacon, from any station."""

    def attribute(self, heard: ReceivedBeacon) -> tuple[bytes, Origin, int | None]:
        """Return the sender of a beacon, the result of the comparison, and an earlier frame that shows a difference.

        The sender of a forged beacon is the ASCII text ``<address> as <identifier>`` instead of a node identifier.
        """
        node, source = heard.sender, heard.source
        if node is None or not any(source) or heard.beacon is None:
            return speaker(heard), Origin.USUAL, None
        station = self._stations.get(source)
        seqno = heard.seqno
        if station is not None and station.node == node:
            station.beacons += 1
            station.seqno = self._last[node] = seqno
            return node, Origin.USUAL, None
        owner = self._owners.get(node)
        if station is None:
            if owner is None:
                if len(self._stations) < self._most:
                    self._stations[source] = _Station(node, heard.number, seqno)
                    self._owners[node] = source
                    self._last[node] = seqno
                return node, Origin.USUAL, None
        elif (
            station.beacons >= _USUAL
            and self._continues(station.seqno, seqno)
            and not self._continues(self._last.get(node), seqno)
        ):
            station.seqno = self._last[station.node] = seqno
            return station.node, Origin.WRONG, station.frame
        if owner is not None and owner != source:
            owned = self._stations[owner]
            if owned.beacons >= _USUAL and not self._continues(self._last.get(node), seqno):
                name = node.hex(":") if len(node) <= 8 else node.decode("ascii", "replace")
                return f"{source.hex(':')} as {name}".encode(), Origin.FORGED, owned.frame
        self._last[node] = seqno
        return node, Origin.ANOTHER, self._stations[owner].frame if owner else station.frame if station else None

    @staticmethod
    def _continues(last: int | None, seqno: int | None) -> bool:
        """Whether ``seqno`` is at most ``_CONTINUES`` larger than ``last`` (modulo 2^32)."""
        return last is not None and seqno is not None and (seqno - last) % BP_SEQNO_MODULUS <= _CONTINUES
