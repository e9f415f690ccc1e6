"""``dcp-node sweep``: a scenario for all combinations of some values, and for several seeds."""

from __future__ import annotations

import json
import math
import shutil
import sys
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dcp_codec.common.commandline import ExpectedError, path_option
from dcp_codec.common.extras import advice
from dcp_stack.cli.common import note, table_lines

if TYPE_CHECKING:
    from dcp_lab.sim.sweep.plan import Run
    from dcp_lab.sim.sweep.results import Estimate, Outcome

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
@path_option(
    "--out",
    metavar="DIR",
    help="Folder of the results; runs that it has are not repeated.  [default: STUDY without .toml]",
    file_okay=False,
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
@path_option(
    "--verify",
    metavar="BUNDLE",
    help="Repeat the runs of a bundle.json of STUDY, and compare their digests.",
    dir_okay=False,
    exists=True,
)
def command(
    study: Path, out: Path | None, seeds: int | None, jobs: int | None, until_ci: float | None, verify: Path | None
) -> int:
    """Run STUDY, a scenario (docs/scenarios.md) with a table [sweep]: lists of values by the keys of the scenario.

    Writes runs.jsonl as it goes, and at the end table.csv, runs.csv, bundle.json, runs.parquet (needs pyarrow), and
    plot.svg, plot.png and page.html (need matplotlib).
    """
    import msgspec

    from dcp_lab.sim.scenario.definition import ScenarioError
    from dcp_lab.sim.sweep.output import notes, write_page, write_parquet, write_tables
    from dcp_lab.sim.sweep.output import table as table_for_people
    from dcp_lab.sim.sweep.plan import load_study
    from dcp_lab.sim.sweep.results import farthest, stored, summaries

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
            table = summaries(own, found.preceding())
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
        names = ["runs.jsonl", *write_tables(found, own, table, folder)]
        for write, what, package in (
            (write_parquet, "runs.parquet", "pyarrow"),
            (write_page, "plot.svg, plot.png and page.html", "matplotlib"),
        ):
            try:
                names += write(found, own, table, folder)
            except ImportError:
                note(f"without {what}: {advice(package)}")
    except ScenarioError as error:
        raise ExpectedError(str(error)) from None
    except OSError as error:
        raise ExpectedError(f"{folder}: {error.strerror}") from None
    cpu = sum(each.cpu_s for each in own)
    took = time.monotonic() - begun
    click.echo(f"{len(own)} of {len(runs)} runs ({resumed} resumed), {cpu:.1f} CPU s, {took:.1f} s\n")
    header, lines = table_for_people(found, table)
    width = shutil.get_terminal_size().columns if sys.stdout.isatty() else None
    click.echo("\n".join(table_lines(header, lines, width) if lines else ["no values were produced"]))
    for each in notes(found, table):
        click.echo(each)
    if unmet := sum(not each.met for each in own):
        click.echo(f"\n{unmet} runs do not meet the expectations of the scenario")
    click.echo(f"\n{folder}: {', '.join(names)}")
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
    from dcp_lab.sim.sweep.results import outcome

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
