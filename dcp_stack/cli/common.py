"""Common parts of the subcommands: errors, the connection to a node, tables and JSON."""

from __future__ import annotations

import json
import math
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import repeat
from typing import Any, TypeVar

import click

from dcp_codec.common.commandline import UNUSABLE, ExpectedError
from dcp_codec.common.printable import plain
from dcp_stack.control.client import ControlClient, ControlError, Notification, ServiceError
from dcp_stack.control.jsonrpc import ErrorCode
from dcp_stack.control.places import find_socket, places

from . import main

NOT_OK, UNREACHABLE = 1, 3

EXIT_STATUS = f"Exit status: {main.exit_status}"

F = TypeVar("F", bound=Callable[..., Any])
#: Characters down to which a column of a table may be narrowed.
_NARROWEST = 12
#: Errors of a request that the user can correct.
_USAGE = (ErrorCode.PARSE_ERROR, ErrorCode.INVALID_REQUEST, ErrorCode.METHOD_NOT_FOUND, ErrorCode.INVALID_PARAMS)


#: Write a message to stderr, apart from output that is piped.
note = main.note


def _found(_ctx: click.Context, _param: click.Parameter, value: str | None) -> str:
    """Return the given socket, or the default socket of a running node. Raises ExpectedError if there is none."""
    if value is not None:
        return value
    path = find_socket()
    if path is None:
        looked = " and ".join(map(str, places()))
        raise ExpectedError(
            f"no node found at {looked}; start one with 'dcp-node run', or give its socket: --control PATH", UNREACHABLE
        )
    return str(path)


def control_option(function: F) -> F:
    """Add the option ``--control``, the socket of the node."""
    return click.option(
        "--control",
        envvar="DCP_NODE_CONTROL",
        callback=_found,
        metavar="PATH",
        help="Control socket of the node.  [env: DCP_NODE_CONTROL; default: that of a node without --control]",
    )(function)


