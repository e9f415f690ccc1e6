"""``dcp-node simulate``: a network of nodes in virtual time."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dcp_codec.common.commandline import PROFILE_HELP, UNUSABLE, ExpectedError, path_option
from dcp_codec.common.extras import advice
from dcp_stack.cli.common import Seconds

if TYPE_CHECKING:
    from dcp_lab.sim.scenario.definition import Scenario
    from dcp_lab.sim.virtual.player import Simulation

NOT_MET = 1


def scenario_of(
    path: str | None,
    *,
    nodes: int | None,
    topology: str | None,
    profile: str | None,
    loss: float | None,
    duration: float | None,
    seed: int | None,
    variables: int = 2,
    warm_up: float | None = None,
    settings: dict[str, object] | None = None,
) -> Scenario:
    """Return the scenario of a file or the default one, with the options of the command line applied.

    Raises :class:`ExpectedError` if the scenario is invalid.
    """
    # Imported here, as in the command: --help should not load them.
    import msgspec
    from dcp_spec.profile.loading import ProfileError

    from dcp_lab.sim.scenario.defaults import default_scenario
    from dcp_lab.sim.scenario.definition import LinkQuality, ScenarioError
    from dcp_lab.sim.scenario.loading import change, check, load_scenario, parse_topology, scenario_from

    try:
        shape = None if topology is None else parse_topology(topology)
        if path is None:
            if nodes is None:
                raise ExpectedError("give a SCENARIO file or a number of nodes")
            found = default_scenario(
                nodes,
                topology=shape or parse_topology("full"),
                profile=profile or "dcp-2.0",
                duration_s=60.0 if duration is None else duration,
                variables=variables,
                link=LinkQuality(loss=loss or 0.0),
            )
            if settings:
                found = scenario_from(change(msgspec.to_builtins(found), settings, "simulation"), "simulation")
        else:
            found = load_scenario(path, settings or {})
        changes: dict[str, object] = {
            "nodes": nodes,
            "topology": shape,
            "profile": profile,
            "duration_s": duration,
            "seed": seed,
            "warm_up_s": warm_up,
            "link": None if loss is None else msgspec.structs.replace(found.link, loss=loss),
        }
        given = {name: value for name, value in changes.items() if value is not None}
        return check(msgspec.structs.replace(found, **given), path or "simulation")
    except (ScenarioError, ProfileError) as error:
        raise ExpectedError(str(error)) from None


def _settings(_ctx: click.Context, _param: click.Parameter, given: tuple[str, ...]) -> dict[str, object]:
    """Return the values of ``--set`` by their keys: values of TOML, other text as strings."""
    import tomllib

    found: dict[str, object] = {}
    for each in given:
        key, equals, text = each.partition("=")
        if not (key and equals):
            raise click.BadParameter(f"{each!r} is not KEY=VALUE")
        try:
            found[key] = tomllib.loads(f"value = {text}")["value"]
        except tomllib.TOMLDecodeError:
            found[key] = text
    return found


@click.command(
    "simulate",
    epilog="Exit status: 0 all expectations are met, 1 one is not, 2 wrong usage, an invalid scenario or a recording "
    "that could not be completed.",
)
@click.argument("scenario", required=False, metavar="[SCENARIO]")
@click.option("-n", "--nodes", type=click.IntRange(min=1), metavar="N", help="Number of nodes.")
@click.option("--topology", metavar="full|line|grid[:COLUMNS]|FILE", help="Nodes that are neighbours.  [default: full]")
@click.option("-p", "--profile", metavar="NAME|FILE", help=PROFILE_HELP + "  [default: dcp-2.0]")
@click.option("--loss", type=click.FloatRange(0, 1), metavar="P", help="Share of frames lost at each receiver.")
@click.option("--duration", type=Seconds(0, min_open=True), metavar="S", help="Duration in virtual seconds.")
@click.option(
    "--warm-up",
    type=Seconds(0),
    metavar="S",
    help="Evaluate values, consistency and traffic only after this virtual second.",
)
@click.option("--seed", type=int, metavar="N", help="Random seed.  [default: 1]")
@click.option(
    "--variables",
    type=click.IntRange(0, 255),
    default=2,
    show_default=True,
    metavar="N",
    help="Number of variables, updated every 5 s; only without a SCENARIO.",
)
@click.option(
    "--set",
    "settings",
    multiple=True,
    callback=_settings,
    metavar="KEY=VALUE",
    help="Set a key of the scenario, such as link.loss=0.3 or events.*.repetitions=2; may be given several times.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
@path_option(
    "--record",
    metavar="DIR",
    help="Record the frames that each node sent and received to DIR/node-N.mcap.",
    file_okay=False,
)
@path_option(
    "--record-medium", metavar="FILE", help="Record each transmission once, as seen on the medium.", dir_okay=False
)
@path_option(
    "--values",
    metavar="FILE",
    help="Write a row for each value and each node at which it was due: .csv, or .parquet (needs pyarrow).",
    dir_okay=False,
)
@click.option("--ages", is_flag=True, help="Measure the mean age of state reports, which takes longer.")
def command(
    scenario: str | None,
    as_json: bool,
    ages: bool,
    record: Path | None,
    record_medium: Path | None,
    values: Path | None,
    **options: Any,
) -> int:
    """Run a SCENARIO (docs/scenarios.md) on a simulated medium, as fast as possible.

    The same seed gives the same trace digest. Without a SCENARIO the nodes move, and a few variables are created and
    updated. Options override the SCENARIO.
    """
    from dcp_lab.sim.scenario.definition import ScenarioError
    from dcp_lab.sim.scenario.report import lines
    from dcp_lab.sim.virtual.player import Simulation
    from dcp_stack.links.base import LinkError

    played = scenario_of(scenario, **options)
    if values is not None and values.suffix not in (".csv", ".parquet"):
        raise ExpectedError(f"--values {values}: the name of the file ends with .csv or .parquet")
    try:
        if record is not None:
            record.mkdir(parents=True, exist_ok=True)
        simulation = Simulation(played, record=record, record_medium=record_medium)
        if values is not None:
            simulation.measurements.values.keep_receptions()
        if ages:
            simulation.measure_ages()
    except ScenarioError as error:
        raise ExpectedError(f"{scenario or 'simulation'}: {error}") from None
    except LinkError as error:
        raise ExpectedError(str(error)) from None
    except OSError as error:
        raise ExpectedError(f"{record}: {error.strerror}") from None
    try:
        report = simulation.run()
    except ScenarioError as error:
        raise ExpectedError(f"{scenario or 'simulation'}: {error}") from None
    click.echo(json.dumps(report.plain(), indent=2) if as_json else "\n".join(lines(report)))
    if values is not None:
        _write_values(simulation, values)
    if not simulation.recorded:
        return UNUSABLE
    return 0 if report.met else NOT_MET


def _write_values(simulation: Simulation, path: Path) -> None:
    """Write the receptions of all values. Raises :class:`ExpectedError` if the file cannot be written."""
    from dcp_lab.sim.measuring.values import Reception

    names = [*Reception._fields, "delay_ms"]
    rows = (
        {
            **each._asdict(),
            "born": each.born / 1e9,
            "arrived": None if each.arrived is None else each.arrived / 1e9,
            "delay_ms": None if each.arrived is None else (each.arrived - each.born) / 1e6,
        }
        for each in simulation.measurements.values.receptions()
    )
    try:
        if path.suffix == ".csv":
            import csv

            with path.open("w", encoding="utf-8", newline="") as file:
                writer = csv.DictWriter(file, names)
                writer.writeheader()
                writer.writerows(rows)
            return
        import pyarrow as pa
        import pyarrow.parquet

        whole, real = pa.int64(), pa.float64()
        schema = pa.schema([(name, real if name in ("born", "arrived", "delay_ms") else whole) for name in names])
        pyarrow.parquet.write_table(pa.Table.from_pylist(list(rows), schema), path)
    except ImportError as error:
        raise ExpectedError(f"--values {path}: {advice(error.name or 'pyarrow')}") from None
    except OSError as error:
        raise ExpectedError(f"{path}: cannot be written: {error.strerror or error}") from None
