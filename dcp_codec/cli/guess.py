"""``dcp-codec guess``: which profile does a recording speak?"""

from __future__ import annotations

import json

import click

from dcp_codec.guess import SAMPLE, guess, sample

from .common import each_file, open_input, report_capture_problems
from .common import ether_type as parse_ether_type


@click.command("guess")
@click.argument("files", nargs=-1, required=True, metavar="FILE...")
@click.option("--ether-type", callback=parse_ether_type, metavar="N", help="EtherType of the beacons.")
@click.option(
    "-n", "--sample", "limit", type=click.IntRange(min=1), default=SAMPLE, show_default=True, help="Frames to look at."
)
@click.option("-f", "--format", "form", type=click.Choice(["text", "json"]), default="text", show_default=True)
def command(files: tuple[str, ...], ether_type: int | None, limit: int, form: str) -> int:
    """Rank the built-in wire profiles by how well they explain the first frames of a recording.

    The score is 1 when every frame decodes and everything it says is plausible.
    """
    return each_file(files, lambda name: _guess(name, ether_type, limit, form))


def _guess(name: str, ether_type: int | None, limit: int, form: str) -> int:
    with open_input(name) as reader:
        first, _ = sample(reader, limit, ether_type=ether_type)
        found = guess(first, ether_type=ether_type)
        status = report_capture_problems(reader, name)
    if form == "json":
        rows = [
            {
                "profile": candidate.profile.name,
                "score": round(candidate.score, 6),
                "decoded": candidate.decoded,
                "frames": candidate.frames,
                "doubts": list(candidate.doubts),
            }
            for candidate in found.candidates
        ]
        best = found.best
        tied = [best.profile.name, *(other.profile.name for other in found.tied)]
        click.echo(json.dumps({"file": name, "profile": best.profile.name, "tied": tied, "ranking": rows}))
        return status
    click.echo(f"{name}: {found}")
    click.echo("  score  decoded        profile       doubts")
    for candidate in found.candidates:
        share = f"{candidate.decoded}/{candidate.frames}"
        doubts = "; ".join(candidate.doubts)
        click.echo(f"  {candidate.score:5.3f}  {share:<13}  {candidate.profile.name:<12}  {doubts}".rstrip())
    return status
