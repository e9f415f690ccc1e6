"""``dcp-codec wireshark``: install dissectors in Wireshark's folder of plugins."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import click
from dcp_spec.profile.loading import profile_names

from dcp_codec.common.commandline import path_option, writing

from .common import load_codec

#: Seconds that tshark may take to list its folders.
_PATIENCE = 30
_USUAL = Path("~/.local/lib/wireshark/plugins")


@click.command(
    "wireshark",
    epilog="Several dissectors can be loaded at once: each beacon is shown by one that fits. Exit status: 0 all good, "
    "2 wrong usage, or a file that cannot be written.",
)
@click.argument("action", type=click.Choice(["install", "remove", "where"]))
@click.option(
    "-p",
    "--profile",
    "profiles",
    multiple=True,
    metavar="NAME|FILE",
    help="Wire profile to install or remove; may be given several times.  [default: all built-in profiles]",
)
@path_option(
    "--folder",
    metavar="DIR",
    help="Folder of Lua plugins.  [default: the personal one of 'tshark -G folders']",
)
def command(action: str, profiles: tuple[str, ...], folder: Path | None) -> int:
    """Install dissectors in the folder of personal Lua plugins of Wireshark and tshark.

    \b
    install   write one file for each profile, replacing earlier versions
    remove    remove them
    where     show the folder
    """
    place = folder or plugin_folder()
    if action == "where":
        click.echo(str(place))
        return 0
    from dcp_codec.common.atomic_write import write_whole
    from dcp_codec.export.lua import wireshark_dissector

    for name in profiles or profile_names():
        codec = load_codec(name)
        path = place / f"dcp-{re.sub('[^A-Za-z0-9.-]+', '-', codec.profile.name)}.lua"
        with writing(path):
            if action == "remove":
                path.unlink(missing_ok=True)
                continue
            place.mkdir(parents=True, exist_ok=True)
            write_whole(path, wireshark_dissector(codec).encode())
        click.echo(str(path))
    if action == "install":
        click.echo("Wireshark loads them when it starts, or with Analyze > Reload Lua Plugins.")
    return 0


def plugin_folder() -> Path:
    """Return the folder of personal Lua plugins: the one that tshark reports, or the usual one without tshark."""
    tshark = shutil.which("tshark")
    if tshark is not None:
        try:
            done = subprocess.run(  # noqa: S603 - what the user has installed under this name
                [tshark, "-G", "folders"], capture_output=True, text=True, timeout=_PATIENCE, check=False
            )
        except (OSError, subprocess.TimeoutExpired):
            done = None
        found = re.search(r"^Personal Lua Plugins:\s*(.+)$", done.stdout if done else "", re.MULTILINE)
        if found:
            return Path(found[1].strip())
    return _USUAL.expanduser()
