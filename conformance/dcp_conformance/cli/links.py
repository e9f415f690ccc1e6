"""Options that tell which nodes hear which others: ``--hears`` and ``--topology``."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from dcp_conformance.errors import UsageError

if TYPE_CHECKING:
    from dcp_conformance.check.topology import Topology

Command = TypeVar("Command", bound=Callable[..., Any])


def link_options(command: Command) -> Command:
    """Add the options to a command."""
    hears = click.option(
        "--hears",
        multiple=True,
        metavar="A=B,C",
        help="Node A can hear B and C only; A-B-C: a line, in both directions. Ends of identifiers are enough. "
        "Repeatable.  [default: inferred from reactions]",
    )
    topology = click.option(
        "--topology",
        type=click.Path(path_type=Path),
        metavar="FILE",
        help="TOML file with a table [hears], or the scenario of dcp-node that made the recording.",
    )
    return hears(topology(command))


def links_of(hears: tuple[str, ...], topology: Path | None) -> Topology | None:
    """Return the links that the options tell; None without any. Raises :class:`UsageError`."""
    from dcp_conformance.check.topology import from_table, table_of, told

    if hears and topology is not None:
        raise UsageError("give --hears or --topology, not both")
    if topology is None:
        return told(hears) if hears else None
    table = table_of(topology)
    return _of_scenario(topology) if "nodes" in table else from_table(topology, table)


def _of_scenario(path: Path) -> Topology:
    """Return the links of a scenario, at any time of it. Raises :class:`UsageError`."""
    from dcp_codec.codec import Codec
    from dcp_conformance.check.base import name
    from dcp_conformance.check.topology import Topology
    from dcp_stack.sim.scenario.definition import ScenarioError
    from dcp_stack.sim.scenario.loading import load_scenario
    from dcp_stack.virtual.world import node_id

    try:
        scenario = load_scenario(path)
    except ScenarioError as error:
        raise UsageError(str(error)) from None
    if scenario.topology.kind == "positions" and scenario.tracks:
        raise UsageError(f"{path}: its nodes move, so their links change: omit --topology")
    profile = Codec(scenario.profile).profile
    names = [name(node_id(profile, index)) for index in range(scenario.nodes)]
    hears: dict[str, set[str]] = {each: set() for each in names}
    for one, two in scenario.topology.pairs(scenario.nodes):
        hears[names[one]].add(names[two])
        hears[names[two]].add(names[one])
    return Topology(hears, str(path))
