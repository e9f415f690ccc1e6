"""The table of the described faults and their counterexamples, as Markdown."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from statistics import median

from dcp_spec.markdown import table

from dcp_selftest.mutants import all_mutants

from .campaign import Searched
from .faults import DESCRIBED, LONG

_HEADINGS = ("mutant", "the node ...", "violates", "found by", "named", "steps", "seconds")


def section(results: Sequence[Searched], sequences: int, seed: int) -> str:
    """Return the section ``model`` of the document. ``sequences``: most drawn ones; ``seed``: of the search."""
    found = [each for each in results if each.by]
    named = sum(_is_named(each) for each in found)
    by_run = sum(each.by == "run" for each in found)
    lines = [
        "## The model",
        "",
        f"Made by `dcp-selftest model --described --shrink --sequences {sequences} --seed {seed} --document "
        "docs/selftest.md`.",
        "",
        "An adversary's trial of the suite described these faults; no case noticed most of them at that time. Here no",
        "case is executed, but only the sequences of a run (`run`), and, if these show nothing, newly drawn ones",
        f"(`search`, up to {sequences:,} about the protocol of the fault). *Steps* is the length of the shortened",
        "counterexample, *seconds* the processor time with that of shortening it.",
        "",
        f"{len(found)} of {len(results)} are found, {by_run} by the sequences of a run. The counterexample names a",
        f"violated requirement in {named}. Median length: {median(each.steps for each in found):g} steps."
        if found
        else "None is found.",
        "",
        table(_HEADINGS, _rows(results), "lllllrr"),
    ]
    return "\n".join(lines) + "\n"


def _rows(results: Sequence[Searched]) -> Iterator[tuple[object, ...]]:
    order = {name: number for number, name in enumerate(DESCRIBED)}
    for each in sorted(results, key=lambda each: order[each.fault.id]):
        mutant = all_mutants()[each.fault.id]
        by = each.by or ("`run --plan long`" if mutant.id in LONG else "-")
        named = (", ".join(each.requirements) or "-") + ("" if not each.by or _is_named(each) else " (another)")
        row = f"`{mutant.id}`", mutant.what, ", ".join(mutant.requirements), by, named
        yield *row, each.steps or "-", f"{each.seconds:.1f}"


def _is_named(each: Searched) -> bool:
    return not set(each.requirements).isdisjoint(all_mutants()[each.fault.id].requirements)
