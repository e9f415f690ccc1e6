"""Help of commands: sections name existing parameters, each once."""

from __future__ import annotations

import importlib
from collections.abc import Iterator

import click
import pytest

from dcp_codec.common.commandline import SectionedCommand


def commands(group: click.Group, path: str) -> Iterator[tuple[str, click.Command]]:
    context = click.Context(group)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        assert command is not None
        if isinstance(command, click.Group):
            yield from commands(command, f"{path} {name}")
        else:
            yield f"{path} {name}", command


@pytest.mark.parametrize("package", ["dcp_codec", "dcp_stack", "dcp_conformance"])
def test_long_help_has_sections_that_name_each_option_at_most_once(package: str) -> None:
    for name, command in commands(importlib.import_module(f"{package}.cli").main.group(), package):
        options = {each.name for each in command.params if isinstance(each, click.Option) and not each.hidden}
        if not isinstance(command, SectionedCommand):
            assert len(options) <= 14, f"{name}: {len(options)} options without sections"
            continue
        named = [each for names in command.sections.values() for each in names.split()]
        assert len(named) == len(set(named)), f"{name}: an option is in two sections"
        assert set(named) == options, f"{name}: {set(named) ^ options}"
