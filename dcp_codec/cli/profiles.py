"""``dcp-codec profiles``: what the wire profiles are, and what one says."""

from __future__ import annotations

import json

import click
import msgspec
from dcp_spec.profile_loading import ProfileError, load_profile, profile_names

from .common import ExpectedError


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
        click.echo(profile_toml(msgspec.to_builtins(profile)), nl=False)
    else:
        from dcp_codec.codec import Codec
        from dcp_codec.export.markdown import format_tables

        click.echo(format_tables(Codec(profile)))
    return 0


def profile_toml(data: dict[str, object]) -> str:
    """A profile as a TOML file that loads again to the same profile; unset keys are left out."""
    lines = [
        f"{key} = {_toml(value)}" for key, value in data.items() if not isinstance(value, dict) and value is not None
    ]
    for key, value in data.items():
        if isinstance(value, dict):
            lines += ["", f"[{key}]"]
            lines += [f"{_key(inner)} = {_toml(each)}" for inner, each in value.items() if each is not None]
    return "\n".join(lines) + "\n"


def _key(key: str) -> str:
    return key if key.replace("-", "").replace("_", "").isalnum() else json.dumps(key)


def _toml(value: object) -> str:
    if isinstance(value, dict):
        inner = ", ".join(f"{_key(key)} = {_toml(each)}" for key, each in value.items() if each is not None)
        return f"{{ {inner} }}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(_toml(each) for each in value)}]"
    # JSON's spelling of strings, numbers and booleans is also TOML's.
    return json.dumps(value, ensure_ascii=False)
