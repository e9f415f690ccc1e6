"""``dcp-selftest vectors``."""

from __future__ import annotations

from pathlib import Path

import click
from dcp_conformance.errors import UsageError

from dcp_codec.common.commandline import say

from .common import (
    document_option,
    jobs_option,
    quiet_option,
    report_option,
    verbose_option,
    write_file,
    write_json,
    write_section,
)  # fmt: skip


@click.command(
    "vectors",
    epilog="Exit status: 0 all permitted nodes pass, and the vectors detect enough; 1 not; 2 wrong usage.",
)
@click.option(
    "-p",
    "--profile",
    "names",
    multiple=True,
    metavar="NAME",
    help="Use only the vectors of this profile.  [default: all]",
)
@click.option("--make", "making", is_flag=True, help="Make the behaviour vectors again first, and keep those in use.")
@jobs_option
@report_option
@document_option
@verbose_option
@quiet_option
def command(
    names: tuple[str, ...],
    *,
    making: bool,
    jobs: int | None,
    report_dir: Path | None,
    document: Path | None,
    verbose: bool,
    quiet: bool,
) -> int:
    """Test the vectors: all permitted variants pass them, and they alone detect mutants.

    Wire mutants are all single changes of the generated decoder and encoder, behaviour mutants those of the node.
    """
    import gzip

    import msgspec
    from dcp_conformance.vectors.behaviour import load, profiles

    from dcp_selftest.vectors.kills import Results, campaign
    from dcp_selftest.vectors.making import collection
    from dcp_selftest.vectors.selection import selected

    found = []
    for name in names or profiles():
        kept = load(name)
        if making:
            kept = selected(collection(name, jobs), kept)
            path = Path(__file__).parents[3] / "conformance" / "dcp_conformance" / "data" / f"behaviour-{name}.json.gz"
            write_file(path, gzip.compress(msgspec.json.encode(kept), mtime=0))
        if kept is None:
            raise UsageError(f"{name} has no behaviour vectors: --make makes them")
        result = campaign(name, kept, jobs)
        found.append(result)
        if not quiet:
            for each in result.refused:
                say(f"permitted, but refused: {each.node} {each.vector}: {each.why}")
            for one in (*result.wire, *result.behaviour) if verbose else ():
                say(f"{one.vector or 'survives':40}  {one.mutant}")
        for line in result.summary():
            say(line)
    results = Results(tuple(found))
    write_json(results, report_dir, "vectors.json")
    if document is not None:
        write_section(document, "vectors", results.section())
    return max(each.exit_status() for each in found)
