"""Describe findings as text: the steps, the probable cause, and the requirements that decide."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

import msgspec
from dcp_conformance.errors import UsageError
from dcp_spec.catalogue.requirements import requirement

from dcp_codec.codec import Codec
from dcp_codec.common.printable import printable
from dcp_codec.texts import payload_line
from dcp_lab.fuzz.reduce.causes import Cause
from dcp_lab.fuzz.steps import Frame, Step, Wait

from .artefact import Artefact, load

if TYPE_CHECKING:
    from dcp_lab.fuzz.campaign import Campaign, CauseCount

#: Maximum number of steps that are shown; the file contains all of them.
_STEPS: Final = 5
#: Maximum number of characters of a step that are shown.
_WIDTH: Final = 200


def headline(artefact: Artefact) -> str:
    """Return a finding in one line: identifier, effect, size, and whether it was minimised and confirmed."""
    kept = ", not made smaller" if not artefact.minimised else "" if artefact.confirmed else ", not seen again"
    return f"{artefact.id}: {printable(artefact.effect.detail)} ({_size(artefact.frames, artefact.octets)}{kept})"


def evidence_lines(codec: Codec, artefact: Artefact) -> Iterator[str]:
    """Yield one line for each of the first steps, then the cause, then the requirements that decide."""
    # Inputs of functions are not frames.
    steps = [] if artefact.target.mode == "codec" else artefact.as_steps()
    for step in steps[:_STEPS]:
        yield _step_line(codec, step)
    if len(steps) > _STEPS:
        yield f"... and {len(steps) - _STEPS} more steps"
    if artefact.cause is not None:
        yield from _cause_lines(artefact.cause)
    for identifier in artefact.effect.requirements:
        yield f"decides   {requirement(identifier).cite()}"


def summary_lines(campaign: Campaign) -> Iterator[str]:
    """Yield the findings of a campaign by probable cause, with the smallest artefact of each and its evidence."""
    state = campaign.state
    known = {each.id: each for each in campaign.artefacts}
    if len(state.findings) > 1 and state.causes:
        found = sum(each.findings for each in state.causes.values())
        yield f"{found} findings, {len(state.causes)} probable {'cause' if len(state.causes) == 1 else 'causes'}:"
    for counted in sorted(state.causes.values(), key=lambda each: -each.findings):
        yield from _one_cause(campaign, counted, known.get(counted.smallest))
    for artefact in campaign.artefacts:
        # Findings of functions in process have no cause.
        if artefact.cause is None:
            yield headline(artefact)
            yield from _details(campaign, artefact)


def _one_cause(campaign: Campaign, counted: CauseCount, artefact: Artefact | None) -> Iterator[str]:
    times = f"{counted.findings} findings; the smallest: " if counted.findings > 1 else ""
    yield ""
    yield f"{printable(counted.title)}: {printable(counted.reaction)}"
    if artefact is None and campaign.directory is not None:
        # A finding from before the campaign was resumed.
        try:
            artefact = load(campaign.directory / f"{counted.smallest}.json")
        except UsageError:
            artefact = None
    if artefact is None:
        yield f"  {times}{counted.smallest} ({_size(counted.frames, counted.octets)})"
        return
    yield f"  {times}{headline(artefact)}"
    yield from _details(campaign, artefact)


def _details(campaign: Campaign, artefact: Artefact) -> Iterator[str]:
    for line in evidence_lines(campaign.codec, artefact):
        yield f"  {printable(line)}"
    if campaign.directory is not None:
        yield f"  again     {artefact.command}"


def _size(frames: int, octets: int) -> str:
    return f"{frames} frame{'' if frames == 1 else 's'}, {octets} octet{'' if octets == 1 else 's'}"


def _cause_lines(cause: Cause) -> Iterator[str]:
    sure = "" if not cause.places else " (without it nothing shows)" if cause.proven else " (probably)"
    yield f"cause     {cause.title}{sure}"
    if cause.also:
        yield f"not this  {_shortened(', '.join(cause.also))} (also there at first, not needed)"


def _step_line(codec: Codec, step: Step) -> str:
    if isinstance(step, Wait):
        return f"wait      {step.periods:g} beacon periods"
    if isinstance(step, Frame):
        return f"sent      {_frame_text(codec, step.octets)}"
    return f"call      {_shortened(f'{step.method} {msgspec.json.encode(step.params).decode()}')}"


def _frame_text(codec: Codec, octets: bytes) -> str:
    """Return the messages of a beacon, and its first problem, in one line."""
    dissection = codec.dissect(octets)
    payloads = dissection.root.child("payloads")
    text = "  ".join(payload_line(payload) for payload in payloads.children) if payloads is not None else ""
    text = _shortened(text) or f"{len(octets)} octets"
    if not dissection.errors:
        return text
    problem = dissection.errors[0]
    return f"{text}  ERROR {problem.reason} at {problem.path or 'beacon'} [{problem.requirement}]"


def _shortened(text: str) -> str:
    return text if len(text) <= _WIDTH else f"{text[:_WIDTH]}..."
