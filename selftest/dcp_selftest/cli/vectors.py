"""``dcp-selftest vectors``."""

from __future__ import annotations

from pathlib import Path

import click
from dcp_conformance.errors import UsageError

from dcp_codec.common.commandline import say

from .common import jobs_option, quiet_option, report_option, verbose_option, write_file, write_json


@click.command(
    "vectors",
    epilog="Exit status: 0 all permitted nodes pass, and the vectors detect enough; 1 not; 2 wrong usage.",
)
@click.option("--profile", default="dcp-2.0", show_default=True, metavar="NAME", help="Profile of the vectors.")
@click.option("--make", "making", is_flag=True, help="Make the behaviour vectors again first, and keep those in use.")
@jobs_option
@report_option
@verbose_option
@quiet_option
def command(
    profile: str, *, making: bool, jobs: int | None, report_dir: Path | None, verbose: bool, quiet: bool
) -> int:
    """Test the vectors: all permitted variants pass them, and they alone detect mutants.

    Wire mutants are all single changes of the generated decoder and encoder, behaviour mutants those of the node.
    """
    import gzip

    import msgspec
    from dcp_conformance.vectors.behaviour import load

    from dcp_selftest.vectors.kills import campaign
    from dcp_selftest.vectors.making import collection
    from dcp_selftest.vectors.selection import selected

    kept = load(profile)
    if making:
        kept = selected(collection(profile, jobs), kept)
        path = Path(__file__).parents[3] / "conformance" / "dcp_conformance" / "data" / f"behaviour-{profile}.json.gz"
        write_file(path, gzip.compress(msgspec.json.encode(kept), mtime=0))
    if kept is None:
        raise UsageError(f"{profile} has no behaviour vectors")
    result = campaign(profile, kept, jobs)
    write_json(result, report_dir, "vectors.json")
    if not quiet:
        for each in result.refused:
            say(f"permitted, but refused: {each.node} {each.vector}: {each.why}")
        for one in (*result.wire, *result.behaviour) if verbose else ():
            say(f"{one.vector or 'survives':40}  {one.mutant}")
    for line in result.summary():
        say(line)
    return result.exit_status()
