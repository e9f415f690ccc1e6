"""Worker processes for cells that end in an orderly way: no namespace, link or process is left.

A worker interrupts its job when a signal asks for it, when the command closes their pipe, and when the command has
died. All of this is one signal handler in the worker (``Stop``). The job heeds it only where that does no harm: a cell
while its test runs, and not while its network is built or removed.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Generator, Sequence
from functools import partial
from multiprocessing.connection import Connection
from typing import Final

from dcp_conformance.errors import ConformanceError

from dcp_codec.common.signals import Stop, deferred
from dcp_codec.common.workers import Item, Result, WorkerLostError, completed
from dcp_codec.network.namespaces import NamespaceError
from dcp_lab.sim.testbed import namespaces

#: Seconds that workers have to remove their networks: a relay and an upper tester may each take a minute to answer.
_END: Final = 150.0
#: Seconds in which a signal to the whole process group reaches this process as well.
_GROUP: Final = 1.0


class _Worker:
    """The state of a worker process."""

    def __init__(self, command: Connection, life: Connection) -> None:
        """``command``: closed by the command when it ends. ``life``: closed when this process ends."""
        self.stop = Stop()
        self.stop.install()
        self.busy = False
        self._command = command
        self._life = life
        threading.Thread(target=self._watch, args=(threading.get_ident(),), daemon=True).start()

    def _watch(self, main_thread: int) -> None:
        with contextlib.suppress(EOFError, OSError):
            self._command.recv_bytes()
        deadline = time.monotonic() + _END
        signal.pthread_kill(main_thread, signal.SIGTERM)
        time.sleep(0.1)
        while self.busy and time.monotonic() < deadline:
            time.sleep(0.1)
        # The main thread waits for a job, which the command no longer sends, or hangs in something that no signal ends.
        os._exit(1)

    def run(self, job: Callable[[Item, Stop], Result], item: Item) -> Result:
        """Do a job. Raises ``KeyboardInterrupt`` after a signal."""
        self.busy = True
        try:
            if self.stop.wanted:
                raise KeyboardInterrupt
            return job(item, self.stop)
        finally:
            self.busy = False


_worker: _Worker | None = None
"""Set once at the start of a worker process; the pool has no other place for it."""


def _begin(command: Connection, life: Connection) -> None:
    global _worker
    _worker = _Worker(command, life)


def _run(job: Callable[[Item, Stop], Result], item: Item) -> Result:
    assert _worker is not None
    return _worker.run(job, item)


def run_in_workers(
    job: Callable[[Item, Stop], Result], items: Sequence[Item], jobs: int
) -> Generator[tuple[int, Result]]:
    """Do a job with each item, ``jobs`` at a time; yields results, with their places in ``items``, as they come.

    Job, items and results are pickled. Interrupts all workers when the generator is closed or interrupted, and waits
    until they have removed what they had built. Raises ``ConformanceError`` if a worker ends by itself.
    """
    context = multiprocessing.get_context("forkserver")
    command, our_command = context.Pipe(duplex=False)
    our_life, life = context.Pipe(duplex=False)
    finished = False
    try:
        begin, preload = partial(_begin, command, life), f"{__package__}.preload"
        yield from completed(partial(_run, job), items, jobs, start="forkserver", preload=preload, begin=begin)
        finished = True
    except WorkerLostError as error:
        # A signal to the process group also ends the server that forks workers. It means an interruption then.
        time.sleep(_GROUP)
        raise ConformanceError(str(error)) from None
    finally:
        with deferred():
            command.close()
            life.close()
            our_command.close()
            # Without that server the pool cannot wait for its workers; they hold the other end of this pipe.
            our_life.poll(_END + 5)
            our_life.close()
            if not finished:
                with contextlib.suppress(NamespaceError):
                    namespaces.sweep()
