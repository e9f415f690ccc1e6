"""Worker processes: a pool that maps a function, and single workers that are connected by a pipe.

The parent alone handles Ctrl-C, and ends the workers by SIGTERM. A worker that ends by itself is an error of the pool,
and a message for the parent of a single worker.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, ProcessPoolExecutor, ThreadPoolExecutor, wait
from multiprocessing.connection import Connection
from typing import Any, Literal, TypeVar

from .signals import deferred

Item = TypeVar("Item")
Result = TypeVar("Result")

#: Seconds between two calls of ``tick``.
_TICK = 0.2


class WorkerLostError(Exception):
    """A process of a pool has ended by itself."""

    def __init__(self) -> None:
        super().__init__("a worker process ended by itself; was it killed, or is memory short?")


def completed(
    work: Callable[[Item], Result],
    items: Iterable[Item],
    jobs: int | None = None,
    *,
    start: Literal["fork", "forkserver", "spawn", "thread"] = "fork",
    preload: str = "",
    begin: Callable[[], None] | None = None,
    tick: Callable[[], None] | None = None,
) -> Generator[tuple[int, Result]]:
    """Call ``work`` with each item in ``jobs`` workers; yield results, with the places of their items, as they come.

    ``jobs``: None is one worker for each processor. ``start``: how processes start; or threads, for work that waits for
    processes of its own. ``preload``: module that the server imports before it forks workers. ``begin`` is called once
    in each worker: it sets state that its items share. ``tick`` is called about every 0.2 s while results are awaited.
    What is sent to a worker is pickled. At most two items for each worker are drawn from ``items`` ahead.

    When the generator is closed or fails, running items end by SIGTERM (in threads: they are awaited), and the others
    do not start. Raise what ``work`` raises, and :class:`WorkerLostError` if a process ends by itself.
    """
    jobs = jobs or os.cpu_count() or 1
    pool: ThreadPoolExecutor | ProcessPoolExecutor
    if start == "thread":
        pool = ThreadPoolExecutor(jobs)
    else:
        others = set(multiprocessing.active_children())
        context = multiprocessing.get_context(start)
        if preload:
            context.set_forkserver_preload([preload])
        pool = ProcessPoolExecutor(jobs, context, initializer=_begin, initargs=(begin,))
    running: dict[Future[Result], int] = {}
    left = iter(enumerate(items))
    finished = False
    try:
        while True:
            # As many again as there are workers: one that is ready has its next item at hand.
            while len(running) < 2 * jobs and (following := next(left, None)) is not None:
                running[pool.submit(work, following[1])] = following[0]
            if not running:
                break
            done = wait(running, None if tick is None else _TICK, FIRST_COMPLETED).done
            if tick is not None:
                tick()
            for each in done:
                yield running.pop(each), each.result()
        finished = True
    except BrokenExecutor:
        raise WorkerLostError from None
    finally:
        with deferred():
            if not finished and isinstance(pool, ProcessPoolExecutor):
                for process in set(multiprocessing.active_children()) - others:
                    process.terminate()
            pool.shutdown(cancel_futures=True)


def _begin(begin: Callable[[], None] | None) -> None:
    # Ctrl-C is sent to all processes of a terminal; the parent handles it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    if begin is not None:
        begin()


class Worker:
    """A process, and the end of the pipe to it that this process has."""

    def __init__(self, context: Any, main: Callable[..., None], *arguments: object, duplex: bool = False) -> None:
        """Start ``main(its end of the pipe, *arguments)``. ``context``: of multiprocessing. Raise ``OSError``."""
        ours, theirs = context.Pipe(duplex)
        self.connection: Connection = ours
        with theirs:
            self.process = context.Process(target=main, args=(theirs, *arguments), daemon=True)
            self.process.start()

    def status(self, patience: float = 5.0) -> int | None:
        """Return the exit status (-N: signal N) of a worker that closed the pipe; None if it is not over in time."""
        self.process.join(patience)
        status: int | None = self.process.exitcode
        return status

    def end(self, patience: float = 10.0, *, terminate: bool = False) -> None:
        """Wait ``patience`` s for the end of the process, with ``terminate`` after SIGTERM; kill it; close the pipe."""
        if terminate:
            self.process.terminate()
        self.process.join(patience)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()
        self.connection.close()
