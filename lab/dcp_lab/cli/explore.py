"""``dcp-node explore``: all sequences of events in a small network."""

from __future__ import annotations

import json
import shutil
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dcp_codec.common.commandline import PROFILE_HELP, ExpectedError, SectionedCommand, path_option
from dcp_stack.cli.common import counted, note, table_lines

if TYPE_CHECKING:
    from dcp_lab.explore.search import Result, Search, Violation
    from dcp_lab.explore.space import Space

FOUND, INCOMPLETE = 1, 4
#: Seconds between two reports of progress.
_PROGRESS_S = 2.0
_LIMITS = {
    "nodes": "Number of nodes, 2 to 4.",
    "producers": "Nodes that may create the variable.",
    "repetitions": "repCnt of the variable.",
    "creations": "Creations, the first one and others.",
    "updates": "Updates.",
    "deletions": "Deletions.",
    "restarts": "Restarts.",
    "clock_steps": "Changes of a producer's clock between the correct time and an hour ahead.",
    "silences": "Periods of 0.6 timeouts of the variable without beacons.",
    "partitions": "Partitions into two groups.",
    "losses": "Receptions that may be lost.  [default: any number]",
    "rounds": "Lossless rounds after which requests have to have ended.",
    "max_states": "Number of states after which the exploration ends.",
}


def _limits(function: Any) -> Any:
    """Add an option for each limit of a space."""
    for name, text in reversed(_LIMITS.items()):
        option = f"--{name.replace('_', '-')}"
        function = click.option(option, name, type=click.IntRange(min=0), metavar="N", help=text)(function)
    return function


@click.command(
    "explore",
    cls=SectionedCommand,
    sections={
        "Space": f"profile {' '.join(_LIMITS)} seqno_modulus proposal",
        "Output": "as_json chart out",
    },
    epilog="Exit status: 0 all states were visited, and none violates a property; 1 violations were found; 2 wrong "
    "usage or an invalid space; 4 no violation was found, but not all states were visited (Ctrl-C, --max-states).",
)
@click.argument("space", required=False, type=click.Path(dir_okay=False, path_type=Path), metavar="[SPACE]")
@click.option("-p", "--profile", metavar="NAME|FILE", help=PROFILE_HELP + "  [default: dcp-2.0]")
@_limits
@click.option("--seqno-modulus", type=click.IntRange(min=2), metavar="N", help="Number of sequence numbers, such as 4.")
@click.option("--proposal", metavar="NAME", help="Explore a changed specification (docs/hazards.md lists them).")
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
@click.option("--chart/--no-chart", default=True, show_default=True, help="Show message sequence charts.")
@path_option(
    "--out",
    metavar="DIR",
    help="Write each violation to DIR as a scenario for 'dcp-node simulate' and as a recording of its medium.",
    file_okay=False,
)
def command(space: Path | None, as_json: bool, chart: bool, out: Path | None, **options: Any) -> int:
    """Visit every state that a network of 2 to 4 nodes with one variable can reach (docs/explore.md).

    SPACE is a TOML file with the limits of the options; options override it. Each beacon may be heard by any of the
    nodes. The result are the shortest sequences that violate a property, one for each cause, or that there is none.
    """
    from dcp_lab.explore.replay import refusal
    from dcp_lab.explore.search import Search

    found = _space(space, options)
    try:
        search = Search(found)
        if out is not None:
            if (problem := refusal(search)) is not None:
                raise ExpectedError(problem)
            out.mkdir(parents=True, exist_ok=True)
    except ValueError as error:
        raise ExpectedError(str(error)) from None
    except OSError as error:
        raise ExpectedError(f"{out}: {error.strerror}") from None
    result = search.run(_progress() if sys.stderr.isatty() else None)
    written = _write(search, result, out) if out is not None else {}
    if as_json:
        click.echo(json.dumps(_plain(search, result, written), indent=2))
    else:
        _show(search, result, chart, written)
    if result.violations:
        return FOUND
    return 0 if result.complete else INCOMPLETE


def _space(path: Path | None, options: dict[str, Any]) -> Space:
    """Return the space of a file and of the options. Raises ExpectedError."""
    import msgspec

    from dcp_lab.explore.space import Space, SpaceError, check, load_space

    given = {name: value for name, value in options.items() if value is not None}
    modulus = given.pop("seqno_modulus", None)
    try:
        found = Space() if path is None else load_space(path)
        if modulus is not None:
            given["vardis"] = msgspec.structs.replace(found.vardis, seqno_modulus=modulus)
        return check(msgspec.structs.replace(found, **given))
    except SpaceError as error:
        raise ExpectedError(str(error)) from None


