"""Replay behaviour vectors on nodes of this process."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from dcp_conformance.errors import UpperTesterError
from dcp_conformance.reference.inprocess import InProcess, MakeNode, VirtualUpperTester
from dcp_conformance.upper_tester import Answer
from dcp_conformance.vectors.behaviour import Event, Step, Vector, answered, events_of, judged

from dcp_stack.config import NodeConfig

from .model import Watcher

MS = 1_000_000


class Trace(NamedTuple):
    """The reaction of a node to the steps of a vector."""

    answers: list[Answer | None]
    """One for each step; None for a frame, and for a call without an answer."""
    events: list[Event]
    died: str


def trace(
    config: NodeConfig,
    make: MakeNode,
    steps: Sequence[Step],
    end: int,
    seed: int = 1,
    watcher: Watcher | None = None,
    early: int = 0,
) -> Trace:
    """Replay steps on a new node; ``watcher`` follows what happens.

    ``early``: milliseconds by which the node is started before time 0, so that its timers have another phase.
    """
    sut = InProcess(config, make=make, seed=seed, now=-early * MS)
    upper = VirtualUpperTester(sut, greet=False)
    answers: list[Answer | None] = []
    events: list[Event] = []
    for place, step in enumerate(steps):
        _advance(sut, upper, step.at, events, watcher)
        if step.receive is not None:
            octets = bytes.fromhex(step.receive)
            if watcher is not None:
                watcher.frame(octets, sut.now)
            sut.deliver(octets)
            answers.append(None)
            continue
        try:
            answers.append(upper.call(step.call or "", dict(step.params)))
        except UpperTesterError:
            answers.append(None)
        if watcher is not None:
            watcher.call(place, step, answers[-1], sut.now)
    _advance(sut, upper, end, events, watcher)
    return Trace(answers, events, sut.died)


def _advance(
    sut: InProcess, upper: VirtualUpperTester, until: int, events: list[Event], watcher: Watcher | None
) -> None:
    _take(sut, upper, events, watcher)
    while sut.now < until * MS and not sut.died:
        sut.advance(until * MS)
        _take(sut, upper, events, watcher)
    if watcher is not None:
        watcher.passed(sut.now)


def _take(sut: InProcess, upper: VirtualUpperTester, events: list[Event], watcher: Watcher | None) -> None:
    """Add what the node has sent and indicated."""
    while sut.arrivals:
        arrival = sut.arrivals.popleft()
        if watcher is not None:
            watcher.beacon(arrival.octets, arrival.time)
        events.extend(events_of(sut.config.codec, arrival.octets, arrival.time / MS))
    for each in upper.poll():
        if watcher is not None:
            watcher.notified(each.method, each.params, each.time)
        prot_id = each.params.get("protId", 0)
        if each.method == "BP-ReceivePayload.indication":
            events.append(Event(each.time / MS, "indication", prot_id, str(each.params.get("payload"))))
        elif each.method == "BP-PayloadTransmitted.indication":
            events.append(Event(each.time / MS, "transmitted", prot_id, ""))


def failures(vector: Vector, found: Trace) -> Iterator[str]:
    """Yield what is wrong with the trace of a vector."""
    if found.died:
        yield f"the node ends: {found.died}"
    for step, answer in zip(vector.steps, found.answers, strict=True):
        if step.call is not None and answer is not None:
            yield from answered(step, _status(answer), answer.result)
        elif step.call is not None and step.status:
            yield f"{step.at} ms {step.call}: no answer"
    yield from judged(vector, found.events)


def _status(answer: Answer) -> str:
    return answer.status if answer.code is None else f"error {answer.code}"
