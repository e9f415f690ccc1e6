"""``dcp-conformance check``."""

from __future__ import annotations

import datetime
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec

from dcp_codec.common.commandline import ETHER_TYPE_HELP, PROFILE_HELP, UNUSABLE, path_option, say
from dcp_conformance.errors import UsageError

from .links import link_options, links_of
from .options import EXIT_STATUS, Factor, as_typed, expected_option, pics_option, report_option

if TYPE_CHECKING:
    from dcp_conformance.definitions.case import Case


@click.command("check", epilog=EXIT_STATUS)
@click.argument("captures", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="FILE...")
@click.option("-p", "--profile", metavar="NAME|FILE", help=PROFILE_HELP + "  [default: detected for each recording]")
@click.option("--ether-type", metavar="HEX", help=ETHER_TYPE_HELP)
@pics_option
@click.option(
    "--beacon-period",
    type=Factor(1_000_000),
    metavar="MS",
    help="Beacon period of the nodes.  [default: estimated from the recording]",
)
@link_options
@expected_option
@report_option
@path_option(
    "--tables",
    file_okay=False,
    metavar="DIR",
    help="Write the states of variables, the links and the findings there: holdings.csv, links.csv, events.csv.",
)
@click.option(
    "--jobs",
    "-j",
    type=click.IntRange(1, 3),
    metavar="1|2|3",
    help="Number of processes for each recording.  [default: for a long one, as many as there are processors]",
)
@click.option("--requirements", "show_requirements", is_flag=True, help="Show which requirements were exercised.")
@click.option("--quiet", "-q", is_flag=True, help="Show only findings and damage of the files.")
def command(
    captures: tuple[Path, ...],
    profile: str | None,
    ether_type: str | None,
    pics: Path | None,
    beacon_period: float | None,
    hears: tuple[str, ...],
    topology: Path | None,
    expected: Path | None,
    report_dir: Path | None,
    tables: Path | None,
    jobs: int | None,
    *,
    show_requirements: bool,
    quiet: bool,
) -> int:
    """Judge recordings (MCAP, pcap, pcapng) of a network offline.

    Each frame is checked against invariants per sender and between senders. A requirement is decided only if the
    recording has occasions for it.
    """
    from dcp_conformance.check.recording import judge_versions
    from dcp_conformance.definitions.outcome import exit_status
    from dcp_conformance.definitions.pics import Pics, load_pics
    from dcp_conformance.execution.expected import ExpectedResults
    from dcp_conformance.execution.target import exact
    from dcp_conformance.reporting import write_report

    from .display import console, print_findings, print_summary

    links = links_of(hears, topology)
    known = load_pics(pics) if pics is not None else Pics()
    stated = beacon_period is not None or (pics is not None and _states_period(pics))
    if beacon_period is not None:
        known = msgspec.structs.replace(
            known, pixit=msgspec.structs.replace(known.pixit, beacon_period_ms=beacon_period)
        )
    known_cases = _known_cases() if expected is not None else {}
    worst_status = 0
    for capture in captures:
        words = ["check", str(capture)]
        for option, value in (("profile", profile), ("ether-type", ether_type), ("pics", pics)):
            words += [f"--{option}", str(value)] if value is not None else []
        words += [word for each in hears for word in ("--hears", each)]
        words += ["--topology", str(topology)] if topology is not None else []
        words += ["--beacon-period", exact(beacon_period)] if beacon_period is not None else []
        try:
            runs = judge_versions(
                capture,
                profile,
                known,
                ether_type=ether_type,
                command=as_typed(*words),
                period_known=stated,
                show_progress=True,
                name_damage=quiet,
                topology=links,
                jobs=jobs,
                tables=tables if tables is None or len(captures) == 1 else tables / capture.stem,
            )
        except UsageError as error:
            # The other recordings are judged all the same.
            say(f"dcp-conformance: {error}", err=True)
            worst_status = max(worst_status, UNUSABLE)
            continue
        for run, codec in runs:
            report = ""
            if report_dir is not None:
                directory = report_dir if len(captures) == 1 else report_dir / capture.stem
                # Write a separate report for each version in the recording.
                directory = directory if len(runs) == 1 else directory / codec.profile.name
                report = str(write_report(run, directory, codec))
            if quiet:
                print_findings(run)
            else:
                print_summary(run, report=report)
            if show_requirements:
                from dcp_spec.catalogue.requirements import requirements

                out = console()
                out.print(f"  {'requirement':<12} {'verdict':<13} {'occasions':>9}")
                for identifier, verdict in sorted(run.requirements.items()):
                    count = f"{run.occasions[identifier]:,}" if identifier in run.occasions else "-"
                    statement = requirements()[identifier].statement
                    out.print(f"  {identifier:<12} {verdict:<13} {count:>9}  {statement}")
            unexpected: bool | None = None
            if expected is not None:
                results = ExpectedResults.load(expected, known_cases.values())
                ran = [known_cases[case.id] for case in run.cases]
                surprises = [results.judge(known, case) for known, case in zip(ran, run.cases, strict=True)]
                complaints = results.complaints(ran, datetime.datetime.now(datetime.UTC).date())
                for each in complaints:
                    say(each, err=True)
                unexpected = any(surprises) or bool(complaints)
            worst_status = max(worst_status, exit_status(run.cases, unexpected=unexpected))
    return worst_status


def _known_cases() -> dict[str, Case]:
    """Return the cases allowed in a file of expected results, by id: test cases and invariants of recordings."""
    from dcp_conformance.check.judge import cases
    from dcp_conformance.definitions.case import all_cases

    return all_cases() | {case.id: case for case in cases()}


def _states_period(pics: Path) -> bool:
    """Return whether a PICS file contains the beacon period, even if it is the default value."""
    return "beacon_period_ms" in tomllib.loads(pics.read_text(encoding="utf-8")).get("pixit", {})
