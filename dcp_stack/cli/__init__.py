"""The ``dcp-node`` command. Subcommands are imported when they are called, so that ``--help`` stays quick."""

from __future__ import annotations

import importlib
import importlib.util
import os
import sys
from typing import Any

import click
from dcp_spec.version import __version__

#: subcommand -> (module, one-line help); the module has a click command called ``command``.
_COMMANDS = {
    "run": ("run", "Run a node on an interface or over UDP."),
    "status": ("status", "Show the state of a node."),
    "monitor": ("monitor", "Watch a node: neighbours, variables, rates, drops."),
    "neighbours": ("neighbours", "Show the neighbour table."),
    "var": ("var", "Create, update, read, delete, list and watch variables."),
    "bp": ("bp", "Register client protocols, send and watch their payloads."),
    "param": ("param", "Get and set the parameters of BP, SRP and VarDis."),
    "activate": ("activate", "Let BP and VarDis work."),
    "deactivate": ("deactivate", "Let BP and VarDis rest."),
    "reset": ("reset", "Bring a node back to the state after its start."),
    "simulate": ("simulate", "Run a network of nodes in virtual time."),
    "testbed": ("testbed", "Run nodes in network namespaces on a virtual Ethernet."),
}


class _Group(click.Group):
    """A group whose commands are loaded by name."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002 - click calls with a fixed signature
        return [name for name in _COMMANDS if _exists(name)]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002 - as above
        if cmd_name not in _COMMANDS or not _exists(cmd_name):
            return None
        module = importlib.import_module(f"dcp_stack.cli.{_COMMANDS[cmd_name][0]}")
        command: click.Command = module.command
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        # Only the table is needed here; importing every module for its help would cost what laziness saves.
        with formatter.section("Commands"):
            formatter.write_dl([(name, _COMMANDS[name][1]) for name in self.list_commands(ctx)])


def _exists(name: str) -> bool:
    return importlib.util.find_spec(f"dcp_stack.cli.{_COMMANDS[name][0]}") is not None


@click.group(
    cls=_Group,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="Exit status: 0 OK; 1 a service answered with a status other than OK; 2 wrong usage, or a configuration, "
    "link or request that cannot be used; 3 no node could be reached. 'dcp-node COMMAND --help' tells more.",
)
@click.version_option(__version__, prog_name="dcp-node")
def main_group() -> None:
    """Run a DCP node (BP, SRP, VarDis), and talk to one that runs."""


def main(args: list[str] | None = None) -> Any:
    """Entry point of ``dcp-node``: every failure is one line on stderr and a documented exit status."""
    from .common import ExpectedError

    try:
        status = main_group.main(args, prog_name="dcp-node", standalone_mode=False)
        sys.stdout.flush()
    except click.exceptions.Exit as stop:
        status = stop.exit_code
    except click.ClickException as error:
        error.show()
        status = 2
    except click.Abort:
        status = 130
    except ExpectedError as error:
        click.echo(f"dcp-node: {error}", err=True)
        status = error.status
    except BrokenPipeError:
        # The reader of our output has seen enough; that is no failure. What is still buffered has nowhere to go.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        status = 0
    sys.exit(status or 0)
