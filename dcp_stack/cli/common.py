"""What the subcommands share: failures, the connection to a node, tables and JSON."""

from __future__ import annotations

import json
import math
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

import click

from dcp_codec.common.commandline import UNUSABLE, ExpectedError
from dcp_codec.common.printable import plain
from dcp_stack.control.client import ControlClient, ControlError, Notification, ServiceError
from dcp_stack.control.jsonrpc import INVALID_PARAMS, INVALID_REQUEST, METHOD_NOT_FOUND, PARSE_ERROR
from dcp_stack.control.places import find_socket, places

from . import main

NOT_OK, UNREACHABLE = 1, 3

EXIT_STATUS = f"Exit status: {main.exit_status}"

F = TypeVar("F", bound=Callable[..., Any])
#: Characters to which a column of a table may be cut.
_NARROWEST = 12
_USAGE = frozenset({PARSE_ERROR, INVALID_REQUEST, METHOD_NOT_FOUND, INVALID_PARAMS})


#: Tell something on stderr, where it does not disturb output that is piped on.
note = main.note


def _found(_ctx: click.Context, _param: click.Parameter, value: str | None) -> str:
    """The socket given, or that of the node that runs without a path of its own."""
    if value is not None:
        return value
    path = find_socket()
    if path is None:
        looked = " and ".join(map(str, places()))
        raise ExpectedError(
            f"no node found at {looked}; start one with 'dcp-node run', or say where it is: --control PATH", UNREACHABLE
        )
    return str(path)


def control_option(function: F) -> F:
    """``--control``: which node."""
    return click.option(
        "--control",
        envvar="DCP_NODE_CONTROL",
        callback=_found,
        metavar="PATH",
        help="Control socket of the node.  [env: DCP_NODE_CONTROL; default: that of the node that runs without "
        "--control]",
    )(function)


def node_options(function: F) -> F:
    """``--control`` and ``--json``."""
    return control_option(click.option("--json", "as_json", is_flag=True, help="The result as JSON.")(function))


