"""``dcp-conformance selftest``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click
from rich.markup import escape
from rich.table import Table

from dcp_conformance.errors import UsageError
from dcp_conformance.selftest import Baseline, SelftestResult, Trial, chosen, selftest

from .display import console, progress_bar

EXIT_STATUS = (
    "Exit status: 0 our node passes and every mutant is killed by a case that names its requirement; 1 not so; "
    "2 wrong usage; 4 a case ended in an error of the tester."
)
#: Columns of the terminal from which on the table of mutants has all of its columns.
_WIDE = 110
#: Mutants up to which each has a row of its own without --verbose.
_FEW = 40


@click.command("selftest", epilog=EXIT_STATUS)
@click.argument("mutants", nargs=-1)
@click.option("--profile", multiple=True, metavar="NAME", help="Only on this profile.  [default: all versions]")
@click.option("--full", is_flag=True, help="Every case against every mutant, not only those that name its requirement.")
@click.option("--jobs", type=click.IntRange(1), metavar="N", help="Processes.  [default: one for each processor]")
@click.option("--report-dir", type=click.Path(path_type=Path), metavar="DIR", help="Write selftest.json there.")
@click.option("--document", type=click.Path(path_type=Path), metavar="FILE", help="Write the kill matrix (Markdown).")
@click.option("--list", "listing", is_flag=True, help="Only show the mutants.")
@click.option("--verbose", "-v", is_flag=True, help="A line for every mutant.")
@click.option("--quiet", "-q", is_flag=True, help="Only what is wrong, and the numbers.")
def command(mutants: tuple[str, ...], **options: Any) -> int:
    """Test the suite: it must pass our node, and notice small faults in it.

    MUTANTS are identifiers of mutants or of the requirements that they violate, or globs of them; without any, all.
    """
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
    _show(result, verbose=options["verbose"] or (bool(mutants) and len(picked) <= _FEW), quiet=options["quiet"])
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
        raise UsageError(f"the report cannot be written: {error}") from None


def _show(result: SelftestResult, *, verbose: bool, quiet: bool) -> None:
    out = console()
    if not quiet:
        out.print(_baselines(result.baselines))
        out.print()
        out.print(_mutants(result, out.width) if verbose else _sections(result.mutants))
    for each in result.baselines:
        for finding in each.findings:
            out.print(
                f"[bold red]{finding.verdict}[/] {finding.case} on {each.profile}: {escape(finding.reason)}",
                soft_wrap=True,
            )
    for trial in result.survivors:
        out.print(f"[bold red]survives[/] {trial.mutant} ({trial.profile}): {escape(trial.what)}", soft_wrap=True)
        also = f"; noticed by {', '.join(each.case for each in trial.also[:3])}" if trial.also else ""
        names = " ".join(trial.requirements)
        out.print(f"         {trial.candidates} cases name {names}{also}", soft_wrap=True)
    for trial in result.mutants:
        for finding in trial.errors:
            reason = escape(finding.reason)
            out.print(f"[bold magenta]error[/] {finding.case} with {trial.mutant}: {reason}", soft_wrap=True)
    killed = len(result.mutants) - len(result.survivors)
    how = "every case" if result.full else "the cases that name the requirement"
    out.print(f"\n{killed} of {len(result.mutants)} mutants killed, by {how}, in {result.duration:.1f} s")


def _baselines(baselines: Sequence[Baseline]) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("our node", no_wrap=True)
    table.add_column("cases", justify="right")
    table.add_column("")
    for each in baselines:
        said = "[green]passes[/]" if each.good else f"[bold red]{len(each.findings)} do not pass[/]"
        table.add_row(each.profile, str(each.cases), said)
    return table


def _sections(trials: Sequence[Trial]) -> Table:
    """By group of requirements: enough where all is well."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("mutants of", no_wrap=True)
    for heading in ("there", "killed", "survive"):
        table.add_column(heading, justify="right", no_wrap=True)
    groups: dict[str, list[Trial]] = {}
    for trial in trials:
        groups.setdefault(trial.requirements[0].rpartition("-")[0], []).append(trial)
    for name, group in sorted(groups.items()):
        killed = sum(each.killed for each in group)
        alive = len(group) - killed
        table.add_row(name, str(len(group)), str(killed), f"[bold red]{alive}[/]" if alive else "[dim].[/]")
    return table


def _mutants(result: SelftestResult, width: int) -> Table:
    """A row for each mutant; on a narrow terminal only who killed it."""
    wide = width >= _WIDE
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("mutant", no_wrap=True, overflow="ellipsis", max_width=width // 2)
    if wide:
        table.add_column("violates", no_wrap=True)
    table.add_column("killed by", overflow="fold")
    if result.full:
        table.add_column("also", justify="right", no_wrap=True)
    for trial in result.mutants:
        killers = [each.case for each in trial.killers]
        more = f" and {len(killers) - 1} more" if len(killers) > 1 else ""
        cells = [trial.mutant, *([trial.requirements[0]] if wide else [])]
        cells.append(f"[green]{escape(killers[0])}[/]{more}" if killers else "[bold red]nobody[/]")
        table.add_row(*cells, *([str(len(trial.also)) if trial.also else "."] if result.full else []))
    return table
