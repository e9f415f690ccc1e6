"""``dcp-node monitor``: a live view of a node on the terminal."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

import click

from dcp_stack.drops import split

from .common import (
    EXIT_STATUS,
    Seconds,
    connect,
    counted,
    node_options,
    polled,
    printable,
    say,
    shown_value,
    span,
    table_lines,
)
from .neighbours import percent, place
from .status import as_line, own_address, troubles

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.text import Text


SHOWN: Final = 200
"""Maximum number of rows in a table: each takes time to draw. The title reports if there are more."""


@click.command("monitor", epilog=EXIT_STATUS)
@click.option("--interval", type=Seconds(0.1), default=1, show_default=True, metavar="S", help="Time between updates.")
@click.option("--count", type=click.IntRange(min=1), metavar="N", help="End after N updates.")
@node_options
def command(interval: float, count: int | None, control: str, as_json: bool) -> int:
    """Show neighbours with age and loss, variables, beacon rates and ignored input; Ctrl-C or q ends it.

    On a terminal the view is updated in place. If it is longer than the terminal, its last line shows how much is
    hidden; arrows, Page Up and Page Down scroll it. With --count each update is printed in full. Output to a pipe has
    one line per update, or with --json one object.
    """
    with connect(control) as client:
        rates = Rates()
        if as_json or not sys.stdout.isatty():
            for status in polled(client, "UT-Status", interval, count):
                say(as_line(status) if as_json else _line(status, rates))
            return 0
        from rich.console import Console
        from rich.live import Live

        from .scrolling import Window, key_within, keyboard

        console, window = Console(highlight=False, emoji=False, markup=False), Window()
        if count is not None:
            for status in polled(client, "UT-Status", interval, count):
                console.print(view(status, rates, console.width))
            return 0
        with Live(console=console, screen=True, auto_refresh=False) as live, keyboard() as keys:
            while True:
                seen = view(client.call("UT-Status"), rates, console.width)
                until = time.monotonic() + interval
                while True:
                    live.update(window.shown(seen), refresh=True)
                    key = key_within(keys, until - time.monotonic())
                    if key is None:
                        break
                    if key == "quit":
                        return 0
                    window.move(key)


class Rates:
    """Rates per second, computed from the change of counters since the previous update."""

    def __init__(self) -> None:
        self._before: dict[str, tuple[int, int]] = {}
        self._now: dict[str, tuple[int, int]] = {}

    def look(self) -> None:
        """Start an update; counters that were not used in the previous update are discarded."""
        self._before, self._now = self._now, {}

    def of(self, name: str, value: int, now: int) -> float | None:
        """Return the rate of a counter at the monotonic time ``now`` (ns); None the first time."""
        before, self._now[name] = self._before.get(name), (value, now)
        if before is None or now <= before[1]:
            return None
        # A counter that decreased was reset.
        return max(value - before[0], 0) * 1e9 / (now - before[1])


def _line(status: dict[str, Any], rates: Rates) -> str:
    """Format a status as one line with counters and rates."""
    rates.look()
    counters, now = status["node"]["bp"]["counters"], status["now"]
    parts = [time.strftime("%H:%M:%S", time.localtime(status["wall"] / 1e9)), status["nodeId"]]
    for name, shown in (("beacons-sent", "sent"), ("beacons-received", "received")):
        number = counters.get(name, 0)
        parts.append(f"{shown}={number}")
        rate = rates.of(name, number, now)
        if rate is not None:
            parts.append(f"{shown}/s={rate:.1f}")
    parts.append(f"neighbours={len(status['node'].get('srp', {}).get('neighbours', ()))}")
    variables = status["node"].get("vardis", {}).get("variables", {})
    parts.append(f"variables={sum(not each['isDeleted'] for each in variables.values())}")
    ignored, redundant = split(status["drops"])
    parts += [f"ignored={sum(ignored.values())}", f"redundant={sum(redundant.values())}"]
    parts += [f"{name}={count}" for name, count in troubles(status["runtime"].get("link", {})).items()]
    return " ".join(parts)


def view(status: dict[str, Any], rates: Rates, width: int) -> RenderableType:
    """Return the whole view for ``width`` columns; below 80 the tables have fewer columns."""
    from rich.console import Group

    rates.look()
    node = status["node"]
    parts: list[RenderableType] = [_head(status, rates)]
    parts.append(_neighbours(status, rates, width))
    if "vardis" in node:
        parts.append(_variables(status, width))
    parts.append(_ignored(status, rates))
    return Group(*parts)


def _table(
    title: str, header: Sequence[str], rows: Sequence[tuple[list[str], bool]], width: int, **layout: Sequence[int]
) -> Text:
    """Return a table of at most ``width``; ``layout`` is as in :func:`~dcp_stack.cli.common.table_lines`.

    ``rows`` are cells, each row with a flag that shows it dimmed.
    """
    from rich.text import Text

    head, *lines = table_lines(header, [cells for cells, _ in rows], width - 1, **layout)
    text = Text(no_wrap=True, overflow="ellipsis")
    text.append(f"{title}\n\n {head}\n", style="bold")
    text.append(f" {'─' * max(map(len, (head, *lines)))}\n")
    for line, (_, dim) in zip(lines, rows, strict=True):
        text.append(f" {line}\n", style="dim" if dim else "")
    return text


def _title(number: int, noun: str) -> str:
    """Format the title of a table, with a note if it has more than ``SHOWN`` rows."""
    return counted(number, noun) + (f", the first {SHOWN}:" if number > SHOWN else "")


def _head(status: dict[str, Any], rates: Rates) -> RenderableType:
    """Return the lines above the tables: identity, beacon rates, problems."""
    from rich.text import Text

    bp, runtime, now = status["node"]["bp"], status["runtime"], status["now"]
    link = runtime.get("link", {})
    counters = bp["counters"]
    sent, received = counters.get("beacons-sent", 0), counters.get("beacons-received", 0)
    text = Text(no_wrap=True, overflow="ellipsis")
    text.append(status["nodeId"], style="bold")
    text.append(f"  {status['profile']}  {link.get('name', '')}  up {span(runtime.get('uptime_ms', 0))}\n")
    text.append(f"beacons  sent {sent}{_per_second(rates.of('sent', sent, now))}")
    text.append(f"  received {received}{_per_second(rates.of('received', received, now))}")
    if not bp["active"]:
        text.append("  BP not active", style="bold red")
    if not status["node"].get("vardis", {"active": True})["active"]:
        text.append("  VarDis not active", style="bold red")
    text.append("\n")
    problems = [f"{name.replace('_', ' ')} {count}" for name, count in troubles(link).items()]
    if same := own_address(link):
        problems.append(same)
    recording = runtime.get("recording")
    if recording:
        problems.append(f"recording {recording['frames']} frames {recording['problem']}".strip())
    text.append("  ".join(problems) + "\n" if problems else "")
    return text


def _per_second(rate: float | None) -> str:
    return "" if rate is None else f" ({rate:.1f}/s)"


def _neighbours(status: dict[str, Any], rates: Rates, width: int) -> RenderableType:
    """Return one table of the senders of beacons and state reports: a neighbour may send only one of them."""
    now = status["now"]
    reports = {each["node_id"]: each for each in status["node"].get("srp", {}).get("neighbours", ())}
    losses = {each["node_id"]: each for each in status["node"]["bp"]["losses"]}
    heard = sorted(losses, key=lambda node: -losses[node]["heard"])
    order = [*reports, *(node for node in heard if node not in reports)]
    rows = []
    for node in order[:SHOWN]:
        report, loss = reports.get(node), losses.get(node)
        last = max(each for each in (report and report["received_at"], loss and loss["heard"]) if each is not None)
        rate = None if loss is None else rates.of(f"from {node}", loss["received"], now)
        cells = [
            node,
            span((now - last) / 1e6),
            "" if rate is None else f"{rate:.1f}",
            percent(None if loss is None else loss["loss"]),
            "" if loss is None else str(loss["lost"]),
            "" if report is None else str(report["received"]),
            "" if report is None else _place(report),
        ]
        rows.append((cells, now - last > 2_000_000_000))
    headers = ("node", "age", "beacons/s", "loss", "lost", "reports", "position")
    spare = (4, 2, 6, 5)
    title = _title(len(order), "neighbour")
    return _table(title, headers, rows, width, right=(1, 2, 3, 4, 5), give=(6,), spare=spare)


def _place(report: dict[str, Any]) -> str:
    shown = {"sData": report["safety_data"]}
    if report["position"] is not None:
        shown["position"] = report["position"]
    return place(shown)


def _variables(status: dict[str, Any], width: int) -> RenderableType:
    variables = status["node"]["vardis"]["variables"]
    own = status["nodeId"]
    rows = [
        (
            [
                str(number),
                "this node" if each["prodId"] == own else each["prodId"],
                str(each["seqno"]),
                span(max(status["wall"] - each["tStamp"], 0) / 1e6),
                "deleted" if each["isDeleted"] else shown_value(each["value"]),
                printable(each["descr"]),
            ],
            each["isDeleted"],
        )
        for number, each in sorted(variables.items(), key=lambda item: int(item[0]))[:SHOWN]
    ]
    headers = ("id", "producer", "seqno", "age", "value", "description")
    title = _title(len(variables), "variable")
    return _table(title, headers, rows, width, right=(0, 2, 3), give=(4, 5), spare=(2, 5, 3))


def _ignored(status: dict[str, Any], rates: Rates) -> RenderableType:
    """Return the lines with numbers and rates of ignored and redundant input."""
    from rich.text import Text

    text = Text()
    for title, counts in zip(("ignored    ", "\nredundant  "), split(status["drops"]), strict=True):
        parts = [
            f"{name} {count}{_per_second(rates.of(f'drop {name}', count, status['now']))}"
            for name, count in counts.items()
        ]
        text.append(title, style="bold").append(", ".join(parts) or "nothing")
    return text