def node_options(function: F) -> F:
    """Add the options ``--control`` and ``--json``."""
    return control_option(click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")(function))


class Seconds(click.FloatRange):
    """A duration in s, short enough to wait for."""

    name = "seconds"

    def __init__(self, least: float, most: float = 100_000_000, *, min_open: bool = False) -> None:
        super().__init__(min=least, max=most, min_open=min_open)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the number; fails if it is not a number or out of range."""
        number = super().convert(value, param, ctx)
        if math.isnan(number):
            self.fail(f"{value!r} is not a number of seconds", param, ctx)
        return number


def utf8(_ctx: click.Context, _param: click.Parameter, value: str) -> str:
    """Refuse text that is not UTF-8: arguments from the shell can have any octets."""
    try:
        value.encode()
    except UnicodeEncodeError:
        raise click.BadParameter("the text is not UTF-8") from None
    return value


def octets_options(option: str) -> Callable[[F], F]:
    """Add ``--text TEXT`` and, named ``option``, octets in hex; :func:`octets_given` evaluates them."""

    def add(function: F) -> F:
        what = option.removeprefix("--")
        function = click.option("--text", metavar="TEXT", help=f"The {what} as text (UTF-8).")(function)
        return click.option(option, "octets", metavar="HEX", help=f"The {what} in hex.")(function)

    return add


def octets_given(option: str, octets: str | None, text: str | None) -> str:
    """Return the octets given with the options of :func:`octets_options`, as hex."""
    if (octets is None) == (text is None):
        raise click.UsageError(f"give the {option.removeprefix('--')} with {option} HEX or --text TEXT")
    if octets is None:
        # Octets that are not UTF-8 are sent unchanged.
        return (text or "").encode("utf-8", "surrogateescape").hex()
    try:
        return bytes.fromhex(octets.replace(":", "")).hex()
    except ValueError:
        raise click.BadParameter(f"{octets!r} is not hex", param_hint=option) from None


def watch_options(what: str) -> Callable[[F], F]:
    """Add the options ``--count`` and ``--for`` of a command that uses :func:`show_notifications`."""

    def add(function: F) -> F:
        function = click.option("--for", "seconds", type=Seconds(0), metavar="S", help="End after S seconds.")(function)
        return click.option("--count", type=click.IntRange(min=1), metavar="N", help=f"End after N {what}.")(function)

    return add


def show_notifications(
    client: ControlClient, count: int | None, seconds: float | None, what: str, show: Callable[[Notification], str]
) -> int:
    """Print ``show(notification)`` for each notification of the node, unless it is empty; return the exit status.

    Ends after ``count`` lines or ``seconds`` s (None: without limit). Raises ExpectedError if there are fewer than
    ``count`` lines in this time.
    """
    deadline = None if seconds is None else time.monotonic() + seconds
    shown = 0
    while count is None or shown < count:
        left = None if deadline is None else deadline - time.monotonic()
        told = client.wait(left) if left is None or left > 0 else None
        if told is None:
            break
        if text := show(told):
            say(text)
            shown += 1
    if count is not None and shown < count:
        raise ExpectedError(f"{shown} of {count} {what} within the given time", NOT_OK)
    return 0


def polled(client: ControlClient, method: str, interval: float, count: int | None) -> Iterator[dict[str, Any]]:
    """Yield the result of a method every ``interval`` s, ``count`` times (None: without limit)."""
    yield client.call(method)
    for _ in repeat(None) if count is None else range(count - 1):
        time.sleep(interval)
        yield client.call(method)


@contextmanager
def connect(path: str) -> Iterator[ControlClient]:
    """Connect to the node; its errors become ExpectedError with the exit status for them."""
    try:
        with ControlClient(path) as client:
            yield client
    except ControlError as error:
        raise ExpectedError(str(error), UNREACHABLE) from None
    except ServiceError as error:
        raise ExpectedError(str(error), UNUSABLE if error.code in _USAGE else NOT_OK) from None


def is_ok(result: dict[str, Any]) -> bool:
    """Whether the status of a result is OK."""
    return str(result.get("status", "")).endswith("-STATUS-OK")


def finish(method: str, result: dict[str, Any], as_json: bool, text: str | None = None) -> int:
    """Show a result and return its exit status; ``text`` is shown instead of the status if it is OK."""
    if as_json:
        click.echo(json.dumps(result))
    elif is_ok(result):
        click.echo(result["status"] if text is None else text)
    if is_ok(result):
        return 0
    if not as_json:
        note(f"{method}: {result['status']}{_meaning(result['status'])}")
    return NOT_OK


def _meaning(status: str) -> str:
    """Return the meaning of a status from the specification; empty for an unknown status."""
    from dcp_spec.status import BPStatus, SRPStatus, VardisStatus

    for kind in (BPStatus, SRPStatus, VardisStatus):
        try:
            return f": {kind.parse(status).meaning}"
        except ValueError:
            continue
    return ""


def simple(
    control: str, as_json: bool, method: str, /, show: Callable[[dict[str, Any]], str] | None = None, **params: Any
) -> int:
    """Call a method, show its result, and return the exit status; ``show`` formats a result whose status is OK."""
    with connect(control) as client:
        result = client.call(method, **params)
    return finish(method, result, as_json, show(result) if show and not as_json and is_ok(result) else None)


def columns(
    header: Sequence[str], rows: Sequence[Sequence[str]], *, right: Sequence[int] = (), give: Sequence[int] = ()
) -> str:
    """Format a table as text that fits the terminal if possible; see :func:`table_lines` for the columns."""
    width = shutil.get_terminal_size().columns if sys.stdout.isatty() else None
    return "\n".join(table_lines(header, rows, width, right=right, give=give))


def table_lines(
    header: Sequence[str],
    rows: Sequence[Sequence[str]],
    width: int | None,
    *,
    right: Sequence[int] = (),
    give: Sequence[int] = (),
    spare: Sequence[int] = (),
) -> list[str]:
    """Return the header and the rows of a table as lines; ``right`` are the indices of right-aligned columns.

    For lines of at most ``width`` characters (None: without limit) the columns ``give`` are narrowed, and then those in
    ``spare`` omitted in this order.
    """
    cells = [header, *rows]
    natural = [max(map(len, column)) for column in zip(*cells, strict=True)]
    kept, leaving, widths = list(range(len(natural))), list(spare), natural
    while width is not None:
        room = width - 2 * (len(kept) - 1)
        widths = fitted([natural[number] for number in kept], room, [kept.index(each) for each in give if each in kept])
        if sum(widths) <= room or not leaving:
            break
        kept.remove(leaving.pop(0))
    lines = []
    for row in cells:
        shown = [(number, clipped(row[number], size), size) for number, size in zip(kept, widths, strict=True)]
        aligned = [text.rjust(size) if number in right else text.ljust(size) for number, text, size in shown]
        lines.append("  ".join(aligned).rstrip())
    return lines


def fitted(widths: Sequence[int], room: int, give: Sequence[int]) -> list[int]:
    """Return the widths of columns for a total of ``room``: the widest columns of ``give`` are narrowed down to 12."""
    narrowed = list(widths)
    for _ in range(sum(widths) - room):
        widest = max(give, key=lambda number: narrowed[number], default=None)
        if widest is None or narrowed[widest] <= _NARROWEST:
            break
        narrowed[widest] -= 1
    return narrowed


def clipped(text: str, width: int) -> str:
    """Truncate a text to ``width`` characters; dots mark the omission."""
    return text if len(text) <= width else text[: width - 3] + "..."


def counted(number: int, noun: str) -> str:
    """Return a number with its noun: ``1 neighbour``, ``2 neighbours``."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def say(text: str) -> None:
    """Print a line and flush, because the reader of a pipe may be waiting for it."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def span(milliseconds: float) -> str:
    """Format a duration in a readable unit."""
    if milliseconds < 10_000:
        return f"{milliseconds / 1000:.1f} s"
    seconds = round(milliseconds / 1000)
    if seconds < 120:
        return f"{seconds} s"
    minutes, seconds = divmod(seconds, 60)
    if minutes < 120:
        return f"{minutes} min {seconds:02d} s"
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes:02d} min" if hours < 48 else f"{hours // 24} d {hours % 24} h"


def shown_value(hexadecimal: str, limit: int = 64) -> str:
    """Format a value as hex, and as text if it is printable; control characters never reach the terminal."""
    octets = bytes.fromhex(hexadecimal)
    text = octets.decode("utf-8", "replace")
    readable = text.isprintable() and "\ufffd" not in text and bool(text)
    shown = clipped(hexadecimal, limit)
    return f'{shown} "{text[:limit]}"' if readable else shown


def printable(text: str, limit: int = 60) -> str:
    """Escape control characters of a received text, and truncate it to ``limit`` characters."""
    return clipped(plain(text), limit)
