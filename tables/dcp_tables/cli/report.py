"""``dcp-codec report``: one HTML page with plots and tables about recordings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dcp_codec.capture import CaptureError
from dcp_codec.cli.common import note, profile_options
from dcp_codec.common.atomic_write import refuse_irregular, write_whole
from dcp_codec.common.commandline import FORCE_HELP, ExpectedError, expected, out_option, path_option

from .recordings import check_input, extras, octets_progress, tell

if TYPE_CHECKING:
    from dcp_tables.report.findings import Judged
    from dcp_tables.report.page import Chapter
    from dcp_tables.table.job import Outcome

#: Maximum number of recordings on one page.
_MANY = 20


@click.command(
    "report",
    epilog="FILE is an MCAP, pcap or pcapng recording, a folder with some, or a pattern in quotes; - is standard "
    "input. What the plots show: docs/report.md. Exit status: 0 all good, 1 malformed DCP frames were seen, 2 wrong "
    "usage or input that could not be read to its end (the page shows the readable part).",
)
@click.argument("files", nargs=-1, required=True, metavar="FILE...")
@out_option(
    "FILE.html",
    "Write the page to this file.  [default: in the current folder, NAME.html of the recording; report.html for "
    "several]",
    folder=False,
)
@path_option(
    "--findings",
    metavar="FILE",
    help="results.json of 'dcp-conformance check --report-dir': its findings about the recording are on the page.",
    dir_okay=False,
)
@profile_options
@click.option("--force", is_flag=True, help=FORCE_HELP)
def command(
    files: tuple[str, ...],
    out: Path | None,
    findings: Path | None,
    profile: str,
    ether_type: int | None,
    force: bool,
) -> int:
    """Show which node holds which values, losses and missing values, in plots to zoom.

    The page is one self-contained file that works offline, in light and dark. Two recordings are shown side by side;
    three or more get a chapter each and a table that compares them.
    """
    check_input(files, profile)
    with extras():
        from dcp_tables.table.archive import find_recordings
        from dcp_tables.table.job import TableError

        with expected(TableError):
            recordings = find_recordings(files)
        if len(recordings) > _MANY:
            raise ExpectedError(f"a page holds {_MANY} recordings, and these are {len(recordings)}: give fewer")
        page = out or _default(recordings)
        if page.exists() and not force:
            raise ExpectedError(f"{page}: exists; give --force to replace it")
        try:
            refuse_irregular(page)
        except OSError as error:
            raise ExpectedError(f"{page}: {error.strerror}") from None
        from dcp_tables.report.findings import FindingsError, read_findings
        from dcp_tables.report.page import render

        with expected(FindingsError):
            judged = None if findings is None else read_findings(findings)
        with octets_progress(recordings) as advance:
            chapters, outcomes = _chapters(recordings, profile, ether_type, judged, advance)
        if not chapters:
            raise ExpectedError("; ".join(str(outcome.failure) for outcome in outcomes[:5]))
        try:
            page.parent.mkdir(parents=True, exist_ok=True)
            write_whole(page, render(chapters).encode("utf-8", "backslashreplace"))
        except OSError as error:
            raise ExpectedError(f"{error.filename or page}: {error.strerror or error}") from None
    note(f"{page}: {sum(len(chapter.plots) for chapter in chapters)} plots")
    return max(tell(outcome) for outcome in outcomes)


def _default(recordings: Sequence[str]) -> Path:
    if len(recordings) > 1 or recordings[0] == "-":
        return Path("report.html")
    return Path(Path(recordings[0]).stem + ".html")


def _chapters(
    recordings: Sequence[str],
    profile: str,
    ether_type: int | None,
    judged: Judged | None,
    advance: Callable[[int], object],
) -> tuple[list[Chapter], list[Outcome]]:
    from dcp_tables.report.chapter import chapter
    from dcp_tables.report.recorded import gather
    from dcp_tables.table.job import Outcome

    chapters, outcomes = [], []
    for number, path in enumerate(recordings, start=1):
        try:
            recorded = gather(path, profile, ether_type, advance)
        except CaptureError as error:
            outcomes.append(Outcome(path, failure=str(error)))
            continue
        chapters.append(chapter(recorded, number, judged))
        outcomes.append(recorded.outcome)
    return chapters, outcomes
