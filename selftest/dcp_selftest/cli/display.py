"""Summaries printed by ``dcp-selftest``."""

from __future__ import annotations

from collections.abc import Sequence

from dcp_conformance.cli.display import console, data
from rich.table import Table

from dcp_selftest.citations.campaign import CitationsResult
from dcp_selftest.generated.campaign import GeneratedResult
from dcp_selftest.mutants import Mutant
from dcp_selftest.recordings import CleanResult, FaultyResult
from dcp_selftest.recordings.faulty import SHAPES
from dcp_selftest.recordings.table import REASONS, TITLES
from dcp_selftest.runner import Baseline, Finding, SelftestResult, Trial
from dcp_selftest.variants import Variant, all_variants
from dcp_selftest.variants.campaign import Judged, VariantsResult

#: Minimum width of the terminal, in characters, for all columns of the table of mutants.
_WIDE = 110


def versions(each: Mutant | Variant) -> str:
    """Return a text with the versions of the specification that a mutant or variant concerns."""
    return f"since {each.since}" if each.until is None else f"{each.since} to {each.until}"


def print_selftest(result: SelftestResult, *, verbose: bool, quiet: bool) -> None:
    """Print passed nodes and killed mutants by group, or each with ``verbose``; with ``quiet`` only faults."""
    out = console()
    if not quiet:
        out.print(_baselines(result.baselines))
        out.print()
        out.print(_mutants(result, out.width) if verbose else _sections(result.mutants))
    for each in result.baselines:
        for finding in each.findings:
            out.print(
                f"[bold red]{finding.verdict}[/] {finding.case} on {each.profile}: {data(finding.reason)}",
                soft_wrap=True,
            )
    for trial in result.survivors:
        out.print(f"[bold red]survives[/] {trial.mutant} ({trial.profile}): {data(trial.what)}", soft_wrap=True)
        also = f"; detected by {', '.join(each.case for each in trial.also[:3])}" if trial.also else ""
        names = " ".join(trial.requirements)
        out.print(f"         {trial.candidates} cases name {names}{also}", soft_wrap=True)
    for trial in result.mutants:
        for finding in trial.errors:
            reason = data(finding.reason)
            out.print(f"[bold magenta]error[/] {finding.case} with {trial.mutant}: {reason}", soft_wrap=True)
    there = {each.mutant for each in result.mutants}
    killed = len(there) - len({each.mutant for each in result.survivors})
    how = "every case" if result.full else "the cases that name the requirement"
    tried = f"in {len(result.mutants)} trials"
    out.print(f"\n{killed} of {len(there)} mutants killed {tried}, by {how}, in {result.duration:.1f} s")


def _baselines(baselines: Sequence[Baseline]) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("reference node", no_wrap=True)
    table.add_column("cases", justify="right")
    table.add_column("")
    for each in baselines:
        outcome = "[green]passes[/]" if each.good else f"[bold red]{len(each.findings)} do not pass[/]"
        table.add_row(each.profile, str(each.cases), outcome)
    return table


