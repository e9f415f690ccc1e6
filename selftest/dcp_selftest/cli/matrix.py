"""``dcp-selftest matrix``."""

from __future__ import annotations

from pathlib import Path

import click

from dcp_codec.common.commandline import say


@click.command("matrix", epilog="Exit status: 0 the matrix is complete, 1 it has problems, 2 wrong usage.")
@click.argument("root", type=click.Path(path_type=Path), default=Path())
@click.option("--check", is_flag=True, help="Write nothing, only report missing or outdated parts.")
def command(root: Path, *, check: bool) -> int:
    """Make docs/traceability.md, and add new cases to the ledger of identifiers.

    ROOT is the checkout of this project; the current folder by default.
    """
    from dcp_selftest.traceability import DOCUMENT, matrix, outdated, write

    found = matrix(root) if check else write(root)
    problems = found.problems()
    if check and outdated(root, found):
        problems.append(f"{DOCUMENT} is outdated: run make matrix")
    for each in problems:
        say(each, err=True)
    return 1 if problems else 0
