"""``dcp-selftest mutants``."""

from __future__ import annotations

from pathlib import Path

import click

from dcp_codec.common.commandline import say

from .common import (
    FEW,
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
    "mutants",
    epilog="Exit status: 0 the reference node passes and every mutant is killed by a case that names its requirement; "
    "1 the node fails a case, or a mutant is not killed; 2 wrong usage; 4 a case ended in an error of the tester.",
)
@click.argument("mutants", nargs=-1)
@profile_option
@click.option("--full", is_flag=True, help="Run all cases against each mutant, not only those of its requirement.")
@jobs_option
@report_option
@document_option
@list_option
@verbose_option
@quiet_option
def command(
    mutants: tuple[str, ...],
    profile: tuple[str, ...],
    jobs: int | None,
    report_dir: Path | None,
    document: Path | None,
    *,
    full: bool,
    listing: bool,
    verbose: bool,
    quiet: bool,
) -> int:
    """Test the suite: the reference node must pass, and small faults of it must be detected.

    MUTANTS are identifiers of mutants or of the requirements that they violate, or globs of them; all by default.
    """
    from dcp_conformance.cli.display import progress_bar

    from dcp_selftest.runner import Baseline, Trial, chosen, selftest

    from .display import print_selftest, versions

    picked = chosen(mutants)
    if listing:
        for each in picked:
            say(f"{each.id:<44}  {each.what}  [{', '.join(each.requirements)}; {versions(each)}]")
        return 0
    with progress_bar(quiet=quiet) as progress:
        task = progress.add_task("mutants", total=None)

        def done(outcome: Baseline | Trial) -> None:
            name = outcome.mutant if isinstance(outcome, Trial) else outcome.profile
            progress.update(task, advance=1, description=name)

        result = selftest(
            picked,
            profiles=profile,
            full=full,
            # The document needs all killers: the first one changes with the order of the cases.
            every=document is not None,
            jobs=jobs,
            on_start=lambda total: progress.update(task, total=total),
            on_result=done,
        )
    write_json(result, report_dir, "selftest.json")
    if document is not None:
        from dcp_selftest.kill_matrix import markdown

        write_section(document, "mutants", markdown(result))
    print_selftest(result, verbose=verbose or (bool(mutants) and len(picked) <= FEW), quiet=quiet)
    return result.exit_status()
