"""All cells of a matrix, several at a time, and seeds of each in virtual time."""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from importlib import import_module
from pathlib import Path
from typing import Any

import msgspec
from dcp_spec.version import __version__

from dcp_conformance.errors import ConformanceError, UsageError
from dcp_conformance.model.declared import declared_by
from dcp_conformance.model.moment import timestamp
from dcp_conformance.model.verdict import Verdict

from .cell import Cell, WorldKind, obstacle, run_cell
from .definition import NetworkTest, all_tests
from .implementations import Implementation, codec_of
from .results import CellResult, ImplementationResult, MatrixResult

OnCell = Callable[[CellResult, int, int], None]
"""Called with each result, how many there are, and of how many."""


def cells_of(
    implementations: Mapping[str, Implementation],
    tests: Iterable[NetworkTest],
    *,
    rows: Sequence[str] = (),
    columns: Sequence[str] = (),
    world: WorldKind = "virtual",
    seed: int = 1,
) -> list[Cell]:
    """Return the cells of a matrix, also those that do not apply.

    A test of different versions is symmetric in A and B, but roles are not: both orders are cells.
    """
    return [
        Cell(a=a, b=b, test=test.id, implementations=(implementations[a], implementations[b]), world=world, seed=seed)
        for test in tests
        for a in (rows or list(implementations))
        for b in (columns or list(implementations))
    ]


def parse_only(texts: Iterable[str]) -> list[tuple[str, str, str]]:
    """Parse ``IMPL:IMPL:TEST``; names of built-in implementations contain colons of their own (``node:dcp-2.0``).

    Raises ``UsageError`` for a text of another form.
    """
    found = []
    for text in texts:
        names = _names(text.split(":"))
        if names is None:
            raise UsageError(
                f"--only {text!r}: expected A:B:TEST, for example node:dcp-2.0:node:dcp-2.0:IT_VD_CREATE-pair"
            )
        found.append(names)
    return found


def _names(parts: list[str]) -> tuple[str, str, str] | None:
    names: list[str] = []
    place = 0
    while place < len(parts) and len(names) < 2:
        if parts[place] in ("node", "mutant", "variant") and place + 1 < len(parts):
            names.append(":".join(parts[place : place + 2]))
            place += 2
        else:
            names.append(parts[place])
            place += 1
    rest = parts[place:]
    return (names[0], names[1], rest[0]) if len(names) == 2 and len(rest) == 1 and all((*names, *rest)) else None


def run_seeds(cell: Cell, seeds: int, folder: Path | None = None) -> CellResult:
    """Run a cell with ``seeds`` seeds from its own on; the result is that of the first that does not pass."""
    test = all_tests()[cell.test]
    first: CellResult | None = None
    failed: list[int] = []
    chosen: CellResult | None = None
    for seed in range(cell.seed, cell.seed + seeds):
        result = run_cell(msgspec.structs.replace(cell, seed=seed), test)
        first = first or result
        if result.verdict is Verdict.NOT_APPLICABLE:
            return result
        if result.verdict is not Verdict.PASS:
            failed.append(seed)
            chosen = chosen or result
    found = chosen or first
    assert found is not None
    if folder is not None:
        # Again, with recordings: the same seed does the same.
        found = run_cell(msgspec.structs.replace(cell, seed=found.seed), test, folder)
    return msgspec.structs.replace(found, seeds=seeds, failed_seeds=tuple(failed))


def _job(cell: Cell, seeds: int, folder: str | None) -> CellResult:
    where = None if folder is None else Path(folder)
    if cell.world == "real":
        return run_cell(cell, all_tests()[cell.test], where)
    return run_seeds(cell, seeds, where)


def default_jobs(world: WorldKind) -> int:
    """How many cells run side by side: real ones wait most of the time."""
    processors = len(os.sched_getaffinity(0))
    return processors if world == "virtual" else 4 * processors


