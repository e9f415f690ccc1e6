"""``dcp-conformance report``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from dcp_codec.common.commandline import out_option, path_option, say
from dcp_conformance.errors import UsageError

if TYPE_CHECKING:
    from dcp_conformance.definitions.results import RunResult


@click.command("report", epilog="Exit status: 0 done; 2 results that cannot be read, or a page that cannot be written.")
@click.argument("results", nargs=-1, required=True, type=click.Path(path_type=Path))
@out_option("FILE", "Write the page to this file (HTML).")
@path_option(
    "--issues",
    file_okay=False,
    metavar="DIR",
    help="For one run: write a report for each probable fault to DIR, to be pasted into an issue tracker.",
)
@path_option(
    "--requirements",
    dir_okay=False,
    metavar="FILE",
    help="For one run: the verdict of each requirement as a table (.csv or .md).",
)
@path_option("--summary", dir_okay=False, metavar="FILE", help="For one run: a summary of one page (.md).")
@path_option("--badge", dir_okay=False, metavar="FILE", help="For one run: a badge (.svg).")
def command(results: tuple[Path, ...], out: Path | None, issues: Path | None, **exports: Path | None) -> int:
    """Generate the page of a run again, or compare several runs in one table.

    RESULTS are results.json files, or the folders that contain them. For several runs, a table of implementations and
    requirements is shown; with --out it is written as a page.
    """
    from dcp_conformance.reporting import load_results
    from dcp_conformance.reporting.files import codec_of
    from dcp_conformance.reporting.merge import labels, matrix, render_matrix
    from dcp_conformance.reporting.page import render

    runs = [load_results(path) for path in results]
    if issues is not None or any(exports.values()):
        if len(runs) != 1:
            raise UsageError("--issues, --requirements, --summary and --badge are for the results of one run")
        _export(runs[0], issues, exports)
        if out is None:
            return 0
    if len(runs) == 1:
        from .display import print_summary

        if out is not None:
            _write(out, render(runs[0], codec_of(runs[0])))
        print_summary(runs[0], report=str(out or ""))
        return 0
    from rich.table import Table

    from .display import STYLES, console, data

    if out is not None:
        _write(out, render_matrix(runs))
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("requirement", no_wrap=True)
    for label in labels(runs):
        table.add_column(data(label))
    for identifier, verdicts in matrix(runs):
        cells = [
            f"[{STYLES[verdict]}]{verdict}[/]" if verdict is not None else "[dim]not run[/]" for verdict in verdicts
        ]
        table.add_row(data(identifier), *cells)
    console().print(table)
    return 0


def _export(run: RunResult, issues: Path | None, exports: dict[str, Path | None]) -> None:
    """Write the exports of one run."""
    from dcp_conformance.reporting import exports as making
    from dcp_conformance.reporting.files import codec_of

    table = exports["requirements"]
    if table is not None and table.suffix not in (".csv", ".md"):
        raise UsageError(f"--requirements {table}: the name must end in .csv or .md")
    makers = {
        "requirements": making.requirements_csv
        if table is not None and table.suffix == ".csv"
        else making.requirements_markdown,
        "summary": making.summary_markdown,
        "badge": making.badge,
    }
    for name, make in makers.items():
        path = exports[name]
        if path is not None:
            _write(path, make(run))
    if issues is not None:
        from dcp_conformance.reporting.issues import write_issues

        for path in write_issues(run, issues, codec_of(run)):
            say(str(path))


def _write(path: Path, text: str) -> None:
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise UsageError(f"{path}: cannot be written: {error.strerror or error}") from None