def _sections(trials: Sequence[Trial]) -> Table:
    """Return a table of the mutants by group of requirements."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("requirements", no_wrap=True)
    for heading in ("mutants", "trials", "killed", "survive"):
        table.add_column(heading, justify="right", no_wrap=True)
    groups: dict[str, list[Trial]] = {}
    for trial in trials:
        groups.setdefault(trial.requirements[0].rpartition("-")[0], []).append(trial)
    for name, group in sorted(groups.items()):
        killed = sum(each.killed for each in group)
        alive = len(group) - killed
        there = len({each.mutant for each in group})
        table.add_row(name, str(there), str(len(group)), str(killed), f"[bold red]{alive}[/]" if alive else "[dim].[/]")
    return table


def _mutants(result: SelftestResult, width: int) -> Table:
    """Return a table with a row for each mutant; a narrow terminal shows only the cases that killed it."""
    wide = width >= _WIDE
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("mutant", no_wrap=True, overflow="ellipsis", max_width=width // 2)
    if wide:
        table.add_column("violates", no_wrap=True)
    table.add_column("killed by", overflow="fold")
    if result.full:
        table.add_column("also", justify="right", no_wrap=True)
    several = len({each.profile for each in result.mutants}) > 1
    for trial in result.mutants:
        killers = [each.case for each in trial.killers]
        more = f" and {len(killers) - 1} more" if len(killers) > 1 else ""
        cells = [
            f"{trial.mutant} ({trial.profile})" if several else trial.mutant,
            *([trial.requirements[0]] if wide else []),
        ]
        cells.append(f"[green]{data(killers[0])}[/]{more}" if killers else "[bold red]no case[/]")
        table.add_row(*cells, *([str(len(trial.also)) if trial.also else "."] if result.full else []))
    return table


def print_generated(result: GeneratedResult, *, verbose: bool) -> None:
    """Print the surviving changes with file and line, and the share of killed ones."""
    out = console()
    for trial in result.trials:
        if verbose and trial.killed:
            by = f"  {trial.outcome.by}" if trial.outcome.by else ""
            out.print(f"[green]{trial.outcome.fate}[/] {data(str(trial.site))}{data(by)}", soft_wrap=True)
        if verbose and trial.excused:
            out.print(f"[dim]ledger[/] {data(str(trial.site))}  {data(trial.excused)}", soft_wrap=True)
    for trial in result.misplaced:
        out.print(f"[bold red]not invisible[/] {trial.site.key} {data(str(trial.site))}", soft_wrap=True)
        out.print(f"              reason in the ledger: {data(trial.excused)}", soft_wrap=True)
        out.print(f"              killed by {data(trial.outcome.by)}", soft_wrap=True)
    for trial in result.survivors:
        out.print(f"[bold red]survives[/] {trial.site.key} {data(str(trial.site))}", soft_wrap=True)
        if trial.outcome.fate == "noticed":
            out.print(f"         not failed, but affected: {data(trial.outcome.by)}", soft_wrap=True)
    judged, excused = len(result.judged), len(result.trials) - len(result.judged)
    out.print(
        f"\n{judged - len(result.survivors)} of {judged} random changes killed ({result.score:.1%}), "
        f"{len(result.by_model)} of them by the model only; {excused} more "
        f"are in the ledger; drawn from {result.sites} with seed {result.seed}, in {result.duration} s",
        soft_wrap=True,
    )
    share = result.ledger / result.sites if result.sites else 0.0
    out.print(f"the ledger holds {result.ledger} of {result.sites} changes ({share:.1%})", soft_wrap=True)


def print_variants(result: VariantsResult, *, verbose: bool, quiet: bool) -> None:
    """Print a row for each variant, and its failed cases; with ``quiet`` only the latter."""
    out = console()
    if not quiet:
        out.print(_variants(result, verbose=verbose))
        out.print()
    for each in result.trials:
        where = f"{each.variant} ({each.profile})"
        for kind, findings in (("fail", each.fails), ("inconclusive", each.inconclusive), ("error", each.errors)):
            for finding in findings:
                out.print(_finding(kind, where, finding), soft_wrap=True)
    by_name = _by_variant(result)
    for name, expressions in result.idle(all_variants()[each] for each in by_name).items():
        for expression in expressions:
            out.print(f"[yellow]explains nothing[/] {data(expression)} of {data(name)}", soft_wrap=True)
    fair = sum(all(each.good for each in trials) for trials in by_name.values())
    out.print(
        f"\n{fair} of {len(by_name)} variants without fail, error or unexplained inconclusive verdict, "
        f"{len(result.trials)} runs in {result.duration:.1f} s"
    )


def _finding(kind: str, where: str, finding: Finding) -> str:
    return f"[bold red]{kind}[/] {finding.case} with {data(where)}: {data(finding.reason)}"


def _by_variant(result: VariantsResult) -> dict[str, list[Judged]]:
    found: dict[str, list[Judged]] = {}
    for each in result.trials:
        found.setdefault(each.variant, []).append(each)
    return found


def _variants(result: VariantsResult, *, verbose: bool) -> Table:
    """Return a table with a row for each variant, or with ``verbose`` for each variant and profile."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("variant", no_wrap=True)
    if verbose:
        table.add_column("profile", no_wrap=True)
    for heading in ("profiles", "cases", "fails", "unexplained", "explained", "errors"):
        table.add_column(heading, justify="right", no_wrap=True)
    rows = [[each] for each in result.trials] if verbose else list(_by_variant(result).values())
    for trials in rows:
        wrong = (
            sum(len(each.fails) for each in trials),
            sum(len(each.inconclusive) for each in trials),
            sum(len(each.errors) for each in trials),
        )
        fails, unexplained, errors = (f"[bold red]{count}[/]" if count else "[dim].[/]" for count in wrong)
        explained = sum(each.explained for each in trials)
        table.add_row(
            data(trials[0].variant),
            *([trials[0].profile] if verbose else []),
            str(len(trials)),
            str(sum(each.cases for each in trials)),
            fails,
            unexplained,
            str(explained) if explained else "[dim].[/]",
            errors,
        )
    return table


