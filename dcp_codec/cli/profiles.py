"""``dcp-codec profiles``: what the wire profiles are, and what one says."""

from __future__ import annotations

import json

import click
import msgspec
from dcp_spec.profile_loading import ProfileError, load_profile, profile_names

from dcp_codec.commandline import ExpectedError


@click.command("profiles")
@click.argument("name", required=False, metavar="[NAME|FILE]")
@click.option("-f", "--format", "form", type=click.Choice(["text", "json", "toml"]), default="text", show_default=True)
def command(name: str | None, form: str) -> int:
    """List the built-in wire profiles, or show one with everything it takes over from others.

    A TOML file of your own is checked the same way; 'extends = "cpp-2.0"' in it takes over what you do not state.
    """
    try:
        if name is not None:
            return _show(name, form)
        found = [load_profile(each) for each in profile_names()]
    except ProfileError as error:
        raise ExpectedError(str(error)) from None
    if form == "json":
        click.echo(json.dumps([{"name": each.name, "title": each.title} for each in found], indent=2))
        return 0
    width = max(len(each.name) for each in found)
    for each in found:
        click.echo(f"{each.name:<{width}}  {each.title}")
    return 0


def _show(name: str, form: str) -> int:
    profile = load_profile(name)
    if form == "json":
        click.echo(msgspec.json.format(msgspec.json.encode(profile), indent=2).decode())
    elif form == "toml":
        from dcp_codec.export.tomltext import profile_toml

        click.echo(profile_toml(profile), nl=False)
    else:
        from dcp_codec.codec import Codec
        from dcp_codec.export.markdown import format_tables

        click.echo(format_tables(Codec(profile)))
    return 0
