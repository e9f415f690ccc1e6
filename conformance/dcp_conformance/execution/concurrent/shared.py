"""The view of the session that a case gets while others are executed beside it, with its own link and upper tester."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from dcp_conformance.errors import CouldNotAskError
from dcp_conformance.lower_tester import Arrival, LinkHealth
from dcp_conformance.test_system.session import Session
from dcp_conformance.upper_tester import Answer, Notification, UpperTester

from .scheduler import Scheduler, Task
from .sharing import ALONE, forbidden

if TYPE_CHECKING:
    from dcp_conformance.frames.received import ReceivedBeacon


class SharedLink:
    """The link of a task; see :class:`~dcp_conformance.lower_tester.LowerTester`."""

    def __init__(self, scheduler: Scheduler, task: Task) -> None:
        self._scheduler, self._task = scheduler, task
        # Only receptions and losses are those of the task.
        lower = scheduler.lower
        self.name, self.now, self.wall = lower.name, lower.now, lower.wall
        self.framed, self.send = lower.framed, lower.send
        self.send_frame, self.take_in = lower.send_frame, lower.take_in

    def receive(self, until: int, also: Sequence[int] = ()) -> Arrival | None:  # noqa: ARG002 - the scheduler knows them
        """Return the next frame before ``until`` (ns); None at that time, or if notifications arrive."""
        return self._scheduler.receive(self._task, until)

    def health(self) -> LinkHealth:
        """Return the losses since the last call."""
        dropped, self._task.dropped = self._task.dropped, 0
        return LinkHealth(dropped)

    def close(self) -> None:
        """Do nothing: the session closes the link."""


class SharedUpper:
    """The upper tester of a task; see :class:`~dcp_conformance.upper_tester.UpperTester`.

    It does not have the methods that a case must not call while others are executed.
    """

    def __init__(self, scheduler: Scheduler, task: Task, upper: UpperTester) -> None:
        self._scheduler, self._task = scheduler, task
        self.name, self.another = upper.name, upper.another
        self.about = upper.about
        self.methods = frozenset(upper.methods - ALONE)

    def call(self, method: str, params: dict[str, Any]) -> Answer:
        """Call a method and return its answer. Raise ``UpperTesterError``.

        Raise ``CouldNotAskError`` for a call that a case must not make while others are executed.
        """
        if why := forbidden(method, params):
            raise CouldNotAskError(f"other cases are executed at the same time: {why}")
        return self._scheduler.call(self._task, method, params)

    def poll(self) -> list[Notification]:
        """Return the notifications since the last call. Raise ``UpperTesterError`` if the upper tester is lost."""
        if self._scheduler.lost_upper is not None:
            raise self._scheduler.lost_upper
        found, self._task.notifications = self._task.notifications, []
        return found

    def filenos(self) -> tuple[int, ...]:
        """Return no descriptors, because the scheduler watches them."""
        return ()

    def close(self) -> None:
        """Do nothing: the session closes the connection."""


class SharedSession(Session):
    """The session of a task. All tasks share the attributes except link, upper tester, ``beside`` and call times."""

    def __init__(self, base: Session, link: SharedLink, upper: SharedUpper | None) -> None:
        """Share the attributes of ``base``; later assignments to attributes change ``base``."""
        vars(self).update(
            lower=link,
            upper=upper,
            beside=True,
            provisional=True,
            _base=base,
            call_times=deque(base.call_times, base.call_times.maxlen),
        )

    def __getattr__(self, name: str) -> Any:
        return getattr(vars(self)["_base"], name)

    def __setattr__(self, name: str, value: Any) -> None:
        setattr(vars(self)["_base"], name, value)

    def heard(self, heard: ReceivedBeacon, arrival: Arrival, case: str, traffic: object, departure: int) -> None:
        """Do nothing: all tasks receive each frame, and the executor adds it to the traffic once."""
