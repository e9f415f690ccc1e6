"""A lower tester whose frames go through an impaired link, in real and in virtual time."""

from __future__ import annotations

import contextlib
import heapq
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import msgspec

from dcp_codec.impairment import Channel, Copy, Counters, Fate
from dcp_codec.network.sockets import ETHERNET_HEADER
from dcp_conformance.lower_tester import Arrival, HearsEveryType, Incident, LinkHealth, LowerTester, OnThisMachine

from .directions import Directions


class _Leaving(NamedTuple):
    """A frame on its way to the implementation."""

    time: int
    number: int
    octets: bytes
    source: bytes | None
    """The station that sends a bearer payload; None for a whole frame."""
    incidents: tuple[Incident, ...]
    case: int


class _Coming(NamedTuple):
    """A frame on its way to the tester."""

    time: int
    number: int
    arrival: Arrival
    incidents: tuple[Incident, ...]


class ImpairedLowerTester:
    """Another lower tester behind a bad link; see :class:`~dcp_conformance.lower.LowerTester`.

    Frames that are delayed leave while the tester waits: time passes nowhere else. What the link adds to or changes in
    frames of the implementation is none of its doing, so the second copy of a frame and corrupted frames are
    discarded, as the check sequence of a real link would do it; a corrupted frame counts as taken.
    """

    def __init__(self, inner: LowerTester, directions: Directions, *, seed: int = 1, tolerance: int = 0) -> None:
        """``tolerance``: ns by which the delay of a frame may differ from the usual one without being an incident."""
        self.name = inner.name
        self.directions = directions
        self._inner = inner
        self._calm = Directions(directions.to.only_delays(), directions.back.only_delays())
        self._to, self._back = Channel(self._calm.to, seed, "to"), Channel(self._calm.back, seed, "from")
        self._counters = (Counters(), Counters())
        """What became of frames while the link was bad, to the implementation and from it."""
        self._uncounted = (self._to.counters, self._back.counters)
        self._tolerance = tolerance
        self._start = inner.now()
        self._engaged = 0
        self._cases = 0
        self._number = 0
        self._leaving: list[_Leaving] = []
        self._coming: list[_Coming] = []
        self._incidents: list[Incident] = []

    # -- the impairment ------------------------------------------------------------------------------------------------

    @contextlib.contextmanager
    def engaged(self) -> Iterator[None]:
        """The link is as bad as it can be within the block; otherwise it only delays. Blocks may overlap."""
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
        counters = self._counters if self._engaged else self._uncounted
        for channel, impairment, count in zip((self._to, self._back), wanted, counters, strict=True):
            if channel.counters is not count:
                channel.counters = count
                channel.change(impairment)

    @property
    def changes_intervals(self) -> bool:
        """Whether the times between beacons are not those at which the implementation sent them."""
        return bool(self.directions.back.jitter or self.directions.back.reorder)

    def counters(self) -> dict[str, Any]:
        """What became of frames while the link was bad (``to``, ``from``), as plain data for JSON."""
        return {name: msgspec.to_builtins(each) for name, each in zip(("to", "from"), self._counters, strict=True)}

    def summary(self) -> str:
        """What was wanted and what was realised, in words."""
        parts = []
        for where, count in zip(("to the implementation", "from it"), self._counters, strict=True):
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

    def now(self) -> int:
        """Monotonic ns."""
        return self._inner.now()

    def wall(self) -> int:
        """ns since 1970."""
        return self._inner.wall()

    def framed(self, octets: bytes, source: bytes) -> bytes:
        """The whole frame in which a bearer payload goes out."""
        return self._inner.framed(octets, source)

    def send(self, octets: bytes, source: bytes) -> bytes:
        """Put a bearer payload on the bad link; the frame as it was sent. Raises ``LowerTesterError``."""
        self._flush()
        now = self._inner.now()
        self._hand_over(self._to.offer(octets, now - self._start), octets, source, now)
        return self._inner.framed(octets, source)

    def send_frame(self, frame: bytes) -> None:
        """Put a whole frame on the bad link, which spares its header. Raises ``LowerTesterError``."""
        self._flush()
        now = self._inner.now()
        self._hand_over(self._to.offer(frame, now - self._start, ETHERNET_HEADER), frame, None, now)

    def _hand_over(self, fate: Fate, octets: bytes, source: bytes | None, now: int) -> None:
        usual = self._to.impairment.delay + self._tolerance
        incidents = _incidents(fate, to=True, octets=octets, late=self._is_late(fate.copies, now, usual))
        self._incidents += incidents
        for copy in fate.copies:
            leaving = _Leaving(copy.time + self._start, self._number, copy.octets, source, incidents, self._cases)
            self._number += 1
            if leaving.time <= now:
                self._put_out(leaving)
            else:
                heapq.heappush(self._leaving, leaving)

    def _flush(self) -> None:
        """Send what is due."""
        now = self._inner.now()
        while self._leaving and self._leaving[0].time <= now:
            leaving = heapq.heappop(self._leaving)
            if leaving.case != self._cases:
                # The case that meets it is not the one that has sent it.
                self._incidents += leaving.incidents
            self._put_out(leaving)

    def _put_out(self, leaving: _Leaving) -> None:
        if leaving.source is None:
            self._inner.send_frame(leaving.octets)
        else:
            self._inner.send(leaving.octets, leaving.source)

    def settle(self) -> None:
        """Wait until no frame is under way to the implementation; what arrives meanwhile is kept."""
        self._flush()
        while self._leaving:
            if (arrival := self._inner.receive(self._leaving[0].time)) is not None:
                self._take(arrival)
            self._flush()

    def receive(self, until: int, also: Sequence[int] = ()) -> Arrival | None:
        """The next frame that came through the link before ``until``; None then, or when ``also`` is readable."""
        while True:
            self._flush()
            limit = until
            if self._coming:
                limit = min(limit, self._coming[0].time)
            if self._leaving:
                limit = min(limit, self._leaving[0].time)
            arrival = self._inner.receive(limit, also)
            if arrival is not None:
                self._take(arrival)
                continue
            if self._inner.now() < limit:
                # A descriptor is readable.
                return None
            if self._coming and self._coming[0].time <= limit and self._coming[0].time < until:
                coming = heapq.heappop(self._coming)
                self._incidents += coming.incidents
                return coming.arrival
            if limit >= until:
                return None

    def _take(self, arrival: Arrival) -> None:
        """Decide what becomes of a frame of the implementation."""
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
        heapq.heappush(self._coming, _Coming(arrival.time, self._number, arrival, incidents))
        self._number += 1

    def _is_late(self, copies: Sequence[Copy], now: int, usual: int) -> bool:
        return any(copy.time + self._start - now > usual for copy in copies)

    def take_in(self) -> None:
        """Read what has arrived, and send what is due. Raises ``LowerTesterError``."""
        self._inner.take_in()
        self._flush()

    def health(self) -> LinkHealth:
        """What was lost since the last call, with what the impaired link did."""
        found, self._incidents = tuple(self._incidents), []
        return self._inner.health()._replace(incidents=found)

    def close(self) -> None:
        """Close the lower tester behind it; frames under way are lost."""
        self._inner.close()


