"""``dcp-selftest variants``."""

from __future__ import annotations

from pathlib import Path

import click
from dcp_conformance.errors import UsageError

from dcp_codec.common.commandline import say

from .common import (
    document_option,
    jobs_option,
    list_option,
    profile_option,
    quiet_option,
    report_option,
    verbose_option,
    write_json,
    write_section,
)  # fmt: skip


@click.command(
    "variants",
    epilog="Exit status: 0 no variant fails a case, and every inconclusive verdict is explained; 1 otherwise; 2 wrong "
    "usage; 4 a case ended in an error of the tester.",
)
@click.argument("variants", nargs=-1)
@profile_option
@jobs_option
@report_option
@document_option
@list_option
@verbose_option
@quiet_option
def command(
    variants: tuple[str, ...],
    profile: tuple[str, ...],
    jobs: int | None,
    report_dir: Path | None,
    document: Path | None,
    *,
    listing: bool,
    verbose: bool,
    quiet: bool,
) -> int:
    """Test the suite with permitted variants of the node: none may fail a case.

    VARIANTS are identifiers of variants, or globs of them; all by default.
    """
    from dcp_conformance.cli.display import progress_bar

    from dcp_selftest.variants import ALL_VARIANTS
    from dcp_selftest.variants.campaign import Judged, run

    from .display import print_variants, versions

    picked = ALL_VARIANTS.select(variants)
    if listing:
        for each in picked:
            say(f"{each.id:<36}  {each.what}  [{each.why}; {versions(each)}]")
        return 0
    with progress_bar(quiet=quiet) as progress:
        task = progress.add_task("variants", total=None)

        def done(judged: Judged) -> None:
            progress.update(task, advance=1, description=f"{judged.variant} {judged.profile}")

        result = run(
            picked,
            profiles=profile,
            jobs=jobs,
            on_start=lambda total: progress.update(task, total=total),
            on_result=done,
        )
    if not result.trials:
        raise UsageError("none of these variants exists on these profiles")
    write_json(result, report_dir, "variants.json")
    if document is not None:
        from dcp_selftest.variants.table import section

        write_section(document, "variants", section(result))
    print_variants(result, verbose=verbose, quiet=quiet)
    return result.exit_status()
