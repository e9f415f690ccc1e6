"""Determine by experiments with a minimised finding which requirement the implementation violates.

The model detects a wrong record or state, not its cause: a skipped container shows as a missing request. Therefore the
same records are sent in another form. If no effect occurs then, the implementation processes the original form wrongly.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Final, NamedTuple

import msgspec
from dcp_spec.constants import ICType

from dcp_codec.codec import Codec
from dcp_codec.errors import DecodeError, EncodeError
from dcp_codec.values import Container, Payload, VarCreate, VardisRecord, VarSpec, VarUpdate
from dcp_conformance.frames.received import var_id_of
from dcp_conformance.fuzz.execute.model_monitor import Observer
from dcp_conformance.fuzz.steps import Call, Effect, Frame, Step, Wait

from .anomalies import anomalies
from .causes import GENERAL, decided_by
from .minimise import Run

#: Nominal beacon period for the model that names messages, in ns.
_PERIOD: Final = 100_000_000
#: Exclusive or of a variable identifier with this value gives an unrelated identifier.
_FAR: Final = 0x40


class Form(NamedTuple):
    """Steps with the same records in another form, and the requirement that is violated if they show no effect."""

    requirement: str
    steps: list[Step]
    moved: tuple[list[Step], ...] = ()
    """Further forms, to detect skipped containers: all containers but one with other variables; then the reverse
    order."""
    ordered: bool = False
    """Whether the containers have the order in which they must be processed."""


def broken_rule(codec: Codec, steps: list[Step], effect: Effect, run: Run, own_id: bytes) -> str:
    """Return the requirement that an implementation violates with these steps; empty if the effect itself names it.

    Forwards exceptions of ``run``.
    """
    for form in forms(codec, steps):
        shown = run(form.steps)
        if shown is None:
            return _order_or_extraction(form, run) if form.moved else form.requirement
        if shown.kind == effect.kind:
            # Continue with fewer messages in each frame, which isolates the message that is processed wrongly.
            steps, effect = form.steps[: shown.step + 1], shown
    return culprit_by_message(codec, steps, effect, own_id)


def _order_or_extraction(form: Form, run: Run) -> str:
    """Return the requirement for a wrong processing order of containers, or for a container that is not extracted."""
    *unrelated, reversed_form = form.moved
    if any(run(other) is not None for other in unrelated):
        # This container has no effect, even if the other containers are about other variables.
        return "VD-RX-04"
    if run(reversed_form) is None and form.ordered:
        # The reverse order is correct for processing in order of reception, but not if only the first are extracted.
        return "VD-RX-04"
    return form.requirement


def forms(codec: Codec, steps: Sequence[Step]) -> Iterator[Form]:
    """Yield other forms of the last frame with several records, the coarse ones first."""
    for at in range(len(steps) - 1, -1, -1):
        step = steps[at]
        if isinstance(step, Frame):
            found = [
                Form(each.requirement, *_put(steps, at, each.steps, each.moved), each.ordered)
                for each in _split(codec, step)
            ]
            if found:
                yield from found
                return


def _put(
    steps: Sequence[Step], at: int, frames: list[Step], moved: tuple[list[Step], ...]
) -> tuple[list[Step], tuple[list[Step], ...]]:
    before, after = steps[:at], steps[at + 1 :]
    return [*before, *frames, *after], tuple([*before, *each, *after] for each in moved)


def _split(codec: Codec, frame: Frame) -> Iterator[Form]:
    """Yield the frame split into several: by blocks, by containers, by records."""
    try:
        beacon = codec.decode(frame.octets)
    except DecodeError:
        return
    replace = msgspec.structs.replace

    def sent(blocks: Sequence[Payload], *, together: bool = False) -> list[Step]:
        groups = [tuple(blocks)] if together else [(block,) for block in blocks]
        return [replace(frame, octets=codec.encode(replace(beacon, payloads=group)), valid=b"") for group in groups]

    order = _processing_order(codec)
    blocks = [
        replace(block, content=tuple(sorted(block.vardis, key=order))) if block.vardis is not None else block
        for block in beacon.payloads
    ]
    containers = [each for block in blocks for each in block.vardis or ()]
    try:
        if len(blocks) > 1:
            yield Form("BP-RX-07", sent(beacon.payloads))
        if any(len(block.vardis or ()) > 1 for block in blocks):
            # Use the required processing order, so that an effect of this form does not depend on the order.
            apart = [replace(block, content=(each,)) for block in blocks for each in block.vardis or ()]
            if _share_a_variable(containers):
                unrelated = [[_about_others(block, kept) for block in beacon.payloads] for kept in containers]
                backwards = [
                    replace(block, content=block.vardis[::-1]) if block.vardis is not None else block
                    for block in beacon.payloads
                ]
                moved = tuple(sent(form, together=True) for form in (*unrelated, backwards))
                yield Form("VD-RX-08", sent(apart), moved, tuple(blocks) == beacon.payloads)
            else:
                yield Form("VD-RX-04", sent(apart))
        if any(len(each.records) > 1 for each in containers):
            single = [
                replace(block, content=(replace(each, records=(record,)),))
                for block in blocks
                for each in block.vardis or ()
                for record in each.records
            ]
            yield Form("VD-RX-09", sent(single))
    except EncodeError:
        return


def _processing_order(codec: Codec) -> Callable[[Container], int]:
    """Return the sort key for the required processing order: creations, deletions, updates, then all others."""
    numbers = codec.profile.vardis.container_types.by_name()
    first = [numbers[kind.label] for kind in (ICType.CREATE_VARIABLES, ICType.DELETE_VARIABLES, ICType.UPDATES)]
    return lambda container: first.index(container.ic_type) if container.ic_type in first else len(first)


def _share_a_variable(containers: Sequence[Container]) -> bool:
    variables = [{var_id_of(record) for record in each.records} for each in containers]
    return any(one & other for at, one in enumerate(variables) for other in variables[at + 1 :])


def _about_others(block: Payload, kept: Container) -> Payload:
    """Return a block in which all containers except ``kept`` are about other variables."""
    if block.vardis is None:
        return block
    replace = msgspec.structs.replace

    def moved(record: VardisRecord) -> VardisRecord:
        other = var_id_of(record) ^ _FAR
        if isinstance(record, VarCreate):
            return replace(record, spec=replace(record.spec, var_id=other), upd=replace(record.upd, var_id=other))
        return replace(record, var_id=other)

    return replace(
        block,
        content=tuple(
            each if each is kept else replace(each, records=tuple(map(moved, each.records))) for each in block.vardis
        ),
    )


#: Requirement by state of a variable and message. A key without qualifier ("update") is for all others of its kind.
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


#: Requirements to ignore a message.
_IGNORED: Final = frozenset(
    {"VD-PC-01", "VD-PD-01", "VD-PD-02", "VD-PD-03", "VD-PU-02", "VD-PU-03", "VD-PU-05", "VD-PS-02", "VD-RU-02",
     "VD-RU-03", "VD-RC-02"}
)  # fmt: skip


def rule_about(state: str, message: str) -> str:
    """Return the requirement about a message in a state of its variable, both as named by :class:`Observer`, or ""."""
    rules = _RULES.get(state) or _RULES.get(state.partition(" ")[0], {})
    return rules.get(message) or rules.get(message.partition(" ")[0], "")


def rule_about_record(codec: Codec, record: VardisRecord, own_id: bytes) -> str:
    """Return the requirement to ignore a record in any state of its variable; empty if there is none."""
    limits = codec.profile.limits
    update = record.upd if isinstance(record, VarCreate) else record
    if isinstance(update, VarUpdate) and not 0 < len(update.value) <= limits.max_value_length:
        return "VD-PC-04" if isinstance(record, VarCreate) else "VD-PU-04"
    if not isinstance(record, VarCreate):
        return ""
    spec = record.spec
    if spec.prod_id == own_id:
        return "VD-PC-03"
    if not 0 < len(spec.descr) <= limits.max_description_length:
        return "VD-PC-05"
    return "" if 0 < spec.rep_cnt <= limits.max_repetitions else "VD-PC-06"


def _last_record(codec: Codec, steps: Sequence[Step]) -> VardisRecord | None:
    """Return the last record of the last valid frame with records, or None."""
    for step in reversed(steps):
        if isinstance(step, Frame):
            try:
                beacon = codec.decode(step.octets)
            except DecodeError:
                continue
            records = [
                record for payload in beacon.payloads for each in payload.vardis or () for record in each.records
            ]
            if records:
                last: VardisRecord = records[-1]
                return last
    return None


def last_message(codec: Codec, steps: Sequence[Step], own_id: bytes) -> tuple[str, str] | None:
    """Return state and message of the last record that the node received, from the model; None if there was none."""
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
    """Update the model by a service call, unless the model expects that it is refused."""
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
    """Return the requirement about the last message if the effect names none, or only a general one; else ""."""
    named = decided_by(effect)
    if effect.step < len(steps) and isinstance(steps[effect.step], Call):
        return ""
    if any(each.is_damage for step in steps if isinstance(step, Frame) for each in anomalies(codec, step.octets)):
        # The damaged frame before the last message is the cause.
        return ""
    if (named and not GENERAL.intersection(named)) or effect.kind not in ("said", "state"):
        return ""
    record = _last_record(codec, steps)
    last = last_message(codec, steps, own_id)
    if record is None or last is None:
        return ""
    if rule := rule_about_record(codec, record, own_id):
        return rule
    rule = rule_about(*last)
    # Sending too often after a message that is a reason to send is not a fault in the processing of that message.
    ignored = rule in _IGNORED and last[1] != "create later"
    return rule if ignored or effect.kind == "state" else ""


__all__ = ["Form", "broken_rule", "forms", "last_message", "rule_about", "rule_about_record"]
