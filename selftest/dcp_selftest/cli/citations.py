"""``dcp-selftest citations``."""

from __future__ import annotations

from pathlib import Path

import click

from dcp_codec.common.commandline import say

from .common import jobs_option, list_option, quiet_option, report_option, verbose_option, write_json


@click.command(
    "citations",
    epilog="Exit status: 0 every citation is proved by a case or test, or has a reason in the ledger that is still "
    "needed; 1 otherwise; 2 wrong usage.",
)
@click.argument("places", nargs=-1)
@jobs_option
@report_option
@list_option
@verbose_option
@quiet_option
def command(
    places: tuple[str, ...], jobs: int | None, report_dir: Path | None, *, listing: bool, verbose: bool, quiet: bool
) -> int:
    """Check citations (##= ID) in the node's source: changes of the cited code must be detected.

    A case or test with the same ID must detect them. PLACES are IDs or file names; all citations by default.
    """
    from dcp_conformance.cli.display import progress_bar

    from dcp_selftest.citations.campaign import Verdict, chosen, run
    from dcp_selftest.citations.unit_tests import checkout

    from .display import print_citations

    picked = chosen(places)
    if listing:
        for each in picked:
            say(f"{each.requirement:<10}  {each}  {each.function or '(module)'}")
        return 0
    with progress_bar(quiet=quiet) as progress:
        task = progress.add_task("citations", total=len(picked))

        def done(verdict: Verdict) -> None:
            progress.update(task, advance=1, description=f"{verdict.citation.requirement} {verdict.proof}")

        result = run(picked, jobs=jobs, root=checkout(), on_result=done)
    write_json(result, report_dir, "citations.json")
    print_citations(result, verbose=verbose, quiet=quiet)
    return 1 if result.unproved or result.outdated else 0
