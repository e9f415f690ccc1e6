"""Several stations and the links between them: which frames arrive where, when, and with which impairment."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import msgspec

from .channel import Channel
from .counters import Counters
from .parameters import PERFECT, Impairment, ImpairmentError


class Transit(NamedTuple):
    """The arrival of a frame at ``receiver``. ``time`` and ``sent`` are ns since the start."""

    time: int
    sender: int
    receiver: int
    octets: bytes
    sent: int


class _Flight(NamedTuple):
    time: int
    number: int
    transit: Transit


class Network:
    """Stations 0..``ports`` - 1. A broadcast reaches all stations in reach of the sender, each over its own channel.

    Order of calls: :meth:`broadcast` any number of times, :meth:`poll_timeout` for the time of the next arrival, and
    :meth:`due` at that time. Each direction has its own seed (``seed`` and ``"SENDER>RECEIVER"``), so the traffic of
    one station does not change the fate of another station's frames.

    Raises ``ImpairmentError`` for stations that do not exist.
    """

    def __init__(
        self,
        ports: int,
        *,
        default: Impairment = PERFECT,
        seed: int = 1,
        hears: Iterable[tuple[int, int]] | None = None,
    ) -> None:
        """``hears``: the pairs (sender, receiver) in reach of each other; None: every station reaches every other."""
        self.ports = ports
        self._default, self._seed = default, seed
        everybody = ((a, b) for a in range(ports) for b in range(ports) if a != b)
        reach = sorted(set(everybody if hears is None else hears))
        for sender, receiver in reach:
            self._known(sender, receiver)
        self._channels = {(a, b): Channel(default, seed, f"{a}>{b}") for a, b in reach}
        self._receivers = {a: [b for each, b in reach if each == a] for a in range(ports)}
        self._own: set[tuple[int, int]] = set()
        """Directions whose impairment was set individually."""
        self._member: dict[int, int] | None = None
        self._off: set[int] = set()
        self._flights: list[_Flight] = []
        self._number = 0

    # -- quality -------------------------------------------------------------------------------------------------------

    def set(self, impairment: Impairment, sender: int | None = None, receiver: int | None = None) -> None:
        """Set the impairment of one direction, or with (None, None) of all directions without an individual one.

        With one of the two given: of all directions from this sender, or to this receiver.
        """
        if sender is None and receiver is None:
            self._default = impairment
            chosen = [each for each in self._channels if each not in self._own]
        else:
            self._known(*(each for each in (sender, receiver) if each is not None))
            chosen = [(a, b) for a, b in self._channels if (sender is None or a == sender) and receiver in (None, b)]
            if not chosen:
                raise ImpairmentError(f"link {sender}>{receiver}: {receiver} is not in reach of {sender}")
            self._own.update(chosen)
        for each in chosen:
            self._channels[each].change(impairment)

    def partition(self, groups: Sequence[Iterable[int]]) -> None:
        """Restrict frames to their groups; the stations in no group form another one. Without groups the partition
        ends.
        """
        member: dict[int, int] = {}
        for number, group in enumerate(groups, start=1):
            for station in group:
                self._known(station)
                if station in member:
                    raise ImpairmentError(f"partition: station {station} is in two groups")
                member[station] = number
        self._member = member if groups else None

    def heal(self) -> None:
        """End the partition."""
        self._member = None

    def port(self, number: int, *, up: bool) -> None:
        """Connect or disconnect a station; a disconnected station neither sends nor receives."""
        self._known(number)
        (self._off.discard if up else self._off.add)(number)

    def connected(self, sender: int, receiver: int) -> bool:
        """Return whether frames of ``sender`` can reach ``receiver`` now, apart from losses."""
        if (sender, receiver) not in self._channels or sender in self._off or receiver in self._off:
            return False
        member = self._member
        return member is None or member.get(sender, 0) == member.get(receiver, 0)

    # -- frames --------------------------------------------------------------------------------------------------------

    def broadcast(self, sender: int, octets: bytes, now: int, start: int = 0) -> None:
        """Transmit a frame of ``sender`` at ``now`` (ns since the start, not before the time of the last call).

        Octets before ``start`` are not corrupted.
        """
        for receiver in self._receivers[sender]:
            channel = self._channels[sender, receiver]
            if not self.connected(sender, receiver):
                channel.counters.offered += 1
                channel.counters.down += 1
                continue
            for copy in channel.offer(octets, now, start).copies:
                transit = Transit(copy.time, sender, receiver, copy.octets, now)
                heapq.heappush(self._flights, _Flight(copy.time, self._number, transit))
                self._number += 1

    def poll_timeout(self) -> int | None:
        """Return the time of the next arrival in ns since the start; None if no frame is under way."""
        return self._flights[0].time if self._flights else None

    def due(self, now: int) -> list[Transit]:
        """Return the arrivals up to ``now``, by time, then in the order of sending.

        A frame is lost (``down``) if its receiver was disconnected while the frame was under way.
        """
        found = []
        while self._flights and self._flights[0].time <= now:
            transit = heapq.heappop(self._flights).transit
            counters = self._channels[transit.sender, transit.receiver].counters
            if transit.receiver in self._off:
                counters.down += 1
                continue
            counters.delivered += 1
            found.append(transit)
        return found

    def of(self, sender: int, receiver: int) -> Counters:
        """Return the counters of one direction."""
        return self._channels[sender, receiver].counters

    def counters(self) -> dict[str, Any]:
        """Return the counters of all directions by ``"SENDER>RECEIVER"``, as plain data for JSON."""
        return {f"{a}>{b}": msgspec.to_builtins(each.counters) for (a, b), each in self._channels.items()}

    def _known(self, *stations: int) -> None:
        for each in stations:
            if not 0 <= each < self.ports:
                raise ImpairmentError(f"station {each}: there are 0..{self.ports - 1}")
