"""``dcp-selftest origins``."""

from __future__ import annotations

from pathlib import Path

import click

from dcp_codec.common.commandline import say


@click.command(
    "origins",
    epilog="Exit status: 0 every requirement has its statements (--check: and the files are up to date), 1 if not, "
    "2 wrong usage.",
)
@click.argument("repository", type=click.Path(path_type=Path))
@click.option(
    "--root",
    type=click.Path(path_type=Path),
    default=Path(),
    metavar="FOLDER",
    help="Checkout of this project.  [default: the current folder]",
)
@click.option("--check", is_flag=True, help="Write nothing, only compare.")
def command(repository: Path, root: Path, *, check: bool) -> int:
    """Write the origins of the requirements from the anchors.

    REPOSITORY is a git repository of the specification, with its tags.
    """
    from dcp_selftest.provenance.anchors import PATH, read_anchors
    from dcp_selftest.provenance.recording import DATA, record

    recording = record(repository, read_anchors(root / PATH))
    problems = list(recording.remarks)
    for name, text in recording.files.items():
        path = root / DATA / name
        if not check:
            path.write_text(text, encoding="utf-8")
        elif not path.exists() or path.read_text(encoding="utf-8") != text:
            problems.append(f"{path} is outdated; run dcp-selftest origins {repository}")
    for each in problems:
        say(each, err=True)
    return 1 if problems else 0
