"""The common part of ``dcp-node activate`` and ``deactivate``."""

from __future__ import annotations

import json

import click

from .common import EXIT_STATUS, NOT_OK, connect, finish, is_ok, node_options


def activation(verb: str, about: str) -> click.Command:
    """Return the command that calls BP-MGMT- and VD-MGMT- with ``verb``, Activate or Deactivate."""

    @click.command(verb.lower(), epilog=EXIT_STATUS, help=about)
    @click.argument("which", required=False, type=click.Choice(["bp", "vardis"]))
    @node_options
    def command(which: str | None, control: str, as_json: bool) -> int:
        prefixes = {"bp": ["BP"], "vardis": ["VD"], None: ["BP", "VD"]}[which]
        methods = [f"{prefix}-MGMT-{verb}" for prefix in prefixes]
        with connect(control) as client:
            if which is None:
                # A node may run without VarDis, or follow a version without these services.
                served = client.call("UT-Hello")["methods"]
                methods = [method for method in methods if method in served] or methods
            results = {method: client.call(method) for method in methods}
        if as_json and which is None:
            click.echo(json.dumps(results))
            return 0 if all(map(is_ok, results.values())) else NOT_OK
        return max(finish(method, result, as_json) for method, result in results.items())

    return command
