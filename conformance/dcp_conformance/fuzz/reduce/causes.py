"""The probable cause of a finding: what its steps cannot do without, and how the implementation reacts to it.

A crash leaves no message from which its cause could be read. But after minimising, a frame has only anomalies whose
repair makes the implementation survive: they are the cause. Findings without an anomaly are named after the messages
in them, and findings about the state of variables after the message that was treated wrongly.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import Final

import msgspec
from dcp_spec.catalogue.requirements import requirements

from dcp_codec.codec import Codec
from dcp_codec.values import Beacon
from dcp_conformance.fuzz.steps import NUMBERS, ROBUSTNESS, STOPPED, Call, Effect, Frame, Step

from .anomalies import Anomaly, anomalies

#: Parts of one cause that are named.
_MOST: Final = 3
#: Requirements that say that something is said too often or again, whatever has caused it.
GENERAL: Final = frozenset({"VD-SCP-01", "VD-SCP-02", "VD-SCP-03", "VD-UPD-10", "VD-CMP-04", "VD-CMP-05"})
#: Lines in which programs say why they end.
_WHY: Final = re.compile(
    r"error|exception|fatal|abort|assert|panic|terminate|overflow|violation|corrupt|invalid|fault|traceback", re.I
)
#: Words of :class:`~dcp_conformance.sut.process.ProcessControl` about an end.
_ENDED: Final = "it ended with "
_SAID: Final = "; it said: "


class Cause(msgspec.Struct, frozen=True, omit_defaults=True):
    """Why a finding shows, as far as experiments can tell."""

    title: str
    """``unknown-type at payloads[].vardis[].icType``, or what an ordinary beacon speaks of."""
    reaction: str
    """How the implementation reacts: how it ends, or which requirements it breaks."""
    group: str
    """Equal for findings that most likely have one cause: what provokes them, and the reaction."""
    proven: bool = False
    """Whether without each of the anomalies the finding does not show."""
    places: tuple[str, ...] = ()
    """The anomalies with their paths and what they mean."""
    also: tuple[str, ...] = ()
    """Anomalies that were in the first frame, and without which the finding shows all the same."""
    requirements: tuple[str, ...] = ()
    """What decides."""


def kinds_in(codec: Codec, octets: bytes) -> list[str]:
    """The kinds of anomalies of a frame, each once."""
    return list(dict.fromkeys(each.kind for each in anomalies(codec, octets)))


def cause_of(codec: Codec, steps: Iterable[Step]) -> str:
    """What is in steps that may be at fault, in words: the anomalies, or else what the messages speak of."""
    return _named(list(dict.fromkeys(each.kind for each in _anomalies_in(codec, steps))), codec, steps)


def explained(
    codec: Codec,
    steps: Sequence[Step],
    effect: Effect,
    first: Sequence[Step] = (),
    *,
    proven: bool = False,
    culprit: str = "",
) -> Cause:
    """The cause of a finding of which ``steps`` are left.

    ``first``: the same steps before their frames were made small; ``proven``: whether each anomaly is needed;
    ``culprit``: the requirement that an experiment has found to be violated.
    """
    found = _anomalies_in(codec, steps)
    left = {each.kind for each in found}
    title = _named(list(dict.fromkeys(each.kind for each in found)), codec, steps)
    about = _named(list(dict.fromkeys(each.group for each in found)), codec, steps)
    also = dict.fromkeys(each.kind for each in _anomalies_in(codec, first) if each.kind not in left)
    decides = decided_by(effect, found if proven or effect.kind in STOPPED else (), culprit)
    if effect.kind in STOPPED:
        reaction = death_of(effect)
        group = f"{reaction}: {about}"
    else:
        reaction = f"breaks {', '.join(decides)}" if decides else effect.signature
        # The rule that an experiment finds to be broken is the cause, whatever shows it.
        group = reaction if culprit or effect.kind == "bad-beacon" else f"{reaction}: {about}"
    return Cause(
        title,
        reaction,
        group,
        proven,
        tuple(f"{each.reason} at {each.path or 'the frame'}: {each.meaning}" for each in _once(found)),
        tuple(also),
        decides,
    )


def decided_by(effect: Effect, found: Sequence[Anomaly] = (), culprit: str = "") -> tuple[str, ...]:
    """The requirements that decide an effect: of what was not survived, or of what was done wrong."""
    if culprit:
        return (culprit,)
    damaged = effect.kind in ("said", "state") and any(each.is_damage for each in found)
    if effect.kind in STOPPED or damaged:
        # What damage does beside stopping an entity is to corrupt its state.
        return tuple(dict.fromkeys(each for anomaly in found for each in anomaly.requirements)) or ROBUSTNESS
    known = requirements()
    return tuple(dict.fromkeys(word for word in effect.signature.split() if word in known))


def death_of(effect: Effect) -> str:
    """How an implementation has stopped, without what differs from death to death."""
    if effect.kind != "dead":
        return effect.signature if effect.kind == "raised" else effect.kind
    how, _, words = effect.detail.partition(_SAID)
    lines = [line for line in words.split(" | ") if _WHY.search(line)]
    # An exit status is no accident; other numbers (processes, addresses, times) are.
    how = how if how.startswith(_ENDED) else NUMBERS.sub("#", how)
    said = NUMBERS.sub("#", lines[-1].strip()) if lines else ""
    return ", ".join(filter(None, (effect.kind, how, said)))


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
    """The kinds of messages in a beacon."""
    kinds = {
        type(record).__name__ for payload in beacon.payloads for each in payload.vardis or () for record in each.records
    }
    kinds |= {type(payload.srp).__name__ for payload in beacon.payloads if payload.srp is not None}
    return f"a valid beacon with {', '.join(sorted(kinds)) or 'nothing that is known'}"


__all__ = ["GENERAL", "Cause", "cause_of", "death_of", "decided_by", "explained", "kinds_in"]
