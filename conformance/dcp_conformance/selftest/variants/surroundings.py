"""The surroundings of a variant in virtual time: its clock, its application and its upper tester."""

from __future__ import annotations

from typing import Any, Final

import msgspec

from dcp_conformance.reference.inprocess import InProcess, VirtualUpperTester
from dcp_conformance.upper_tester import Answer, Notification
from dcp_stack.virtual.world import World

from .variant import Application, Setup, UpperTesting

#: Methods that every upper tester has.
_ALWAYS: Final = frozenset({"UT-Hello"})


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
        """Call a method as the reference upper tester does, with the delay and the changed answer of the variant."""
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
        """Return the notifications that have arrived: each is delayed as long as a call takes."""
        delay = round(self._testing.call_ms * 1e6)
        self._late += [msgspec.structs.replace(each, time=each.time + delay) for each in super().poll()]
        arrived = [each for each in self._late if each.time <= self._node.now]
        self._late = self._late[len(arrived) :]
        return arrived

    def another(self) -> VirtualUpperTester | None:  # type: ignore[override]
        """Return a second connection of the same kind; None if the upper tester allows only one."""
        return None if self._testing.one_connection else Upper(self._node, self._testing)


def slow(call_ms: float, without: frozenset[str] = frozenset()) -> UpperTesting:
    """Return an upper tester that takes ``call_ms`` for each call and lacks the methods ``without``."""
    return UpperTesting(call_ms=call_ms, without=without)


def without(*methods: str) -> UpperTesting:
    """Return an upper tester that lacks ``methods``."""
    return UpperTesting(without=frozenset(methods))


def extended(answer: Answer, **members: Any) -> Answer:
    """Return an answer with changed or additional members in its result."""
    return msgspec.structs.replace(answer, result={**answer.result, **members})
