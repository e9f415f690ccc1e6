"""Decode recordings with a Dask cluster: one task for each, in folders that all workers can access."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from importlib import import_module
from pathlib import Path
from typing import Any

import msgspec

from .job import Advance, Job, Outcome, TableError, run, size_of

#: Timeout of the connection to a scheduler in seconds.
_PATIENCE = 10


def run_on_cluster(jobs: Sequence[Job], workers: int, scheduler: str | None, advance: Advance) -> list[Outcome]:
    """Execute the jobs, and return their outcomes in the same order.

    ``scheduler`` is the address of a Dask scheduler; None starts a local cluster of ``workers`` processes. Paths are
    made absolute, and must be valid for every worker. ``advance`` is called with the size of each decoded recording.
    Raise ImportError without dask.distributed, and TableError if the scheduler cannot be reached or its workers die.
    """
    # Imported by name, because the package has no type hints.
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
                n_workers=min(workers, len(jobs)),
                threads_per_worker=1,
                dashboard_address="127.0.0.1:0",
                silence_logs=50,
            )
            client = stack.enter_context(distributed.Client(stack.enter_context(cluster)))
        else:
            try:
                client = stack.enter_context(distributed.Client(scheduler, timeout=_PATIENCE))
            except (OSError, ValueError) as error:
                raise TableError(f"the Dask scheduler {scheduler} cannot be reached: {error}") from error
        # pure=False: Dask would otherwise execute equal jobs only once.
        futures = [client.submit(run, job, pure=False) for job in whole]
        sizes = {future.key: size_of(job.path) for future, job in zip(futures, whole, strict=True)}
        for future in distributed.as_completed(futures):
            advance(sizes[future.key])
        try:
            outcomes: list[Outcome] = client.gather(futures)
        except (distributed.KilledWorker, distributed.CancelledError) as error:
            raise TableError(f"the Dask cluster lost a recording: {error}") from error
    for outcome, job in zip(outcomes, jobs, strict=True):
        outcome.path = job.path
    return outcomes
