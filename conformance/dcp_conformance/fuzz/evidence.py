"""A finding as people read it: what was sent, and what the specification says about what came of it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import msgspec
from dcp_spec.requirements import requirement

from dcp_codec.codec import Codec
from dcp_codec.texts import payload_line

from .artefact import Artefact
from .causes import Cause
from .steps import Frame, Step, Wait

#: Steps that are shown; all of them are in the file.
_STEPS: Final = 5
#: Characters of a step that are shown.
_WIDTH: Final = 200


def evidence_lines(codec: Codec, artefact: Artefact) -> Iterator[str]:
    """What was done, one line for each of the first steps, and which requirements decide."""
    # Inputs of functions are of any form.
    steps = [] if artefact.target.mode == "codec" else artefact.as_steps()
    for step in steps[:_STEPS]:
        yield _step_line(codec, step)
    if len(steps) > _STEPS:
        yield f"... and {len(steps) - _STEPS} more steps"
    if artefact.cause is not None:
        yield from _cause_lines(artefact.cause)
    for identifier in artefact.effect.requirements:
        yield f"decides   {requirement(identifier).cite()}"


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
    """The messages of a beacon, and its first problem."""
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
