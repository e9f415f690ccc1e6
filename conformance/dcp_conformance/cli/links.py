"""Options that tell which nodes hear which others: ``--hears`` and ``--topology``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from dcp_codec.common.commandline import path_option
from dcp_conformance.errors import UsageError

from .options import F

if TYPE_CHECKING:
    from dcp_conformance.check.topology import Topology

#: Group of entry points with functions that return the links in a file, by the kind of the file.
READERS: Final = "dcp_conformance.topologies"


def link_options(command: F) -> F:
    """Add the options to a command."""
    hears = click.option(
        "--hears",
        multiple=True,
        metavar="A=B,C",
        help="Node A can hear B and C only; A-B-C: a line, in both directions. Ends of identifiers are enough. "
        "Repeatable.  [default: inferred from reactions]",
    )
    topology = path_option(
        "--topology",
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
    """Return the links of a scenario, which the laboratory can read. Raises :class:`UsageError`."""
    # Lazy import: it costs the start of the command 20 ms.
    from importlib.metadata import entry_points

    from dcp_codec.common.extras import advice

    for entry in entry_points(group=READERS, name="scenario"):
        links: Topology = entry.load()(path)
        return links
    raise UsageError(f"{path} is a scenario: {advice('dcp_lab')}")
