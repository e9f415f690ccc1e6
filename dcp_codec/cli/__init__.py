"""The ``dcp-codec`` command. Subcommands are imported when they are called, so that ``--help`` stays quick."""

from __future__ import annotations

import importlib
import os
import sys
from typing import Any

import click
from dcp_spec.version import __version__

#: subcommand -> (module, one-line help); the module has a click command called ``command``.
_COMMANDS = {
    "decode": ("decode", "Show every beacon, state report and instruction of a recording."),
    "stats": ("stats", "Count what is in recordings."),
    "guess": ("guess", "Rank the wire profiles for a recording."),
    "convert": ("convert", "Convert between MCAP, pcap and pcapng."),
    "encode": ("encode", "Turn JSON into beacons: hex, or a recording."),
    "export": ("export", "Write the wire format for Wireshark, Kaitai, scapy, JSON Schema or people."),
    "profiles": ("profiles", "List the wire profiles, or show one."),
    "verify": ("verify", "Verify recordings against their manifest."),
}


class _Group(click.Group):
    """A group whose commands are loaded by name."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(_COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in _COMMANDS:
            return None
        module = importlib.import_module(f"dcp_codec.cli.{_COMMANDS[cmd_name][0]}")
        command: click.Command = module.command
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        # Only the table is needed here; importing every module for its help would cost what laziness saves.
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in _COMMANDS.items()])


@click.group(
    cls=_Group,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="Exit status: 0 all good; 1 malformed DCP frames were seen; 2 wrong usage, or input that could not be "
    "read (to its end). 'dcp-codec COMMAND --help' tells more.",
)
@click.version_option(__version__, prog_name="dcp-codec")
def main_group() -> None:
    """Read recordings of DCP drone traffic (BP, SRP, VarDis): what was said, and which octet is wrong."""


def main(args: list[str] | None = None) -> Any:
    """Entry point of ``dcp-codec``: every failure is one line on stderr and a documented exit status."""
    from .common import ExpectedError

    try:
        status = main_group.main(args, prog_name="dcp-codec", standalone_mode=False)
        sys.stdout.flush()
    except click.exceptions.Exit as stop:
        status = stop.exit_code
    except click.ClickException as error:
        error.show()
        status = 2
    except click.Abort:
        status = 130
    except ExpectedError as error:
        click.echo(f"dcp-codec: {error}", err=True)
        status = error.status
    except BrokenPipeError:
        # The reader of our output has seen enough; that is no failure. What is still buffered has nowhere to go.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        status = 0
    sys.exit(status or 0)
