"""A node in virtual time with its surroundings: clock, application, upper tester, PICS and PIXIT."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final, Protocol

import msgspec

from dcp_conformance.definitions.pics import Pics
from dcp_conformance.upper_tester import Answer, Notification
from dcp_stack.config import NodeConfig
from dcp_stack.virtual.world import World

from .inprocess import InProcess, MakeNode, VirtualUpperTester, plain_node

#: Methods that every upper tester has.
_ALWAYS: Final = frozenset({"UT-Hello"})


class Application(Protocol):
    """An application on the node, which uses services during the test. Times are in ns."""

    def due(self) -> int:
        """Return the monotonic time of the next call of :meth:`act`."""
        ...

    def act(self, node: Any, now: int, wall: int) -> None:
        """Use services of the node. ``UT-Reset`` or a restart may have removed the application's registrations."""
        ...


def same_clock(now: int) -> int:
    """Return 0: the node's clock agrees with the tester's."""
    del now
    return 0


class UpperTesting(msgspec.Struct, frozen=True, kw_only=True):
    """The differences between the upper tester of a set-up and that of the reference node."""

    there: bool = True
    """Whether the node has an upper tester."""
    without: frozenset[str] = frozenset()
    """Methods that it does not have."""
    call_ms: float = 0.0
    """Duration of each call in ms; half of it passes before the node executes the call."""
    notification_ms: float = 0.0
    """Time in ms by which notifications are later than the calls."""
    answers: Callable[[str, dict[str, Any], Any], Any] | None = None
    """Function of method, parameters and :class:`~dcp_conformance.upper_tester.Answer`; returns the answer to send."""
    one_connection: bool = False
    """Whether the upper tester allows only one connection at a time."""


@dataclass(frozen=True, slots=True)
class Setup:
    """A node with its surroundings, and the PICS and PIXIT that the tester gets."""

    config: NodeConfig
    make: MakeNode = plain_node
    pics: Pics = field(default_factory=Pics)
    upper: UpperTesting = field(default_factory=UpperTesting)
    can_restart: bool = True
    application: Callable[[], Application] | None = None
    clock: Callable[[int], int] = same_clock
    """Function of the monotonic time in ns; returns the offset of the node's wall clock from the tester's in ns."""
    surroundings: Callable[[Setup], Any] | None = None
    """Function that starts the node with its tester; None: :class:`Tested`."""


class Tested(InProcess):
    """The node of a set-up with its clock and its application."""

    def __init__(self, setup: Setup, *, seed: int = 1, now: int = 0, world: World | None = None) -> None:
        """Start the node of a set-up with the random seed ``seed``; the others are those of :class:`InProcess`."""
        self._clock = setup.clock
        self._make_application = setup.application
        self._application: Application | None = None
        super().__init__(setup.config, seed=seed, make=setup.make, now=now, world=world)
        self.can_restart = setup.can_restart

    def wall(self) -> int:
        """Return the time of the node's clock in ns since 1970."""
        return max(self.world.wall + self._clock(self.now), 0)

    def switch_on(self) -> None:
        """Start a new node with a new application."""
        self._application = None if self._make_application is None else self._make_application()
        super().switch_on()

    def poll_timeout(self) -> int | None:
        """Return when the node or its application is called next."""
        due = super().poll_timeout()
        if self._application is None or self.died:
            return due
        moment = max(self._application.due(), self.now)
        return moment if due is None else min(due, moment)

    def wake(self) -> None:
        """Call the node if its timer has expired, otherwise the application."""
        due = super().poll_timeout()
        if self._application is None or (due is not None and due <= self.now):
            super().wake()
        else:
            self.guarded(self._act, self._application)

    def _act(self, application: Application) -> None:
        application.act(self.node, self.now, self.wall())
        self.node.settle(self.now, self.wall())

    def connection(self, testing: UpperTesting) -> VirtualUpperTester | None:
        """Return the upper tester of a set-up; None if it has none."""
        return Upper(self, testing) if testing.there else None


class Upper(VirtualUpperTester):
    """An upper tester with the differences of :class:`UpperTesting`."""

    def __init__(self, sut: InProcess, testing: UpperTesting) -> None:
        self._testing = testing
        self._node = sut
        self._late: list[Notification] = []
        """Notifications on their way, with the times of their arrival."""
        super().__init__(sut)
        self.methods = (self.methods - testing.without) | _ALWAYS
        self.about = {**self.about, "methods": sorted(self.methods)}

    def call(self, method: str, params: dict[str, Any]) -> Answer:
        """Call a method as the reference upper tester does, with the delay and the changed answer of the set-up."""
        if method in self._testing.without:
            return Answer(code=-32601, message=f"no method {method!r}")
        # UT-Reset is called between cases, where a delay has no effect.
        delay = 0 if method == "UT-Reset" else round(self._testing.call_ms * 1e6)
        if delay:
            self._node.elapse(delay // 2)
        answer = super().call(method, params)
        if delay:
            self._node.elapse(delay - delay // 2)
        if self._testing.answers is not None:
            changed: Answer = self._testing.answers(method, params, answer)
            return changed
        return answer

    def poll(self) -> list[Notification]:
        """Return the notifications that have arrived: each is delayed as long as a call takes, and further."""
        delay = round((self._testing.call_ms + self._testing.notification_ms) * 1e6)
        self._late += [msgspec.structs.replace(each, time=each.time + delay) for each in super().poll()]
        arrived = [each for each in self._late if each.time <= self._node.now]
        self._late = self._late[len(arrived) :]
        return arrived

    def another(self) -> VirtualUpperTester | None:  # type: ignore[override]
        """Return a second connection of the same kind; None if the upper tester allows only one."""
        return None if self._testing.one_connection else Upper(self._node, self._testing)
