"""``dcp-selftest goldens``."""

from __future__ import annotations

from pathlib import Path

import click

from dcp_codec.common.commandline import ExpectedError, path_option

EXIT_STATUS = "Exit status: 0 all recordings match the manifest, 1 some differ, 2 unreadable manifest."


@click.group("goldens", epilog=EXIT_STATUS)
def command() -> None:
    """Verify or build the recordings of this project: captures/manifest.toml."""


@command.command("verify", epilog=EXIT_STATUS)
@click.argument("manifest", type=click.Path(dir_okay=False, path_type=Path))
def verify_command(manifest: Path) -> int:
    """Verify recordings: hashes, attachments, the round trip of every beacon, and the counts."""
    from dcp_selftest.goldens import GoldensError, load_manifest, verify

    try:
        findings = verify(manifest)
        number = len(load_manifest(manifest).capture)
    except GoldensError as error:
        raise ExpectedError(str(error)) from None
    if not number:
        raise ExpectedError(f"{manifest}: names no recording")
    for finding in findings:
        click.echo(str(finding))
    click.echo(f"{number} recordings, {len(findings)} findings")
    return 1 if findings else 0


@command.command("make", epilog=EXIT_STATUS)
@click.argument("manifest", type=click.Path(dir_okay=False, path_type=Path))
@path_option(
    "--originals",
    metavar="FOLDER",
    help="Folder of the recordings.  [default: those attached to the existing files]",
    file_okay=False,
)
@click.pass_context
def make_command(context: click.Context, manifest: Path, originals: Path | None) -> int:
    """Build every recording again, write the manifest, and verify the recordings."""
    from dcp_selftest.goldens import GoldensError, make

    try:
        for golden in make(manifest, originals).capture:
            click.echo(f"{golden.file}: {golden.frames} frames, SHA-256 {golden.sha256}")
    except GoldensError as error:
        raise ExpectedError(str(error)) from None
    status: int = context.invoke(verify_command, manifest=manifest)
    return status
