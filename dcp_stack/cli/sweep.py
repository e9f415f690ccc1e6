"""``dcp-node sweep``: a scenario for all combinations of some values, and for several seeds."""

from __future__ import annotations

import csv
import json
import math
import shutil
import sys
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dcp_codec.common.commandline import ExpectedError

from .common import note, table_lines

if TYPE_CHECKING:
    from dcp_stack.sim.sweep.plan import Run, Study
    from dcp_stack.sim.sweep.results import Estimate, Outcome, Summary

DIFFERENT, INCOMPLETE = 1, 4
#: Seeds after which ``--until-ci`` ends.
_MOST_SEEDS = 1000
#: Seconds between two reports of progress.
_PROGRESS_S = 2.0


@click.command(
    "sweep",
    epilog="Exit status: 0 all runs are done; 1 with --verify: a run has another digest; 2 wrong usage, an invalid "
    "study or a file that cannot be written; 4 interrupted (Ctrl-C): the runs that are done are kept.",
)
@click.argument("study", type=click.Path(dir_okay=False, path_type=Path), metavar="STUDY")
@click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="DIR",
    help="Folder of the results; runs that it has are not repeated.  [default: STUDY without .toml]",
)
@click.option("--seeds", type=click.IntRange(min=1), metavar="N", help="Number of seeds, in place of sweep.seeds.")
@click.option("--jobs", type=click.IntRange(min=1), metavar="N", help="Processes.  [default: all cores]")
@click.option(
    "--until-ci",
    type=click.FloatRange(0, 1, min_open=True),
    metavar="X",
    help="Double the seeds of each combination until half of the confidence interval of the share at the longest "
    "distance is at most X (up to 1,000 seeds).",
)
@click.option(
    "--verify",
    type=click.Path(dir_okay=False, exists=True, path_type=Path),
    metavar="BUNDLE",
    help="Repeat the runs of a bundle.json of STUDY, and compare their digests.",
)
def command(
    study: Path, out: Path | None, seeds: int | None, jobs: int | None, until_ci: float | None, verify: Path | None
) -> int:
    """Run STUDY, a scenario (docs/scenarios.md) with a table [sweep]: lists of values by the keys of the scenario.

    Writes runs.jsonl as it goes, and at the end table.csv, plot.svg, runs.csv, runs.parquet (extra
    'table') and bundle.json.
    """
    import msgspec

    from dcp_stack.sim.scenario.definition import ScenarioError
    from dcp_stack.sim.sweep.plan import load_study
    from dcp_stack.sim.sweep.results import farthest, stored, summaries

    folder = out or study.with_suffix("")
    try:
        found = load_study(study, seeds)
        runs = found.runs(str(study))
        if verify is not None:
            return _verify(runs, verify, jobs)
        if out is None and folder == study:
            raise ExpectedError(f"{study}: give a folder for the results: --out DIR")
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / "runs.jsonl"
        done = stored(path)
        resumed, begun = sum(run.key in done for run in runs), time.monotonic()
        while True:
            complete = _run_missing(runs, done, path, jobs)
            # The numbers of cells are those of this study: the file may have runs of another one.
            own = [
                msgspec.structs.replace(done[run.key], cell=run.cell, seed=run.seed) for run in runs if run.key in done
            ]
            table = summaries(own)
            wide = {
                each.cell
                for each in farthest(table)
                if until_ci is not None and each.share is not None and _half(each.share) > until_ci
            }
            if not complete or not wide or found.seeds >= _MOST_SEEDS:
                break
            # Cells that are precise enough keep their seeds.
            found = msgspec.structs.replace(found, seeds=min(2 * found.seeds, _MOST_SEEDS))
            planned = {run.key for run in runs}
            runs += [run for run in found.runs(str(study)) if run.cell in wide and run.key not in planned]
        _write(found, own, table, folder)
    except ScenarioError as error:
        raise ExpectedError(str(error)) from None
    except OSError as error:
        raise ExpectedError(f"{folder}: {error.strerror}") from None
    cpu = sum(each.cpu_s for each in own)
    took = time.monotonic() - begun
    click.echo(f"{len(own)} of {len(runs)} runs ({resumed} resumed), {cpu:.1f} CPU s, {took:.1f} s\n")
    click.echo("\n".join(_shown(found, farthest(table))))
    if unmet := sum(not each.met for each in own):
        click.echo(f"\n{unmet} runs do not meet the expectations of the scenario")
    click.echo(f"\n{folder}: runs.jsonl, runs.csv, table.csv, plot.svg, bundle.json" + _parquet(found, own, folder))
    return 0 if complete else INCOMPLETE


def _half(estimate: Estimate) -> float:
    """Return half of a confidence interval, infinity with a single seed."""
    return math.inf if estimate.half is None else estimate.half


