"""Extract from a case the steps that lead to a failure: frames that the tester sent, and services that it called."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from dcp_conformance.definitions.results import CaseResult, Check
from dcp_conformance.reporting.frames import octets_of

#: Parts of the names of services that only query the implementation and do not change its state.
_QUERIES = ("Describe", "Read", "Get", "List", "Query", "Table", "Hello", "Status")


class Step(NamedTuple):
    """A frame that the tester sent, or a service that it called."""

    time: float
    """Seconds since the first step."""
    octets: bytes
    """The whole link-layer frame that was sent; empty for a call."""
    start: int
    """Offset of the bearer payload (the BP packet) in the frame, in octets."""
    text: str
    """For a call: the service and its parameters; empty for a frame."""


def stimulus(case: CaseResult, check: Check) -> list[Step]:
    """Return the steps of a case up to the failure of this check, with times from the first step.

    The failure is at the last frame that the check cites, or at the finding itself, whichever is later.
    """
    marked = {mark.frame for mark in check.frames}
    events = list(case.evidence)
    seen = [place for place, event in enumerate(events) if event.frame in marked and event.frame]
    finding = f"{check.verdict}: {check.expected}"
    failed = next((place for place, event in enumerate(events) if event.text.startswith(finding)), len(events))
    last = max(seen, default=failed)
    # A frame cited by a check is recorded before the finding about it.
    end = max(last, min(failed, len(events))) if seen else failed
    found: list[Step] = []
    for event in events[: end + 1]:
        octets = octets_of(event) if event.direction == "sent" else b""
        if octets or event.direction == "call":
            found.append(Step(event.time / 1e9, octets, event.start, "" if octets else event.text))
    begin = found[0].time if found else 0.0
    return [step._replace(time=step.time - begin) for step in found]


def needs_calls(steps: Sequence[Step]) -> bool:
    """Return whether a step calls a service that changes the state of the implementation."""
    names = (step.text.partition(" ")[0] for step in steps)
    return any(not any(word in name for word in _QUERIES) for name in names if name)
