"""``dcp-selftest recordings``."""

from __future__ import annotations

from pathlib import Path

import click

from dcp_codec.common.commandline import path_option

from .common import FEW, jobs_option, quiet_option, report_option, verbose_option, write_file, write_json


@click.command(
    "recordings",
    epilog="Exit status: 0 no finding in networks without a fault; 1 there are some; 2 wrong usage.",
)
@click.argument("mutants", nargs=-1)
@click.option(
    "--clean",
    "networks",
    type=click.IntRange(0),
    default=50,
    show_default=True,
    metavar="N",
    help="Also judge N networks without a fault, which must have no finding.",
)
@jobs_option
@report_option
@path_option("--document", metavar="FILE", help="Write the page (Markdown).", dir_okay=False)
@verbose_option
@quiet_option
def command(
    mutants: tuple[str, ...],
    networks: int,
    jobs: int | None,
    report_dir: Path | None,
    document: Path | None,
    *,
    verbose: bool,
    quiet: bool,
) -> int:
    """Test 'check': each mutant in a simulated network of five nodes, on a bus and in a line.

    MUTANTS are identifiers or globs of mutants; all by default.
    """
    from dcp_conformance.cli.display import progress_bar

    from dcp_selftest.recordings import clean, faulty
    from dcp_selftest.recordings.table import document as page
    from dcp_selftest.runner import chosen

    from .display import print_recordings

    picked = chosen(mutants)
    with progress_bar(quiet=quiet) as progress:
        task = progress.add_task("networks", total=2 * len(picked) + networks)
        result = faulty(
            picked, jobs=jobs, on_result=lambda each: progress.update(task, advance=1, description=each.mutant)
        )
        without = clean(
            range(networks),
            jobs=jobs,
            on_result=lambda number, _: progress.update(task, advance=1, description=f"network {number}"),
        )
    write_json(result, report_dir, "recordings-faulty.json")
    write_json(without, report_dir, "recordings-clean.json")
    if document is not None:
        write_file(document, page(result, without).encode())
    print_recordings(result, without, verbose=verbose or (bool(mutants) and len(picked) <= FEW))
    return 1 if without.false else 0
