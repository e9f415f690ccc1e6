"""A busy machine in virtual time: tester, node and frames are held up at random, by a seed.

The reference node is unchanged, and follows the specification; only the moments at which it and the tester are executed
differ. Tester and node are held up separately, as two processes on a machine with more work than processors. Frames
have the time stamp of the moment at which they were sent, and become readable later.
"""

from __future__ import annotations

import math
import random
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from dcp_conformance.lower_tester import Arrival
from dcp_conformance.reference.inprocess import VirtualLowerTester, VirtualUpperTester
from dcp_conformance.reference.surroundings import Setup, Tested, UpperTesting
from dcp_conformance.upper_tester import Answer, Notification

from .variant import Variant, setup

_MS: Final = 1_000_000
_SECOND: Final = 1000 * _MS


@dataclass(frozen=True, slots=True)
class Load:
    """How busy the machine is. Delays are random between 1 ms and ``longest_ms``, most of them short."""

    tester: float = 0.0
    """Probability that the tester is held up before or after one of its steps: send, receive, call, read of a clock."""
    node: float = 0.0
    """Mean number of times per second that the node is held up."""
    flight: float = 0.0
    """Probability that a frame or a notification of the node becomes readable late."""
    longest_ms: float = 40.0
    longest_flight_ms: float = 20.0
    rare: float = 0.0
    """Share of the delays of tester and node that are 2 s."""


LOADS: Final = {
    "mild": Load(tester=0.1, node=2, flight=0.2, longest_ms=30, longest_flight_ms=10),
    "busy": Load(tester=0.2, node=3, flight=0.3, longest_ms=120, longest_flight_ms=20),
    "late-tester": Load(tester=0.1, longest_ms=800, rare=0.01),
    "late-node": Load(node=0.5, longest_ms=800, rare=0.01),
    "late-frames": Load(flight=0.5, longest_flight_ms=80),
    "all-late": Load(tester=0.06, node=0.5, flight=0.3, longest_ms=800, longest_flight_ms=40, rare=0.01),
}
"""Loads by name. With ``mild`` nothing is longer than a third of the usual beacon period."""
#: Reasons for an inconclusive verdict on such a machine.
_LATE: Final = (
    r"; but it did not fail in|, but not in another execution|; executed \d times$"
    r"|^TC_BP_TX_TI_02.*: too few beacons for their variance"
    r"|which this case needs: (none|room for|VARDIS-STATUS|BP-STATUS)|: a beacon in between in each attempt"
    r"|^the implementation survives: it does not answer any more.*; not reproduced",
)
#: Number of seeds of each load in the campaign.
_SEEDS: Final = 3


class _Readable(NamedTuple):
    """A frame of the node, and the time in ns from which the tester can read it."""

    since: int
    arrival: Arrival


