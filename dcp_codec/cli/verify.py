"""``dcp-codec verify``: compare recordings with their manifest."""

from __future__ import annotations

from pathlib import Path

import click

from dcp_codec.common.commandline import ExpectedError


@click.command(
    "verify", epilog="Exit status: 0 all recordings match the manifest, 1 some differ, 2 unreadable manifest."
)
@click.argument("manifest", type=click.Path(dir_okay=False, path_type=Path))
def command(manifest: Path) -> int:
    """Verify recordings: hashes, attachments, that every beacon decodes and encodes to the same octets, and the counts.

    The recordings of this project are verified with: dcp-codec verify captures/manifest.toml
    """
    from dcp_codec.testing.goldens import GoldensError, verify

    try:
        findings = verify(manifest)
    except GoldensError as error:
        raise ExpectedError(str(error)) from None
    for finding in findings:
        click.echo(str(finding))
    click.echo(f"{manifest}: {'as it says' if not findings else f'{len(findings)} findings'}")
    return 1 if findings else 0
