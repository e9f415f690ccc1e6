"""Cooperative scheduling of cases over one link and one upper tester."""

from __future__ import annotations

import contextlib
import socket
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

from greenlet import greenlet

from dcp_conformance.errors import LowerTesterError, NoAnswerError, UpperTesterError
from dcp_conformance.lower_tester import Arrival, LowerTester, OnThisMachine
from dcp_conformance.upper_tester import Answer, Notification, UpperTester


class Task:
    """A case in execution, with the frames and notifications that it has not processed yet."""

    def __init__(self, body: Callable[[Task], None]) -> None:
        self.inbox: deque[Arrival] = deque()
        """Frames that the case has not received yet."""
        self.notifications: list[Notification] = []
        self.dropped = 0
        """Number of frames that the kernel has dropped since the case last called ``health``."""
        self.until: int | None = None
        """The case waits for a frame or notification until this time (ns). None: it waits for an answer, or runs."""
        self.done = False
        self._body = body
        self.greenlet = greenlet(self._run)

    def _run(self) -> None:
        try:
            self._body(self)
        finally:
            self.done = True


class _Call:
    """A call of the upper tester that waits for earlier calls, or for its answer."""

    __slots__ = ("ended", "future", "method", "params", "task")

    def __init__(self, task: Task, method: str, params: dict[str, Any]) -> None:
        self.task, self.method, self.params = task, method, params
        self.future: Future[Answer] | None = None
        self.ended = False
        """Whether the call has ended and was removed from the queue of the scheduler."""


