"""The ``dcp-conformance`` command. Subcommands are imported when they are called, so that ``--help`` stays quick."""

from __future__ import annotations

import importlib
import os
import sys
from typing import Any

import click
from dcp_spec.version import __version__

_COMMANDS = {
    "run": ("run", "Test an implementation."),
    "list": ("list", "Show the test cases."),
}


class _Group(click.Group):
    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(_COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in _COMMANDS:
            return None
        command: click.Command = importlib.import_module(f"dcp_conformance.cli.{_COMMANDS[cmd_name][0]}").command
        return command


@click.group(cls=_Group)
@click.version_option(__version__, prog_name="dcp-conformance")
def main_group() -> None:
    """Test implementations of DCP."""


def main(args: list[str] | None = None) -> Any:
    from dcp_conformance.errors import ConformanceError

    try:
        status = main_group.main(args, prog_name="dcp-conformance", standalone_mode=False)
    except click.ClickException as error:
        error.show()
        status = 2
    except ConformanceError as error:
        click.echo(f"dcp-conformance: {error}", err=True)
        status = 2
    sys.exit(status or 0)
