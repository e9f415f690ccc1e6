"""The world in virtual time: our node, its mutants and its permitted variants over a simulated medium.

Everything random comes from one seed, so that a world with the same seed does the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import msgspec
from dcp_conformance.errors import UpperTesterError
from dcp_conformance.reference.surroundings import Setup, Tested
from dcp_conformance.upper_tester import Answer

from dcp_codec.impairment import Impairment
from dcp_lab.interop.definition import Shape
from dcp_lab.interop.world import Limits, Place, Received, Sent, World
from dcp_stack.virtual.medium import Arrival, ImpairedMedium
from dcp_stack.virtual.world import EPOCH, LATER, node_id
from dcp_stack.virtual.world import World as Clock

#: How long a frame takes, in ns: a receiver never answers at the instant of the transmission.
_FLIGHT: Final = 20_000
_PERFECT: Final = Impairment(delay=_FLIGHT)


class _Station(Tested):
    """A node with its application, clock and upper tester; a slow upper tester lets time pass for the whole world."""

    def __init__(self, world: VirtualWorld, place: int, setup: Setup, seed: int) -> None:
        self._network = world
        self._place = place
        self.rank = LATER + place
        super().__init__(setup, seed=seed, world=world.clock)

    def wall(self) -> int:
        """Return the node's clock in ns since 1970, with the offset that the test has set."""
        return super().wall() + self._network.offsets[self._place]

    def send(self, octets: bytes) -> None:
        """Broadcast a beacon of the node."""
        self._network.broadcast(self._place, octets)

    def fail(self, error: Exception) -> None:
        """Note the exception that ended the node, and its time."""
        super().fail(error)
        self._network.note_death(self._place, self.died)


class VirtualWorld(World):
    """A world without a machine: everything is in memory, and every transmission is known."""

    epoch = EPOCH

    def __init__(self, setups: Sequence[tuple[str, Setup, Limits]], shape: Shape, seed: int = 1) -> None:
        """``setups``: for each place the name of its implementation, how it is made, and its limits."""
        super().__init__(shape.pairs)
        self._seed = seed
        count = len(setups)
        self.offsets = [0] * count
        self._setups: list[Setup] = []
        for number, (name, setup, limits) in enumerate(setups):
            codec = setup.config.codec
            # As for a single node, the identifiers of places are the addresses of their interfaces.
            own = node_id(codec.profile, number + 1)
            # Applications use one variable identifier: two of them would be two producers of one variable, which the
            # specification leaves to the user to avoid (VD-TYP-01).
            alone = all(each.application is None for each in self._setups)
            config = msgspec.structs.replace(setup.config, node_id=own)
            self._setups.append(replace(setup, config=config, application=setup.application if alone else None))
            self.places.append(Place(number, name, codec, own, limits))
        everybody = [each for place in range(count) for each in ((place, count), (count, place))]
        self.medium = ImpairedMedium(count + 1, _PERFECT, seed=seed, pairs=[*shape.pairs, *everybody])
        self.clock = Clock(self.medium, self.arrive)
        self._received: list[Received] = []
        self._stations: list[_Station | None] = [None] * count
        self._uppers: list[Any] = [None] * count
        self._methods: list[frozenset[str] | None] = [None] * count
        self._lives = [0] * count

    # -- time ----------------------------------------------------------------------------------------------------------

    @property
    def now(self) -> int:
        """Virtual ns since the start."""
        return self.clock.now

    def run(self, duration: int) -> None:
        """Let virtual time pass."""
        self.clock.run_until(self.now + duration)

    def arrive(self, arrival: Arrival) -> None:
        """Deliver a frame to the stations that are switched on."""
        for place in arrival.receivers:
            station = None if place == len(self.places) else self._stations[place]
            if station is not None:
                self._received.append(Received(self.now, place, arrival.sender, arrival.octets))
                station.deliver(arrival.octets)

    def broadcast(self, place: int, octets: bytes) -> None:
        """Broadcast from a station."""
        self._sent.append(Sent(self.now, place, octets))
        self.medium.broadcast(place, octets, self.now)

    def note_death(self, place: int, why: str) -> None:
        """Note the first end of a node at a place."""
        self._deaths.setdefault(place, f"at {self.now / 1e9:.3f} s: {why}")

    # -- stations ------------------------------------------------------------------------------------------------------

    def power(self, place: int, *, on: bool) -> None:
        """Switch a station on or off."""
        station = self._stations[place]
        if on and station is None:
            self._lives[place] += 1
            seed = (self._seed * 1009 + place) * 101 + self._lives[place]
            self._stations[place] = station = _Station(self, place, self._setups[place], seed)
            testing = self._setups[place].upper
            self._uppers[place] = None if station.died else station.connection(testing)
            upper = self._uppers[place]
            self._methods[place] = frozenset() if upper is None else upper.methods
        elif not on and station is not None:
            station.switch_off()
            self._stations[place] = self._uppers[place] = None

    def is_on(self, place: int) -> bool:
        """Whether the station is switched on."""
        return self._stations[place] is not None

    def call(self, place: int, method: str, params: Mapping[str, Any]) -> Answer | None:
        """Call a service of the node."""
        upper = self._uppers[place]
        if upper is None or method not in upper.methods:
            return None
        try:
            answer: Answer = upper.call(method, dict(params))
        except UpperTesterError:
            # The node has died; deaths() has the reason.
            answer = Answer(code=-32603, message="the node ended")
        upper.poll()
        return answer

    def offers(self, place: int, method: str) -> bool | None:
        """Whether the upper tester has a method."""
        methods = self._methods[place]
        return None if methods is None else method in methods

    def set_clock(self, place: int, offset: int) -> None:
        """Set the wall clock of a station."""
        self.offsets[place] = offset

    # -- links ---------------------------------------------------------------------------------------------------------

    def set_quality(self, impairment: Impairment, sender: int | None = None, receiver: int | None = None) -> None:
        """Change the links between the places."""
        if not impairment.delay:
            impairment = msgspec.structs.replace(impairment, delay=_FLIGHT)
        for each in self._pairs:
            if sender in (None, each[0]) and receiver in (None, each[1]):
                self.medium.set_quality(impairment, *each)

    def partition(self, groups: Sequence[Sequence[int]]) -> None:
        """Let frames stay within their groups."""
        self.medium.partition(groups)

    def transmit(self, octets: bytes) -> None:
        """Broadcast from the tester's own station."""
        self.broadcast(len(self.places), octets)

    def link_counters(self) -> dict[str, Any]:
        """The counters of each direction between places."""
        pairs = {f"{a}>{b}" for a, b in self._pairs}
        return {name: each for name, each in self.medium.directions().items() if name in pairs}

    def received(self) -> Sequence[Received]:
        """Return the frames that arrived at the places."""
        return self._received