def _run_missing(runs: Sequence[Run], done: dict[str, Outcome], path: Path, jobs: int | None) -> bool:
    """Execute the runs that are not done, and append them to the file; False after an interruption."""
    import msgspec

    from dcp_codec.common.workers import WorkerLostError

    missing = [run for run in runs if run.key not in done]
    with path.open("ab") as lines:
        if lines.tell() and not path.read_bytes().endswith(b"\n"):
            lines.write(b"\n")
        try:
            for outcome in _outcomes(missing, jobs, len(runs) - len(missing)):
                done[outcome.key] = outcome
                lines.write(msgspec.json.encode(outcome) + b"\n")
                lines.flush()
        except KeyboardInterrupt:
            return False
        except WorkerLostError as error:
            raise ExpectedError(f"{error} The runs that are done are kept", INCOMPLETE) from None
    return True


def _outcomes(runs: Sequence[Run], jobs: int | None, resumed: int) -> Iterable[Outcome]:
    """Execute runs, and yield their outcomes as they come; reports progress on stderr."""
    from dcp_codec.common.workers import completed
    from dcp_stack.sim.sweep.results import outcome

    begun = reported = time.monotonic()
    for count, (_, each) in enumerate(completed(outcome, runs, jobs), 1):
        yield each
        now = time.monotonic()
        if sys.stderr.isatty() and now - reported >= _PROGRESS_S:
            reported = now
            left = (now - begun) / count * (len(runs) - count)
            note(f"{resumed + count} of {resumed + len(runs)} runs; about {left:.0f} s left; Ctrl-C keeps what is done")


def _verify(runs: Sequence[Run], path: Path, jobs: int | None) -> int:
    """Repeat the runs of a bundle, and compare the digests."""
    expected: dict[str, str] = json.loads(path.read_text(encoding="utf-8"))["digests"]
    known = [run for run in runs if run.key in expected]
    different = [each for each in _outcomes(known, jobs, 0) if each.digest != expected[each.key]]
    for each in different:
        click.echo(f"cell {each.cell}, seed {each.seed}: digest {each.digest[:16]}, not {expected[each.key][:16]}")
    others = len(expected) - len(known)
    click.echo(f"{len(known) - len(different)} of {len(expected)} runs have the same digest")
    if others:
        note(f"{others} runs of the bundle are not runs of this study and version")
    return DIFFERENT if different or others else 0


def _shown(study: Study, found: Sequence[Summary]) -> list[str]:
    """Return the table for the terminal: for each cell the farthest nodes."""
    width = shutil.get_terminal_size().columns if sys.stdout.isatty() else None
    header = [*(key.rpartition(".")[2] for key in study.axes), "hops", "share", "delay ms", "newest", "n"]
    lines = [
        [
            *(str(study.cells[each.cell][key]) for key in study.axes),
            str(each.hops),
            "-" if each.share is None else each.share.text(3),
            "-" if each.delay_ms is None else each.delay_ms.text(1) + (" *" if each.few else ""),
            "-" if each.newest is None else each.newest.text(3),
            str(each.seeds),
        ]
        for each in found
    ]
    table = table_lines(header, lines, width) if lines else ["no values were produced"]
    marked = (
        [f"* {sum(each.few for each in found)} cells with fewer than 10 receptions"]
        if any(each.few for each in found)
        else []
    )
    return [*table, *marked]


def _write(study: Study, outcomes: Sequence[Outcome], table: Sequence[Summary], folder: Path) -> None:
    """Write the tables and the bundle."""
    from dcp_spec.version import __version__

    from dcp_stack.sim.sweep.plot import svg
    from dcp_stack.sim.sweep.results import farthest, rows

    lines: list[dict[str, Any]] = []
    for each in table:
        line: dict[str, Any] = {**study.cells[each.cell], "kind": each.kind, "hops": each.hops, "seeds": each.seeds}
        line |= {"received": each.received, "few": each.few}
        for name in ("share", "delay_ms", "newest"):
            estimate = getattr(each, name)
            line[name] = None if estimate is None else estimate.mean
            line[f"{name}_ci95"] = None if estimate is None else estimate.half
        lines.append(line)
    _csv(folder / "table.csv", lines)
    _csv(folder / "runs.csv", list(rows(study, outcomes)))
    if (plot := svg(study, farthest(table))) is not None:
        (folder / "plot.svg").write_text(plot, encoding="utf-8")
    bundle = {
        "study": study.raw,
        "kit_version": __version__,
        "python_version": sys.version.split()[0],
        "seeds": study.seeds,
        "digests": {each.key: each.digest for each in outcomes},
    }
    (folder / "bundle.json").write_text(json.dumps(bundle, indent=1) + "\n", encoding="utf-8")


def _csv(path: Path, lines: Sequence[dict[str, Any]]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(lines[0]) if lines else [])
        writer.writeheader()
        writer.writerows(lines)


def _parquet(study: Study, outcomes: Sequence[Outcome], folder: Path) -> str:
    """Write the rows of all runs as Parquet if pyarrow is installed; returns the name for the list of files."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        return " (runs.parquet needs the extra 'table')"
    from dcp_stack.sim.sweep.results import rows

    found = list(rows(study, outcomes))
    columns = {
        # Values of different types in one list, such as numbers and texts, are texts.
        key: [str(each[key]) if isinstance(each[key], dict | list) else each[key] for each in found]
        for key in (found[0] if found else ())
    }
    pyarrow.parquet.write_table(pyarrow.table(columns), folder / "runs.parquet")
    return ", runs.parquet"