class Busy(Tested):
    """The node of a set-up on a busy machine."""

    def __init__(self, setup: Setup, load: Load, *, seed: int = 1, now: int = 0) -> None:
        """Start the node; ``seed`` also decides the delays."""
        self.load = load
        self._chance = random.Random(f"busy/{seed}")  # noqa: S311 - no secret
        self._held_until: int | None = None
        """The node is not executed until this time, ns; None while it is."""
        self._next_hold = self._draw_hold(now)
        self._inbox: deque[bytes] = deque()
        """Frames that the node has not processed yet."""
        self._flying: deque[_Readable] = deque()
        super().__init__(setup, seed=seed, now=now)

    # -- chance --------------------------------------------------------------------------------------------------------

    def _duration(self, longest_ms: float) -> int:
        """Return the duration of a delay in ns: its logarithm is uniformly distributed."""
        return round(math.exp(self._chance.uniform(0, math.log(longest_ms))) * _MS)

    def _delay(self) -> int:
        rare = self.load.rare and self._chance.random() < self.load.rare
        return 2 * _SECOND if rare else self._duration(self.load.longest_ms)

    def _draw_hold(self, after: int) -> int:
        """Return the time in ns at which the node is held up the next time."""
        if not self.load.node:
            return 1 << 62
        return after + round(self._chance.expovariate(self.load.node) * _SECOND)

    def hold_tester(self) -> None:
        """Perhaps do not execute the tester for some time, in which the node continues."""
        if self._chance.random() < self.load.tester:
            self.elapse(self._delay())

    def flight(self) -> int:
        """Return the ns until something that the node sends now can be read."""
        return self._duration(self.load.longest_flight_ms) if self._chance.random() < self.load.flight else 0

    # -- the node ------------------------------------------------------------------------------------------------------

    def await_node(self) -> None:
        """Let time pass until the node is executed."""
        while self._held_until is not None and not self.died:
            self.elapse(self._held_until - self.now)

    def deliver(self, octets: bytes) -> None:
        """Deliver a frame to the node, which processes it when it is executed the next time."""
        if self._held_until is None:
            super().deliver(octets)
        elif self.linked:
            self._inbox.append(octets)

    def poll_timeout(self) -> int | None:
        """Return when the node is called or held up next, or when it is executed again."""
        if self._held_until is not None:
            return self._held_until
        due = super().poll_timeout()
        return self._next_hold if due is None else min(due, self._next_hold)

    def wake(self) -> None:
        """Call the node, hold it up, or execute it again."""
        due = super().poll_timeout()
        if self._held_until is not None:
            self._held_until = None
            frames_first = self._chance.random() < 0.5
            if not frames_first:
                self.guarded(self.node.handle_timeout, self.now, self.wall())
            while self._inbox:
                super().deliver(self._inbox.popleft())
        elif due is not None and due <= self.now:
            super().wake()
        else:
            self._held_until = self.now + self._delay()
            self._next_hold = self._draw_hold(self._held_until)
        self.schedule()

    def switch_on(self) -> None:
        """Start a new node. Frames that the former one has sent can still be read."""
        sent = list(self.arrivals)
        self._inbox.clear()
        super().switch_on()
        self.arrivals.extendleft(reversed(sent))

    def fail(self, error: Exception) -> None:
        """Note the exception that ended the node. Its frames can still be read."""
        sent = list(self.arrivals)
        super().fail(error)
        self.arrivals.extend(sent)

    # -- the tester ----------------------------------------------------------------------------------------------------

    def next_frame(self, until: int) -> Arrival | None:
        """Return the next frame that can be read before ``until`` (ns) and was sent before; None at that time."""
        self.hold_tester()
        while True:
            begun = self.now
            while self.arrivals:
                # Frames of one socket do not overtake each other.
                since = self._flying[-1].since if self._flying else 0
                arrival = self.arrivals.popleft()
                self._flying.append(_Readable(max(since, arrival.time + self.flight()), arrival))
            if self._flying and self._flying[0].since <= self.now:
                if self._flying[0].arrival.time >= until:
                    return None
                found = self._flying.popleft().arrival
                self.hold_tester()
                return found
            if begun >= until:
                return None
            self.advance(min(until, self._flying[0].since) if self._flying else until)

    def lower_tester(self) -> BusyLowerTester:
        """Return a lower tester for the node."""
        return BusyLowerTester(self)

    def connection(self, testing: UpperTesting) -> VirtualUpperTester | None:
        """Return the upper tester; None if the set-up has none."""
        return BusyUpper(self) if testing.there else None


class BusyLowerTester(VirtualLowerTester):
    """The lower tester of a busy machine."""

    def __init__(self, sut: Busy) -> None:
        super().__init__(sut)
        self._machine = sut

    def now(self) -> int:
        """Return virtual ns since the start, perhaps after a delay."""
        self._machine.hold_tester()
        return super().now()

    def send(self, octets: bytes, source: bytes) -> bytes:
        """Deliver a beacon to the node, perhaps after a delay."""
        self._machine.hold_tester()
        return super().send(octets, source)

    def send_frame(self, frame: bytes) -> None:
        """Deliver a whole frame to the node, perhaps after a delay."""
        self._machine.hold_tester()
        super().send_frame(frame)

    def receive(self, until: int, also: Sequence[int] = ()) -> Arrival | None:
        """Return the next frame that can be read."""
        return self._machine.next_frame(until)


class BusyUpper(VirtualUpperTester):
    """The upper tester of a busy machine: request, node and answer can be late."""

    def __init__(self, sut: Busy) -> None:
        self._machine = sut
        self._late: deque[tuple[int, Notification]] = deque()
        super().__init__(sut)

    def call(self, method: str, params: dict[str, Any]) -> Answer:
        """Call a method when the node is executed."""
        machine = self._machine
        machine.hold_tester()
        machine.await_node()
        answer = super().call(method, params)
        machine.hold_tester()
        return answer

    def poll(self) -> list[Notification]:
        """Return the notifications that can be read."""
        for each in super().poll():
            since = self._late[-1][0] if self._late else 0
            self._late.append((max(since, each.time + self._machine.flight()), each))
        found = []
        while self._late and self._late[0][0] <= self._machine.now:
            found.append(self._late.popleft()[1])
        return found

    def another(self) -> VirtualUpperTester | None:  # type: ignore[override]
        """Return a second connection."""
        return BusyUpper(self._machine)


def busy(profile: str, load: Load, seed: int, **changes: Any) -> Setup:
    """Return a set-up of the reference node on a busy machine; ``changes``: of :func:`~.variant.setup`."""
    return setup(profile, surroundings=lambda made: Busy(made, load, seed=seed), **changes)


def _variants() -> Iterator[Variant]:
    for name, load in LOADS.items():
        for seed in range(1, _SEEDS + 1):
            yield Variant(
                f"V-BUSY-{name}-{seed}",
                f"and the tester are held up by a busy machine ({name}, seed {seed})",
                "the specification has no time limits for reactions",
                lambda profile, load=load, seed=seed: busy(profile, load, seed),  # type: ignore[misc]
                explains=() if name == "mild" else _LATE,
            )


VARIANTS = tuple(_variants())
