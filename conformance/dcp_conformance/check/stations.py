"""Which station sent a frame: the address of the frame against the node identifier in the beacon.

Whatever a forged beacon says must not be held against the node whose identifier it carries. A beacon that comes from
another station than all others with this identifier is the node's own only if it continues the node's numbers (a
gateway may carry the beacons of others); otherwise it gets a speaker of its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto

from dcp_spec.constants import BP_SEQNO_MODULUS

from dcp_conformance.frames.received import ReceivedBeacon

from .statements import speaker

#: A beacon continues a sequence of numbers that was so far behind at most.
_CONTINUES = 20
#: So many beacons under one identifier make it the usual one of a station.
_USUAL = 3


class Origin(Enum):
    """What the address of a frame says about the node identifier in it."""

    USUAL = auto()
    """The station uses this identifier, and nobody else does."""
    ANOTHER = auto()
    """The station has used another identifier before: several nodes, a gateway, or a change."""
    WRONG = auto()
    """It continues the station's own numbers, but not its identifier."""
    FORGED = auto()
    """The identifier belongs to another station, whose numbers it does not continue."""


@dataclass(slots=True)
class _Station:
    node: bytes
    frame: int
    """The first frame with the usual identifier."""
    seqno: int | None
    beacons: int = 1


class Stations:
    """All stations of a recording, by the address of their frames."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._stations: dict[bytes, _Station] = {}
        self._owners: dict[bytes, bytes] = {}
        """Node identifier -> the station that used it first."""
        self._last: dict[bytes, int | None] = {}
        """Node identifier -> number of its last beacon, from whatever station."""

    def attribute(self, heard: ReceivedBeacon) -> tuple[bytes, Origin, int | None]:
        """Who speaks in a frame, what the address says about it, and an earlier frame that shows the difference.

        The speaker of a forged beacon has a name of its own, which is text: ``"<address> as <identifier>"``.
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
        return last is not None and seqno is not None and (seqno - last) % BP_SEQNO_MODULUS <= _CONTINUES
