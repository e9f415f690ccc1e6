"""``python -m dcp_conformance.provenance REPOSITORY``: write the origins of the requirements from the anchors."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from dcp_conformance.errors import UsageError

from .anchors import PATH, read_anchors
from .recording import DATA, record


def main(arguments: Sequence[str] | None = None) -> int:
    """0 if every requirement has its statements (``--check``: and the files are up to date), 1 if not, 2 misuse."""
    parser = argparse.ArgumentParser(
        prog="dcp_conformance.provenance", description=(__doc__ or "").partition(": ")[2].capitalize()
    )
    parser.add_argument("repository", type=Path, help="a git repository of the specification, with its tags")
    parser.add_argument("--root", type=Path, default=Path(), help="the checkout of this project (default: here)")
    parser.add_argument("--check", action="store_true", help="write nothing, only compare")
    options = parser.parse_args(arguments)
    try:
        recording = record(options.repository, read_anchors(options.root / PATH))
    except UsageError as error:
        print(error, file=sys.stderr)
        return 2
    problems = list(recording.remarks)
    for name, text in recording.files.items():
        path = options.root / DATA / name
        if not options.check:
            path.write_text(text, encoding="utf-8")
        elif not path.exists() or path.read_text(encoding="utf-8") != text:
            problems.append(f"{path} is outdated; run python -m dcp_conformance.provenance {options.repository}")
    for each in problems:
        print(each, file=sys.stderr)
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