class _RealTime(ImpairedLowerTester):
    """The same around a lower tester in real time."""

    def overload(self) -> str:
        """Why this machine may have slowed down what it runs."""
        return self._inner.overload() if isinstance(self._inner, OnThisMachine) else ""


class _Ethernet(_RealTime):
    """The same around a lower tester that can listen to all types of frames. Listening is not impaired."""

    @property
    def ether_type(self) -> int:
        """The EtherType of its beacons."""
        assert isinstance(self._inner, HearsEveryType)
        return self._inner.ether_type

    def overhear(self, asked: Iterable[bytes], duration: int) -> list[bytes]:
        """Send whole frames, and listen for ``duration`` ns."""
        assert isinstance(self._inner, HearsEveryType)
        return self._inner.overhear(asked, duration)


def impaired(inner: LowerTester, directions: Directions, *, seed: int, tolerance: int) -> LowerTester:
    """The lower tester behind an impaired link, with what else it can do; itself if the link is perfect."""
    if directions.to.perfect and directions.back.perfect:
        return inner
    if isinstance(inner, HearsEveryType):
        return _Ethernet(inner, directions, seed=seed, tolerance=tolerance)
    kind = _RealTime if isinstance(inner, OnThisMachine) else ImpairedLowerTester
    return kind(inner, directions, seed=seed, tolerance=tolerance)


def _incidents(fate: Fate, *, to: bool, octets: bytes, late: bool = False) -> tuple[Incident, ...]:
    found = [Incident(to, what, octets) for what in sorted(fate.events)]
    if late and "reordered" not in fate.events:
        found.append(Incident(to, "late", octets))
    return tuple(found)
