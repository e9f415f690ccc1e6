"""``dcp-selftest side-by-side``."""

from __future__ import annotations

from pathlib import Path

import click

from dcp_codec.common.commandline import say

from .common import (
    jobs_option,
    profile_option,
    quiet_option,
    report_option,
    seed_option,
    verbose_option,
    write_json,
)  # fmt: skip


@click.command(
    "side-by-side",
    epilog="Exit status: 0 the verdicts of the reference node are equal and no mutant survives only one of the modes; "
    "1 otherwise; 2 wrong usage.",
)
@click.argument("mutants", nargs=-1)
@profile_option
@seed_option
@click.option(
    "--period", "periods", type=click.IntRange(min=1), multiple=True, metavar="MS",
    help="Execute concurrent cases against nodes on a virtual Ethernet with this beacon period, instead of virtual "
    "time; can be repeated.",
)  # fmt: skip
@jobs_option
@report_option
@verbose_option
@quiet_option
def command(
    mutants: tuple[str, ...],
    profile: tuple[str, ...],
    seed: int,
    periods: tuple[int, ...],
    jobs: int | None,
    report_dir: Path | None,
    *,
    verbose: bool,
    quiet: bool,
) -> int:
    """Compare the verdicts of concurrent cases with those of cases in succession.

    The cases run against the reference node and MUTANTS: identifiers or globs of mutants; all by default.
    """
    from dcp_conformance.cli.display import progress_bar

    from dcp_selftest.runner import chosen
    from dcp_selftest.side_by_side import Comparison, compare_all

    with progress_bar(quiet=quiet) as progress:
        task = progress.add_task("mutants", total=None)

        def done(comparison: Comparison) -> None:
            over = f" {comparison.period} ms" if comparison.period else ""
            progress.update(task, advance=1, description=f"{comparison.mutant} {comparison.profile}{over}")

        result = compare_all(
            chosen(mutants),
            profiles=profile,
            jobs=jobs,
            seed=seed,
            periods=periods,
            on_start=lambda total: progress.update(task, total=total),
            on_result=done,
        )
    write_json(result, report_dir, "side-by-side.json")
    for each in result.comparisons:
        if each.survives or each.our_node or verbose:
            for difference in each.differences:
                say(str(difference))
    say(result.summary())
    return result.exit_status()
