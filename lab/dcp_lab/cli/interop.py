"""``dcp-conformance interop``."""

from __future__ import annotations

import contextlib
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec
from dcp_conformance.cli.options import as_typed
from dcp_conformance.errors import UsageError

from dcp_codec.common.commandline import path_option, say

if TYPE_CHECKING:
    from dcp_lab.interop.cell import WorldKind
    from dcp_lab.interop.results import CellResult, MatrixResult

EXIT_STATUS = (
    "Exit status: 0 every cell that applies passes; 1 a cell fails; 2 wrong usage, or no cell applies; 3 a cell is "
    "inconclusive; 4 a fault of the tester; 130 interrupted."
)


@click.command("interop", epilog=EXIT_STATUS)
@click.argument("file", required=False, type=click.Path(path_type=Path))
@click.option("--virtual", is_flag=True, help="Run in virtual time on a simulated medium instead of processes.")
@click.option("--test", "tests", multiple=True, metavar="ID|GLOB", help="Only these network tests.")
@click.option("--short", is_flag=True, help="Only the short selection of network tests.")
@click.option(
    "--with",
    "names",
    multiple=True,
    metavar="IMPL",
    help="Add an implementation: node:PROFILE; mutant:ID or variant:ID (dcp-conformance-selftest).",
)
@click.option("--only", multiple=True, metavar="IMPL:IMPL:TEST", help="Only this cell.")
@click.option(
    "--seed", type=int, default=1, show_default=True, metavar="N", help="Random seed; with --seeds, the first one."
)
@click.option(
    "--seeds", type=click.IntRange(1), default=1, show_default=True, metavar="N", help="Number of seeds for each cell."
)
@click.option(
    "-j",
    "--jobs",
    type=click.IntRange(1),
    metavar="N",
    help="Number of concurrent cells.  [default: six for each processor; --virtual: one]",
)
@path_option("--report-dir", metavar="DIR", help="Write reports and recordings there.")
@path_option("--replay", metavar="FILE", help="Run the cell of a failed/*.json again, with its seed.")
@click.option("--list", "show_list", is_flag=True, help="Only show the network tests.")
@click.option("--quiet", "-q", is_flag=True, help="Show only cells that do not pass.")
def command(
    file: Path | None,
    tests: tuple[str, ...],
    names: tuple[str, ...],
    only: tuple[str, ...],
    seed: int,
    seeds: int,
    jobs: int | None,
    report_dir: Path | None,
    replay: Path | None,
    *,
    virtual: bool,
    short: bool,
    show_list: bool,
    quiet: bool,
) -> int:
    """Test networks of several implementations: each pair, in both roles.

    FILE (TOML) describes the implementations; without FILE the reference node in all versions is tested with itself.
    """
    from dcp_conformance.cli.display import Minutes

    from dcp_lab.interop.definition import select_tests
    from dcp_lab.interop.implementations import BUILT_IN, Matrix, load_description, resolve
    from dcp_lab.interop.matrix import applicable, cells_of, forecast, parse_only, run_matrix

    chosen = select_tests(tests, short=short)
    if show_list:
        for each in chosen:
            say(f"{each.id:<34} {each.purpose}")
        return 0
    if seeds > 1 and not (virtual or replay):
        raise UsageError("--seeds repeats cells in virtual time; add --virtual")
    if replay is not None:
        return _replay(replay, file, report_dir)
    described = load_description(file) if file is not None else None
    known = described.implementation if described is not None else {}
    choice = described.matrix if described is not None else Matrix()
    wanted = parse_only(only)
    kind: WorldKind = "virtual" if virtual else "real"
    if wanted:
        from dcp_lab.interop.definition import all_tests

        cells = []
        for a, b, test in wanted:
            if test not in all_tests():
                raise UsageError(f"--only: there is no network test {test!r}; see dcp-conformance interop --list")
            found = resolve((a, b), known)
            cells += cells_of(found, [all_tests()[test]], rows=[a], columns=[b], world=kind, seed=seed)
    else:
        found = resolve([*(known or ([] if names else BUILT_IN)), *names], known)
        if not tests and choice.tests:
            chosen = select_tests(choice.tests, short=short)
        rows = [*choice.rows, *names] if choice.rows else []
        columns = [*choice.columns, *names] if choice.columns else []
        cells = cells_of(found, chosen, rows=rows, columns=columns, world=kind, seed=seed)

    if (text := forecast(cells, jobs)) and not quiet:
        say(text)
    minutes = Minutes("cells", partial(say, err=True))
    minutes.start(len(applicable(cells)))

    def on_cell(result: CellResult, done: int, many: int) -> None:
        minutes.done(f"{result.a} with {result.b}: {result.test}")
        if not quiet or result.verdict not in ("pass", "not-applicable"):
            _say_cell(result, f"{done}/{many} ")

    from dcp_codec.common.signals import deferred, ending_like_interrupts

    if report_dir is not None:
        report_dir.mkdir(parents=True, exist_ok=True)
    with ending_like_interrupts(), contextlib.nullcontext() if quiet else minutes:
        matrix = run_matrix(cells, seeds=seeds, jobs=jobs, folder=report_dir, on_cell=on_cell, command=as_typed())
        with deferred():
            if file is not None:
                matrix = _with_file(matrix, file)
            return _finish(matrix, report_dir)


