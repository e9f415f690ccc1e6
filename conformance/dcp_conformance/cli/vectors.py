"""``dcp-conformance vectors``."""

from __future__ import annotations

from pathlib import Path

import click

from dcp_codec.common.commandline import path_option, say


@click.command("vectors", epilog="Exit status: 0 they were written; 2 wrong usage.")
@click.argument("folder", type=click.Path(path_type=Path, file_okay=False), metavar="DIR")
@click.option(
    "--profile", "profiles", multiple=True, metavar="NAME", help="Only this profile; repeatable.  [default: all]"
)
@click.option("--kind", "kinds", multiple=True, type=click.Choice(("wire", "behaviour")), help="Only this kind.")
@path_option("--archive", metavar="FILE", help="Also write them as a zip file.")
def command(folder: Path, profiles: tuple[str, ...], kinds: tuple[str, ...], archive: Path | None) -> int:
    """Write test vectors to DIR, for unit tests in any language.

    Wire vectors are octets with the values or the problem in them. Behaviour vectors are frames, service calls and
    times, with what must, may and must not come out of a node. Tests that use them need neither this program nor a
    network.
    """
    from dcp_spec.profile.loading import ProfileError, load_profile, profile_names

    from dcp_conformance.errors import UsageError
    from dcp_conformance.vectors.files import KINDS, files, write

    for name in profiles:
        try:
            load_profile(name)
        except ProfileError as error:
            raise UsageError(str(error)) from None
    count = write(folder, files(profiles or profile_names(), kinds or KINDS), archive)
    say(f"{count} files in {folder}" + (f", and {archive}" if archive else ""))
    return 0
