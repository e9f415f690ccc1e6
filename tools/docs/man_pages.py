"""Write man pages of all three commands with click-man: ``python -m tools.docs.man_pages FOLDER`` (``make man``)."""

from __future__ import annotations

import sys
from pathlib import Path

import click
from click_man.core import write_man_pages
from dcp_conformance.cli import main as conformance
from dcp_spec.version import __version__

from dcp_codec.cli import main as codec
from dcp_codec.common.commandline import CommandLine
from dcp_stack.cli import main as node


def eager(command: click.Command, short: str | None = None) -> click.Command:
    """The same command with all subcommands loaded, and with its exit status in the description."""
    command.help = "\n\n".join(text for text in (command.help, command.epilog) if text)
    command.short_help = short or command.short_help
    if not isinstance(command, click.Group):
        return command
    context = click.Context(command)
    found = ((name, command.get_command(context, name)) for name in command.list_commands(context))
    command.commands = {name: eager(each) for name, each in found if each is not None}
    return command


def write(line: CommandLine, folder: Path) -> None:
    """Write the pages of one command, the release of the kit in their footer."""
    group = line.group()
    eager(group, line.about)
    for name, short in line.subcommands.items():
        group.commands[name].short_help = short
    write_man_pages(line.name, group, version=__version__, target_dir=str(folder))


def main() -> None:
    """Write all pages to the folder that the command line names."""
    if len(sys.argv) != 2:
        sys.exit(f"usage: {sys.argv[0]} FOLDER")
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    for line in (codec, node, conformance):
        write(line, folder)


if __name__ == "__main__":
    main()
