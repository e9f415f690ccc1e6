"""``dcp-node param``: parameters with the names of the specification."""

from __future__ import annotations

import json
import math
from typing import Any

import click
from dcp_spec.parameters import UnknownParameterError, parameter

from dcp_codec.common.commandline import ExpectedError
from dcp_stack.control.client import ControlClient, ServiceError
from dcp_stack.control.jsonrpc import ErrorCode

from .common import EXIT_STATUS, connect, node_options, simple


@click.group("param", epilog=EXIT_STATUS)
def command() -> None:
    """Get and set the parameters of BP, SRP and VarDis."""


@command.command("get", epilog=EXIT_STATUS)
@click.argument("name", required=False, metavar="[NAME]")
@node_options
def get(name: str | None, control: str, as_json: bool) -> int:
    """Show all parameters, or the parameter NAME."""
    with connect(control) as client:
        found = {**_of(client, "BP"), **_of(client, "SRP"), **_of(client, "VD")}
    if name is not None and name not in found:
        raise ExpectedError(f"the node has no parameter {name}; it has {', '.join(found)}")
    shown = found if name is None else {name: found[name]}
    if as_json:
        click.echo(json.dumps(shown))
    elif name is not None:
        click.echo(str(shown[name]))
    else:
        width = max(map(len, shown))
        for each, value in shown.items():
            unit = parameter(each).unit
            without = unit == "none" or isinstance(value, str)
            click.echo(f"{each:<{width}}  {value}{'' if without else ' ' + unit}")
    return 0


def _of(client: ControlClient, protocol: str) -> dict[str, Any]:
    """Return the parameters of a protocol; none if the node runs without it."""
    try:
        found: dict[str, Any] = client.call(f"{protocol}-GetParameters")["parameters"]
    except ServiceError as error:
        if error.code == ErrorCode.METHOD_NOT_FOUND:
            return {}
        raise
    return found


@command.command("set", epilog=EXIT_STATUS)
@click.argument("name")
@click.argument("value")
@node_options
def set_(name: str, value: str, control: str, as_json: bool) -> int:
    """Set parameter NAME to VALUE.

    If VALUE is out of bounds, it is refused and the old value is kept.
    """
    try:
        protocol = parameter(name).protocol
    except UnknownParameterError as error:
        raise ExpectedError(f"{error}; 'dcp-node param get' lists them") from None
    return simple(control, as_json, f"{protocol}-SetParameter", name=name, value=_number(value))


def _number(text: str) -> int | float:
    for kind in (lambda: int(text, 0), lambda: float(text)):
        try:
            number = kind()
        except ValueError:
            continue
        # An integer is always finite; math.isfinite would fail for large ones.
        if isinstance(number, int) or math.isfinite(number):
            return number
    raise click.BadParameter(f"{text!r} is not a number", param_hint="VALUE")
