"""A world: the network that a network test runs in, in virtual time or in real time."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
from dcp_conformance.upper_tester import Answer

from dcp_codec.codec import Codec
from dcp_codec.impairment import Impairment


class Sent(NamedTuple):
    """A frame that a station transmitted. ``time``: ns since the start; ``octets``: the bearer payload."""

    time: int
    place: int
    octets: bytes


class Received(NamedTuple):
    """A frame that arrived at the station at ``place``."""

    time: int
    place: int
    sender: int
    octets: bytes


class Limits(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The limits of an implementation: parameters and capacities. Lengths are octets, times ms."""

    value: int = 32
    """VARDISPAR_MAX_VALUE_LENGTH."""
    description: int = 32
    """VARDISPAR_MAX_DESCRIPTION_LENGTH."""
    repetitions: int = 15
    """VARDISPAR_MAX_REPETITIONS."""
    summaries: int = 20
    """VARDISPAR_MAX_SUMMARIES."""
    payload: int = 1000
    """VARDISPAR_MAX_PAYLOAD_SIZE."""
    variables: int = 256
    """Variables that the database has room for."""
    neighbours: int = 1000
    """Entries that the neighbour table has room for."""
    neighbour_timeout_ms: float = 3000
    """SRPPAR_NEIGHBOUR_TABLE_TIMEOUT."""
    scrubbing_period_ms: float = 1000
    """VARDISPAR_SCRUBBING_PERIOD."""
    beacon_period_ms: float = 100
    """BPPAR_BEACON_PERIOD."""
    buffer_check_ms: float = 50
    """VARDISPAR_BUFFER_CHECK_PERIOD."""
    network_id: int | None = None
    """BPPAR_NETWORK_ID; None: the profile's."""


class Place(NamedTuple):
    """A station as the judge knows it."""

    number: int
    implementation: str
    codec: Codec
    node_id: bytes
    limits: Limits


class World(ABC):
    """The interface of a scene to its network. Times are ns since the start; places are numbers from 0.

    The number after the last place is the tester's own station: :meth:`transmit` sends as it.
    """

    places: list[Place]
    """The stations."""
    tester_address = b"\x02\x00\x00\x00\x7f\x01"
    """The address of the tester's own station."""
    epoch: int
    """The start as the clocks of the stations have it, in ns since 1970: recordings begin there."""
    patience = 1.0
    """1 in virtual time, more where machines are busy.

    A limit is extended by ``patience`` - 1 times the time that the change takes on the average (not by that factor:
    limits on bad links allow for bad luck, which a busy machine does not multiply).
    """
    most_backlog = float("inf")
    """The most seconds that are granted to stations for what they still have to work off."""

    def __init__(self, pairs: Sequence[tuple[int, int]]) -> None:
        """``pairs``: the directions (sender, receiver) between the places."""
        self.places = []
        self._pairs = pairs
        self._sent: list[Sent] = []
        self._deaths: dict[int, str] = {}

    @property
    def lateness(self) -> str:
        """Why the machine may have been too busy for the stations or the recorder; empty if it was not."""
        return ""

    @property
    @abstractmethod
    def now(self) -> int:
        """The time since the start."""

    @abstractmethod
    def run(self, duration: int) -> None:
        """Let time pass."""

    def sent(self) -> Sequence[Sent]:
        """Return all transmissions so far, in their order; the sequence grows."""
        return self._sent

    @abstractmethod
    def power(self, place: int, *, on: bool) -> None:
        """Switch a station on or off; it loses all state."""

    @abstractmethod
    def is_on(self, place: int) -> bool:
        """Return whether the station was switched on."""

    @abstractmethod
    def call(self, place: int, method: str, params: Mapping[str, Any]) -> Answer | None:
        """Call a service; None if the station has no upper tester or this method is missing."""

    @abstractmethod
    def offers(self, place: int, method: str) -> bool | None:
        """Return whether a method can be called there; None while the station is off and this is unknown."""

    @abstractmethod
    def set_quality(self, impairment: Impairment, sender: int | None = None, receiver: int | None = None) -> None:
        """Change the links between the places: all, or from and to single ones."""

    @abstractmethod
    def partition(self, groups: Sequence[Sequence[int]]) -> None:
        """Let frames stay within their groups; no groups: heal."""

    @abstractmethod
    def set_clock(self, place: int, offset: int) -> None:
        """Set the wall clock of a station ``offset`` ns ahead."""

    @abstractmethod
    def transmit(self, octets: bytes) -> None:
        """Broadcast a bearer payload from the tester's own station to all places."""

    def deaths(self) -> Mapping[int, str]:
        """Return how implementations ended without being told to, by place."""
        return self._deaths

    @abstractmethod
    def link_counters(self) -> dict[str, Any]:
        """Return what each direction between places did to frames, as plain data."""

    def settle(self) -> None:
        """Take in what is still under way, if anything is; nothing happens in the world afterwards."""
        return

    def received(self) -> Sequence[Received]:
        """Return what arrived at the places, as far as the world has it."""
        return ()

    def recordings(self) -> Mapping[int, Path]:
        """Return the recording of each place, as far as the world itself makes one."""
        return {}

    def logs(self) -> Mapping[int, str]:
        """Return the path of the log of each process."""
        return {}

    def close(self) -> None:
        """End everything that was started, if anything was."""
        return


def node_text(node_id: bytes) -> str:
    """Return a node identifier as text; identifiers of variable length are text already."""
    return node_id.decode() if b":" in node_id else node_id.hex(":")
