"""All cells of a matrix, several at a time, and seeds of each in virtual time."""

from __future__ import annotations

import contextlib
import os
import re
import time
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Final

import msgspec
from dcp_conformance.definitions.declared import declared_by
from dcp_conformance.definitions.results import timestamp
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.errors import ConformanceError, UsageError
from dcp_spec.version import __version__

from dcp_codec.codec import get_codec
from dcp_codec.common.signals import Stop

from .cell import Cell, WorldKind, obstacle, run_cell
from .definition import NetworkTest, all_tests
from .implementations import Implementation
from .results import INTERRUPTED, CellResult, ImplementationResult, MatrixResult
from .workers.pool import run_in_workers

#: A name with a kind of built-in implementations has a colon.
_NAME: Final = r"((?>(?:node|mutant|variant):[^:]*|[^:]+))"
_CELL: Final = re.compile(f"{_NAME}:{_NAME}:([^:]+)")
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
        match = _CELL.fullmatch(text)
        if match is None:
            raise UsageError(
                f"--only {text!r}: expected A:B:TEST, for example node:dcp-2.0:node:dcp-2.0:IT_VD_CREATE-pair"
            )
        found.append((match[1], match[2], match[3]))
    return found


def run_seeds(cell: Cell, seeds: int, folder: Path | None = None) -> CellResult:
    """Run a cell with ``seeds`` seeds from its own on; the result is that of the first that does not pass."""
    test = all_tests()[cell.test]
    found: CellResult | None = None
    failed: list[int] = []
    for seed in range(cell.seed, cell.seed + seeds):
        result = run_cell(msgspec.structs.replace(cell, seed=seed), test)
        if result.verdict is Verdict.NOT_APPLICABLE:
            return result
        if found is None or (result.verdict is not Verdict.PASS and not failed):
            found = result
        if result.verdict is not Verdict.PASS:
            failed.append(seed)
    assert found is not None
    if folder is not None:
        # Again, with recordings: the same seed does the same.
        found = run_cell(msgspec.structs.replace(cell, seed=found.seed), test, folder)
    return msgspec.structs.replace(found, seeds=seeds, failed_seeds=tuple(failed))


def _job(cell: Cell, stop: Stop, *, seeds: int, folder: Path | None) -> CellResult:
    if cell.world == "real":
        return run_cell(cell, all_tests()[cell.test], folder, stop)
    with stop.interruptible_by_signals():
        return run_seeds(cell, seeds, folder)


def default_jobs(world: WorldKind) -> int:
    """Return the default number of cells that run side by side; real ones wait most of the time."""
    processors = len(os.sched_getaffinity(0))
    return processors if world == "virtual" else 6 * processors


def in_order(cells: Sequence[Cell], places: Iterable[int]) -> list[int]:
    """Return places of cells in the order of their start: the short selection first, and long cells before short ones.

    A long cell would otherwise be left alone at the end.
    """
    tests = all_tests()
    return sorted(places, key=lambda place: (not tests[cells[place].test].short, -tests[cells[place].test].longest_s))


def applicable(cells: Iterable[Cell]) -> list[Cell]:
    """Return the cells that will be executed."""
    tests = all_tests()
    return [each for each in cells if not obstacle(tests[each.test], *each.implementations, each.world)]


def forecast(cells: Iterable[Cell], jobs: int | None = None) -> str:
    """Return how many cells will be executed, and how long that takes at most; empty for cells in virtual time.

    ``jobs``: the number of concurrent cells; None: the default.
    """
    tests = all_tests()
    real = [each for each in applicable(cells) if each.world == "real"]
    if not real:
        return ""
    short = [each for each in real if tests[each.test].short]
    text = f"{len(real)} cells, about {_seconds(real, jobs):.0f} s at most"
    if short and len(short) < len(real):
        text += f"; first the short selection (--short), {len(short)} cells in about {_seconds(short, jobs):.0f} s"
    return text


def _seconds(cells: Sequence[Cell], jobs: int | None) -> float:
    """Return an upper estimate of the seconds that cells take."""
    longest = [all_tests()[each.test].longest_s for each in cells]
    return max(sum(longest) / (jobs or default_jobs("real")), *longest, 0.0)


def run_matrix(
    cells: Sequence[Cell],
    *,
    seeds: int = 1,
    jobs: int | None = None,
    folder: Path | None = None,
    on_cell: OnCell | None = None,
    command: str = "",
) -> MatrixResult:
    """Run cells and return their results in the same order.

    ``folder``: gets recordings and logs.

    ``KeyboardInterrupt`` and the loss of a worker end the matrix early. The result then has ``ended_early``, and the
    cells that were finished.
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
    waiting = in_order(cells, waiting)
    done = len(cells) - len(waiting)
    where = None if folder is None else folder.resolve()
    chosen = [cells[number] for number in waiting]
    ended_early = ""
    try:
        with contextlib.closing(_executed(chosen, seeds, jobs, where)) as executed:
            for number, result in executed:
                results[waiting[number]] = result
                done += 1
                if on_cell is not None:
                    on_cell(result, done, len(cells))
    except KeyboardInterrupt:
        ended_early = INTERRUPTED
    except ConformanceError as error:
        ended_early = str(error)
    names = {name: each for cell in cells for name, each in zip((cell.a, cell.b), cell.implementations, strict=True)}
    return MatrixResult(
        tool=f"dcp-conformance {__version__}",
        started=started,
        elapsed_s=round(time.monotonic() - began, 2),
        command=command,
        implementations=tuple(_described(name, each) for name, each in names.items()),
        cells=tuple(result for result in results if result is not None),
        ended_early=ended_early,
        unfinished=results.count(None),
    )


def _described(name: str, each: Implementation) -> ImplementationResult:
    found: dict[str, list[str]] = {}
    for profile in each.profiles:
        for identifier, text in declared_by(get_codec(profile).profile).items():
            found.setdefault(identifier, []).append(f"{profile}: {text}")
    declared = {identifier: "; ".join(texts) for identifier, texts in found.items()}
    return ImplementationResult(name, each.profile, each.what, declared)


def _executed(
    cells: Sequence[Cell], seeds: int, jobs: int | None, folder: Path | None
) -> Generator[tuple[int, CellResult]]:
    """Run cells and yield their results with their places in ``cells``."""
    if not cells:
        return
    jobs = jobs or default_jobs(cells[0].world)
    job = partial(_job, seeds=seeds, folder=folder)
    if jobs == 1 and cells[0].world == "virtual":
        for number, cell in enumerate(cells):
            yield number, run_seeds(cell, seeds, folder)
    else:
        yield from run_in_workers(job, cells, min(jobs, len(cells)))
