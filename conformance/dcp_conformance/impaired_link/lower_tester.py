"""A lower tester whose frames go through an impaired link, in real and in virtual time."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

from dcp_codec.common.events import EventQueue
from dcp_codec.impairment import Channel, Copy, Counters, Fate
from dcp_codec.network.sockets import ETHERNET_HEADER
from dcp_conformance.lower_tester import Arrival, Incident, LinkHealth, ListensToAllTypes, LowerTester, OnThisMachine

from .directions import Directions


class _Leaving(NamedTuple):
    """A frame on its way to the implementation."""

    octets: bytes
    source: bytes | None
    """The station that sends a bearer payload; None for a whole frame."""
    incidents: tuple[Incident, ...]
    case: int


class _Coming(NamedTuple):
    """A frame on its way to the tester."""

    arrival: Arrival
    incidents: tuple[Incident, ...]


class ImpairedLowerTester:
    """A wrapper that impairs the link of another lower tester; see :class:`~dcp_conformance.lower_tester.LowerTester`.

    Delayed frames are sent while the tester waits, because time passes only then. Duplicates and corrupted frames of
    the implementation are discarded, as the frame check sequence of a real link would do, because the implementation
    did not send them; a corrupted frame counts as lost.
    """

    def __init__(self, inner: LowerTester, directions: Directions, *, seed: int = 1, tolerance: int = 0) -> None:
        """``tolerance``: maximum excess of a delay over the configured one, in ns, that is not an incident."""
        self.name, self.now, self.wall, self.framed, self.close = (
            inner.name, inner.now, inner.wall, inner.framed, inner.close,
        )  # fmt: skip
        self.directions = directions
        self._inner = inner
        self._calm = Directions(directions.to.only_delays(), directions.back.only_delays())
        self._to, self._back = Channel(self._calm.to, seed, "to"), Channel(self._calm.back, seed, "from")
        self.counters = (Counters(), Counters())
        """The numbers of lost and changed frames while the link was impaired, to the implementation and from it."""
        self._uncounted = (self._to.counters, self._back.counters)
        self._tolerance = tolerance
        self._start = inner.now()
        self._engaged = 0
        self._cases = 0
        self._leaving: EventQueue[_Leaving] = EventQueue()
        self._coming: EventQueue[_Coming] = EventQueue()
        self._incidents: list[Incident] = []

    # -- the impairment ------------------------------------------------------------------------------------------------

    @contextlib.contextmanager
    def engaged(self) -> Iterator[None]:
        """Impair the link during the block; otherwise it only delays. Blocks may overlap."""
        self._engaged += 1
        self._cases += 1
        self._switch()
        try:
            yield
        finally:
            self._engaged -= 1
            self._switch()

    def _switch(self) -> None:
        wanted = self.directions if self._engaged else self._calm
        counters = self.counters if self._engaged else self._uncounted
        for channel, impairment, count in zip((self._to, self._back), wanted, counters, strict=True):
            if channel.counters is not count:
                channel.counters = count
                channel.change(impairment)

    @property
    def changes_intervals(self) -> bool:
        """Whether the times between beacons are not those at which the implementation sent them."""
        return bool(self.directions.back.jitter or self.directions.back.reorder)

    def summary(self) -> str:
        """Describe the configured impairment and its effects."""
        parts = []
        for where, count in zip(("to the implementation", "from it"), self.counters, strict=True):
            done = [f"{count.lost + count.down} of {count.offered} frames lost"]
            for what in ("corrupted", "duplicated", "reordered"):
                if number := getattr(count, what):
                    done.append(f"{number} {what}")
            parts.append(f"{where} {', '.join(done)}")
        return (
            f"the link was impaired while cases were executed ({self.directions}): {'; '.join(parts)}. A failure that "
            "this explains is inconclusive, and such a case was executed again"
        )

    # -- the contract of a lower tester --------------------------------------------------------------------------------

    def send(self, octets: bytes, source: bytes) -> bytes:
        """Send a bearer payload through the link; return its unimpaired frame. Raise ``LowerTesterError``."""
        self._flush()
        now = self._inner.now()
        self._hand_over(self._to.offer(octets, now - self._start), octets, source, now)
        return self._inner.framed(octets, source)

    def send_frame(self, frame: bytes) -> None:
        """Send a whole frame through the link, which does not corrupt its header. Raise ``LowerTesterError``."""
        self._flush()
        now = self._inner.now()
        self._hand_over(self._to.offer(frame, now - self._start, ETHERNET_HEADER), frame, None, now)

    def _hand_over(self, fate: Fate, octets: bytes, source: bytes | None, now: int) -> None:
        usual = self._to.impairment.delay + self._tolerance
        incidents = _incidents(fate, to=True, octets=octets, late=self._is_late(fate.copies, now, usual))
        self._incidents += incidents
        for copy in fate.copies:
            leaving = _Leaving(copy.octets, source, incidents, self._cases)
            if copy.time + self._start <= now:
                self._put_out(leaving)
            else:
                self._leaving.push(copy.time + self._start, leaving)

    def _flush(self) -> None:
        """Send the frames that are due."""
        for leaving in self._leaving.due(self._inner.now()):
            if leaving.case != self._cases:
                # A later case than the one that sent the frame is affected.
                self._incidents += leaving.incidents
            self._put_out(leaving)

    def _put_out(self, leaving: _Leaving) -> None:
        if leaving.source is None:
            self._inner.send_frame(leaving.octets)
        else:
            self._inner.send(leaving.octets, leaving.source)

    def settle(self) -> None:
        """Wait until all delayed frames are sent to the implementation; keep frames that arrive during the wait."""
        self._flush()
        while (time := self._leaving.next_time()) is not None:
            if (arrival := self._inner.receive(time)) is not None:
                self._take(arrival)
            self._flush()

    def receive(self, until: int, also: Sequence[int] = ()) -> Arrival | None:
        """Return the next frame from the link before ``until`` (ns); None at that time, or if ``also`` is readable."""
        while True:
            self._flush()
            coming = self._coming.next_time()
            limit = min(each for each in (until, coming, self._leaving.next_time()) if each is not None)
            arrival = self._inner.receive(limit, also)
            if arrival is not None:
                self._take(arrival)
                continue
            if self._inner.now() < limit:
                # A descriptor in ``also`` is readable.
                return None
            if coming is not None and coming <= limit and coming < until:
                first = self._coming.pop()
                self._incidents += first.incidents
                return first.arrival
            if limit >= until:
                return None

    def _take(self, arrival: Arrival) -> None:
        """Impair a frame of the implementation, and queue it unless it is lost."""
        fate = self._back.offer(arrival.octets, max(0, arrival.time - self._start))
        lost = fate.events & {"lost", "down", "corrupted"}
        if lost:
            self._incidents += _incidents(fate, to=False, octets=arrival.octets)
            return
        copy = fate.copies[0]
        delay = copy.time + self._start - arrival.time
        usual = self._back.impairment.delay + self._tolerance
        incidents = tuple(
            each
            for each in _incidents(fate, to=False, octets=arrival.octets, late=delay > usual)
            if each.what != "duplicated"
        )
        arrival = arrival._replace(time=arrival.time + delay, wall=arrival.wall + delay, disturbed=bool(incidents))
        self._coming.push(arrival.time, _Coming(arrival, incidents))

    def _is_late(self, copies: Sequence[Copy], now: int, usual: int) -> bool:
        return any(copy.time + self._start - now > usual for copy in copies)

    def take_in(self) -> None:
        """Read received frames, and send the frames that are due. Raise ``LowerTesterError``."""
        self._inner.take_in()
        self._flush()

    def health(self) -> LinkHealth:
        """Return the losses and the incidents of the impaired link since the last call."""
        found, self._incidents = tuple(self._incidents), []
        return self._inner.health()._replace(incidents=found)


class _RealTime(ImpairedLowerTester):
    """A wrapper of a lower tester in real time."""

    def overload(self) -> str:
        """Return why this machine may be overloaded; empty if it is not known to be."""
        return self._inner.overload() if isinstance(self._inner, OnThisMachine) else ""


class _Ethernet(_RealTime):
    """A wrapper of a lower tester that can listen to all types of frames. Listening is not impaired."""

    @property
    def ether_type(self) -> int:
        """The EtherType of its beacons."""
        assert isinstance(self._inner, ListensToAllTypes)
        return self._inner.ether_type

    def exchange_all_types(self, asked: Iterable[bytes], duration: int) -> list[bytes]:
        """Send whole frames, listen for ``duration`` ns, and return the received frames."""
        assert isinstance(self._inner, ListensToAllTypes)
        return self._inner.exchange_all_types(asked, duration)


def impaired(inner: LowerTester, directions: Directions, *, seed: int, tolerance: int) -> LowerTester:
    """Wrap a lower tester in an impaired link, with the same capabilities; return it unchanged for a perfect link."""
    if directions.to.perfect and directions.back.perfect:
        return inner
    if isinstance(inner, ListensToAllTypes):
        return _Ethernet(inner, directions, seed=seed, tolerance=tolerance)
    kind = _RealTime if isinstance(inner, OnThisMachine) else ImpairedLowerTester
    return kind(inner, directions, seed=seed, tolerance=tolerance)


def _incidents(fate: Fate, *, to: bool, octets: bytes, late: bool = False) -> tuple[Incident, ...]:
    found = [Incident(to, what, octets) for what in sorted(fate.events)]
    if late and "reordered" not in fate.events:
        found.append(Incident(to, "late", octets))
    return tuple(found)
