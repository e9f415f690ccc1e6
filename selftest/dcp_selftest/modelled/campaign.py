"""Search faulty nodes with the model alone: first the sequences of a run, then newly drawn ones."""

from __future__ import annotations

import gc
import time
from collections.abc import Generator, Sequence
from functools import partial
from typing import Final

import msgspec
from dcp_conformance.stateful.corpus import corpus
from dcp_conformance.stateful.driver import Counterexample, Driver, shorter
from dcp_conformance.stateful.machine import NodeMachine
from dcp_conformance.stateful.search import search
from dcp_conformance.stateful.steps import Step
from dcp_conformance.stateful.virtual import VirtualExecutor

from dcp_codec.common.workers import completed

from .faults import LONG, Fault

#: By protocol: what new sequences are about.
_THEMES: Final = {
    "srp": ("neighbours",),
    "bp": ("registrations", "inactivity", "sizes", "reception", "everything"),
    "vardis": ("services", "dissemination", "timeouts", "limits", "crowds", "variable", "own-variable", "everything"),
}


class Searched(msgspec.Struct, frozen=True):
    """The result of the search in one faulty node."""

    fault: Fault
    by: str
    """``run`` or ``search``; empty if nothing was found."""
    requirements: tuple[str, ...] = ()
    steps: int = 0
    """Number of steps of the counterexample."""
    sequences: int = 0
    """Number of sequences until then."""
    seconds: float = 0.0
    """Processor time, with that of making the counterexample shorter."""
    text: str = ""
    """The counterexample as a table."""


def searched(fault: Fault, *, sequences: int, seed: int, shrink: bool) -> Searched:
    """Search one faulty node."""
    config, make = fault.config(), fault.make()
    began = time.process_time()

    def execute(steps: Sequence[Step]) -> Counterexample | None:
        try:
            Driver(VirtualExecutor(config, make=make)).run(steps)
        except Counterexample as found:
            return found
        return None

    found: Counterexample | None
    for number, each in enumerate(corpus().sequences, 1):
        if (found := execute(each.steps)) is not None:
            if shrink:
                found = shorter(execute, found, attempts=len(found.steps))
            seconds = time.process_time() - began
            return Searched(fault, "run", found.finding.requirements, len(found.steps), number, seconds, str(found))
    if not sequences or fault.id in LONG:
        return Searched(fault, "", seconds=time.process_time() - began)
    result = search(
        lambda: VirtualExecutor(config, make=make),
        sequences=sequences,
        steps=10,
        seed=seed,
        shrink=shrink,
        machine=type("Machine", (NodeMachine,), {"themes": _THEMES[fault.about]}) if fault.about else NodeMachine,
    )
    seconds = time.process_time() - began
    gc.collect()
    if result.counterexample is None:
        return Searched(fault, "", sequences=result.sequences, seconds=seconds)
    found = result.counterexample
    return Searched(
        fault, "search", found.finding.requirements, len(found.steps), result.sequences, seconds, str(found)
    )


def run(faults: Sequence[Fault], *, sequences: int, seed: int, shrink: bool, jobs: int | None) -> Generator[Searched]:
    """Search all faulty nodes; yield the results as they come."""
    work = partial(searched, sequences=sequences, seed=seed, shrink=shrink)
    for _, result in completed(work, faults, jobs):
        yield result