def _progress() -> Any:
    """Return a function that reports the progress on stderr now and then."""
    next_report = time.monotonic() + _PROGRESS_S

    def report(search: Search) -> None:
        nonlocal next_report
        if time.monotonic() >= next_report:
            next_report = time.monotonic() + _PROGRESS_S
            note(f"{len(search.states):,} states, {search.depths[-1]} steps deep; Ctrl-C shows what was found")

    return report


def _label(search: Search, violation: Violation) -> str:
    """Return the hazard of a violation, or "new"."""
    from dcp_lab.explore.hazards import hazard_of

    return hazard_of(violation, search.cores.codec.profile.spec_version) or "new"


def _summary(result: Result) -> str:
    """Return the result without its violations as a sentence."""
    size = f"{result.states:,} states, {result.transitions:,} transitions, {result.depth} steps deep"
    work = f"{result.calls:,} calls of real cores, {result.seconds:.1f} s CPU"
    found = counted(len(result.violations), "violation").replace("0 violations", "no violation")
    if not result.complete:
        return f"Not complete: {found} in the first {size} ({work})."
    other = f"{found}, and no other" if result.violations else found
    return f"{other} in this space: {size} ({work})."


def _show(search: Search, result: Result, with_chart: bool, written: dict[int, list[str]]) -> None:
    """Print a result as text."""
    from dcp_spec.catalogue.readings import readings

    from dcp_lab.explore.properties import PROPERTIES
    from dcp_lab.explore.trace import chart, table, trace

    space = result.space
    width = shutil.get_terminal_size().columns if sys.stdout.isatty() else 100
    text = f"{space.profile}{f' with {space.proposal}' if space.proposal else ''}: {space.bounds}"
    click.echo(text)
    for number, violation in enumerate(result.violations, 1):
        found, hazard = trace(search, violation), _label(search, violation)
        title = f": {readings()[hazard].title}" if hazard in readings() else ", not in the catalogue"
        click.echo(f"\n{number}. {PROPERTIES[violation.name]} [{violation.name}]")
        click.echo(f"   {hazard}{title}")
        click.echo(f"   events: {', '.join(sorted(violation.kinds))}\n")
        header, rows = table(found, space.nodes)
        click.echo("\n".join(table_lines(header, rows, width, give=[1])))
        if with_chart:
            click.echo("\n" + "\n".join(chart(found, space.nodes, width)))
        for name in written.get(number, ()):
            click.echo(f"   {name}")
    sentence = _summary(result)
    click.echo(("\n" if result.violations else "") + sentence[0].upper() + sentence[1:])


def _plain(search: Search, result: Result, written: dict[int, list[str]]) -> dict[str, Any]:
    """Return a result as plain data."""
    import msgspec

    from dcp_lab.explore.trace import described, trace

    found: dict[str, Any] = msgspec.to_builtins(result)
    for number, (plain, violation) in enumerate(zip(found["violations"], result.violations, strict=True), 1):
        rows = trace(search, violation).rows
        plain["kinds"] = sorted(violation.kinds)
        plain["hazard"] = _label(search, violation)
        plain["steps"] = [described(row, result.space.nodes) for row in rows if not row.in_rounds]
        plain["held"] = [[held.text for held in row.held] for row in rows if not row.in_rounds]
        plain["files"] = written.get(number, [])
    return found


def _write(search: Search, result: Result, directory: Path) -> dict[int, list[str]]:
    """Write scenarios and recordings; returns the names of the files by the number of the violation."""
    from dcp_lab.explore.replay import scenario_text
    from dcp_lab.sim.scenario.loading import load_scenario
    from dcp_lab.sim.virtual.player import Simulation
    from dcp_stack.links.base import LinkError

    written = {}
    for number, violation in enumerate(result.violations, 1):
        stem = f"{number:02}-{_label(search, violation)}-{violation.name}"
        scenario, recording = directory / f"{stem}.toml", directory / f"{stem}.mcap"
        try:
            scenario.write_text(scenario_text(search, violation), encoding="utf-8")
            Simulation(load_scenario(scenario), record_medium=recording).run()
        except (OSError, LinkError) as error:
            raise ExpectedError(str(error)) from None
        written[number] = [str(scenario), str(recording)]
    return written
