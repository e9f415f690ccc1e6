"""The steps that lead to a failure: frames that the tester sent, and services that it called."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import NamedTuple

from dcp_conformance.model.results import CaseResult, Check

#: Services that only find something out, and change nothing.
_QUERIES = ("Describe", "Read", "Get", "List", "Query", "Table", "Hello", "Status")


class Step(NamedTuple):
    """Something that the tester did."""

    time: float
    """Seconds since the first step."""
    octets: bytes
    """The whole link-layer frame that was sent; empty for a call."""
    start: int
    """Where the bearer payload begins in the frame."""
    text: str
    """For a call: the service and its parameters."""
    frame: int = 0
    """For a frame: its place among all frames that the tester sent in the case, from 0."""


def stimulus(case: CaseResult, check: Check) -> list[Step]:
    """The steps of a case until the failure was seen, without calls that only find something out at the end."""
    marked = {mark.frame for mark in check.frames}
    events = list(case.evidence)
    seen = [place for place, event in enumerate(events) if event.frame in marked and event.frame]
    failed = next((place for place, event in enumerate(events) if _is_finding(event.text, check)), len(events))
    last = max(seen, default=failed)
    # A failure that is seen in what was sent is seen after it.
    end = max(last, min(failed, len(events))) if seen else failed
    found: list[Step] = []
    sent = 0
    for event in events[: end + 1]:
        octets = _octets(event.octets) if event.direction == "sent" else b""
        if octets or event.direction == "call":
            found.append(Step(event.time / 1e9, octets, event.start, "" if octets else event.text, sent))
        sent += event.direction == "sent"
    return _from_zero(found)


def only(steps: Sequence[Step], frames: Collection[int]) -> list[Step]:
    """The calls, and of the frames those at these places."""
    return _from_zero([step for step in steps if not step.octets or step.frame in frames])


def _from_zero(steps: list[Step]) -> list[Step]:
    begin = steps[0].time if steps else 0.0
    return [step._replace(time=step.time - begin) for step in steps]


def needs_calls(steps: Sequence[Step]) -> bool:
    """Whether services of the implementation have to be called, too."""
    return any(step.text and not _is_query(step.text) for step in steps)


def _is_query(text: str) -> bool:
    return any(word in text.partition(" ")[0] for word in _QUERIES)


def _is_finding(text: str, check: Check) -> bool:
    return text.startswith(f"{check.verdict}: {check.expected}")


def _octets(text: str) -> bytes:
    try:
        return bytes.fromhex(text)
    except ValueError:
        return b""