def print_citations(result: CitationsResult, *, verbose: bool, quiet: bool) -> None:
    """Print the unproved citations; with ``verbose`` all citations, each with its proof."""
    out = console()
    if verbose:
        for each in result.verdicts:
            proof = each.by or each.reason or each.proof
            out.print(f"{each.citation.requirement:<10} {each.citation}: {data(proof)}", soft_wrap=True)
            if each.change and not quiet:
                out.print(f"           {data(each.change)}", soft_wrap=True)
    texts = {
        "none": "no change of the cited code is detected",
        "breaks": "changes of the cited code only break the node as a whole",
        "no change": "the cited code has no possible change",
    }
    for each in result.unproved:
        out.print(
            f"[bold red]unproved[/] {each.citation.requirement} {each.citation}: {texts[each.proof]}", soft_wrap=True
        )
    for each in result.outdated:
        out.print(
            f"[bold red]proved[/] {each.citation.requirement} {each.citation}, by {data(each.by)}: "
            "remove it from the ledger",
            soft_wrap=True,
        )
    counts = {proof: sum(each.proof == proof for each in result.verdicts) for proof in ("case", "test")}
    excused = sum(bool(each.reason) and not each.proved for each in result.verdicts)
    out.print(
        f"\n{len(result.verdicts)} citations: {counts['case']} proved by a case, {counts['test']} by a test, "
        f"{excused} in the ledger, {len(result.unproved)} unproved, in {result.duration:.1f} s"
    )


def print_recordings(result: FaultyResult, networks: CleanResult, *, verbose: bool) -> None:
    """Print the findings of `check` in simulated networks: counts by shape, false findings, mutants if ``verbose``."""
    out = console()
    if verbose:
        for each in result.outcomes:
            found = ", ".join(each.rules) or REASONS[each.fate]
            out.print(f"{each.mutant:<44} {each.shape:<5} {each.fate:<10} {data(found)}", soft_wrap=True)
    for shape in SHAPES:
        fates = [each.fate for each in result.outcomes if each.shape == shape]
        counts = ", ".join(f"{fates.count(fate)} {words}" for fate, words in TITLES.items() if fate in fates)
        if counts:
            out.print(f"mutants, {shape}: {counts}", soft_wrap=True)
    for false in networks.false:
        out.print(f"[bold red]false[/] {false.rule}: {data(false.text)} ({data(false.situation)})", soft_wrap=True)
    out.print(
        f"{networks.networks} networks without a fault, {networks.beacons} beacons: {len(networks.false)} findings, "
        f"inconclusive verdicts in {networks.doubts}; {result.seconds + networks.seconds:.0f} s of processor time"
    )
