"""Execute one run in several worker processes, each with its own node and a share of the cases.

Cases wait most of the time, so that many workers need few processors. An implementation of the user runs several times
only if the user asks for it (:mod:`.copies`).
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import multiprocessing
import os
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from dcp_codec.common.signals import deferred
from dcp_codec.common.workers import Worker
from dcp_codec.network.namespaces import NamespaceError
from dcp_conformance.definitions.case import SANITY, Case
from dcp_conformance.definitions.results import CaseResult
from dcp_conformance.execution.run import ConformanceRun, WorkerEnd
from dcp_conformance.execution.selection import Selection

from .copies import Cable, cable_of, enter


class Revised(NamedTuple):
    """A message that replaces an earlier result of a worker."""

    result: bytes
    """JSON of a ``CaseResult``."""


def workers_for(run: ConformanceRun, jobs: int | None = None) -> int:
    """Return the number of workers for a run, at most ``jobs`` and at most the number of cases.

    For the reference node in processes ``jobs`` defaults to three for each processor, but 6 to 16: a worker needs a
    twentieth of a processor, but a second of processor time to start. Otherwise it defaults to 1.
    """
    options = run.options
    if options.in_process:
        return 1
    jobs = jobs or (1 if options.foreign else min(16, max(6, 3 * (os.cpu_count() or 1))))
    return max(1, min(jobs, len(run.selected)))


def run_in_workers(run: ConformanceRun, workers: int) -> None:
    """Run the selected cases of ``run`` in ``workers`` processes, and add each result to ``run`` when it arrives.

    Raises :class:`UsageError` if an implementation of the user cannot run several times.
    """
    cable = cable_of(run.options) if run.options.foreign else None
    # Every worker begins with the sanity case, also if no other case is selected.
    cases = [case.id for case in run.selected if case.base != SANITY] or [SANITY]
    workers = max(1, min(workers, len(cases)))
    # Adjacent cases take about the same time: assigning them in turn balances the workers.
    shares = [cases[number::workers] for number in range(workers)]
    # Imports take most of the time to start a worker. Import once, in the server that forks the workers.
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([f"{__package__}.preload"])
    if run.on_start is not None:
        run.on_start(len(cases))
    with contextlib.ExitStack() as stack:
        connections: dict[Connection, Worker] = {}
        for number, share in enumerate(shares, 1):
            target = run.options
            if target.output is not None:
                target = dataclasses.replace(target, output=target.output.with_stem(f"{target.output.stem}-{number}"))
            make = functools.partial(
                ConformanceRun,
                target,
                _selection(run, share),
                repeat=run.repeat,
                max_fails=run.max_fails,
                artefacts=run.artefacts,
                side_by_side=run.side_by_side,
            )
            worker = Worker(context, _execute_share, make, cable, target.output and target.output.parent)
            stack.callback(worker.end, terminate=True)
            connections[worker.connection] = worker
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
    """Return the selection of one worker: its share of the cases, with or without the sanity case."""
    return Selection(patterns=tuple(cases), exclude=() if run.with_sanity else (SANITY,))


def messages(connections: dict[Connection, Worker]) -> Iterator[Any]:
    """Yield the messages of all workers until all have ended. ``connections`` maps their connections to them.

    If a worker ends without a :class:`WorkerEnd`, yield one with the reason.
    """
    open_ones = dict(connections)
    done: set[Connection] = set()
    while open_ones:
        for ready in wait(list(open_ones)):
            assert isinstance(ready, Connection)
            try:
                message = ready.recv()
            except (EOFError, OSError):
                # OSError: the worker was killed while it sent a message.
                status = open_ones.pop(ready).status()
                if status or ready not in done:
                    # The worker ended without its last message.
                    text = f"a worker of the tester has ended with status {status}, before all its cases were run"
                    yield WorkerEnd(None, (), text, usage=False)
                continue
            if isinstance(message, WorkerEnd):
                done.add(ready)
            yield message


def _execute_share(
    to: Connection, make: Callable[..., ConformanceRun], cable: Cable | None, shared: Path | None
) -> None:
    """Execute one share of the cases and send the results: the main function of a worker process.

    ``make`` makes its run. ``cable``: that of an implementation of the user, which the worker starts in namespaces of
    its own; ``shared``: the folder in which it makes files for others.
    """
    # Ctrl-C is sent to the whole process group; the parent handles it and ends the workers.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # The parent ends a worker by SIGTERM. As a KeyboardInterrupt it closes all resources.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    sys.stdout = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115 - for as long as the process lives
    sent: set[tuple[str, int]] = set()

    def report(_case: Case, result: CaseResult, _surprise: str) -> None:
        # A revised result is sent by another callback, as Revised.
        if (result.id, result.attempt) not in sent:
            sent.add((result.id, result.attempt))
            to.send(msgspec.json.encode(result))

    try:
        if cable is not None:
            enter(cable, shared)
        run = make(on_result=report)
        run.execute(lambda result: to.send(Revised(msgspec.json.encode(result))))
        to.send(run.end())
    except NamespaceError as error:
        to.send(WorkerEnd(None, (), f"--jobs: {error}", usage=True))
    except (BrokenPipeError, KeyboardInterrupt):
        # The parent has ended, or has ended the worker.
        return
    finally:
        to.close()
