"""What the subcommands share: failures, the connection to a node, tables and JSON."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

import click

from dcp_codec.commandline import UNUSABLE, ExpectedError
from dcp_stack.control.client import ControlClient, ControlError, ServiceError
from dcp_stack.control.jsonrpc import INVALID_PARAMS, INVALID_REQUEST, METHOD_NOT_FOUND, PARSE_ERROR

from . import main

NOT_OK, UNREACHABLE = 1, 3

EXIT_STATUS = f"Exit status: {main.exit_status}"

F = TypeVar("F", bound=Callable[..., Any])
_USAGE = frozenset({PARSE_ERROR, INVALID_REQUEST, METHOD_NOT_FOUND, INVALID_PARAMS})


#: Tell something on stderr, where it does not disturb output that is piped on.
note = main.note


def control_option(function: F) -> F:
    """``--control``: which node."""
    return click.option(
        "--control",
        required=True,
        envvar="DCP_NODE_CONTROL",
        metavar="PATH",
        help="Control socket of the node.  [env: DCP_NODE_CONTROL]",
    )(function)


def node_options(function: F) -> F:
    """``--control`` and ``--json``."""
    return control_option(click.option("--json", "as_json", is_flag=True, help="The result as JSON.")(function))


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


def columns(header: Sequence[str], rows: Sequence[Sequence[str]], *, right: Sequence[int] = ()) -> str:
    """A table as lines; ``right`` are the numbers of the columns that are aligned to the right."""
    widths = [max(len(row[number]) for row in (header, *rows)) for number in range(len(header))]
    lines = []
    for row in (header, *rows):
        cells = [
            text.rjust(width) if number in right else text.ljust(width)
            for number, (text, width) in enumerate(zip(row, widths, strict=True))
        ]
        lines.append("  ".join(cells).rstrip())
    return "\n".join(lines)


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
    clipped = hexadecimal if len(hexadecimal) <= limit else hexadecimal[: limit - 3] + "..."
    return f'{clipped} "{text[:limit]}"' if readable else clipped


def printable(text: str, limit: int = 60) -> str:
    """Text from the air for a terminal: what is not printable is escaped."""
    safe = "".join(char if char.isprintable() else char.encode("unicode_escape").decode() for char in text)
    return safe if len(safe) <= limit else safe[: limit - 3] + "..."
