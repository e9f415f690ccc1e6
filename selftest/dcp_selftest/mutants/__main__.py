"""A mutant as a process, to try external test tools on it: ``python -m dcp_selftest.mutants ID``."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import click

from dcp_codec.common.commandline import path_option
from dcp_stack.config import NodeConfig
from dcp_stack.node import Node
from dcp_stack.runtime.errors import NodeError
from dcp_stack.runtime.opening import open_node
from dcp_stack.runtime.settings import load_settings

from .mutant import Mutant, all_mutants


@click.command()
@click.argument("mutant")
@click.option("-i", "--interface", metavar="IF")
@click.option("--link", metavar="LINK")
@click.option("--node-id", metavar="ID")
@click.option("-p", "--profile", metavar="NAME|FILE", help="[default: the newest in which the mutant is a fault]")
@click.option("--control", metavar="PATH")
@click.option("--beacon-period", type=int, metavar="MS")
@path_option("--config", metavar="FILE")
@click.option("--log-level", metavar="LEVEL")
def command(mutant: str, config: Path | None, log_level: str | None, **flags: Any) -> None:
    """Run a MUTANT (M-...) of our node until SIGTERM; options are those of dcp-node run."""
    del log_level
    known = all_mutants()
    if mutant not in known:
        raise click.UsageError(f"there is no mutant {mutant!r}; see dcp-selftest mutants --list")
    faulty: Mutant = known[mutant]
    flags["bp.beacon_period_ms"] = flags.pop("beacon_period")
    flags["profile"] = flags["profile"] or faulty.profile

    def make(config: NodeConfig, *, rng: random.Random, now: int, wall: int) -> Node:
        made: Node = faulty.make(config, rng, now, wall)
        return made

    try:
        with open_node(load_settings(config, flags), make) as driver:
            driver.run(lambda: None)
    except NodeError as error:
        raise click.ClickException(str(error)) from None


if __name__ == "__main__":
    command(prog_name="python -m dcp_selftest.mutants")
