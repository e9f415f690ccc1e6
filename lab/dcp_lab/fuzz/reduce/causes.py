"""Determine the probable cause of a finding: the necessary part of its steps, and the reaction of the implementation.

A crash leaves no message with its cause, so crashes are grouped by their probable cause. After minimising, a frame has
only anomalies whose repair makes the implementation survive: they are the cause. A finding without an anomaly is named
after its messages.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import Final

import msgspec
from dcp_spec.catalogue.requirements import requirements

from dcp_codec.codec import Codec
from dcp_codec.values import Beacon
from dcp_lab.fuzz.steps import NUMBERS, ROBUSTNESS, STOPPED, Call, Effect, Frame, Step

from .anomalies import Anomaly, anomalies

#: Maximum number of anomalies in the title of a cause.
_MOST: Final = 3
#: Pattern of lines in which a program reports why it ends.
_WHY: Final = re.compile(
    r"error|exception|fatal|abort|assert|panic|terminate|overflow|violation|corrupt|invalid|fault|traceback", re.I
)
#: Texts in the report of :class:`~dcp_conformance.sut.process.ProcessControl` about the end of a process.
_ENDED: Final = "it ended with "
_OUTPUT: Final = "; its output: "


class Cause(msgspec.Struct, frozen=True, omit_defaults=True):
    """The probable cause of a finding."""

    title: str
    """Anomalies such as ``unknown-type at payloads[].vardis[].icType``, or the messages of a valid beacon."""
    reaction: str
    """The reaction of the implementation: how it ends, or which requirements it violates."""
    group: str
    """Text that is equal for findings with probably the same cause: the anomalies and the reaction."""
    proven: bool = False
    """Whether the effect disappears if any one of the anomalies is repaired."""
    places: tuple[str, ...] = ()
    """The anomalies with their paths and meanings."""
    also: tuple[str, ...] = ()
    """Anomalies of the original frame that are not necessary for the effect."""
    requirements: tuple[str, ...] = ()
    """The requirements that decide the effect."""


def cause_of(codec: Codec, steps: Iterable[Step]) -> str:
    """Return the possible cause in these steps as text: the anomalies, or the messages if there are none."""
    return _named(list(dict.fromkeys(each.kind for each in _anomalies_in(codec, steps))), codec, steps)


def explained(
    codec: Codec,
    steps: Sequence[Step],
    effect: Effect,
    first: Sequence[Step] = (),
    *,
    proven: bool = False,
) -> Cause:
    """Return the cause of a finding with these minimised steps.

    ``first``: the same steps before their frames were minimised; ``proven``: whether each anomaly is necessary.
    """
    found = _anomalies_in(codec, steps)
    left = {each.kind for each in found}
    title = _named(list(dict.fromkeys(each.kind for each in found)), codec, steps)
    about = _named(list(dict.fromkeys(each.group for each in found)), codec, steps)
    also = dict.fromkeys(each.kind for each in _anomalies_in(codec, first) if each.kind not in left)
    decides = decided_by(effect, found if effect.kind in STOPPED else ())
    if effect.kind in STOPPED:
        reaction = death_of(effect)
        group = f"{reaction}: {about}"
    else:
        reaction = f"breaks {', '.join(decides)}" if decides else effect.signature
        group = reaction if effect.kind == "bad-beacon" else f"{reaction}: {about}"
    return Cause(
        title,
        reaction,
        group,
        proven,
        tuple(f"{each.reason} at {each.path or 'the frame'}: {each.meaning}" for each in _once(found)),
        tuple(also),
        decides,
    )


def decided_by(effect: Effect, found: Sequence[Anomaly] = ()) -> tuple[str, ...]:
    """Return the requirements that decide an effect: those of the anomalies after a crash, else those it names."""
    if effect.kind in STOPPED:
        return tuple(dict.fromkeys(each for anomaly in found for each in anomaly.requirements)) or ROBUSTNESS
    known = requirements()
    return tuple(dict.fromkeys(word for word in effect.signature.split() if word in known))


def death_of(effect: Effect) -> str:
    """Return how an implementation stopped, without details that differ between crashes of the same kind."""
    if effect.kind != "dead":
        return effect.signature if effect.kind == "raised" else effect.kind
    how, _, words = effect.detail.partition(_OUTPUT)
    lines = [line for line in words.split(" | ") if _WHY.search(line)]
    # Keep the exit status. Replace other numbers (process ids, addresses, times), which vary.
    how = how if how.startswith(_ENDED) else NUMBERS.sub("#", how)
    output = NUMBERS.sub("#", lines[-1].strip()) if lines else ""
    return ", ".join(filter(None, (effect.kind, how, output)))


def _anomalies_in(codec: Codec, steps: Iterable[Step]) -> list[Anomaly]:
    return [each for step in steps if isinstance(step, Frame) for each in anomalies(codec, step.octets)]


def _once(found: Iterable[Anomaly]) -> list[Anomaly]:
    return list({each.kind: each for each in found}.values())


def _named(kinds: Sequence[str], codec: Codec, steps: Iterable[Step]) -> str:
    names = list(kinds) or list(dict.fromkeys(_contents(codec, steps)))
    more = f" and {len(names) - _MOST} more" if len(names) > _MOST else ""
    return ", ".join(names[:_MOST]) + more or "nothing at all"


def _contents(codec: Codec, steps: Iterable[Step]) -> Iterable[str]:
    for step in steps:
        if isinstance(step, Frame):
            yield _content(codec.decode(step.octets))
        elif isinstance(step, Call):
            yield step.method


def _content(beacon: Beacon) -> str:
    """Return the kinds of messages in a valid beacon as text."""
    kinds = {
        type(record).__name__ for payload in beacon.payloads for each in payload.vardis or () for record in each.records
    }
    kinds |= {type(payload.srp).__name__ for payload in beacon.payloads if payload.srp is not None}
    return f"a valid beacon with {', '.join(sorted(kinds)) or 'nothing that is known'}"
