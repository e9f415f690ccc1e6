"""``dcp-node var``: the variables of a node."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import click

from dcp_stack.control.client import ControlClient, Notification

from .common import (
    EXIT_STATUS,
    columns,
    connect,
    finish,
    is_ok,
    node_options,
    note,
    octets_given,
    octets_options,
    printable,
    say,
    show_notifications,
    shown_value,
    simple,
    span,
    utf8,
    watch_options,
)

if TYPE_CHECKING:
    from dcp_spec.profile.definition import Profile


def _field(given: str) -> tuple[str, int | float | str]:
    """Return name and value of a field that the profile adds to a record."""
    name, equals, value = given.partition("=")
    if not name or not equals:
        raise click.BadParameter(f"needs NAME=VALUE, such as priority=3, not {given!r}", param_hint="--field")
    if value.startswith("0x"):
        return name, value[2:]
    try:
        return name, int(value)
    except ValueError:
        pass
    try:
        return name, float(value)
    except ValueError:
        message = f"needs a number, or octets in hex after 0x, as value of {name}, not {value!r}"
        raise click.BadParameter(message, param_hint="--field") from None


def _own_fields(_context: click.Context, _option: click.Parameter, given: tuple[str, ...]) -> dict[str, Any]:
    """Return the member ``ownFields`` of a request; without fields nothing."""
    return {"ownFields": dict(map(_field, given))} if given else {}


_FIELDS = click.option(
    "--field",
    "fields",
    multiple=True,
    callback=_own_fields,
    metavar="NAME=VALUE",
    help="A field that the profile adds to the record: a number, or octets in hex after 0x.  [default: 0]",
)


@click.group("var", epilog=EXIT_STATUS)
def command() -> None:
    """Create, update, read, delete, list and watch variables (RTDB services of VarDis)."""


@command.command("create", epilog=EXIT_STATUS)
@click.argument("var_id", type=int, metavar="ID")
@octets_options("--value")
@click.option(
    "--descr",
    required=True,
    callback=utf8,
    metavar="TEXT",
    help="Description; other nodes ignore a variable without one.",
)
@click.option(
    "--repcnt",
    type=int,
    metavar="N",
    help="Number of beacons that contain each change.  [default: 3, or less if profile or parameter require it]",
)
@click.option(
    "--timeout",
    type=int,
    default=0,
    metavar="MS",
    help="Delete it after this time without update; 0: never.  [default: 0]",
)
@_FIELDS
@node_options
def create(
    var_id: int,
    octets: str | None,
    text: str | None,
    descr: str,
    repcnt: int | None,
    timeout: int,
    fields: dict[str, Any],
    control: str,
    as_json: bool,
) -> int:
    """Create variable ID, with this node as its producer."""
    params = {"varId": var_id, "descr": descr, "value": octets_given("--value", octets, text), **fields}
    if timeout:
        params["timeout"] = timeout
    with connect(control) as client:
        params["repCnt"] = _repetitions(client) if repcnt is None else repcnt
        result = client.call("RTDB-Create", **params)
        if is_ok(result):
            for warning in _ignored_by_others(client, descr, repcnt):
                note(f"warning: {warning}")
    return finish("RTDB-Create", result, as_json)


def _repetitions(client: ControlClient) -> int:
    """Return the default of repCnt: what the profile recommends, else 3, at most the maximum of the node."""
    most = client.call("VD-GetParameters")["parameters"].get("VARDISPAR_MAX_REPETITIONS", 3)
    profile = _profile(client)
    return min(3 if profile is None else profile.among.repetitions or 3, int(most))


def _profile(client: ControlClient) -> Profile | None:
    """Return the profile of the node; None if it is defined in a file of the node."""
    from dcp_spec.profile.loading import ProfileError, load_profile

    try:
        return load_profile(client.call("UT-Hello")["profile"])
    except (ProfileError, KeyError):
        return None


def _ignored_by_others(client: ControlClient, descr: str, repcnt: int | None) -> Iterator[str]:
    """Yield reasons why other nodes may ignore a variable although this node has created it."""
    if not descr:
        yield "other nodes ignore a variable without a description"
    if repcnt is None:
        return
    profile = _profile(client)
    if profile is None:
        return
    if repcnt > (most := profile.limits.max_repetitions):
        yield f"nodes with the limits of this profile take at most {most} repetitions, not {repcnt}"
    elif profile.among.repetitions is not None and repcnt > profile.among.repetitions:
        most = profile.among.repetitions
        yield f"unless configured otherwise, nodes of this profile refuse variables with more than {most} repetitions"


@command.command("update", epilog=EXIT_STATUS)
@click.argument("var_id", type=int, metavar="ID")
@octets_options("--value")
@_FIELDS
@node_options
def update(
    var_id: int, octets: str | None, text: str | None, fields: dict[str, Any], control: str, as_json: bool
) -> int:
    """Set the value of variable ID, which this node produces."""
    return simple(control, as_json, "RTDB-Update", varId=var_id, value=octets_given("--value", octets, text), **fields)


@command.command("get", epilog=EXIT_STATUS)
@click.argument("var_id", type=int, metavar="ID")
@click.option("--text", "as_text", is_flag=True, help="Show the value as text (UTF-8) instead of hex.")
@node_options
def get(var_id: int, as_text: bool, control: str, as_json: bool) -> int:
    """Show the value of variable ID."""

    def value(result: dict[str, Any]) -> str:
        octets: str = result["value"]
        return printable(bytes.fromhex(octets).decode("utf-8", "backslashreplace"), 1 << 16) if as_text else octets

    return simple(control, as_json, "RTDB-Read", value, varId=var_id)


@command.command("delete", epilog=EXIT_STATUS)
@click.argument("var_id", type=int, metavar="ID")
@node_options
def delete(var_id: int, control: str, as_json: bool) -> int:
    """Delete variable ID, which this node produces."""
    return simple(control, as_json, "RTDB-Delete", varId=var_id)


@command.command("describe", epilog=EXIT_STATUS)
@click.argument("var_id", type=int, metavar="ID")
@node_options
def describe(var_id: int, control: str, as_json: bool) -> int:
    """Show all data of variable ID, also after its deletion."""
    return simple(control, as_json, "RTDB-DescribeVariable", _members, varId=var_id)


def _members(result: dict[str, Any]) -> str:
    return "\n".join(f"{name:<12}  {_member(name, value)}" for name, value in result["variable"].items())


def _member(name: str, value: Any) -> str:
    if name == "value":
        return shown_value(value)
    if name == "tStamp":
        return f"{value} ({span(max(time.time_ns() - value, 0) / 1e6)} ago)"
    return printable(str(value)) if isinstance(value, str) else json.dumps(value)


@command.command("list", epilog=EXIT_STATUS)
@node_options
def list_(control: str, as_json: bool) -> int:
    """List all variables with their values, including deleted ones."""
    with connect(control) as client:
        result = client.call("RTDB-DescribeDatabase")
        found = sorted(result.get("variables", ()), key=lambda each: each["varId"])
        listed = [_described(client, each) for each in found]
    result["variables"] = listed
    wall = time.time_ns()
    rows = [
        [
            str(each["varId"]),
            each["prodId"],
            str(each.get("seqno", "")),
            span(max(wall - each.get("tStamp", wall), 0) / 1e6),
            "deleted" if each.get("isDeleted") else shown_value(each.get("value", "")),
            printable(each.get("descr", each.get("descrHex", ""))),
        ]
        for each in listed
    ]
    table = columns(("id", "producer", "seqno", "age", "value", "description"), rows, right=(0, 2, 3), give=(4, 5))
    return finish("RTDB-DescribeDatabase", result, as_json, table if rows else "no variables")


def _described(client: ControlClient, variable: dict[str, Any]) -> dict[str, Any]:
    """Return a variable with value and counters, or unchanged if it was removed since it was listed (up to 1.3)."""
    answer = client.call("RTDB-DescribeVariable", varId=variable["varId"])
    found: dict[str, Any] = answer.get("variable", variable)
    return found


@command.command("watch", epilog=EXIT_STATUS)
@click.argument("var_ids", type=int, nargs=-1, metavar="[ID...]")
@watch_options("changes")
@node_options
def watch(var_ids: tuple[int, ...], count: int | None, seconds: float | None, control: str, as_json: bool) -> int:
    """Show the state of variables, and then every change.

    Without an ID, all variables are shown. With --json, one object per line.
    """

    def show(told: Notification) -> str:
        wanted = told.method == "UT-VariableChanged" and (not var_ids or told.params["varId"] in var_ids)
        return _change(told.params, as_json) if wanted else ""

    with connect(control) as client:
        # Subscribe before reading the state: a change in between is then shown twice instead of never.
        client.call("UT-Subscribe", variables=True)
        listed = client.call("RTDB-DescribeDatabase")
        if not is_ok(listed):
            note(f"RTDB-DescribeDatabase: {listed['status']}; showing changes only")
        elif missing := sorted(set(var_ids) - {each["varId"] for each in listed["variables"]}):
            # It may be created later, but with a mistyped ID the command would wait without limit.
            note(f"not in the database yet: {', '.join(map(str, missing))}")
        for each in listed.get("variables", ()):
            if not var_ids or each["varId"] in var_ids:
                say(_change({"event": "is", **_described(client, each)}, as_json))
        return show_notifications(client, count, seconds, "changes", show)


def _change(change: dict[str, Any], as_json: bool) -> str:
    """Return a line about a change of a variable."""
    if as_json:
        names = ("event", "varId", "prodId", "seqno", "value")
        return json.dumps({name: change[name] for name in names if name in change})
    clock = time.strftime("%H:%M:%S")
    event = "deleted" if change.get("isDeleted") else change["event"]
    value = "" if event == "deleted" else "  " + shown_value(change.get("value", ""))
    return f"{clock}  {change['varId']:>5}  {event:<8} {change.get('seqno', ''):>4}  by {change['prodId']}{value}"
