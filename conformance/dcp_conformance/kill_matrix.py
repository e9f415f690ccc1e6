"""The kill matrix as Markdown: which mutants the suite notices, by which cases, and what else fails then."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby

from dcp_spec.requirements import requirements

from .selftest import Finding, SelftestResult, Trial

_SHOWN = 4
#: Groups of requirements with their headings.
_PROTOCOLS = {"DATA": "Data types", "UWB": "Bearer", "BP": "BP", "SRP": "SRP", "VD": "VarDis"}


def markdown(result: SelftestResult) -> str:
    """The section ``mutants`` of the document; the same for the same suite and mutants, whenever it is made."""
    killed = sum(trial.killed for trial in result.mutants)
    lines = [
        "## Mutants",
        "",
        "Made by `dcp-conformance selftest --document docs/selftest.md`.",
        "",
        "The suite runs against our node as it is, which must pass, and against *mutants*: the same node with one",
        "small fault each (`conformance/dcp_conformance/mutants/`). A mutant is killed by a case that fails with a",
        "check that names the requirement which the mutant violates: of so many cases that name it, so many do.",
        "Cases that fail with checks that name only other requirements are counted as *also*; they follow from the",
        "fault, too, but do not point at it.",
        "",
        f"{killed} of {len(result.mutants)} mutants are killed by a case that names the violated requirement.",
        "",
        "### The node as it is",
        "",
        "| profile | cases | neither pass, info nor not applicable |",
        "|---|---:|---|",
        *(f"| {each.profile} | {each.cases} | {_names(each.findings) or '-'} |" for each in result.baselines),
    ]
    for heading, trials in _grouped(result.mutants):
        lines += ["", f"### {heading}", "", *_table(trials, result)]
    return "\n".join(lines) + "\n"


def _grouped(trials: Sequence[Trial]) -> Iterator[tuple[str, list[Trial]]]:
    order = {each: number for number, each in enumerate(requirements())}
    listed = sorted(trials, key=lambda each: (order[each.requirements[0]], each.mutant, each.profile))
    for protocol, group in groupby(listed, key=lambda each: each.requirements[0].partition("-")[0]):
        yield _PROTOCOLS[protocol], list(group)


def _table(trials: Sequence[Trial], result: SelftestResult) -> Iterator[str]:
    yield "| mutant | the node ... | violates | on | killed by | also |"
    yield "|---|---|---|---|---|---:|"
    for each in trials:
        violates = ", ".join(each.requirements)
        cells = [f"`{each.mutant}`", each.what, violates, each.profile, _killers(each, counted=result.every)]
        cells.append(str(len(each.also)) if each.also else "-")
        yield f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"


def _killers(trial: Trial, *, counted: bool) -> str:
    if not trial.killers:
        return "**nobody**"
    number = f"{len(trial.killers)} of {trial.candidates}: " if counted else ""
    return number + _names(trial.killers)


def _names(findings: Sequence[Finding]) -> str:
    named = ", ".join(f"`{each.case}`" for each in findings[:_SHOWN])
    return f"{named}, ..." if len(findings) > _SHOWN else named


__all__ = ["markdown"]