def run_matrix(
    cells: Sequence[Cell],
    *,
    seeds: int = 1,
    jobs: int | None = None,
    folder: Path | None = None,
    dask: str | None = None,
    on_cell: OnCell | None = None,
    command: str = "",
) -> MatrixResult:
    """Run cells and return their results in the same order.

    ``folder``: gets recordings and logs. ``dask``: the address of a Dask scheduler whose workers run the cells, or
    ``local`` for a cluster on this machine. Raises ``UsageError`` if there is no such scheduler.
    """
    began, started = time.monotonic(), timestamp()
    results: list[CellResult | None] = [None] * len(cells)
    tests = all_tests()
    waiting: list[int] = []
    for number, cell in enumerate(cells):
        # These need no process.
        if obstacle(tests[cell.test], *cell.implementations, cell.world):
            results[number] = run_cell(cell, tests[cell.test])
        else:
            waiting.append(number)
    done = len(cells) - len(waiting)
    where = None if folder is None else str(folder.resolve())
    chosen = [cells[number] for number in waiting]
    for number, result in _executed(chosen, seeds, jobs, where, dask):
        results[waiting[number]] = result
        done += 1
        if on_cell is not None:
            on_cell(result, done, len(cells))
    names = {name: each for cell in cells for name, each in zip((cell.a, cell.b), cell.implementations, strict=True)}
    return MatrixResult(
        tool=f"dcp-conformance {__version__}",
        started=started,
        elapsed_s=round(time.monotonic() - began, 2),
        command=command,
        implementations=tuple(_described(name, each) for name, each in names.items()),
        cells=tuple(result for result in results if result is not None),
    )


def _described(name: str, each: Implementation) -> ImplementationResult:
    found: dict[str, list[str]] = {}
    for profile in each.profiles:
        for identifier, text in declared_by(codec_of(profile).profile).items():
            found.setdefault(identifier, []).append(f"{profile}: {text}")
    declared = {identifier: "; ".join(texts) for identifier, texts in found.items()}
    return ImplementationResult(name, each.profile, each.what, declared)


def _executed(
    cells: Sequence[Cell], seeds: int, jobs: int | None, folder: str | None, dask: str | None
) -> Iterator[tuple[int, CellResult]]:
    if dask is not None:
        yield from _on_cluster(cells, seeds, folder, dask, jobs)
        return
    jobs = min(jobs or default_jobs(cells[0].world if cells else "virtual"), max(1, len(cells)))
    if jobs == 1:
        for number, cell in enumerate(cells):
            yield number, _job(cell, seeds, folder)
        return
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([f"{__package__}.preload"])
    with ProcessPoolExecutor(jobs, mp_context=context) as pool:
        running: dict[Future[CellResult], int] = {}
        left = iter(enumerate(cells))
        try:
            while True:
                for number, cell in left:
                    running[pool.submit(_job, cell, seeds, folder)] = number
                    if len(running) >= 2 * jobs:
                        break
                if not running:
                    return
                finished, _ = wait(running, return_when=FIRST_COMPLETED)
                for each in finished:
                    yield running.pop(each), each.result()
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def _on_cluster(
    cells: Sequence[Cell], seeds: int, folder: str | None, scheduler: str, jobs: int | None
) -> Iterator[tuple[int, CellResult]]:
    """Run cells by the workers of a Dask cluster, all of which see ``folder``."""
    try:
        # By name: it says nothing of types.
        distributed: Any = import_module("distributed")
    except ImportError:
        raise UsageError("--dask needs dask.distributed: pip install 'dcp-conformance-kit[table]'") from None
    try:
        if scheduler == "local":
            cluster = distributed.LocalCluster(
                n_workers=jobs or default_jobs("virtual"), threads_per_worker=1, dashboard_address=None, silence_logs=50
            )
            client = distributed.Client(cluster)
        else:
            cluster, client = None, distributed.Client(scheduler, timeout=10)
    except (OSError, ValueError) as error:
        raise UsageError(f"--dask {scheduler}: the scheduler cannot be reached: {error}") from None
    try:
        numbers = {}
        for number, cell in enumerate(cells):
            future = client.submit(_job, cell, seeds, folder, pure=False)
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
