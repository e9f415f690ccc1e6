"""The world in real time: processes in network namespaces, and a relay between their interfaces."""

from __future__ import annotations

import contextlib
import shutil
import socket
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from dcp_conformance.errors import ConformanceError, LowerTesterError
from dcp_conformance.upper_tester import Answer

from dcp_codec.codec import get_codec
from dcp_codec.errors import DecodeError
from dcp_codec.framing.locate import OtherTraffic, locate
from dcp_codec.impairment import PERFECT, Impairment
from dcp_codec.network.namespaces import NamespaceError, entered
from dcp_lab.interop.definition import Shape
from dcp_lab.interop.implementations import Implementation, command_of, upper_tester_of
from dcp_lab.interop.judge import address_of, ether_frame
from dcp_lab.interop.world import Place, Sent, World, node_text
from dcp_lab.relay import RelayError, RelayFabric
from dcp_lab.sim.testbed import namespaces
from dcp_lab.sim.testbed.place import INTERFACE
from dcp_stack.virtual.world import node_id

from .processes import Station
from .taps import Taps

#: Seconds after which the world says what it waits for.
_QUIET: Final = 3.0
#: ns by which the recorder may be late; it looks every 20 ms.
_HELD: Final = 50_000_000


class RealWorld(World):
    """A world of processes on links of their own. Needs the right to make network namespaces."""

    patience = 3.0
    #: 1500 payloads in a minute: the kernel keeps a few hundred for a process that does not read them.
    most_backlog = 60.0

    def __init__(
        self,
        stations: Sequence[tuple[str, Implementation, str]],
        shape: Shape,
        seed: int,
        *,
        on_wait: Callable[[str], None] | None = None,
    ) -> None:
        """``stations``: for each place the name of its implementation, its description, and its profile.

        ``on_wait``: called with what the world waits for when processes take long to be ready.

        Raises ``LowerTesterError`` if the network cannot be built.
        """
        super().__init__(shape.pairs)
        count = len(stations)
        self._closing = contextlib.ExitStack()
        self._heard: set[int] = set()
        self._paused = 0
        self._pending: list[Station] = []
        self._on_wait = on_wait
        self._counters: dict[str, Any] = {}
        self._settled = False
        self._held = self._lost = 0
        """The longest time in ns until the recorder read a frame, and the number of frames that it lost."""
        self._directory = Path(tempfile.mkdtemp(prefix="dcp-it-"))
        self._closing.callback(shutil.rmtree, self._directory, ignore_errors=True)
        for number, (name, each, profile) in enumerate(stations):
            codec = get_codec(profile)
            self.places.append(Place(number, name, codec, node_id(codec.profile, number + 1), each.limits))
        try:
            self._build(stations, count, seed)
        except (RelayError, NamespaceError) as error:
            self._closing.close()
            raise LowerTesterError(f"the network cannot be built: {error}") from None
        except BaseException:
            self._closing.close()
            raise
        self._begin = time.monotonic_ns()
        self.epoch = time.time_ns()

    def _build(self, stations: Sequence[tuple[str, Implementation, str]], count: int, seed: int) -> None:
        namespaces.sweep()
        tester = [(count, place) for place in range(count)]
        self._fabric = RelayFabric(
            namespaces.own_prefix(), [*map(address_of, self.places), self.tester_address],
            seed=seed, pairs=[*self._pairs, *tester], record=self._directory, profile=stations[0][2],
        )  # fmt: skip
        self._closing.callback(self._fabric.close)
        for direction in tester:
            self._fabric.set_quality(direction, PERFECT)
        self._taps = Taps(self._fabric.air, [f"p{place}" for place in range(count)])
        self._closing.callback(self._taps.close)
        with entered(self._fabric.namespaces[count]):
            self._voice = socket.socket(socket.AF_PACKET, socket.SOCK_RAW)
            self._closing.callback(self._voice.close)
            self._voice.bind((INTERFACE, 0))
        self._stations: list[Station] = []
        for place, (_, each, profile) in zip(self.places, stations, strict=True):
            network = (
                get_codec(profile).profile.bp.network_id if each.limits.network_id is None else each.limits.network_id
            )
            values = {
                "interface": INTERFACE,
                "node_id": node_text(place.node_id),
                "network_id": str(network),
                "profile": profile,
                "control": str(self._directory / f"{place.number}.sock"),
                "directory": str(self._directory),
                "seed": str(seed * 1000 + place.number),
            }
            command, upper = command_of(each, profile, values), upper_tester_of(each, values)
            log = self._directory / f"place-{place.number}.log"
            name = self._fabric.namespaces[place.number]
            self._stations.append(Station(place.number, name, command, upper, log, each.ready_s))
            self._closing.callback(self._stations[-1].stop)

    # -- time ----------------------------------------------------------------------------------------------------------

    @property
    def now(self) -> int:
        """Real ns since the start, without the time that processes took to start."""
        return time.monotonic_ns() - self._begin - self._paused

    def run(self, duration: int) -> None:
        """Let real time pass, after waiting for processes that are starting."""
        self._await_ready()
        end = self.now + duration
        while True:
            self._listen((end - self.now) / 1e9)
            if self.now >= end:
                break
        self._watch()

    def _await_ready(self) -> None:
        if not self._pending:
            return
        begin = time.monotonic()
        told = False
        while True:
            waiting = {each: each.awaited(heard=each.place in self._heard) for each in self._pending}
            self._pending = [each for each, missing in waiting.items() if missing]
            if not self._pending:
                self._refuse_other_identifiers()
                break
            waited = time.monotonic() - begin
            longest = max(each.ready_s for each in self._pending)
            if waited > longest:
                # Nothing can be judged: these stations do not even listen.
                self._pending = []
                raise ConformanceError(f"not ready within {longest:g} s: {self._missing(waiting)}")
            if waited > _QUIET and not told and self._on_wait is not None:
                told = True
                self._on_wait(f"waiting for {self._missing(waiting)}")
            self._listen(0.02)
        self._paused += round((time.monotonic() - begin) * 1e9)

    def _refuse_other_identifiers(self) -> None:
        """Raise if the upper tester of a station reports another node identifier than the station was given."""
        for each in self._stations:
            told, given = each.node_id, node_text(self.places[each.place].node_id)
            if each.on and told and told.replace(":", "").lower() != given.replace(":", "").lower():
                self._refuse(each.place, each.node_id)

    def _refuse(self, number: int, uses: str) -> None:
        place = self.places[number]
        raise ConformanceError(
            f"place {number} ({place.implementation}) uses the node identifier {uses} instead of "
            f"{node_text(place.node_id)}: its command must take {{node_id}}"
        )

    def _refuse_collision(self, number: int, octets: bytes) -> None:
        """Raise if the first beacon of a station has the identifier of another one."""
        try:
            beacon = self.places[number].codec.decode(octets)
        except DecodeError:
            return
        sender = beacon.bp.sender_id if beacon.bp is not None else None
        if sender is not None and any(sender == each.node_id for each in self.places if each.number != number):
            self._refuse(number, node_text(sender))

    def _missing(self, waiting: Mapping[Station, str]) -> str:
        told = [f"place {s.place} ({self.places[s.place].implementation}): {why}" for s, why in waiting.items() if why]
        return "; ".join(told)

    def _listen(self, patience_s: float) -> None:
        now, wall = self.now, time.time_ns()
        for each in self._taps.read(patience_s):
            place = self.places[each.place]
            framing = locate(each.frame, place.codec.profile.link)
            if isinstance(framing, OtherTraffic):
                continue
            moment = now + (each.wall - wall) if each.wall else self.now
            self._held = max(self._held, self.now - moment)
            last = self._sent[-1].time if self._sent else 0
            octets = each.frame[framing.start : framing.end]
            if each.place not in self._heard:
                self._refuse_collision(each.place, octets)
            self._sent.append(Sent(max(moment, last), each.place, octets))
            self._heard.add(each.place)

    @property
    def lateness(self) -> str:
        """Why the machine may have been too busy; empty if it was not."""
        if self._lost:
            return f"the recorder lost {self._lost} frames"
        return f"the recorder was held up for {self._held / 1e6:.0f} ms" if self._held > _HELD else ""

    def _watch(self) -> None:
        for station in self._stations:
            if station.on and station.ended() and station.place not in self._deaths:
                self._deaths[station.place] = f"at {self.now / 1e9:.2f} s: {station.death}"

    # -- stations ------------------------------------------------------------------------------------------------------

    def power(self, place: int, *, on: bool) -> None:
        """Start a process, or kill it."""
        station = self._stations[place]
        if on and not station.on:
            self._heard.discard(place)
            station.start()
            self._pending.append(station)
        elif not on:
            self._watch()
            station.stop()
            self._pending = [each for each in self._pending if each is not station]

    def is_on(self, place: int) -> bool:
        """Whether the process was started."""
        return self._stations[place].on

    def call(self, place: int, method: str, params: Mapping[str, Any]) -> Answer | None:
        """Call a service of a process."""
        self._await_ready()
        answer = self._stations[place].call(method, params)
        self._watch()
        return answer

    def offers(self, place: int, method: str) -> bool | None:
        """Whether the upper tester has a method."""
        self._await_ready()
        methods = self._stations[place].methods
        return None if methods is None else method in methods

    def set_clock(self, place: int, offset: int) -> None:
        """The clock of a single process cannot be set. Raises ``ConformanceError``."""
        raise ConformanceError(f"the clock of place {place} cannot be set by {offset} ns in real time")

    # -- links ---------------------------------------------------------------------------------------------------------

    def set_quality(self, impairment: Impairment, sender: int | None = None, receiver: int | None = None) -> None:
        """Change the links between the places."""
        if sender is None and receiver is None:
            self._fabric.set_quality(None, impairment)
            return
        for each in self._pairs:
            if sender in (None, each[0]) and receiver in (None, each[1]):
                self._fabric.set_quality(each, impairment)

    def partition(self, groups: Sequence[Sequence[int]]) -> None:
        """Let frames stay within their groups."""
        self._fabric.partition(groups)

    def transmit(self, octets: bytes) -> None:
        """Broadcast from the tester's own station."""
        self._sent.append(Sent(self.now, len(self.places), octets))
        frame = ether_frame(self.places[0].codec, self.tester_address, octets)
        with contextlib.suppress(OSError):
            # A full queue loses frames, as a radio channel does.
            self._voice.send(frame)

    # -- the end -------------------------------------------------------------------------------------------------------

    def settle(self) -> None:
        """End the processes, then the relay, so that its recordings are complete."""
        if self._settled:
            return
        self._settled = True
        self._listen(0.05)
        self._lost += self._taps.lost()
        self._watch()
        for station in self._stations:
            station.stop()
        self._counters = self._fabric.close()

    def link_counters(self) -> dict[str, Any]:
        """The counters of each direction between places; complete after :meth:`settle`."""
        pairs = {f"{a}>{b}" for a, b in self._pairs}
        return {name: each for name, each in self._counters.get("links", {}).items() if name in pairs}

    def recordings(self) -> Mapping[int, Path]:
        """The relay's recording of each port."""
        return {place.number: self._directory / f"port-{place.number}.mcap" for place in self.places}

    def logs(self) -> Mapping[int, str]:
        """The log of each process."""
        return {station.place: str(station.log) for station in self._stations}

    def close(self) -> None:
        """End everything and remove it."""
        self._closing.close()
