"""``dcp-node reset``."""

from __future__ import annotations

import click

from .common import EXIT_STATUS, node_options, simple


@click.command("reset", epilog=EXIT_STATUS)
@node_options
def command(control: str, as_json: bool) -> int:
    """Bring the node back to the state after its start: nothing registered, known or counted."""
    return simple(control, as_json, "UT-Reset")
