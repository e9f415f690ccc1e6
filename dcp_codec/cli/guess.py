"""``dcp-codec guess``: rank the profiles for a recording."""

from __future__ import annotations

import json
import shlex
from collections.abc import Sequence

import click
import msgspec

from dcp_codec.analysis.guess import SAMPLE, Candidate, Guess, guess, sample
from dcp_codec.analysis.shortfall import Shortfall, shortfalls
from dcp_codec.capture import Frame
from dcp_codec.codec import get_codec
from dcp_codec.common.commandline import output_format

from .common import each_file, ether_type_option, open_input, report_capture_problems


@click.command("guess")
@click.argument("files", nargs=-1, required=True, metavar="FILE...")
@ether_type_option("EtherType of the beacons, such as 0x4953.  [default: that of each profile]")
@click.option(
    "-n",
    "--sample",
    "limit",
    type=click.IntRange(min=1),
    default=SAMPLE,
    show_default=True,
    metavar="N",
    help="Maximum number of frames to examine.",
)
@output_format("text", "json")
def command(files: tuple[str, ...], ether_type: int | None, limit: int, form: str) -> int:
    """Rank the built-in wire profiles by how well they explain the first frames of a recording.

    The score is 1 if every frame decodes and all its values are plausible. Profiles that explain the same frames
    equally well share a rank. If the best one does not explain all frames, the command shows the unexplained part and,
    if the octets suffice, the lines for a profile of your own that describe it.
    """
    return each_file(files, lambda name: _guess(name, ether_type, limit, form))


def _guess(name: str, ether_type: int | None, limit: int, form: str) -> int:
    with open_input(name) as reader:
        first, _ = sample(reader, limit, ether_type=ether_type)
        found = guess(first, ether_type=ether_type)
        status = report_capture_problems(reader, name)
    missing = _missing(found.best, first)
    if form == "json":
        click.echo(json.dumps(_as_json(name, found, missing)))
        return status
    click.echo(f"{name}: {found}")
    click.echo("  rank  score  decoded        profile       doubts")
    for rank, candidate in _ranked(found):
        share = f"{candidate.decoded}/{candidate.frames}"
        doubts = "; ".join(candidate.doubts)
        click.echo(f"  {rank:<4}  {candidate.score:5.3f}  {share:<13}  {candidate.profile.name:<12}  {doubts}".rstrip())
    _advise(name, found.best, missing)
    return status


def _missing(best: Candidate, frames: Sequence[Frame]) -> list[Shortfall]:
    return shortfalls(get_codec(best.profile.name), frames, best.link) if best.decoded < best.frames else []


def _ranked(found: Guess) -> list[tuple[str, Candidate]]:
    """Return the candidates with their ranks; ``1=`` if several share the first."""
    ranks: list[int] = []
    for place, candidate in enumerate(found.candidates):
        before = found.candidates[place - 1] if place else None
        same = before is not None and before.which == candidate.which and abs(before.score - candidate.score) < 1e-9
        ranks.append(ranks[-1] if same else place + 1)
    return [
        (f"{rank}=" if ranks.count(rank) > 1 else str(rank), candidate)
        for rank, candidate in zip(ranks, found.candidates, strict=True)
    ]


def _advise(name: str, best: Candidate, missing: Sequence[Shortfall]) -> None:
    if not missing:
        return
    click.echo(f"\n  Not explained by {best.profile.name}:")
    for each in missing:
        click.echo(f"    {each.text} (first in frame {each.frame})")
    advised = [each for each in missing if each.advice]
    if advised:
        click.echo("\n  Write these lines into a profile of your own:")
        lines = [
            f'extends = "{best.profile.name}"',
            'name = "mine"',
            *(line for each in advised for line in each.advice),
        ]
        for line in lines:
            click.echo(f"    {line}")
    click.echo(f"\n  dcp-codec profiles new mine --from {shlex.quote(name)} writes a draft and checks it.")


def _as_json(name: str, found: Guess, missing: Sequence[Shortfall]) -> dict[str, object]:
    rows = [
        {
            "rank": rank,
            "profile": candidate.profile.name,
            "score": round(candidate.score, 6),
            "decoded": candidate.decoded,
            "frames": candidate.frames,
            "doubts": list(candidate.doubts),
        }
        for rank, candidate in _ranked(found)
    ]
    best = found.best
    tied = [best.profile.name, *(other.profile.name for other in found.tied)]
    unexplained = [msgspec.to_builtins(each) for each in missing]
    return {"file": name, **found.as_json(), "tied": tied, "ranking": rows, "unexplained": unexplained}
