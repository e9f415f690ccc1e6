"""``dcp-conformance selftest``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dcp_conformance.errors import UsageError

if TYPE_CHECKING:
    from dcp_conformance.selftest import Baseline, SelftestResult, Trial

EXIT_STATUS = (
    "Exit status: 0 our node passes and every mutant is killed by a case that names its requirement; 1 not so; "
    "2 wrong usage; 4 a case ended in an error of the tester."
)
#: Mutants up to which each has a row of its own without --verbose.
_FEW = 40


@click.command("selftest", epilog=EXIT_STATUS)
@click.argument("mutants", nargs=-1)
@click.option("--profile", multiple=True, metavar="NAME", help="Only on this profile.  [default: all versions]")
@click.option("--full", is_flag=True, help="Every case against every mutant, not only those that name its requirement.")
@click.option("--jobs", type=click.IntRange(1), metavar="N", help="Processes.  [default: one for each processor]")
@click.option("--report-dir", type=click.Path(path_type=Path), metavar="DIR", help="Write selftest.json there.")
@click.option(
    "--document",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE",
    help="Write the kill matrix (Markdown).",
)
@click.option("--list", "listing", is_flag=True, help="Only show the mutants.")
@click.option("--verbose", "-v", is_flag=True, help="A line for every mutant.")
@click.option("--quiet", "-q", is_flag=True, help="Only what is wrong, and the numbers.")
def command(mutants: tuple[str, ...], **options: Any) -> int:
    """Test the suite: it must pass our node, and notice small faults in it.

    MUTANTS are identifiers of mutants or of the requirements that they violate, or globs of them; without any, all.
    """
    from dcp_conformance.selftest import Trial, chosen, selftest

    from .display import progress_bar
    from .selftest_display import print_selftest

    picked = chosen(mutants)
    if options["listing"]:
        for each in picked:
            click.echo(f"{each.id:<44}  {each.what}  [{', '.join(each.requirements)}; {each.since} to {each.until}]")
        return 0
    with progress_bar(quiet=options["quiet"]) as progress:
        task = progress.add_task("mutants", total=None)

        def done(outcome: Baseline | Trial) -> None:
            name = outcome.mutant if isinstance(outcome, Trial) else outcome.profile
            progress.update(task, advance=1, description=name)

        result = selftest(
            picked,
            profiles=options["profile"],
            full=options["full"],
            # A matrix of the first killers would change with the order of the cases.
            every=options["document"] is not None,
            jobs=options["jobs"],
            on_start=lambda total: progress.update(task, total=total),
            on_result=done,
        )
    _write(result, options["report_dir"], options["document"])
    print_selftest(
        result, verbose=options["verbose"] or (bool(mutants) and len(picked) <= _FEW), quiet=options["quiet"]
    )
    return result.exit_status()


def _write(result: SelftestResult, directory: Path | None, document: Path | None) -> None:
    import msgspec

    try:
        if directory is not None:
            directory.mkdir(parents=True, exist_ok=True)
            data = msgspec.json.format(msgspec.json.encode(result), indent=2)
            (directory / "selftest.json").write_bytes(data + b"\n")
        if document is not None:
            from dcp_conformance.kill_matrix import markdown

            document.write_text(markdown(result), encoding="utf-8")
    except OSError as error:
        raise UsageError(f"{error.filename}: cannot be written: {error.strerror or error}") from None
