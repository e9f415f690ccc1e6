"""``dcp-conformance run``."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dcp_codec.common.commandline import SectionedCommand, path_option, say
from dcp_conformance.errors import UsageError

from .options import (
    EXIT_STATUS,
    TARGET_SECTIONS,
    as_typed,
    expected_option,
    report_option,
    selection_of,
    selection_options,
    target_of,
    target_options,
)

if TYPE_CHECKING:
    from dcp_conformance.execution.run import ConformanceRun
    from dcp_conformance.execution.selection import Selection


@click.command(
    "run",
    cls=SectionedCommand,
    epilog=EXIT_STATUS,
    sections={
        "Selection": "section exclude plan failed artefacts",
        **TARGET_SECTIONS,
        "Execution": "repeat max_fails jobs side_by_side impair pytest_options dry_run",
        "Output": "report_dir expected verbose quiet",
    },
)
@selection_options
@target_options
@report_option
@expected_option
@path_option("--artefacts", metavar="DIR", help="Also run the fuzzer's findings in DIR as cases.")
@path_option(
    "--failed",
    metavar="REPORT",
    help="Only cases that failed or were undecided in an earlier report (its folder, or results.json).",
)
@click.option("--repeat", type=click.IntRange(1), default=1, metavar="N", help="Run all cases N times.  [default: 1]")
@click.option("--max-fails", type=click.IntRange(1), metavar="N", help="Stop after N failed cases, and report them.")
@click.option(
    "--jobs",
    "-j",
    type=click.IntRange(1, 64),
    metavar="N",
    help="Number of nodes that are tested at the same time, each with a share of the cases. With --start: copies of "
    "the implementation, in own namespaces (root).  [default: 1; reference node: three for each processor, 6 to 16]",
)
@click.option(
    "--side-by-side",
    type=click.IntRange(1, 64),
    metavar="N",
    help="Maximum number of concurrent cases against one implementation; 1: in succession.  [default: 16]",
)
@click.option(
    "--impair",
    multiple=True,
    metavar="KEY=VALUE,...",
    help="Impair the link during the cases, for example loss=0.1,burst=3,delay=5ms. Keys: loss, burst, delay, jitter, "
    "duplicate, reorder, corrupt; with the prefix to: or from: in one direction (docs/impairment.md).",
)
@click.option("--dry-run", is_flag=True, help="Only show the selected cases.")
@click.option("--verbose", "-v", is_flag=True, help="Show a line for every case.")
@click.option("--quiet", "-q", is_flag=True, help="Show only the summary.")
@click.option("--pytest", "pytest_options", metavar="OPTIONS", help="Run the cases with pytest and these options.")
def command(**options: Any) -> int:
    """Test an implementation of DCP.

    CASES are identifiers of cases or of requirements, or globs of them; by default all cases are run. Without
    --interface, --link or --in-process, the reference node is started and tested: over a virtual Ethernet in a separate
    network namespace, or over UDP if that is not possible.
    """
    from dcp_codec.common.signals import deferred, ending_like_interrupts
    from dcp_conformance.execution.run import ConformanceRun
    from dcp_conformance.execution.workers.parallel import run_in_workers, workers_for

    from .display import Display

    report = options["report_dir"]
    output = None if report is None else report / "output.txt"
    target = replace(target_of(options), impair=options["impair"], output=output)
    display = Display(verbose=options["verbose"], quiet=options["quiet"])
    extra = shlex.split(options["pytest_options"] or "")
    run = ConformanceRun(
        target,
        _failed_in(options["failed"], selection_of(options)),
        expected=options["expected"],
        artefacts=options["artefacts"],
        repeat=options["repeat"],
        max_fails=options["max_fails"] or 0,
        side_by_side=_at_a_time(options),
        command=as_typed(),
        on_start=None if extra else display.start,
        on_result=None if extra else display.result,
    )
    run.on_wait = display.waiting
    display.minutes.state = run.restarts
    if options["dry_run"]:
        for case in run.selected:
            say(f"{case.id}  {case.purpose}")
        return 0
    if report is not None:
        from dcp_conformance.reporting import make_folder

        make_folder(report)
    with ending_like_interrupts():
        if extra:
            from dcp_conformance.pytest_plugin import run_with_pytest

            run_with_pytest(run, extra)
        else:
            workers = workers_for(run, options["jobs"])
            with display:
                run_in_workers(run, workers) if workers > 1 else run.execute()
        with deferred():
            _report(run, report)
    return run.exit_status()


def _at_a_time(options: dict[str, Any]) -> int:
    """Return the number of cases executed concurrently against one SUT: that of the user, or a default."""
    from dcp_conformance.execution.concurrent import WIDTH

    if options["impair"] or options["failed"] is not None:
        # Impairments are attributed to cases by their frames, which needs cases in succession. Cases that did not pass
        # last time would have to be repeated alone.
        return 1
    if options["side_by_side"] is not None:
        return int(options["side_by_side"])
    return WIDTH if options["interface"] is not None or options["link"] is not None else 1


def _failed_in(report: Path | None, selection: Selection) -> Selection:
    """Restrict the selection to the cases that did not pass in an earlier report."""
    if report is None:
        return selection
    from dcp_conformance.definitions.verdict import Verdict
    from dcp_conformance.reporting import load_results

    bad = (Verdict.FAIL, Verdict.ERROR, Verdict.INCONCLUSIVE)
    return replace(selection, only=frozenset(case.id for case in load_results(report).cases if case.verdict in bad))


def _report(run: ConformanceRun, folder: Path | None) -> None:
    """Write the report, and show the summary even if the report cannot be written."""
    from .display import print_summary

    if run.usage and not run.results and folder is None:
        # Nothing was executed: the message says everything.
        raise UsageError(run.trouble)
    result = run.result()
    page = ""
    try:
        if folder is not None:
            from dcp_conformance.reporting import write_report

            page = str(write_report(result, folder, run.codec))
    finally:
        print_summary(result, report=page)
    if run.trouble:
        say(f"dcp-conformance: {run.trouble}", err=True)
