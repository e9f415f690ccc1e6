"""What is around a variant: its clock, its applications and its upper tester, in virtual time."""

from __future__ import annotations

from typing import Any, Final

import msgspec

from dcp_conformance.reference.inprocess import InProcess, VirtualUpperTester
from dcp_conformance.upper_tester import Answer

from .variant import Application, Setup, UpperTesting

#: What every upper tester has.
_ALWAYS: Final = frozenset({"UT-Hello"})


class Tested(InProcess):
    """The node of a set-up with its clock and its application."""

    def __init__(self, setup: Setup, *, seed: int = 1, now: int = 0) -> None:
        """``now``: virtual time in ns at which the node starts."""
        self._offset = setup.clock
        self._make_application = setup.application
        self._application: Application | None = setup.application() if setup.application is not None else None
        super().__init__(setup.config, seed=seed, make=setup.make, now=now)
        self.can_restart = setup.can_restart

    def node_wall(self) -> int:
        """The node's clock in ns since 1970."""
        return max(self.wall() + self._offset(self.now), 0)

    def _step(self, until: int) -> bool:
        application = self._application
        if application is None or self.died:
            return super()._step(until)
        due = self.node.poll_timeout()
        moment = max(application.due(), self.now)
        if moment > until or (due is not None and due <= moment):
            return super()._step(until)
        self.now = moment
        self.guarded(self._act, application)
        return True

    def _act(self, application: Application) -> None:
        application.act(self.node, self.now, self.node_wall())
        self.node.settle(self.now, self.node_wall())

    def restart(self) -> None:
        """A new node; its application is started anew as well."""
        super().restart()
        if self._make_application is not None:
            self._application = self._make_application()

    def connection(self, testing: UpperTesting) -> VirtualUpperTester | None:
        """The upper tester that a set-up asks for."""
        return Upper(self, testing) if testing.there else None


class Upper(VirtualUpperTester):
    """An upper tester that differs from ours as :class:`UpperTesting` says."""

    def __init__(self, sut: InProcess, testing: UpperTesting) -> None:
        self._testing = testing
        self._node = sut
        super().__init__(sut)
        self.methods = (self.methods - testing.without) | _ALWAYS
        self.about = {**self.about, "methods": sorted(self.methods)}

    def call(self, method: str, params: dict[str, Any]) -> Answer:
        """As ours, but time passes, and answers can differ."""
        if method in self._testing.without:
            return Answer(code=-32601, message=f"no method {method!r}")
        # Between cases nobody waits for anything.
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

    def another(self) -> VirtualUpperTester | None:  # type: ignore[override]
        """A second connection of the same kind; None if there can be only one."""
        return None if self._testing.one_connection else Upper(self._node, self._testing)


def slow(call_ms: float, without: frozenset[str] = frozenset()) -> UpperTesting:
    """An upper tester that takes so many ms for each call."""
    return UpperTesting(call_ms=call_ms, without=without)


def without(*methods: str) -> UpperTesting:
    """An upper tester that lacks methods."""
    return UpperTesting(without=frozenset(methods))


def extended(answer: Answer, **members: Any) -> Answer:
    """An answer with other or further members in its result."""
    return msgspec.structs.replace(answer, result={**answer.result, **members})
