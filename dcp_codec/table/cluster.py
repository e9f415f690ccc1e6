"""Recordings decoded by a Dask cluster: one task for each, on folders that all workers see."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from importlib import import_module
from pathlib import Path
from typing import Any

import msgspec

from .job import Advance, Job, Outcome, TableError, run

#: Seconds that a scheduler has to answer.
_PATIENCE = 10


def run_on_cluster(jobs: Sequence[Job], workers: int, scheduler: str | None, advance: Advance) -> list[Outcome]:
    """The outcomes of ``jobs`` in their order. ``scheduler`` is the address of a cluster; None starts a local one.

    Paths are made absolute, and have to mean the same to every worker. Raises ImportError without dask.distributed,
    and TableError if there is no scheduler at the address or its workers die.
    """
    # By name, since it says nothing of types.
    distributed: Any = import_module("distributed")
    whole = [
        msgspec.structs.replace(
            job,
            path=str(Path(job.path).resolve()),
            folder=str(Path(job.folder).resolve()),
            profile=str(Path(job.profile).resolve()) if Path(job.profile).is_file() else job.profile,
        )
        for job in jobs
    ]
    with ExitStack() as stack:
        if scheduler is None:
            cluster = distributed.LocalCluster(
                n_workers=min(workers, len(jobs)), threads_per_worker=1, dashboard_address=None, silence_logs=50
            )
            client = stack.enter_context(distributed.Client(stack.enter_context(cluster)))
        else:
            try:
                client = stack.enter_context(distributed.Client(scheduler, timeout=_PATIENCE))
            except (OSError, ValueError) as error:
                raise TableError(f"the Dask scheduler {scheduler} cannot be reached: {error}") from error
        # Two equal jobs are one to Dask unless it is told otherwise.
        futures = [client.submit(run, job, pure=False) for job in whole]
        sizes = {future.key: _size(job.path) for future, job in zip(futures, whole, strict=True)}
        for future in distributed.as_completed(futures):
            advance(sizes[future.key])
        try:
            outcomes: list[Outcome] = client.gather(futures)
        except (distributed.KilledWorker, distributed.CancelledError) as error:
            raise TableError(f"the Dask cluster lost a recording: {error}") from error
    for outcome, job in zip(outcomes, jobs, strict=True):
        outcome.path = job.path
    return outcomes


def _size(path: str) -> int:
    try:
        return Path(path).stat().st_size
    except OSError:
        return 0
