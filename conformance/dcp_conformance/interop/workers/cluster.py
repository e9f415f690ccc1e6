"""Cells in virtual time by the workers of a Dask cluster."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from importlib import import_module
from typing import Any, Final

from dcp_codec.common.signals import Stop
from dcp_conformance.errors import ConformanceError, UsageError
from dcp_conformance.interop.cell import Cell
from dcp_conformance.interop.results import CellResult

#: Seconds that a scheduler has to answer.
_PATIENCE: Final = 10


def run_on_cluster(
    job: Callable[[Cell, Stop], CellResult], cells: Sequence[Cell], scheduler: str, jobs: int
) -> Iterator[tuple[int, CellResult]]:
    """Do a job with each cell by the workers of a Dask cluster, and yield results with their places.

    ``scheduler``: its address, or ``local`` for a cluster of ``jobs`` processes on this machine. Raises ``UsageError``
    if there is no such scheduler, ``ConformanceError`` if it loses a cell.
    """
    try:
        # By name: it has no type information.
        distributed: Any = import_module("distributed")
    except ImportError:
        raise UsageError("--dask needs dask.distributed: pip install 'dcp-conformance-kit[dask]'") from None
    with ExitStack() as stack:
        client = _client(distributed, scheduler, min(jobs, len(cells)), stack)
        # By default Dask executes equal calls once.
        numbers = {client.submit(job, cell, Stop(), pure=False): number for number, cell in enumerate(cells)}
        try:
            for future, result in distributed.as_completed(list(numbers), with_results=True):
                # Without a reference to the future the cluster need not keep its result.
                yield numbers.pop(future), result
        except (distributed.KilledWorker, distributed.CancelledError) as error:
            raise ConformanceError(f"the Dask cluster lost a cell: {error}") from None
        finally:
            # Cells that have not ended are not needed any more.
            client.cancel(list(numbers))


def _client(distributed: Any, scheduler: str, jobs: int, stack: ExitStack) -> Any:
    try:
        if scheduler == "local":
            scheduler = stack.enter_context(
                distributed.LocalCluster(n_workers=jobs, threads_per_worker=1, dashboard_address=None, silence_logs=50)
            )
        return stack.enter_context(distributed.Client(scheduler, timeout=_PATIENCE))
    except (OSError, ValueError) as error:
        raise UsageError(f"--dask {scheduler}: the scheduler cannot be reached: {error}") from None
