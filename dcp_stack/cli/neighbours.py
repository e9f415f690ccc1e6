"""``dcp-node neighbours``: the neighbour table."""

from __future__ import annotations

import json
import time
from typing import Any

import click

from .common import EXIT_STATUS, Seconds, columns, connect, counted, finish, is_ok, node_options, polled, say, span


@click.command("neighbours", epilog=EXIT_STATUS)
@click.option("--watch", is_flag=True, help="Show the table repeatedly.")
@click.option(
    "--interval",
    type=Seconds(0.05),
    default=1,
    show_default=True,
    metavar="S",
    help="With --watch: time between tables.",
)
@click.option("--count", type=click.IntRange(min=1), metavar="N", help="With --watch: end after N tables.")
@node_options
def command(watch: bool, interval: float, count: int | None, control: str, as_json: bool) -> int:
    """Show the neighbours from which state reports were received recently.

    lost: reports missing by their sequence numbers; loss: share of beacons lost recently. With --watch and --json, one
    object per line.
    """
    with connect(control) as client:
        for result in polled(client, "SRP-NeighbourTable", interval, count if watch else 1):
            if not watch:
                return finish("SRP-NeighbourTable", result, as_json, _table(result))
            if as_json:
                say(json.dumps(result))
                continue
            found = counted(len(result["neighbours"]), "neighbour") + f"\n{_table(result)}\n"
            say(f"{time.strftime('%H:%M:%S')}  {found if is_ok(result) else result['status']}")
    return 0


def _table(result: dict[str, Any]) -> str:
    rows = [
        [
            each["nodeId"],
            span(each.get("age", 0)),
            str(each["seqno"]),
            str(each.get("received", "")),
            str(each.get("lost", "")),
            percent(each.get("beaconLoss")),
            place(each),
            f"{each['distance']:.1f} m" if "distance" in each else "-",
        ]
        for each in result.get("neighbours", ())
    ]
    header = ("node", "age", "seqno", "reports", "lost", "loss", "position or data", "distance")
    return columns(header, rows, right=(1, 2, 3, 4, 5, 7)) if rows else "no neighbours"


def percent(share: float | None) -> str:
    """Format a share (0..1) as percentage; empty for None."""
    return "" if share is None else f"{100 * share:.0f} %"


def place(neighbour: dict[str, Any]) -> str:
    """Format the position of a neighbour, or its safety data if the profile has no position."""
    if "position" in neighbour:
        return " ".join(f"{coordinate:.1f}" for coordinate in neighbour["position"])
    return " ".join(f"{name}={value}" for name, value in neighbour["sData"].items())[:40]
