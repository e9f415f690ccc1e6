"""Options and output files that several subcommands of ``dcp-selftest`` have."""

from __future__ import annotations

from pathlib import Path

import click
import msgspec
from dcp_conformance.errors import UsageError

#: Maximum number of selected mutants that are shown in separate rows without --verbose.
FEW = 40

profile_option = click.option(
    "-p", "--profile", multiple=True, metavar="NAME", help="Use only this wire profile.  [default: all versions]"
)
jobs_option = click.option(
    "-j",
    "--jobs",
    type=click.IntRange(1),
    metavar="N",
    help="Number of concurrent processes.  [default: one for each processor]",
)


def _folder(_context: click.Context, _option: click.Parameter, folder: Path | None) -> Path | None:
    """Refuse a folder that cannot be made, before anything is computed."""
    for each in () if folder is None else (folder, *folder.parents):
        if each.exists():
            if not each.is_dir():
                raise UsageError(f"{each}: cannot be written: it is not a folder")
            break
    return folder


def _document(_context: click.Context, _option: click.Parameter, document: Path | None) -> Path | None:
    """Refuse a document in which no section can be replaced, before anything is computed."""
    if document is not None and document.exists():
        from dcp_selftest.document import SECTIONS, DocumentError, section_of

        try:
            text = document.read_text(encoding="utf-8")
            for name in SECTIONS:
                section_of(text, name)
        except (DocumentError, UnicodeDecodeError) as error:
            raise UsageError(f"{document}: {error}") from None
        except OSError as error:
            raise UsageError(f"{document}: cannot be read: {error.strerror or error}") from None
    return document


report_option = click.option(
    "--report-dir",
    type=click.Path(path_type=Path),
    callback=_folder,
    metavar="DIR",
    help="Write the result there (JSON).",
)
document_option = click.option(
    "--document",
    type=click.Path(dir_okay=False, path_type=Path),
    callback=_document,
    metavar="FILE",
    help="Write the table of this command into its section of FILE (Markdown).",
)
seeds_option = click.option(
    "--seed",
    "seeds",
    type=int,
    multiple=True,
    default=(1,),
    show_default=True,
    metavar="N",
    help="Random seed; may be given several times.",
)
seed_option = click.option("--seed", type=int, default=1, show_default=True, metavar="N", help="Random seed.")
list_option = click.option("--list", "listing", is_flag=True, help="Only show what would be tried.")
verbose_option = click.option("--verbose", "-v", is_flag=True, help="Show a line for everything that is tried.")
quiet_option = click.option("--quiet", "-q", is_flag=True, help="Show only problems, and the numbers.")


def write_file(path: Path, data: bytes) -> None:
    """Write a file. Raise ``UsageError`` if it cannot be written."""
    try:
        path.write_bytes(data)
    except OSError as error:
        raise UsageError(f"{path}: cannot be written: {error.strerror or error}") from None


def write_json(result: msgspec.Struct, directory: Path | None, name: str) -> None:
    """Write a result into a folder, which is made; do nothing without one. Raise ``UsageError`` if that fails."""
    if directory is None:
        return
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{error.filename}: cannot be written: {error.strerror or error}") from None
    write_file(directory / name, msgspec.json.format(msgspec.json.encode(result), indent=2) + b"\n")


def write_section(document: Path, name: str, text: str) -> None:
    """Replace one section of the document; the sections of other commands are unchanged."""
    from dcp_selftest.document import DocumentError
    from dcp_selftest.document import write_section as write

    try:
        write(document, name, text)
    except DocumentError as error:
        raise UsageError(f"{document}: {error}") from None
    except OSError as error:
        raise UsageError(f"{error.filename}: cannot be written: {error.strerror or error}") from None
