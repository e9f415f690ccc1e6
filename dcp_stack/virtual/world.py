"""Virtual time: a clock with one queue of events, and stations whose nodes run by it.

Frames in flight, timeouts of nodes and actions of a scenario are events of the same queue. Of simultaneous events,
frames come first, and the others in the order in which they were scheduled. Equal calls therefore cause equal events.
"""

from __future__ import annotations

import random
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, Final

from dcp_spec.profile.definition import Profile

from dcp_codec.common.events import EventQueue
from dcp_stack.config import NodeConfig
from dcp_stack.effects import Effect

from .medium import Arrival, Medium

#: 2026-01-01T00:00:00Z in ns since 1970: the wall clock at virtual time 0.
EPOCH: Final = 1_767_225_600_000_000_000
#: Maximum number of timeouts of a node at one moment. With more, virtual time would never advance again.
MOST_TIMEOUTS: Final = 500
#: Lowest rank of events other than arrivals.
LATER: Final = 1


def node_id(profile: Profile, index: int) -> bytes:
    """Return the identifier of a simulated node: a locally administered MAC address that ends with its number."""
    layout = profile.types.node_id
    mac = b"\x02" + index.to_bytes(5, "big")
    if layout.length is not None:
        return mac.hex(":").encode()
    return mac if layout.width == len(mac) else (index + 1).to_bytes(layout.width, "big")


class World:
    """A clock and its events. All times are virtual ns from 0."""

    def __init__(
        self,
        medium: Medium[Any] | None = None,
        arrive: Callable[[Arrival], None] | None = None,
        *,
        now: int = 0,
    ) -> None:
        """``medium``: that between the stations, if there is one; ``arrive`` then processes its arrivals."""
        self.now = now
        self._medium = medium
        self._arrive = arrive
        self._queue: EventQueue[Any] = EventQueue() if medium is None else medium.queue

    @property
    def wall(self) -> int:
        """The wall clock in ns since 1970."""
        return EPOCH + self.now

    def at(self, time: int, action: Callable[[], None], rank: int = LATER) -> None:
        """Call ``action`` at a future time: after its arrivals, by rank, and in the order of these calls."""
        self._queue.push(max(time, self.now), action, rank)

    def run_until(self, end: int, *, stop: Callable[[], bool] | None = None) -> bool:
        """Let virtual time pass up to ``end``, and process all events until then.

        Calls ``stop`` after each event. Returns True as soon as it returns True, otherwise False at ``end``.
        """
        queue, medium, arrive = self._queue, self._medium, self._arrive
        while (time := queue.next_time()) is not None and time <= end:
            event = queue.pop()
            self.now = time
            if type(event) is not Arrival:
                event()
            elif medium is not None and arrive is not None and (arrival := medium.land(event)) is not None:
                arrive(arrival)
            if stop is not None and stop():
                return True
        self.now = max(self.now, end)
        return False


class Station(ABC):
    """A place with a node that runs in a world; it exists also while the node is switched off."""

    rank = LATER
    """Of simultaneous timeouts, those of stations with a lower rank come first."""

    def __init__(self, world: World, config: NodeConfig, rng: random.Random) -> None:
        self.world = world
        self.config = config
        self.rng = rng
        self.node: Any = None
        """The node; None while it is switched off."""
        self.offset = 0
        """Difference of the node's wall clock from that of the world in ns."""
        self._due: int | None = None
        """When the node is called next."""
        self._called = -1
        self._calls = 0
        """Number of further timeouts at the time ``_called``."""

    def wall(self) -> int:
        """Return the node's clock in ns since 1970."""
        return EPOCH + self.world.now + self.offset

    @property
    def on(self) -> bool:
        """Whether the node runs."""
        return self.node is not None

    @abstractmethod
    def make(self) -> Any:
        """Return a new node for this station."""

    @abstractmethod
    def apply(self, effects: Sequence[Effect]) -> None:
        """Carry out the effects of the node."""

    @abstractmethod
    def fail(self, error: Exception) -> None:
        """Stop the node, which has raised an exception."""

    def switch_on(self) -> None:
        """Start a new node with empty memory."""
        self._called = -1
        self.node = self.make()
        self.guarded(self.node.start, self.world.now, self.wall())

    def switch_off(self) -> None:
        """Stop the node without any further message, as when its battery is empty."""
        self.node = None
        self._due = None

    def guarded(self, step: Callable[..., Any], *args: Any, **more: Any) -> None:
        """Call ``step`` with these arguments, and carry out the effects. An exception stops the node."""
        if not self.on:
            return
        try:
            step(*args, **more)
            self.carry_out()
        except Exception as error:  # the other stations continue
            self.fail(error)

    def carry_out(self) -> None:
        """Carry out the pending effects of the node, and schedule its next timeout."""
        effects = self.node.take_effects()
        if effects:
            self.apply(effects)
        self.schedule()

    def poll_timeout(self) -> int | None:
        """Return when :meth:`wake` has to be called; None: not before another step."""
        due: int | None = self.node.poll_timeout() if self.on else None
        return due

    def schedule(self) -> None:
        """Schedule the next timeout."""
        due = self.poll_timeout()
        if due is not None:
            due = max(due, self.world.now)
        if due != self._due:
            self._due = due
            if due is not None:
                self.world.at(due, self._expire, self.rank)

    def _expire(self) -> None:
        """Process a timeout, unless another one has replaced it."""
        if self._due is None or self._due > self.world.now:
            return
        self._due = None
        now = self.world.now
        self._calls = self._calls + 1 if self._called == now else 0
        self._called = now
        if self._calls > MOST_TIMEOUTS:
            many = f"{self._calls} timeouts were handled, and the next one is due at the same time"
            self.fail(RuntimeError(many))
        else:
            self.wake()

    def wake(self) -> None:
        """Process a timeout."""
        self.guarded(self.node.handle_timeout, self.world.now, self.wall())
