"""``dcp-selftest provenance``."""

from __future__ import annotations

import textwrap
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click
from dcp_conformance.errors import UsageError

from dcp_codec.common.commandline import say

if TYPE_CHECKING:
    from dcp_selftest.provenance.report import ProvenanceResult, RequirementChange, StatementChange

_WIDTH: Final = 80
#: Time in seconds until the first note about the search, and between further notes.
_FIRST_NOTE: Final = 2.0
_NEXT_NOTE: Final = 10.0
_TITLES: Final = {
    "gone": "Gone",
    "changed": "Changed",
    "new": "New, and probably a rule",
    "moved": "Moved to another section or file",
    "renumbered": "Steps with another number",
}


@click.command(
    "provenance",
    epilog="Exit status: 0 the specification has every statement that a requirement is based on at the place in the "
    "catalogue, and no new or changed statement that is probably a rule; 1 there are differences to review; 2 wrong "
    "usage, or no specification found.",
)
@click.argument("checkout", type=click.Path(path_type=Path), metavar="[SPEC_CHECKOUT]", required=False)
@click.option("--rev", metavar="REV", help="Read this tag, branch or commit of the git repository there.")
@click.option(
    "--requirement", multiple=True, metavar="ID", help="Only show the places of this requirement in each version."
)
@click.option("--all", "everything", is_flag=True, help="Also show new and changed statements that are not rules.")
@click.option("--json", "as_json", is_flag=True, help="Print all data as JSON.")
def command(
    checkout: Path | None, *, rev: str | None, requirement: tuple[str, ...], everything: bool, as_json: bool
) -> int:
    """Compare the requirement catalogue with another version of the specification.

    SPEC_CHECKOUT is a folder with the Markdown files of the specification (at any depth), or a git repository of it,
    also a bare one. The command shows each change with the requirements that are based on the statement. For each of
    these requirements it shows the cases that decide it, and the code of the reference node that cites it.
    """
    if requirement:
        return _show(requirement)
    if checkout is None:
        raise UsageError("SPEC_CHECKOUT is missing: give a checkout of the specification, or its git repository")
    from dcp_selftest.provenance.checkout import read_checkout
    from dcp_selftest.provenance.report import compare

    result = compare(read_checkout(checkout, rev, on_folder=SearchNotes()))
    if as_json:
        import msgspec

        click.echo(msgspec.json.format(msgspec.json.encode(result), indent=2).decode())
    else:
        for line in _text(result, everything=everything):
            say(line)
    return result.exit_status()


class SearchNotes:
    """Reports on stderr which folder is being searched, after 2 s and then every 10 s."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._next = clock() + _FIRST_NOTE
        self._folders = 0

    def __call__(self, folder: Path) -> None:
        """Count ``folder``; report it if it is time to do so."""
        self._folders += 1
        if self._clock() >= self._next:
            self._next = self._clock() + _NEXT_NOTE
            say(f"searching for the specification: {self._folders} folders so far, now {folder}", err=True)


def _show(names: Iterable[str]) -> int:
    from dcp_spec.catalogue.origins import link, origins_of
    from dcp_spec.catalogue.requirements import UnknownRequirementError
    from dcp_spec.catalogue.requirements import requirement as look_up

    for name in names:
        try:
            entry, known = origins_of(name), look_up(name)
        except UnknownRequirementError as error:
            raise UsageError(str(error)) from None
        why = f"no sentence of its own: {entry.why}" if entry.why else ""
        for line in (*_wrap(f"{name}  {known.statement}", ""), *_wrap(why, "  ")):
            say(line)
        for version, places in entry.origins.items():
            for each in places:
                say(f"  {version}  {each.fingerprint}  {each}")
                say(f"       {link(each)}")
    return 0


def _text(result: ProvenanceResult, *, everything: bool) -> Iterator[str]:
    yield from _wrap(f"Catalogue of version {result.version} ({result.commit[:12]}) and {result.checkout}", "")
    for change, title in _TITLES.items():
        chosen = [each for each in result.statements if each.change == change and (everything or each.matters)]
        if chosen:
            yield ""
            yield f"{title} ({len(chosen)})"
        if change in ("moved", "renumbered"):
            yield from _sections(chosen)
            continue
        for each in chosen:
            yield from _statement(each)
    if result.touched:
        yield ""
        yield f"Requirements that are based on them ({len(result.touched)})"
    for entry in result.touched:
        yield from _requirement(entry)
    yield ""
    yield f"{'':<12}{'statements':>11}{'requirements':>14}"
    for change, count in result.counts.items():
        requirements = sum(each.change == change for each in result.requirements)
        yield f"{change:<12}{count:>11}{'' if change == 'new' else requirements:>14}"


def _statement(each: StatementChange) -> Iterator[str]:
    places = [str(place) for place in (each.before, each.now) if place is not None]
    place = each.now or each.before
    assert place is not None
    yield from _wrap(f"{' -> '.join(dict.fromkeys(places))}  {place.section}", "  ")
    if each.text:
        yield from _wrap(f"| {each.text}", "    ")
    if each.requirements:
        yield from _wrap(" ".join(each.requirements), "    ")


def _sections(changes: Iterable[StatementChange]) -> Iterator[str]:
    """Group statements that moved together into one entry, since whole sections move."""
    found: dict[str, dict[str, None]] = {}
    for each in changes:
        assert each.before is not None
        assert each.now is not None
        if each.change == "moved":
            way = f"{each.before.file}, {each.before.title} -> {each.now.file}, {each.now.title}"
        else:
            way = f"{each.before}  {each.before.section} -> {each.now.step}"
        found.setdefault(way, {}).update(dict.fromkeys(each.requirements))
    for way, names in found.items():
        yield from _wrap(way, "  ")
        yield from _wrap(" ".join(names), "    ")


def _requirement(entry: RequirementChange) -> Iterator[str]:
    yield from _wrap(f"{entry.id} ({entry.change})  {entry.statement}", "  ")
    yield from _wrap("cases: " + (" ".join(entry.cases) or "none"), "    ")
    yield from _wrap("code: " + (" ".join(entry.code) or "none"), "    ")
    if entry.readings:
        yield from _wrap("readings: " + " ".join(entry.readings), "    ")


def _wrap(text: str, indent: str) -> list[str]:
    return textwrap.wrap(
        text,
        _WIDTH,
        initial_indent=indent,
        subsequent_indent=indent + "  ",
        break_long_words=False,
        break_on_hyphens=False,
    )