class Scheduler:
    """Delivers frames and notifications to all tasks, and runs each task until it waits.

    In real time a thread makes the calls of the upper tester, one at a time, so that the other tasks can continue. In
    virtual time no time passes in a call.
    """

    def __init__(self, lower: LowerTester, upper: UpperTester | None, on_arrival: Callable[[Arrival], None]) -> None:
        """``on_arrival`` is called once with each frame, before the tasks get it."""
        self._on_arrival = on_arrival
        self.lower = lower
        self.upper = upper
        self.tasks: list[Task] = []
        self.current: Task | None = None
        """The running task; None while the scheduler runs."""
        self._main = greenlet.getcurrent()
        self._calls: deque[_Call] = deque()
        self._threads = ThreadPoolExecutor(1) if upper is not None and isinstance(lower, OnThisMachine) else None
        self._awake, self._wake = socket.socketpair()
        self._awake.setblocking(False)
        self._closing = self._abandoned = False
        self.lost_link: LowerTesterError | None = None
        """The error of the link, if it cannot be used any more."""
        self.lost_upper: UpperTesterError | None = None
        """The error of the upper tester, if it cannot be used any more."""

    # -- for the executor ----------------------------------------------------------------------------------------------

    def start(self, body: Callable[[Task], None]) -> None:
        """Execute ``body`` as a new task; return when it waits for the first time, or has ended."""
        task = Task(body)
        self.tasks.append(task)
        self._resume(task)

    def step(self, until: int) -> None:
        """Wait for a frame, an answer or a timeout until ``until`` (ns) at most, and run the tasks that wait for it."""
        self._finish_call()
        self._begin_call()
        lost = self.lost_link is not None or self.lost_upper is not None
        waiting = [task for task in self.tasks if task.until is not None]
        if ready := [task for task in waiting if lost or task.inbox or task.notifications]:
            for task in ready:
                self._resume(task)
            return
        first = min((task.until for task in waiting if task.until is not None), default=until)
        if not self.drain(min(first, until), wait=True) and self.lower.now() >= first:
            for task in waiting:
                if not task.done and task.until is not None and task.until <= self.lower.now():
                    self._resume(task)

    def abandon(self, why: str) -> None:
        """Let all calls and receptions fail from now on: the implementation is gone, and nothing can be undone."""
        self._abandoned = True
        self.lost_link, self.lost_upper = LowerTesterError(why), UpperTesterError(why)

    def close(self) -> None:
        """End all tasks, which undo their changes, and release thread and sockets."""
        self._closing = True
        for task in list(self.tasks):
            if not task.done:
                # throw() raises GreenletExit, a BaseException, which the case does not catch as a finding.
                with contextlib.suppress(Exception):
                    self.current = task
                    task.greenlet.throw()
        self.current = None
        self.tasks.clear()
        if self._threads is not None:
            self._threads.shutdown(wait=True)
            self._threads = None
        self._awake.close()
        self._wake.close()

    # -- for the facades of tasks --------------------------------------------------------------------------------------

    def receive(self, task: Task, until: int) -> Arrival | None:
        """Return the next frame for the task before ``until`` (ns); None at that time, or if notifications arrive.

        Raise ``LowerTesterError`` if the link cannot be used.
        """
        if self.lost_link is not None:
            raise self.lost_link
        if self._closing:
            self.drain(until, wait=True)
        elif not task.inbox and self.lower.now() < until and not task.notifications:
            task.until = until
            self._main.switch()
            task.until = None
            if self.lost_link is not None:
                raise self.lost_link
        elif not task.inbox:
            # Receive all frames that arrived before ``until`` before returning None.
            while self.drain(until, wait=False) and not task.inbox:
                pass
        if task.inbox and task.inbox[0].time < until:
            return task.inbox.popleft()
        return None

    def call(self, task: Task, method: str, params: dict[str, Any]) -> Answer:
        """Call the upper tester for a task and return the answer. Raise the exceptions of the upper tester."""
        assert self.upper is not None
        if self.lost_upper is not None and (self._abandoned or not self._closing):
            raise self.lost_upper
        if self._threads is None:
            answer = self._ask(method, params)
            self.take_notifications()
            return answer
        if self._closing:
            self._settle()
            return self.upper.call(method, params)
        mine = _Call(task, method, params)
        self._calls.append(mine)
        self._begin_call()
        # Not until the future is done: the thread may be faster than this one, and the call is in the queue still.
        while not mine.ended:
            self._main.switch()
        if mine.future is None:
            assert self.lost_upper is not None
            raise self.lost_upper
        return mine.future.result()

    def drain(self, until: int, *, wait: bool) -> bool:
        """Receive the next frame for all tasks; return False if none arrived before ``until`` (ns).

        ``wait``: whether answers and notifications of the upper tester end the wait, too.
        """
        also: Sequence[int] = ()
        if wait and self._threads is not None:
            idle = not self._calls and self.upper is not None
            also = (self._awake.fileno(), *(self.upper.filenos() if idle and self.upper is not None else ()))
        try:
            arrival = self.lower.receive(until, also)
        except LowerTesterError as error:
            # The cases raise the error, because it is not a fault of the scheduler.
            self.lost_link = error
            return False
        dropped = self.lower.health().dropped
        for task in self.tasks if dropped else ():
            task.dropped += dropped
        self.take_notifications()
        if arrival is None:
            return False
        self._on_arrival(arrival)
        for task in self.tasks:
            if not task.done:
                task.inbox.append(arrival)
        return True

    def take_notifications(self) -> None:
        """Deliver the notifications (indications) of the implementation to all tasks."""
        if self.upper is None or self._calls or self.lost_upper is not None:
            return
        try:
            found = self.upper.poll()
        except UpperTesterError as error:
            self.lost_upper = error
            return
        for task in self.tasks if found else ():
            if not task.done:
                task.notifications += found

    # -- internal ------------------------------------------------------------------------------------------------------

    def _resume(self, task: Task) -> None:
        before, self.current = self.current, task
        try:
            task.greenlet.switch()
        finally:
            self.current = before
        if task.done:
            self.tasks.remove(task)

    def _begin_call(self) -> None:
        """Start the next call, unless a call is in progress."""
        if not self._calls or self._calls[0].future is not None or self._threads is None:
            return
        assert self.upper is not None
        call = self._calls[0]
        call.future = self._threads.submit(self._ask, call.method, call.params)
        call.future.add_done_callback(lambda _: self._wake.send(b"\0"))

    def _ask(self, method: str, params: dict[str, Any]) -> Answer:
        """Call the upper tester. If it answers nothing any more, all calls that wait fail together."""
        assert self.upper is not None
        try:
            return self.upper.call(method, params)
        except NoAnswerError as error:
            if "UT-Hello" in self.upper.methods:
                try:
                    self.upper.call("UT-Hello", {})
                except UpperTesterError:
                    self.lost_upper = error
            raise

    def _finish_call(self) -> None:
        """If the call in progress has ended, resume its task, which may make its next call before others."""
        with contextlib.suppress(BlockingIOError):
            self._awake.recv(4096)
        while self._calls and (future := self._calls[0].future) is not None and future.done():
            call = self._calls.popleft()
            call.ended = True
            waiting, self._calls = self._calls, deque()
            self.take_notifications()
            self._resume(call.task)
            if self.lost_upper is None:
                self._calls.extend(waiting)
                self._begin_call()
                continue
            for each in waiting:
                each.ended = True
                self._resume(each.task)

    def _settle(self) -> None:
        """Wait for the call in progress, and drop waiting calls."""
        while self._calls:
            call = self._calls.popleft()
            if call.future is not None:
                with contextlib.suppress(Exception):
                    call.future.result()
