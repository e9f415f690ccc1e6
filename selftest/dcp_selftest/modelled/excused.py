"""Search the changes of the ledger with the model: a counterexample shows that a change can be observed."""

from __future__ import annotations

import random
from collections.abc import Generator
from functools import partial
from multiprocessing.context import ForkServerContext
from typing import TYPE_CHECKING, Final

import msgspec

from dcp_codec.common.workers import completed
from dcp_selftest.generated.isolation import ask, import_changed, process_context
from dcp_selftest.generated.ledger import ledger
from dcp_selftest.generated.sites import Site, mutated, sites
from dcp_selftest.generated.trial import PROFILES, limit

if TYPE_CHECKING:
    from .campaign import Searched

#: Changes of SRP are also tried with a neighbour table that sequences can fill.
_ROOM: Final = 2
#: CPU seconds for the sequences of a run, and for each drawn one: many times what they take.
_SECONDS, _EACH = 30, 0.3


def excused(count: int | None, seed: int) -> list[Site]:
    """Return the changes in the ledger, or ``count`` of them drawn by ``seed``."""
    found = [each for each in sites() if each.key in ledger()]
    if count is None:
        return found
    return random.Random(seed).sample(found, min(count, len(found)))  # noqa: S311 - a draw that can be repeated


def run(changes: list[Site], *, sequences: int, seed: int, jobs: int | None) -> Generator[tuple[Site, Searched]]:
    """Search the node with each change, each in a new process; yield the results as they come.

    ``by`` is the way in which a process ended that an endless loop has ended.
    """
    context = process_context("dcp_conformance.stateful.search")
    work = partial(_in_process, context, sequences=sequences, seed=seed)
    for place, result in completed(work, changes, jobs, start="thread"):
        yield changes[place], result


def _in_process(context: ForkServerContext, site: Site, *, sequences: int, seed: int) -> Searched:
    # Only in a function: these modules import the node, which the new process imports with the change.
    from .campaign import Searched
    from .faults import Fault

    answer, fate = ask(context, _searched, site, sequences, seed)
    if answer:
        return msgspec.json.decode(answer, type=Searched)
    return Searched(Fault(f"change {site.key}", PROFILES[0]), fate)


def _searched(site: Site, sequences: int, seed: int) -> bytes:
    limit(int(_SECONDS + _EACH * sequences))
    import_changed(f"dcp_stack.{site.module}", compile(mutated(site), f"<changed {site.module}.py>", "exec"))
    from .campaign import searched
    from .faults import Fault

    protocol, _, module = site.module.partition(".")
    about = protocol if module else ""
    fault = Fault(f"change {site.key}", PROFILES[0], about)
    found = searched(fault, sequences=sequences, seed=seed, shrink=True)
    if not found.by and about == "srp":
        fault = msgspec.structs.replace(fault, neighbours=_ROOM)
        found = searched(fault, sequences=sequences, seed=seed, shrink=True)
    return msgspec.json.encode(found)
