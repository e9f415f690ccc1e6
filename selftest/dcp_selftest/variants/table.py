"""Permitted variants as Markdown: their difference, the text that permits it, and the verdicts of the suite."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby

from dcp_spec.markdown import table

from .campaign import Judged, VariantsResult

_COLUMNS = (
    "variant", "the node ...", "permitted by", "profiles", "cases", "fails", "unexplained", "explained", "errors",
)  # fmt: skip


def section(result: VariantsResult) -> str:
    """Return the section ``variants`` of the document; it depends on the suite and the variants only."""
    fair = sum(all(each.good for each in trials) for _, trials in _grouped(result))
    total = sum(1 for _ in _grouped(result))
    profiles = list(dict.fromkeys(each.profile for each in result.trials))
    lines = [
        "## Permitted variants",
        "",
        "Made by `dcp-selftest variants --document docs/selftest.md`.",
        "",
        "Each variant is a node that follows the specification and uses one of its freedoms",
        "(`selftest/dcp_selftest/variants/`). The whole suite runs against it on every version that has",
        "the freedom. No case may fail, and only verdicts that the variant makes unavoidable may be inconclusive.",
        "",
        f"{fair} of {total} variants, on {len(result.trials)} pairs of variant and profile, have no fail, error or",
        f"unexplained inconclusive verdict. Profiles: {', '.join(profiles)}.",
        "",
        table(_COLUMNS, (_row(name, trials) for name, trials in _grouped(result)), "lllrrrrrr"),
    ]
    return "\n".join(lines) + "\n"


def _grouped(result: VariantsResult) -> Iterator[tuple[str, list[Judged]]]:
    for name, trials in groupby(result.trials, key=lambda each: each.variant):
        yield name, list(trials)


def _row(name: str, trials: list[Judged]) -> tuple[object, ...]:
    return (
        f"`{name}`",
        trials[0].what,
        trials[0].why,
        len(trials),
        sum(each.cases for each in trials),
        sum(len(each.fails) for each in trials),
        sum(len(each.inconclusive) for each in trials),
        sum(each.explained for each in trials),
        sum(len(each.errors) for each in trials),
    )
