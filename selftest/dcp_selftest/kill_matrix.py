"""The kill matrix as Markdown: the mutants, the cases that detect each of them, and the other cases that fail."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby

from dcp_spec.catalogue.requirements import requirements
from dcp_spec.markdown import table

from .mutants import all_mutants
from .runner import Finding, SelftestResult, Trial

_COLUMNS = ("mutant", "the node ...", "violates", "on", "killed by", "also")
_SHOWN = 4
#: Groups of requirements with their headings.
_PROTOCOLS = {"DATA": "Data types", "UWB": "Bearer", "BP": "BP", "SRP": "SRP", "VD": "VarDis"}


def markdown(result: SelftestResult) -> str:
    """Return the section ``mutants`` of the document; it depends on the suite and the mutants only."""
    there = {trial.mutant for trial in result.mutants}
    killed = len(there) - len({trial.mutant for trial in result.survivors})
    lines = [
        "## Mutants",
        "",
        "Made by `dcp-selftest mutants --document docs/selftest.md`.",
        "",
        "The suite runs against the reference node, which must pass, and against *mutants*: the same node with one",
        "small fault each (`selftest/dcp_selftest/mutants/`). A case kills a mutant if one of its",
        "failed checks names a requirement that the mutant violates. `4 of 7` means that 7 cases name such a",
        "requirement and that 4 cases and passive rules kill the mutant. The column *also* counts the cases whose",
        "failed checks name other requirements only: these are consequences of the fault, but do not identify it.",
        "",
        f"{killed} of {len(there)} mutants are killed by a case that names the violated requirement, on each version",
        "that has it. Cases are counted on the newest of them. A mutant is not tried on the versions in brackets,",
        "because it is permitted or cannot be observed there; its source states the reason.",
        "",
        "### The reference node",
        "",
        table(
            ("profile", "cases", "neither pass, info nor not applicable"),
            ((each.profile, each.cases, _names(each.findings) or "-") for each in result.baselines),
            "lrl",
        ),
    ]
    for heading, trials in _grouped(result.mutants):
        lines += ["", f"### {heading}", "", table(_COLUMNS, _rows(trials, result), "lllllr")]
    return "\n".join(lines) + "\n"


def _grouped(trials: Sequence[Trial]) -> Iterator[tuple[str, list[Trial]]]:
    order = {each: number for number, each in enumerate(requirements())}
    # The trials of a mutant stay in their order, newest version first.
    listed = sorted(trials, key=lambda each: (order[each.requirements[0]], each.mutant))
    for protocol, group in groupby(listed, key=lambda each: each.requirements[0].partition("-")[0]):
        yield _PROTOCOLS[protocol], list(group)


def _rows(trials: Sequence[Trial], result: SelftestResult) -> Iterator[tuple[object, ...]]:
    known = all_mutants()
    for name, group in groupby(trials, key=lambda each: each.mutant):
        tried = list(group)
        each = tried[0]
        on = [one.profile.removeprefix("dcp-") for one in reversed(tried)]
        unseen = known[name].unseen if name in known else {}
        where = ", ".join([*on, *(f"({version})" for version in sorted(unseen))])
        killers = _killers(tried, counted=result.every)
        yield f"`{name}`", each.what, ", ".join(each.requirements), where, killers, len(each.also) or "-"


def _killers(tried: Sequence[Trial], *, counted: bool) -> str:
    if alive := [each.profile for each in tried if not each.killed]:
        return f"**no case** on {', '.join(alive)}"
    trial = tried[0]
    number = f"{len(trial.killers)} of {trial.candidates}: " if counted else ""
    return number + _names(trial.killers)


def _names(findings: Sequence[Finding]) -> str:
    named = ", ".join(f"`{each.case}`" for each in findings[:_SHOWN])
    return f"{named}, ..." if len(findings) > _SHOWN else named


__all__ = ["markdown"]
