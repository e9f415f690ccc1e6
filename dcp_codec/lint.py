"""Rules that a single well-formed message can break: found in a dissection, reported as warnings."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from .dissect import Dissection, Field
from .errors import Problem
from .plan import Group, Text


def _warning(
    field: Field, reason: str, requirement: str, needed: int | None = None, available: int | None = None
) -> Problem:
    return Problem(reason, field.path, field.offset, needed, available, requirement, "warning")


def _value_of(record: Field, name: str) -> object:
    field = record.child(name)
    return None if field is None else field.value


def _payload(record: Field) -> Iterator[Problem]:
    length = record.child("length")
    if length is not None and length.value == 0:
        yield _warning(length, "empty-payload", "BP-TXP-03", 1, 0)


def _var_update(record: Field) -> Iterator[Problem]:
    value = record.child("value")
    if value is not None and value.value == b"":
        yield _warning(value, "empty-value", "VD-TYP-02", 1, 0)


def _var_spec(record: Field) -> Iterator[Problem]:
    rep_cnt, descr = record.child("repCnt"), record.child("descr")
    if rep_cnt is not None and rep_cnt.value == 0:
        yield _warning(rep_cnt, "zero-repetitions", "VD-PC-06", 1, 0)
    if descr is None or descr.value is None:
        return
    if descr.value == b"":
        yield _warning(descr, "empty-description", "VD-PC-05", 1, 0)
    try:
        descr.value.decode()
    except UnicodeDecodeError:
        yield _warning(descr, "invalid-utf8", "DATA-08")


def _var_create(record: Field) -> Iterator[Problem]:
    spec, upd = record.child("spec"), record.child("upd")
    if spec is None or upd is None:
        return
    first, second = spec.child("varId"), upd.child("varId")
    if first and second and second.value is not None and first.value != second.value:
        yield _warning(second, "id-mismatch", "VD-TYP-07", first.value, second.value)


def _container(record: Field) -> Iterator[Problem]:
    records = record.child("records")
    seen: set[object] = set()
    for element in records.children if records is not None else ():
        spec = element.child("spec")
        var_id = (spec or element).child("varId")
        if var_id is None or var_id.value is None:
            continue
        if var_id.value in seen:
            yield _warning(var_id, "duplicate-variable", "VD-PAY-03", None, var_id.value)
        seen.add(var_id.value)


_RULES: dict[str, Callable[[Field], Iterator[Problem]]] = {
    "Payload": _payload,
    "VarUpdate": _var_update,
    "VarSpec": _var_spec,
    "VarCreate": _var_create,
    "Container": _container,
}


def warnings(dissection: Dissection) -> list[Problem]:
    """Every warning about a dissected message, in wire order."""
    found: list[Problem] = []
    header = dissection.root.child("bp")
    sender = _value_of(header, "senderId") if header is not None else None
    waiting = [dissection.root]
    while waiting:
        field = waiting.pop()
        # What has no parts breaks no rule, and most of a message is such.
        waiting.extend([part for part in reversed(field.children) if part.children])
        if type(field.layout) is not Group:
            continue
        rule = _RULES.get(field.layout.type_name)
        if rule is not None:
            found.extend(rule(field))
        elif field.layout.type_name == "ExtendedSafetyData" and sender is not None:
            node = field.child("nodeId")
            if node is not None and node.value not in (None, sender) and not isinstance(node.layout, Text):
                found.append(_warning(node, "foreign-node-id", "SRP-TYP-04"))
    return found
