"""Generate the reference of all commands from their click definitions."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterator

import click
from dcp_conformance.cli import main as conformance
from dcp_selftest.cli import main as selftest

from dcp_codec.cli import main as codec
from dcp_codec.common.commandline import CommandLine
from dcp_stack.cli import main as node

from .markdown import page, table

COMMANDS: tuple[CommandLine, ...] = (codec, node, conformance, selftest)


def command_page(line: CommandLine) -> str:
    """Return the page of one command: every subcommand with its arguments, options and exit status."""
    group = line.group()
    context = click.Context(group, info_name=line.name)
    parts = [line.about, f"Exit status: {line.exit_status}"]
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        assert command is not None
        parts += _command(command, click.Context(command, info_name=name, parent=context), 2)
    return page(f"`{line.name}`", *parts)


def _command(command: click.Command, context: click.Context, level: int) -> Iterator[str]:
    yield f"{'#' * level} `{context.command_path}`"
    yield f"```text\n{' '.join([context.command_path, *command.collect_usage_pieces(context)])}\n```"
    yield _prose(command.help or command.short_help or "")
    rows = [_option(each, context) for each in command.params if isinstance(each, click.Option) and not each.hidden]
    if rows:
        yield table(("Option", "Default", "Meaning"), rows)
    if command.epilog:
        yield _prose(command.epilog)
    if isinstance(command, click.Group):
        for name in command.list_commands(context):
            below = command.get_command(context, name)
            assert below is not None
            yield from _command(below, click.Context(below, info_name=name, parent=context), level + 1)


def _prose(text: str) -> str:
    """Help text as Markdown; paragraphs that click must not wrap (``\\b``) or that are indented are code."""
    out = []
    for part in re.split(r"\n\s*\n", textwrap.dedent(text).strip("\n")):
        verbatim = part.lstrip().startswith("\b") or part.startswith("    ")
        plain = textwrap.dedent(part.replace("\b\n", "").replace("\b", "")).strip("\n")
        out.append(f"```text\n{plain}\n```" if verbatim else _escaped(plain))
    return "\n\n".join(out)


def _escaped(text: str) -> str:
    return re.sub(r"([*_\[\]<])", r"\\\1", text)


def _option(option: click.Option, context: click.Context) -> tuple[str, str, str]:
    kind = "" if option.is_flag or option.count else f" {option.make_metavar(ctx=context)}"
    names = ", ".join(
        f"`{name}{kind if name.startswith('--') else ''}`" for name in [*option.opts, *option.secondary_opts]
    )
    info = option.get_help_extra(context)
    default = info.get("default", "") or ("required" if option.required else "")
    return names, default, _escaped(option.help or "")