class Seconds(click.FloatRange):
    """A duration in s that a system can wait for."""

    name = "seconds"

    def __init__(self, least: float, most: float = 1e8, *, min_open: bool = False) -> None:
        super().__init__(min=least, max=most, min_open=min_open)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The number; refuses what is out of range, and what is no number."""
        number = super().convert(value, param, ctx)
        if math.isnan(number):
            self.fail(f"{value!r} is no number of seconds", param, ctx)
        return number


def utf8(_ctx: click.Context, _param: click.Parameter, value: str) -> str:
    """Refuse a text that cannot be sent as one: the shell hands over any octets."""
    try:
        value.encode()
    except UnicodeEncodeError:
        raise click.BadParameter("the text is not UTF-8") from None
    return value


def octets_options(option: str) -> Callable[[F], F]:
    """``--text TEXT`` and, named ``option``, octets in hex; :func:`octets_given` reads them."""

    def add(function: F) -> F:
        what = option.removeprefix("--")
        function = click.option("--text", metavar="TEXT", help=f"The {what} as text (UTF-8).")(function)
        return click.option(option, "octets", metavar="HEX", help=f"The {what} in hex.")(function)

    return add


def octets_given(option: str, octets: str | None, text: str | None) -> str:
    """What the two options of :func:`octets_options` say, as hex."""
    if (octets is None) == (text is None):
        raise click.UsageError(f"give the {option.removeprefix('--')} with {option} HEX or --text TEXT")
    if octets is None:
        # Octets that are no UTF-8 are sent as they were typed.
        return (text or "").encode("utf-8", "surrogateescape").hex()
    try:
        return bytes.fromhex(octets.replace(":", "")).hex()
    except ValueError:
        raise click.BadParameter(f"{octets!r} is not hex", param_hint=option) from None


def watching(client: ControlClient, seconds: float | None) -> Iterator[Notification]:
    """What the node tells, for so many seconds (None: for ever)."""
    deadline = None if seconds is None else time.monotonic() + seconds
    while True:
        left = None if deadline is None else deadline - time.monotonic()
        told = None if left is not None and left <= 0 else client.wait(left)
        if told is None:
            return
        yield told


def watched(shown: int, count: int | None, what: str) -> int:
    """The exit status after :func:`watching` showed ``shown`` things, of which ``count`` were asked for."""
    if count is not None and shown < count:
        raise ExpectedError(f"{shown} of {count} {what} in the time given", NOT_OK)
    return 0


@contextmanager
def connect(path: str) -> Iterator[ControlClient]:
    """A connection to the node, with its failures as ours."""
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
    """Show a result and return the exit status it calls for; ``text`` is what to show people if it is OK."""
    if as_json:
        click.echo(json.dumps(result, ensure_ascii=False))
    elif is_ok(result):
        click.echo(result["status"] if text is None else text)
    if is_ok(result):
        return 0
    if not as_json:
        note(f"{method}: {result['status']}{_meaning(result['status'])}")
    return NOT_OK


def _meaning(status: str) -> str:
    """What the specification says of a status."""
    from dcp_spec.status import BPStatus, SRPStatus, VardisStatus

    for kind in (BPStatus, SRPStatus, VardisStatus):
        try:
            return f": {kind.parse(status).meaning}"
        except ValueError:
            continue
    return ""


def simple(control: str, as_json: bool, method: str, /, **params: Any) -> int:
    """Call one method and show what came back."""
    with connect(control) as client:
        return finish(method, client.call(method, **params), as_json)


def columns(
    header: Sequence[str], rows: Sequence[Sequence[str]], *, right: Sequence[int] = (), give: Sequence[int] = ()
) -> str:
    """A table as lines; ``right`` are the numbers of the columns that are aligned to the right.

    On a terminal it is as narrow as that, if the columns ``give`` can be cut so far.
    """
    cells = [header, *rows]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    if sys.stdout.isatty():
        widths = fitted(widths, shutil.get_terminal_size().columns - 2 * (len(widths) - 1), give)
        cells = [[clipped(text, width) for text, width in zip(row, widths, strict=True)] for row in cells]
    lines = []
    for row in cells:
        aligned = [
            text.rjust(width) if number in right else text.ljust(width)
            for number, (text, width) in enumerate(zip(row, widths, strict=True))
        ]
        lines.append("  ".join(aligned).rstrip())
    return "\n".join(lines)


def fitted(widths: Sequence[int], room: int, give: Sequence[int]) -> list[int]:
    """The widths of columns that have ``room`` together: the widest of those in ``give`` are narrowed, down to 12."""
    narrowed = list(widths)
    for _ in range(sum(widths) - room):
        widest = max(give, key=lambda number: narrowed[number], default=None)
        if widest is None or narrowed[widest] <= _NARROWEST:
            break
        narrowed[widest] -= 1
    return narrowed


def clipped(text: str, width: int) -> str:
    """A text in so many characters, with dots for what is left out."""
    return text if len(text) <= width else text[: width - 3] + "..."


def counted(number: int, noun: str) -> str:
    """``1 neighbour``, ``2 neighbours``."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def say(text: str) -> None:
    """Show a line at once, also into a pipe: somebody may be waiting for it."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def span(milliseconds: float) -> str:
    """A duration for people."""
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
    """A value as hex, and as text where it is one; nothing in it reaches the terminal as a control sequence."""
    octets = bytes.fromhex(hexadecimal)
    text = octets.decode("utf-8", "replace")
    readable = text.isprintable() and "\ufffd" not in text and bool(text)
    shown = clipped(hexadecimal, limit)
    return f'{shown} "{text[:limit]}"' if readable else shown


def printable(text: str, limit: int = 60) -> str:
    """Text from the air for a terminal: what is not printable is escaped."""
    return clipped(plain(text), limit)
