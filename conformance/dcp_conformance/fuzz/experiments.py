"""Experiments with a finding that is small already: which rule is it that the implementation breaks?

The model tells what was said or held wrongly, not why: a container that was skipped shows as a request that did not
come. So the message that was treated wrongly is sent in another form. If all is well then, it was the form.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import msgspec

from dcp_codec.codec import Codec
from dcp_codec.errors import DecodeError, EncodeError
from dcp_codec.values import Container, Payload, VarSpec
from dcp_conformance.heard import var_id_of

from .causes import GENERAL, decided_by
from .observing import Observer
from .steps import Call, Effect, Frame, Step, Wait

#: Nominal beacon period for the model that names messages, in ns.
_PERIOD: Final = 100_000_000


class Form(NamedTuple):
    """Steps that say the same in another form, and what is broken if they show nothing."""

    requirement: str
    steps: list[Step]


def forms(codec: Codec, steps: Sequence[Step]) -> Iterator[Form]:
    """Other forms of the last frame that says several things."""
    for at in range(len(steps) - 1, -1, -1):
        step = steps[at]
        if not isinstance(step, Frame):
            continue
        for requirement, frames in _split(codec, step):
            yield Form(requirement, [*steps[:at], *frames, *steps[at + 1 :]])


def _split(codec: Codec, frame: Frame) -> Iterator[tuple[str, list[Step]]]:
    """A frame as several: by blocks, by containers, by records."""
    try:
        beacon = codec.decode(frame.octets)
    except DecodeError:
        return
    replace = msgspec.structs.replace

    def sent(blocks: Sequence[Payload]) -> list[Step]:
        return [replace(frame, octets=codec.encode(replace(beacon, payloads=(block,))), valid=b"") for block in blocks]

    containers = [each for payload in beacon.payloads for each in payload.vardis or ()]
    with_several = [payload for payload in beacon.payloads if len(payload.vardis or ()) > 1]
    try:
        if len(beacon.payloads) > 1:
            yield "BP-RX-07", sent(beacon.payloads)
        if with_several:
            apart = [replace(block, content=(each,)) for block in beacon.payloads for each in block.vardis or ()]
            yield _of_containers(containers), sent(apart)
        if any(len(each.records) > 1 for each in containers):
            single = [
                replace(block, content=(replace(each, records=(record,)),))
                for block in beacon.payloads
                for each in block.vardis or ()
                for record in each.records
            ]
            yield "VD-RX-09", sent(single)
    except EncodeError:
        return


def _of_containers(containers: Sequence[Container]) -> str:
    """What is broken when containers have their effect one by one, and not in one payload."""
    variables = [{var_id_of(record) for record in each.records} for each in containers]
    shared = any(one & other for at, one in enumerate(variables) for other in variables[at + 1 :])
    # About one variable the order counts; about several all that can go wrong is that one is not extracted.
    return "VD-RX-08" if shared else "VD-RX-04"


#: State of a variable and message -> the requirement about it. A word of a message is left out where it does not count.
_RULES: Final = {
    "unknown": {
        "update": "VD-PU-01", "summary": "VD-PS-01", "request-update": "VD-RU-01", "request-create": "VD-RC-01",
        "delete": "VD-PD-01", "create": "VD-PC-07",
    },
    "deleted": {
        "update": "VD-PU-02", "summary": "VD-PS-02", "request-update": "VD-RU-02", "request-create": "VD-RC-02",
        "delete": "VD-PD-02", "create later": "VD-PC-02", "create": "VD-PC-01",
    },
    "alive own": {
        "update": "VD-PU-03", "summary": "VD-PS-02", "delete": "VD-PD-03", "create": "VD-PC-01",
        "request-update older": "VD-RU-04", "request-update": "VD-RU-03", "request-create": "VD-RC-03",
    },
    "alive foreign": {
        "update equal": "VD-PU-05", "update older": "VD-PU-06", "update newer": "VD-PU-07",
        "summary equal": "VD-PS-02", "summary older": "VD-PS-03", "summary newer": "VD-PS-04",
        "request-update older": "VD-RU-04", "request-update": "VD-RU-03", "request-create": "VD-RC-03",
        "delete": "VD-PD-04", "create": "VD-PC-01",
    },
}  # fmt: skip


def rule_about(state: str, message: str) -> str:
    """The requirement about a message for a variable in a state, both as :class:`Observer` names them; or nothing."""
    rules = _RULES.get(state) or _RULES.get(state.partition(" ")[0], {})
    return rules.get(message) or rules.get(message.partition(" ")[0], "")


def last_message(codec: Codec, steps: Sequence[Step], own_id: bytes) -> tuple[str, str] | None:
    """State and message of the last thing that was said to the node, by the model; None if nothing was."""
    profile = codec.profile
    observer = Observer(codec, own_id, _PERIOD, network=profile.bp.network_id)
    now = 1
    for number, step in enumerate(steps, start=1):
        match step:
            case Wait():
                now += round(step.periods * _PERIOD)
            case Frame():
                observer.hears(step.octets, now, number)
            case Call():
                _follow(observer, step, now)
        now += 1
    return observer.reached[-1] if observer.reached else None


def _follow(observer: Observer, call: Call, now: int) -> None:
    """A service that has succeeded, as far as the model thinks it could."""
    var_id, value = call.params.get("varId"), _octets(call.params.get("value"))
    if type(var_id) is not int or observer.expects(call.method, var_id) is False:
        return
    match call.method:
        case "RTDB-Create" if value is not None:
            timed = observer.compares_creations
            repetitions = call.params.get("repCnt", 1)
            spec = VarSpec(var_id, observer.own_id, repetitions, b"", now if timed else None, 0 if timed else None)
            observer.created(spec, value, now)
        case "RTDB-Update" if value is not None:
            observer.oracle.updated(var_id, value, now)
        case "RTDB-Delete":
            observer.oracle.deleted(var_id, now)


def _octets(text: object) -> bytes | None:
    try:
        return bytes.fromhex(text) if isinstance(text, str) else None
    except ValueError:
        return None


def culprit_by_message(codec: Codec, steps: Sequence[Step], effect: Effect, own_id: bytes) -> str:
    """The requirement about the last message, where the effect itself names none or a general one."""
    named = decided_by(effect)
    if effect.step < len(steps) and isinstance(steps[effect.step], Call):
        return ""
    if (named and not GENERAL.intersection(named)) or effect.kind not in ("said", "state"):
        return ""
    last = last_message(codec, steps, own_id)
    return rule_about(*last) if last is not None else ""


__all__ = ["Form", "culprit_by_message", "forms", "last_message", "rule_about"]
