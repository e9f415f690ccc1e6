"""What a case sees of the session while others are executed beside it: its own view of link and upper tester."""

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
        self._lower = scheduler.lower
        self.name = self._lower.name

    def now(self) -> int:
        """Monotonic ns."""
        return self._lower.now()

    def wall(self) -> int:
        """ns since 1970."""
        return self._lower.wall()

    def framed(self, octets: bytes, source: bytes) -> bytes:
        """The whole frame of a bearer payload."""
        return self._lower.framed(octets, source)

    def send(self, octets: bytes, source: bytes) -> bytes:
        """Put a bearer payload on the air. Raises ``LowerTesterError``."""
        return self._lower.send(octets, source)

    def send_frame(self, frame: bytes) -> None:
        """Put a whole frame on the air. Raises ``LowerTesterError``."""
        self._lower.send_frame(frame)

    def receive(self, until: int, also: Sequence[int] = ()) -> Arrival | None:  # noqa: ARG002 - the scheduler knows them
        """The next frame before ``until`` (ns); None then, or when there are notifications."""
        return self._scheduler.receive(self._task, until)

    def take_in(self) -> None:
        """Read what has arrived, so that the kernel has room for more. Raises ``LowerTesterError``."""
        self._lower.take_in()

    def health(self) -> LinkHealth:
        """What was lost since the last call."""
        dropped, self._task.dropped = self._task.dropped, 0
        return LinkHealth(dropped)

    def close(self) -> None:
        """The link belongs to the session."""


class SharedUpper:
    """The upper tester of a task; see :class:`~dcp_conformance.upper_tester.UpperTester`.

    It does not offer the services that no case may call while others are executed.
    """

    def __init__(self, scheduler: Scheduler, task: Task, upper: UpperTester) -> None:
        self._scheduler, self._task, self._upper = scheduler, task, upper
        self.name = upper.name
        self.about = upper.about
        self.methods = frozenset(upper.methods - ALONE)

    def call(self, method: str, params: dict[str, Any]) -> Answer:
        """Call a method and wait for its answer. Raises ``UpperTesterError``.

        Raises ``CouldNotAskError`` for what no case may do while others are executed.
        """
        if why := forbidden(method, params):
            raise CouldNotAskError(f"other cases are executed at the same time: {why}")
        return self._scheduler.call(self._task, method, params)

    def poll(self) -> list[Notification]:
        """The notifications since the last call. Raises ``UpperTesterError`` if the upper tester is gone."""
        if self._scheduler.lost_upper is not None:
            raise self._scheduler.lost_upper
        found, self._task.notifications = self._task.notifications, []
        return found

    def filenos(self) -> tuple[int, ...]:
        """None: the scheduler watches the descriptors."""
        return ()

    def another(self) -> UpperTester | None:
        """A second connection."""
        return self._upper.another()

    def close(self) -> None:
        """The connection belongs to the session."""


class SharedSession(Session):
    """The session as a task sees it. What it does not have itself, it shares with all others."""

    def __init__(self, base: Session, link: SharedLink, upper: SharedUpper | None) -> None:
        """Attributes that are set later are set in ``base``."""
        vars(self).update(
            lower=link, upper=upper, _base=base, call_times=deque(base.call_times, base.call_times.maxlen)
        )

    def __getattr__(self, name: str) -> Any:
        return getattr(vars(self)["_base"], name)

    def __setattr__(self, name: str, value: Any) -> None:
        setattr(vars(self)["_base"], name, value)

    def heard(self, heard: ReceivedBeacon, arrival: Arrival, case: str, traffic: object, departure: int) -> None:
        """Nothing: all tasks receive each frame, and the executor takes it into account once."""
