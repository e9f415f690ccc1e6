"""``dcp-selftest diagnose``."""

from __future__ import annotations

import click

from dcp_codec.common.commandline import say

from .common import jobs_option, quiet_option, seed_option, verbose_option

#: Required minimum share of named faults, and maximum share of false faults among the named ones.
_RECALL, _FALSE = 0.9, 0.1
#: Required minimum share of right sentences among those without hedge.
_RIGHT = 0.95
#: Number of single faults that are held back, for each pair.
_HELD_BACK = 4


@click.command(
    "diagnose",
    epilog=f"Exit status: 0 at least {_RECALL:.0%} of the faults are named, and fewer than {_FALSE:.0%} of the named "
    "ones are false, or with --changes or --selections: 95% of the sentences without hedge are right; 1 otherwise; "
    "2 wrong usage.",
)
@click.argument("number", type=click.IntRange(1))
@click.option("--changes", is_flag=True, help="Diagnose NUMBER random changes of the node, all cases for each.")
@click.option("--selections", is_flag=True, help="Diagnose NUMBER selections of 1 to 5 cases, each with one mutant.")
@seed_option
@jobs_option
@verbose_option
@quiet_option
def command(
    number: int, seed: int, jobs: int | None, *, changes: bool, selections: bool, verbose: bool, quiet: bool
) -> int:
    """Diagnose NUMBER nodes with two faults and NUMBER nodes with three faults at once, drawn at random."""
    if changes or selections:
        return _first_sentences(number, seed, jobs, changes=changes, verbose=verbose)
    from dcp_conformance.cli.display import progress_bar
    from dcp_conformance.diagnosis import load

    from dcp_selftest.diagnosis.measuring import Outcome, draw, hold_back, measure

    good = True
    with progress_bar(quiet=quiet) as progress:
        task = progress.add_task("nodes", total=2 * number)

        def done(outcome: Outcome) -> None:
            progress.update(task, advance=1, description=" + ".join(outcome.faults))

        for size, name in ((2, "pairs"), (3, "triples")):
            found = measure(draw(number, size, seed), jobs=jobs, on_result=done)
            hidden = sum(len(each.hidden) for each in found.outcomes)
            say(
                f"{len(found.outcomes)} {name} of faults: {found.recall:.1%} of the faults are named, "
                f"{found.false_share:.1%} of the named ones are false ({hidden} faults are hidden by others)"
            )
            good = good and found.recall >= _RECALL and found.false_share < _FALSE
            for each in found.outcomes if verbose else ():
                missed = [fault for fault in each.faults if fault not in (*each.found, *each.hidden)]
                if missed or each.false:
                    say(f"  {' + '.join(each.faults)}: missed {missed}, false {list(each.false)}")
    held = hold_back(number * _HELD_BACK, seed, load())
    say(
        f"{held.faults} single faults, each removed from the dictionary: {held.same} are explained by another fault of "
        f"the same requirement, {held.other} by faults of other requirements, {held.none} not at all; of "
        f'{held.statements} sentences without "probably" {held.true} name the requirement'
    )
    return 0 if good else 1


def _first_sentences(number: int, seed: int, jobs: int | None, *, changes: bool, verbose: bool) -> int:
    """Show the first sentences about random changes or about selections; return the exit status."""
    from dcp_selftest.diagnosis.unknown import Statement, selections, summary, unknown

    def done(each: Statement) -> None:
        if verbose or not each.right:
            say(f"{each.about}\n  {each.sentence or 'no fault'}{'' if each.right else '  WRONG'}")

    found = unknown(number, seed, jobs=jobs, on_result=done) if changes else selections(number, seed, done)
    what = "random changes that cases detect" if changes else "selections of 1 to 5 cases"
    say(f"{len(found)} {what}: of the first sentences {summary(found)}")
    stated = [each for each in found if each.requirements]
    return 0 if sum(each.right for each in stated) >= _RIGHT * len(stated) else 1
