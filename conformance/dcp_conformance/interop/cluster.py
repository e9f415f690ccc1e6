"""Cells in virtual time by the workers of a Dask cluster."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from typing import Any

from dcp_conformance.errors import ConformanceError, UsageError
from dcp_conformance.execution.signals import Stop

from .cell import Cell
from .results import CellResult


def run_on_cluster(
    job: Callable[[Cell, Stop], CellResult], cells: Sequence[Cell], scheduler: str, jobs: int
) -> Iterator[tuple[int, CellResult]]:
    """Do a job with each cell by the workers of a Dask cluster, and yield results with their places.

    ``scheduler``: its address, or ``local`` for a cluster of ``jobs`` processes on this machine. Raises ``UsageError``
    if there is no such scheduler, ``ConformanceError`` if it loses a cell.
    """
    try:
        # By name: it says nothing of types.
        distributed: Any = import_module("distributed")
    except ImportError:
        raise UsageError("--dask needs dask.distributed: pip install 'dcp-conformance-kit[table]'") from None
    try:
        if scheduler == "local":
            cluster = distributed.LocalCluster(
                n_workers=jobs, threads_per_worker=1, dashboard_address=None, silence_logs=50
            )
            client = distributed.Client(cluster)
        else:
            cluster, client = None, distributed.Client(scheduler, timeout=10)
    except (OSError, ValueError) as error:
        raise UsageError(f"--dask {scheduler}: the scheduler cannot be reached: {error}") from None
    try:
        numbers = {}
        for number, cell in enumerate(cells):
            future = client.submit(job, cell, Stop(), pure=False)
            numbers[future.key] = number
            numbers[number] = future
        futures = [numbers[number] for number in range(len(cells))]
        for future, result in distributed.as_completed(futures, with_results=True):
            yield numbers[future.key], result
    except (distributed.KilledWorker, distributed.CancelledError) as error:
        raise ConformanceError(f"the Dask cluster lost a cell: {error}") from None
    finally:
        client.close()
        if cluster is not None:
            cluster.close()
