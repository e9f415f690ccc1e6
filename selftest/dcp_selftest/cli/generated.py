"""``dcp-selftest generated``."""

from __future__ import annotations

from pathlib import Path

import click
from dcp_conformance.errors import UsageError

from dcp_codec.common.commandline import say

from .common import (
    document_option,
    jobs_option,
    list_option,
    quiet_option,
    report_option,
    seeds_option,
    verbose_option,
    write_json,
    write_section,
)  # fmt: skip


@click.command(
    "generated",
    epilog="Exit status: 0 every change is killed by a case or is in the ledger; 1 a change survives, or "
    "--check-ledger finds one in the ledger that a case kills; 2 wrong usage.",
)
@click.argument("number", type=click.IntRange(1))
@click.argument("parts", nargs=-1)
@seeds_option
@click.option("--check-ledger", is_flag=True, help="Also try changes in the ledger, to find those that a case kills.")
@jobs_option
@report_option
@document_option
@list_option
@verbose_option
@quiet_option
def command(
    number: int,
    parts: tuple[str, ...],
    seeds: tuple[int, ...],
    jobs: int | None,
    report_dir: Path | None,
    document: Path | None,
    *,
    check_ledger: bool,
    listing: bool,
    verbose: bool,
    quiet: bool,
) -> int:
    """Test the suite with NUMBER random changes of the node's source, every case on every version.

    PARTS are parts of the text of changes, or their keys; only such changes are drawn.
    """
    from dcp_conformance.cli.display import progress_bar

    from dcp_selftest.generated.campaign import GeneratedResult, Trial, draw, reach, run

    from .display import print_generated

    draws = {seed: draw(number, seed, patterns=parts) for seed in seeds}
    if not all(draws.values()):
        raise UsageError(f"no change of the node's source contains {' or '.join(map(repr, parts))}")
    if listing:
        for site in dict.fromkeys(site for chosen in draws.values() for site in chosen):
            say(f"{site.key}  {site}")
        return 0
    results: list[GeneratedResult] = []
    with progress_bar(quiet=quiet) as progress:
        task = progress.add_task("changes", total=sum(map(len, draws.values())))

        def done(trial: Trial) -> None:
            progress.update(task, advance=1, description=f"{trial.outcome.fate} {trial.site.module}:{trial.site.line}")

        reached = reach(jobs=jobs) if len(draws) > 1 else None
        for seed, chosen in draws.items():
            results.append(run(chosen, seed=seed, jobs=jobs, excused=check_ledger, reached=reached, on_result=done))
    for result in results:
        name = "generated.json" if len(results) == 1 else f"generated-{result.seed}.json"
        write_json(result, report_dir, name)
        print_generated(result, verbose=verbose)
    if document is not None:
        from dcp_selftest.generated.table import section

        write_section(document, "generated", section(results))
    return 1 if any(result.survivors or result.misplaced for result in results) else 0
