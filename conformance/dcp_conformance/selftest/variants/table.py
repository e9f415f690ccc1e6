"""Permitted variants as Markdown: what differs, what permits it, and what the suite said."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby

from .campaign import Judged, VariantsResult


def section(result: VariantsResult) -> str:
    """The section ``variants`` of the document; the same whenever and wherever it is made."""
    fair = sum(all(each.good for each in trials) for _, trials in _grouped(result))
    total = sum(1 for _ in _grouped(result))
    profiles = list(dict.fromkeys(each.profile for each in result.trials))
    lines = [
        "## Permitted variants",
        "",
        "Made by `dcp-conformance selftest --variants --document docs/selftest.md`.",
        "",
        "Each variant is a node that follows the specification and uses one of its freedoms",
        "(`dcp_conformance.selftest.variants`). The whole suite runs against it on every version that has the",
        "freedom. No case may fail. An inconclusive verdict must be one that the variant makes unavoidable.",
        "",
        f"{fair} of {total} variants, on {len(result.trials)} pairs of variant and profile, have no fail, error or",
        f"unexplained inconclusive verdict. Profiles: {', '.join(profiles)}.",
        "",
        "| variant | the node ... | permitted by | profiles | cases | fails | unexplained | explained | errors |",
        "|---|---|---|---:|---:|---:|---:|---:|---:|",
        *(_row(name, trials) for name, trials in _grouped(result)),
    ]
    return "\n".join(lines) + "\n"


def _grouped(result: VariantsResult) -> Iterator[tuple[str, list[Judged]]]:
    for name, trials in groupby(result.trials, key=lambda each: each.variant):
        yield name, list(trials)


def _row(name: str, trials: list[Judged]) -> str:
    numbers = (
        len(trials),
        sum(each.cases for each in trials),
        sum(len(each.fails) for each in trials),
        sum(len(each.inconclusive) for each in trials),
        sum(each.explained for each in trials),
        sum(len(each.errors) for each in trials),
    )
    cells = [f"`{name}`", trials[0].what, trials[0].why, *(str(each) for each in numbers)]
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"
