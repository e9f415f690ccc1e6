"""``dcp-selftest interop``."""

from __future__ import annotations

from pathlib import Path

import click

from dcp_codec.common.commandline import path_option, say

from .common import jobs_option, quiet_option


@click.command(
    "interop",
    epilog="Exit status: 0 every fault makes a cell fail and no permitted variant does; 1 otherwise; 2 wrong usage; "
    "130 interrupted.",
)
@click.argument("names", nargs=-1)
@click.option("--test", "tests", multiple=True, metavar="ID|GLOB", help="Only these network tests.")
@click.option(
    "--seeds", type=click.IntRange(1), default=1, show_default=True, metavar="N", help="Number of seeds for each cell."
)
@jobs_option
@path_option("--document", metavar="FILE", help="Write the table into its section of FILE (Markdown).", dir_okay=False)
@quiet_option
def command(
    names: tuple[str, ...], tests: tuple[str, ...], seeds: int, jobs: int | None, document: Path | None, *, quiet: bool
) -> int:
    """Put known faults and permitted variants into networks, in virtual time.

    NAMES are mutant:ID, variant:ID, or globs of them; by default the faults that show between nodes, and all variants
    that are nodes of their own.
    """
    from dcp_codec.common.signals import ending_like_interrupts
    from dcp_selftest.interop import run_selftest, write_document

    with ending_like_interrupts():
        result = run_selftest(tests=tests, names=names, seeds=seeds, jobs=jobs, on_line=None if quiet else say)
    for line in result.lines():
        say(line)
    if document is not None:
        write_document(result, document)
    return 0 if result.good else 1
