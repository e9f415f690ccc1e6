"""``dcp-codec stats``: statistics of recordings."""

from __future__ import annotations

import json
import shutil
import sys
from typing import Any

import click

from dcp_codec.analysis.stats import Stats
from dcp_codec.analysis.vantage_point import NO_LOSSES, records_transmissions
from dcp_codec.common.commandline import output_format
from dcp_codec.framing.locate import locate

from .common import (
    MALFORMED,
    choose,
    each_file,
    malformed_note,
    no_beacons_note,
    open_input,
    profile_options,
    progress,
    report_capture_problems,
)

#: Width in characters of the table of senders with one and with two spaces between its columns.
_NARROWEST, _ROOMY = 76, 85

#: Kinds of payloads: the keys of their counts, and their names in the output.
_PAYLOADS = (("srp", "srp", "SRP"), ("vardis", "vardis", "VarDis"), ("other_payloads", "other", "other"))


@click.command(
    "stats",
    epilog="Exit status: 0 all good, 1 malformed DCP frames were seen, 2 wrong usage or input that could not be read "
    "to its end.",
)
@click.argument("files", nargs=-1, required=True, metavar="FILE...")
@profile_options
@output_format("text", "json")
def command(files: tuple[str, ...], profile: str, ether_type: int | None, form: str) -> int:
    """Count beacons, loss, intervals, containers and records, and the last value of every variable.

    For each variable with one producer: how many of the nodes have its last number, how many nodes had a
    stale number (3 s and ten beacons after the producer left it), and the longest lag.

    With --format json, one object for one file, and a list of objects for several.
    """
    found: list[dict[str, Any]] = []

    def one(name: str) -> int:
        stats, status, medium = _read(name, profile, ether_type)
        data = stats.as_json()
        if medium:
            for sender in data["senders"].values():
                sender["lost"] = None
        if form == "text":
            _show(name, data, stats.examples)
            if medium:
                click.echo(f"\n  lost: unknown; {NO_LOSSES}")
        else:
            found.append({"file": name, **data})
        return status

    status = each_file(files, one)
    if form == "json" and (found or len(files) > 1):
        click.echo(json.dumps(found[0] if len(files) == 1 else found, indent=2))
    return status


def _read(name: str, profile: str, ether_type: int | None) -> tuple[Stats, int, bool]:
    """Return the statistics, the exit status, and whether the recording has all transmissions."""
    with open_input(name) as reader:
        dissector, frames = choose(profile, ether_type, iter(reader), name)
        link = dissector.link
        stats = Stats(dissector.codec, link)
        stats.doubt = dissector.doubt
        with progress(reader, name) as advance:
            for frame in frames:
                stats.add(frame, locate(frame.data, link))
                advance()
        status = report_capture_problems(reader, name)
        medium = records_transmissions(getattr(reader, "metadata", {}))
    if stats.malformed:
        malformed_note(name, stats.malformed, stats.frames - stats.other_traffic.total())
        status = max(status, MALFORMED)
    if not stats.beacons and not stats.malformed:
        no_beacons_note(name, stats.frames, dict(stats.other_traffic.most_common()), link)
    return stats, status, medium


def _show(name: str, data: dict[str, Any], examples: list[tuple[int, str]]) -> None:
    from rich.console import Console
    from rich.table import Table

    # On a narrower terminal lines wrap; that is better than numbers that are cut off.
    width = max(shutil.get_terminal_size().columns, _NARROWEST) if sys.stdout.isatty() else 120
    console = Console(width=width, highlight=False, emoji=False, markup=False)
    padding = (0, 2 if width >= _ROOMY else 1, 0, 0)
    span = f", {data['duration_s']:.1f} s" if data["duration_s"] is not None else ""
    console.print(f"{name}", style="bold", soft_wrap=True)
    console.print(
        f"  {data['beacons']} beacons in {data['frames']} frames{span}; profile {data['profile']}; "
        f"{data['padded']} padded; {data['errors']} malformed"
    )
    damaged = data["damaged_payloads"]
    counts = [
        f"{data[key]} {name}" + (f" ({damaged[kind]} damaged)" if kind in damaged else "")
        for key, kind, name in _PAYLOADS
    ]
    console.print(f"  payloads: {', '.join(counts)}\n")
    if data["senders"]:
        table = Table("sender", box=None, padding=padding, header_style="bold")
        for heading in ("beacons", "first", "last", "lost", "restarts", "interval ms", "± ms", "max ms"):
            table.add_column(heading, justify="right")
        for sender, one in data["senders"].items():
            interval = one["interval"]
            shown = [_ms(interval[key]) for key in ("mean_ms", "stddev_ms", "max_ms")]
            numbers = (one[key] for key in ("beacons", "first_seqno", "last_seqno", "lost", "restarts"))
            table.add_row(sender, *("-" if number is None else str(number) for number in numbers), *shown)
        console.print(table)
        backwards = sum(one["backwards"] for one in data["senders"].values())
        if backwards:
            console.print(
                f"\n  time goes back before {backwards} beacons (the clock of the recorder was set?): "
                "intervals leave them out",
                style="red",
            )
        if repeated := sum(one["duplicates"] for one in data["senders"].values()):
            what = "beacon repeats" if repeated == 1 else "beacons repeat"
            console.print(
                f"\n  {repeated} {what} the number of its sender's last one (merged recordings of several nodes?)",
                style="red",
                soft_wrap=True,
            )
    if data["containers"]:
        table = Table("container", box=None, padding=padding, header_style="bold")
        table.add_column("containers", justify="right")
        table.add_column("records", justify="right")
        for kind, count in data["containers"].items():
            table.add_row(kind, str(count), str(data["records"][kind]))
        console.print()
        console.print(table)
    if data["last_sent_value"]:
        table = Table(box=None, padding=padding, header_style="bold")
        table.add_column("variable", no_wrap=True, min_width=len("variable"))
        for heading in ("seqno", "nodes", "stale", "lag s"):
            table.add_column(heading, justify="right", min_width=len(heading))
        table.add_column("last value sent", overflow="fold")
        for var_id, last in data["last_sent_value"].items():
            known = data["variables"].get(var_id)
            row = ("-",) * 3
            if known is not None:
                lag = f"{known['longest_lag_s']:.1f}" if known["stale"] else "-"
                row = (f"{known['current']} of {known['nodes']}", str(known["stale"]), lag)
            table.add_row(var_id, str(last["seqno"]), *row, last["value"])
        console.print()
        console.print(table)
    if examples:
        console.print("\nmalformed", style="bold")
    for number, text in examples:
        console.print(f"  frame {number}: {text}", style="red", soft_wrap=True)
    if data["errors"] > len(examples):
        more = data["errors"] - len(examples)
        console.print(f"  ... and {more} more, see dcp-codec decode --errors-only", style="red")
    if data["other_traffic"]:
        others = ", ".join(f"{kind} {count}" for kind, count in data["other_traffic"].items())
        console.print(f"\n  other traffic: {others}")
    console.print()


def _ms(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}"
