"""``dcp-conformance compare``."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dcp_codec.common.commandline import say
from dcp_conformance.errors import UsageError

if TYPE_CHECKING:
    from dcp_conformance.definitions.verdict import Verdict


@click.command(
    "compare",
    epilog="Exit status: 0 nothing became worse; 1 a case fails that did not fail before, or has no result any more, "
    "or run and check contradict each other; 2 results cannot be read.",
)
@click.argument("old", type=click.Path(path_type=Path))
@click.argument("new", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print the differences as JSON.")
def command(old: Path, new: Path, *, as_json: bool) -> int:
    """Show which verdicts differ between two runs.

    OLD and NEW are results.json files, or the folders they are in. Results of different commands, such as run and
    check, are compared by requirement.
    """
    from dcp_conformance.reporting import load_results
    from dcp_conformance.reporting.merge import WORSE, compare, contradict, side_by_side

    before, after = load_results(old), load_results(new)
    if before.profile != after.profile:
        raise UsageError(
            f"{old} was made with the profile {before.profile}, {new} with {after.profile}; "
            "'dcp-conformance report' shows runs with different profiles in one table"
        )
    if before.kind != after.kind:
        _print_requirements(side_by_side(before, after), (before.kind, after.kind), as_json=as_json)
        return int(contradict(before, after))
    changes = compare(before, after)
    if as_json:
        _print_json(
            {"id": each.id, "kind": each.kind, "old": each.old, "new": each.new, "reason": each.reason}
            for each in changes
        )
    else:
        for each in changes:
            was, is_now = each.old or "not run", each.new or "not run"
            say(f"{each.kind:<10}  {each.id}  {was} -> {is_now}" + (f"  {each.reason}" if each.reason else ""))
        counts = {kind: sum(each.kind == kind for each in changes) for kind in dict.fromkeys(c.kind for c in changes)}
        shown = ", ".join(f"{count} {kind}" for kind, count in counts.items())
        say(f"{sum(case.counted for case in after.cases)} cases: {shown or 'no verdict differs'}")
    return int(any(each.kind in WORSE for each in changes))


def _print_json(rows: Iterable[dict[str, Any]]) -> None:
    import json

    click.echo(json.dumps(list(rows), indent=2))


def _print_requirements(
    rows: list[tuple[str, Verdict | None, Verdict | None]], kinds: tuple[str, str], *, as_json: bool
) -> None:
    """Print the requirements with the verdicts of two commands in adjacent columns."""
    first, second = kinds
    if as_json:
        _print_json({"id": name, first: one, second: two} for name, one, two in rows)
        return
    say(f"{'requirement':<12}  {first:<13}  {second}")
    for name, one, two in rows:
        say(f"{name:<12}  {one or '-':<13}  {two or '-'}")
    say(f"{len(rows)} requirements differ between {first} and {second}" if rows else "no verdict differs")
