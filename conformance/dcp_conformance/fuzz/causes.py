"""What a frame has that may be the cause of a death: its first problem and where, or what it speaks of.

Processes die without a word, and all deaths look alike from outside; the frame that is left of a finding tells them
apart. The cause is a guess, good enough to go on with other frames.
"""

from __future__ import annotations

from collections.abc import Iterable

from dcp_codec import lint
from dcp_codec.codec import Codec
from dcp_codec.errors import DecodeError, Problem
from dcp_codec.mutation import generic
from dcp_codec.values import Beacon

from .steps import Call, Frame, Step

#: Causes of one finding that are named.
_MOST = 3


def problems_of(codec: Codec, octets: bytes) -> list[str]:
    """The problem of a beacon that is none, or the warnings about one; each with its field."""
    try:
        codec.decode(octets)
    except DecodeError as error:
        return [_shown(error.problem)]
    return [_shown(problem) for problem in lint.warnings(codec.dissect(octets))]


def cause_of(codec: Codec, steps: Iterable[Step]) -> str:
    """What there is in steps that show an effect, in words: at most three things, damage if there is any."""
    damage: dict[str, None] = {}
    others: dict[str, None] = {}
    for step in steps:
        if isinstance(step, Frame):
            problems = problems_of(codec, step.octets)
            if problems:
                damage[problems[0]] = None
            else:
                others[_content(codec.decode(step.octets))] = None
        elif isinstance(step, Call):
            others[step.method] = None
    names = list(damage or others)
    more = f" and {len(names) - _MOST} more" if len(names) > _MOST else ""
    return ", ".join(names[:_MOST]) + more or "nothing at all"


def _shown(problem: Problem) -> str:
    return f"{problem.reason} at {generic(problem.path) or 'beacon'}"


def _content(beacon: Beacon) -> str:
    """The kinds of messages in a beacon."""
    kinds = {
        type(record).__name__ for payload in beacon.payloads for each in payload.vardis or () for record in each.records
    }
    kinds |= {type(payload.srp).__name__ for payload in beacon.payloads if payload.srp is not None}
    return f"a valid beacon with {', '.join(sorted(kinds)) or 'nothing that is known'}"
