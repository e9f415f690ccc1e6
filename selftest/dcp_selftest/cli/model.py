"""``dcp-selftest model``."""

from __future__ import annotations

from pathlib import Path

import click
import msgspec
from dcp_conformance.errors import UsageError

from dcp_codec.common.commandline import path_option, say

from .common import (
    document_option,
    jobs_option,
    quiet_option,
    report_option,
    seed_option,
    verbose_option,
    write_file,
    write_json,
    write_section,
)  # fmt: skip


@click.command(
    "model",
    epilog="Exit status: 0 the model finds every faulty node, or sequences are drawn; 1 not, or "
    "--ledger refutes a change; 2 wrong usage.",
)
@click.argument("mutants", nargs=-1)
@click.option("--described", is_flag=True, help="Try the faults that a trial by an adversary described.")
@click.option("--ledger", is_flag=True, help="Try the changes of the ledger, which no case can notice.")
@click.option("--sample", type=click.IntRange(1), metavar="N", help="Of the ledger, try N changes drawn by the seed.")
@click.option("--cells", is_flag=True, help="Try the state table with each cell changed, instead of the mutants.")
@click.option("--profile", "-p", default="dcp-2.0", show_default=True, help="Profile of the state table.")
@click.option(
    "--sequences",
    type=click.IntRange(0),
    default=400,
    show_default=True,
    metavar="N",
    help="Draw so many sequences after those of a run.",
)
@click.option("--shrink", is_flag=True, help="Make counterexamples as short as possible.")
@path_option(
    "--draw",
    metavar="FILE",
    help="Draw sequences with the reference node, and write those of a run and the best new ones to FILE.",
    dir_okay=False,
)
@click.option("--most", type=click.IntRange(1), default=40, show_default=True, metavar="N", help="Add up to N to FILE.")
@seed_option
@jobs_option
@report_option
@document_option
@verbose_option
@quiet_option
def command(
    mutants: tuple[str, ...],
    profile: str,
    sequences: int,
    sample: int | None,
    draw: Path | None,
    most: int,
    seed: int,
    jobs: int | None,
    report_dir: Path | None,
    document: Path | None,
    *,
    described: bool,
    ledger: bool,
    cells: bool,
    shrink: bool,
    verbose: bool,
    quiet: bool,
) -> int:
    """Search faulty nodes with the model alone, without the cases of the suite.

    MUTANTS are the beginnings of identifiers of mutants or requirements: only these mutants are tried.
    """
    from dcp_conformance.cli.display import progress_bar

    from dcp_selftest.modelled import faults
    from dcp_selftest.modelled.campaign import Searched, run

    if draw is not None:
        return _draw(draw, profile, sequences=sequences, seed=seed, most=most)
    if ledger:
        return _ledger(sample, sequences=sequences, seed=seed, jobs=jobs, report_dir=report_dir, quiet=quiet)
    chosen = list(faults.cells(profile) if cells else faults.described() if described else faults.mutants(mutants))
    if not chosen:
        raise UsageError(f"no mutant is called {' or '.join(mutants)} or violates it: dcp-selftest mutants --list")
    if document is not None and not described:
        raise UsageError("--document has the table of --described only")
    results: list[Searched] = []
    with progress_bar(quiet=quiet) as progress:
        task = progress.add_task("faulty nodes", total=len(chosen))
        for each in run(chosen, sequences=sequences, seed=seed, shrink=shrink, jobs=jobs):
            progress.update(task, advance=1, description=each.fault.id)
            results.append(each)
            if verbose or not each.by:
                what = ", ".join(each.requirements) or "not found"
                say(f"{each.fault.id} ({each.fault.profile}): {what} [{each.by or 'search'}, {each.seconds:.1f} s]")
    write_json(Report(tuple(results)), report_dir, "model.json")
    if document is not None:
        from dcp_selftest.modelled.table import section

        write_section(document, "model", section(results, sequences, seed))
    by_run, by_search = (sum(each.by == by for each in results) for by in ("run", "search"))
    say(
        f"{len(results)} faulty nodes: {by_run} found by the sequences of a run, {by_search} by up to {sequences} "
        f"drawn ones, {len(results) - by_run - by_search} not"
    )
    return 0 if by_run + by_search == len(results) else 1


def _ledger(
    sample: int | None, *, sequences: int, seed: int, jobs: int | None, report_dir: Path | None, quiet: bool
) -> int:
    from dcp_conformance.cli.display import progress_bar

    from dcp_selftest.modelled.campaign import Searched
    from dcp_selftest.modelled.excused import excused, run

    changes = excused(sample, seed)
    results: list[Searched] = []
    with progress_bar(quiet=quiet) as progress:
        task = progress.add_task("changes of the ledger", total=len(changes))
        for site, each in run(changes, sequences=sequences, seed=seed, jobs=jobs):
            progress.update(task, advance=1, description=site.key)
            results.append(each)
            if each.by:
                say(f"refuted: {site.key}  {site}")
                for line in each.text.splitlines() or (each.by,):
                    say(f"  {line}")
    write_json(Report(tuple(results)), report_dir, "ledger.json")
    refuted = sum(bool(each.by) for each in results)
    say(f"{len(results)} changes of the ledger: {refuted} refuted")
    return 1 if refuted else 0


class Report(msgspec.Struct, frozen=True):
    """The results of a campaign."""

    results: tuple[msgspec.Struct, ...]


def _draw(file: Path, profile: str, *, sequences: int, seed: int, most: int) -> int:
    from dcp_conformance.reference.inprocess import reference_config
    from dcp_conformance.stateful.corpus import corpus
    from dcp_conformance.stateful.virtual import VirtualExecutor

    from dcp_codec.codec import get_codec
    from dcp_selftest.modelled.drawing import drawn

    config, before = reference_config(get_codec(profile)), corpus()
    found = drawn(lambda: VirtualExecutor(config), before, seed=seed, sequences=sequences, most=most)
    # A line for each sequence, so that a change of the file can be read.
    lines = b",\n".join(msgspec.json.encode(each) for each in found.sequences)
    write_file(file, b'{"seeds": %b, "sequences": [\n%b\n]}\n' % (msgspec.json.encode(found.seeds), lines))
    say(f"{len(before.sequences)} sequences before, {len(found.sequences)} now: {file}")
    return 0
