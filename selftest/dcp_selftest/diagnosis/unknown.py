"""Diagnose nodes with changes that the dictionary does not know, and selections of few cases."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from functools import partial
from multiprocessing.context import ForkServerContext
from typing import Final

import msgspec
from dcp_conformance.definitions.results import CaseResult
from dcp_conformance.diagnosis import explain, load

from dcp_codec.common.workers import completed
from dcp_selftest.generated.campaign import draw
from dcp_selftest.generated.isolation import ask, import_changed, process_context
from dcp_selftest.generated.ledger import ledger
from dcp_selftest.generated.sites import Site, cited, mutated
from dcp_selftest.generated.trial import limit

PROFILE: Final = "dcp-2.0"
#: Maximum number of cases in a selection.
_MOST: Final = 5
#: Requirements that changes violate although they are not cited near them, by the key of the change.
_JUDGED: Final = {
    # A beacon with a block that extends past its end is discarded as a whole.
    "aadfd1b2b763": ("BP-RX-09",),
}


class Statement(msgspec.Struct, frozen=True):
    """The first sentence of a diagnosis."""

    about: str
    """The change, or the fault with the selected cases."""
    sentence: str = ""
    """Empty if nothing is diagnosed."""
    fault: str = ""
    requirements: tuple[str, ...] = ()
    """The requirements that it states as violated; empty if it is hedged."""
    right: bool = True
    """Whether the fault violates these: those of the mutant, or cited near the changed code, or judged by a reader."""
    failed: int = 0
    """The number of failed cases; 0 if the change was not noticed or the node did not start."""


def summary(found: Sequence[Statement]) -> str:
    """Return how many first sentences there are of each kind."""
    stated = [each for each in found if each.requirements]
    probable = sum("probably" in each.sentence for each in found) - len(stated)
    none = sum(not each.sentence for each in found)
    return (
        f"{len(stated)} state a requirement without hedge, {sum(each.right for each in stated)} of them rightly; "
        f"{probable} are probable, {len(found) - len(stated) - probable - none} only compare, {none} name no fault"
    )


def unknown(
    number: int, seed: int, *, jobs: int | None = None, on_result: Callable[[Statement], None] = lambda _: None
) -> list[Statement]:
    """Diagnose ``number`` changes of the node that cases detect, drawn by ``seed``."""
    known = ledger()
    sites = [site for site in draw(4 * number, seed) if site.key not in known]
    found: list[Statement] = []
    for _, each in completed(partial(in_process, process_context()), sites, jobs, start="thread"):
        if each.failed:
            found.append(each)
            on_result(each)
        if len(found) == number:
            break
    return found


def selections(number: int, seed: int, on_result: Callable[[Statement], None] = lambda _: None) -> list[Statement]:
    """Diagnose ``number`` selections of 1 to 5 cases, drawn by ``seed``, each for a mutant that fails one of them.

    A mutant that fails its cases only after others is passed over.
    """
    # Imported here: the process of a change must not have imported the node.
    from dcp_conformance.definitions.case import all_cases

    from dcp_selftest.mutants import all_mutants
    from dcp_selftest.runner import Suite

    rng = random.Random(seed)  # noqa: S311 - a draw, no secret
    able = [fault for fault in load().faults if fault.fails and all_mutants()[fault.id].profile == PROFILE]
    found: list[Statement] = []
    for fault in rng.sample(able, len(able)):
        if len(found) == number:
            break
        fails = sorted(fault.fails)
        others = sorted({case for each in rng.sample(able, 4) for case in each.fails} - fault.fails)
        chosen = {rng.choice(fails), *rng.sample([*fails, *others], rng.randrange(_MOST))}
        results = [*Suite(PROFILE, all_mutants()[fault.id].make).run([all_cases()[case] for case in sorted(chosen)])]
        statement = _statement(f"{fault.id}: {fault.what} ({len(chosen)} cases)", results, fault.requirements)
        if statement.failed:
            found.append(statement)
            on_result(statement)
    return found


def _statement(about: str, results: Sequence[CaseResult], known: Sequence[str]) -> Statement:
    """Return the first sentence about these results. ``known``: the requirements that the fault violates."""
    from dcp_conformance.reporting.overview import sentence, violated

    diagnosis = explain(results, load())
    if not diagnosis.faults:
        return Statement(about, failed=diagnosis.failed)
    first = diagnosis.faults[0]
    stated = violated(first) if first.certain else ()
    return Statement(about, sentence(first), first.fault, stated, set(stated) <= set(known), diagnosis.failed)


def in_process(context: ForkServerContext, site: Site) -> Statement:
    """Diagnose the node with one change, in a new process: see :func:`.isolation.process_context`."""
    answer, _ = ask(context, _try, site)
    return msgspec.json.decode(answer, type=Statement) if answer else Statement(str(site))


def _try(site: Site) -> bytes:
    limit()
    import_changed(f"dcp_stack.{site.module}", compile(mutated(site), f"<changed {site.module}.py>", "exec"))
    from dcp_conformance.errors import ConformanceError

    from dcp_selftest.runner import Suite, cases

    try:
        results = {each.id: each for each in Suite(PROFILE).run(cases())}
    except (ConformanceError, AttributeError, TypeError, KeyError):
        # The node does not start.
        return msgspec.json.encode(Statement(str(site)))
    return msgspec.json.encode(_statement(str(site), [*results.values()], (*cited(site), *_JUDGED.get(site.key, ()))))
