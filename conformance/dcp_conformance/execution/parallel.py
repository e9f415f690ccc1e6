"""One run in several workers: each has an implementation of its own, and a share of the cases.

Cases wait most of the time, so that workers cost little. Only our own node can be had several times; a foreign
implementation is there once.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import sys
from collections.abc import Iterator, Sequence
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from dcp_conformance.model.case import SANITY, Case
from dcp_conformance.model.results import CaseResult, Sut

from .run import ConformanceRun
from .selection import Selection
from .signals import deferred
from .target import TargetOptions


class WorkerEnd(NamedTuple):
    """The last message of a worker."""

    sut: Sut | None
    notes: tuple[str, ...]
    trouble: str
    usage: bool
    passive: tuple[CaseResult, ...] = ()


class Revised(NamedTuple):
    """Replaces a result of a worker; JSON of a ``CaseResult``."""

    result: bytes


def workers_for(run: ConformanceRun, jobs: int | None = None) -> int:
    """How many workers a run needs, at most ``jobs``: one unless it is our own node in processes, or has few cases.

    By default two for each processor, 4 to 16: a worker takes a twentieth of one, but starts with a second of work.
    """
    options = run.options
    jobs = jobs or min(16, max(4, 2 * (os.cpu_count() or 1)))
    return 1 if options.foreign or options.in_process else max(1, min(jobs, len(run.selected)))


def run_in_workers(run: ConformanceRun, workers: int) -> None:
    """Run the selected cases of ``run`` in this many processes, and pass each result to ``run`` as it comes."""
    # Every worker begins with the sanity case, and runs only that if nothing else is wanted.
    cases = [case.id for case in run.selected if case.base != SANITY] or [SANITY]
    workers = max(1, min(workers, len(cases)))
    # Neighbouring cases take about the same time: dealing them out one by one balances the workers.
    shares = [cases[number::workers] for number in range(workers)]
    # Imports take most of the time to start a worker: they are done once, in the server that forks the workers.
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([f"{__package__}.preload"])
    if run.on_start is not None:
        run.on_start(len(cases))
    with contextlib.ExitStack() as stack:
        connections: dict[Connection, Any] = {}
        for share in shares:
            ours, theirs = context.Pipe(duplex=False)
            options = (run.options, _selection(run, share), run.repeat, run.until_fail, run.artefacts)
            process = context.Process(target=_lane, args=(theirs, *options), daemon=True)
            process.start()
            theirs.close()
            stack.callback(_end, process)
            connections[ours] = process
        ends: list[WorkerEnd] = []
        try:
            for message in messages(connections):
                if isinstance(message, WorkerEnd):
                    ends.append(message)
                    continue
                if isinstance(message, Revised):
                    run.revise(msgspec.json.decode(message.result, type=CaseResult))
                    continue
                result = msgspec.json.decode(message, type=CaseResult)
                run.take(run.cases[result.id], result)
                if run.stops(result):
                    break
        except KeyboardInterrupt:
            run.interrupt(len({result.id for result in run.results} - {SANITY}), len(cases))
        with deferred():
            stack.close()
    run.close_workers(ends, workers, [run.cases[name] for name in cases] * run.repeat)


def _selection(run: ConformanceRun, cases: Sequence[str]) -> Selection:
    """The selection of one worker."""
    return Selection(patterns=tuple(cases), exclude=() if run.with_sanity else (SANITY,), first=run.first)


def messages(connections: dict[Connection, Any]) -> Iterator[Any]:
    """Yield the messages of all workers until all have ended; ``connections``: one for each worker, with its process.

    For a worker that ends without a :class:`LaneEnd`, yields one with the reason.
    """
    open_ones = dict(connections)
    done: set[Connection] = set()
    while open_ones:
        for ready in wait(list(open_ones)):
            assert isinstance(ready, Connection)
            try:
                message = ready.recv()
            except (EOFError, OSError):
                # OSError: the worker was killed in the middle of a message.
                process = open_ones.pop(ready)
                process.join(5)
                if process.exitcode or ready not in done:
                    # It ended without its last message.
                    status = f"with status {process.exitcode}"
                    text = f"a worker of the tester has ended {status}, before all its cases were run"
                    yield WorkerEnd(None, (), text, usage=False)
                continue
            if isinstance(message, WorkerEnd):
                done.add(ready)
            yield message


def _lane(
    to: Connection,
    options: TargetOptions,
    selection: Selection,
    repeat: int,
    until_fail: bool,
    artefacts: Path | None,
) -> None:
    """The main function of a worker's process."""
    # Ctrl-C reaches the whole group; the parent decides what it means.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # The parent ends a worker with SIGTERM; everything is closed then.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    sys.stdout = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115 - for as long as the process lives
    sent: set[tuple[str, int]] = set()

    def report(_case: Case, result: CaseResult, _surprise: str) -> None:
        # A result that replaces another one is sent as such.
        if (result.id, result.attempt) not in sent:
            sent.add((result.id, result.attempt))
            to.send(msgspec.json.encode(result))

    run = ConformanceRun(
        options,
        selection,
        repeat=repeat,
        until_fail=until_fail,
        artefacts=artefacts,
        on_result=report,
    )
    try:
        run.execute(lambda result: to.send(Revised(msgspec.json.encode(result))))
        about = run.result()
        to.send(WorkerEnd(about.sut, about.notes, run.trouble, run.usage, tuple(run.passive)))
    except (BrokenPipeError, KeyboardInterrupt):
        # The parent has gone, or has ended the worker.
        return
    finally:
        to.close()


def _end(process: Any) -> None:
    if process.is_alive():
        process.terminate()
        process.join(10)
    if process.is_alive():
        process.kill()