def _with_file(matrix: MatrixResult, file: Path) -> MatrixResult:
    """Add the description file to the commands that repeat cells."""
    import shlex

    def changed(cell: CellResult) -> CellResult:
        words = cell.rerun.replace("interop ", f"interop {shlex.quote(str(file))} ", 1)
        return msgspec.structs.replace(cell, rerun=words)

    return msgspec.structs.replace(matrix, cells=tuple(map(changed, matrix.cells)))


def _say_cell(result: CellResult, before: str = "") -> None:
    line = f"{before}{result.verdict:<12} {result.a} with {result.b}: {result.test}"
    say(f"{line}  {result.reason}" if result.reason else line)


def _finish(matrix: MatrixResult, report_dir: Path | None) -> int:
    from dcp_conformance.definitions.outcome import INTERRUPTED, TESTER_ERROR

    from dcp_lab.interop.reporting import write_reports
    from dcp_lab.interop.results import INTERRUPTED as EARLY

    counts = matrix.counts()
    applied = sum(counts.values()) - counts.get("not-applicable", 0)
    listed = ", ".join(f"{number} {name}" for name, number in sorted(counts.items()))
    say(f"{len(matrix.cells)} cells in {matrix.elapsed_s:.1f} s: {listed or 'none'}")
    if matrix.incomplete:
        say(matrix.incomplete, err=True)
    if report_dir is not None:
        say(f"report: {write_reports(matrix, report_dir)}")
    if matrix.ended_early:
        return INTERRUPTED if matrix.ended_early == EARLY else TESTER_ERROR
    if not applied:
        say("no network test applies to these implementations", err=True)
        return 2
    for verdict, status in (("error", 4), ("fail", 1), ("inconclusive", 3)):
        if counts.get(verdict):
            return status
    return 0


def _replay(path: Path, file: Path | None, report_dir: Path | None) -> int:
    from dcp_conformance.definitions.input_files import load_file

    from dcp_lab.interop.cell import Cell
    from dcp_lab.interop.definition import all_tests
    from dcp_lab.interop.implementations import load_description, resolve
    from dcp_lab.interop.matrix import run_matrix
    from dcp_lab.interop.results import CellResult

    before = load_file(path, CellResult, what="a failed cell (failed/*.json of a report)")
    if before.test not in all_tests():
        raise UsageError(f"{path}: there is no network test {before.test!r} in this version")
    known = load_description(file).implementation if file is not None else {}
    found = resolve((before.a, before.b), known)
    kind: WorldKind = "virtual" if before.world == "virtual" else "real"
    cell = Cell(
        a=before.a, b=before.b, test=before.test, implementations=(found[before.a], found[before.b]), world=kind,
        seed=before.seed,
    )  # fmt: skip
    from dcp_codec.common.signals import deferred, ending_like_interrupts

    if report_dir is not None:
        report_dir.mkdir(parents=True, exist_ok=True)
    with ending_like_interrupts():
        matrix = run_matrix([cell], jobs=1, folder=report_dir, command=as_typed())
        with deferred():
            for each in matrix.cells:
                _say_cell(each)
                if (each.verdict, each.reason) != (before.verdict, before.reason):
                    say(f"before: {before.verdict}  {before.reason}")
            return _finish(matrix, report_dir)
