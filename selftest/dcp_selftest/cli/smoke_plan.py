"""``dcp-selftest smoke-plan``."""

from __future__ import annotations

from pathlib import Path

import click

from dcp_codec.common.commandline import say

from .common import quiet_option, write_file


@click.command("smoke-plan", epilog="Exit status: 0 the plan is written; 2 wrong usage.")
@click.argument("file", type=click.Path(dir_okay=False, path_type=Path))
@quiet_option
def command(file: Path, *, quiet: bool) -> int:
    """Measure the duration of each case, choose the smoke plan by the fault dictionary, and write both to FILE."""
    from dcp_conformance.cli.display import progress_bar
    from dcp_conformance.definitions.case_times import encode
    from dcp_conformance.definitions.results import CaseResult
    from dcp_conformance.diagnosis import load

    from dcp_selftest.smoke_plan import make

    with progress_bar(quiet=quiet) as progress:
        task = progress.add_task("cases", total=None)

        def done(result: CaseResult) -> None:
            progress.update(task, advance=1, description=result.id)

        times = make(done)
    write_file(file, encode(times))
    detected, known = sum(times.smoke.values()), sum(bool(fault.fails) for fault in load().faults)
    say(f"{len(times.smoke)} of {len(times.seconds)} cases detect {detected} of {known} faults; {file}")
    return 0
