"""``dcp-node reset``."""

from __future__ import annotations

import click

from .common import EXIT_STATUS, node_options, simple


@click.command("reset", epilog=EXIT_STATUS)
@node_options
def command(control: str, as_json: bool) -> int:
    """Restore the state of the node after its start: no registrations, variables, neighbours and counts."""
    return simple(control, as_json, "UT-Reset")
