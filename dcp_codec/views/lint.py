"""Rules for a single well-formed message; violations in a dissection are reported as warnings."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from dcp_codec.errors import Problem
from dcp_codec.plan.tree import Group, Text

from .dissector import Doubt
from .fields import Dissection, Field


def _warning(
    field: Field, reason: str, requirement: str, needed: int | None = None, available: int | None = None
) -> Problem:
    return Problem(reason, field.path, field.offset, needed, available, requirement, "warning")


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
    # Either can be cut off: a profile may place upd before spec.
    if first and second and None not in (first.value, second.value) and first.value != second.value:
        yield _warning(second, "id-mismatch", "VD-TYP-07", first.value, second.value)


def _container(record: Field) -> Iterator[Problem]:
    records = record.child("records")
    if records is None:
        return
    seen: set[object] = set()
    where = ""
    for index, element in enumerate(records.children):
        spec = element.child("spec")
        var_id = (spec or element).child("varId")
        if var_id is None or var_id.value is None:
            continue
        if var_id.value in seen:
            # There can be hundreds of records; the path of their list is the same.
            where = where or records.path
            path = f"{where}[{index}].spec.varId" if spec else f"{where}[{index}].varId"
            yield Problem("duplicate-variable", path, var_id.offset, None, var_id.value, "VD-PAY-03", "warning")
        seen.add(var_id.value)


def _report(record: Field, sender: object) -> Iterator[Problem]:
    node = record.child("nodeId")
    if sender is None or node is None or isinstance(node.layout, Text):
        return
    if node.value not in (None, sender):
        yield _warning(node, "foreign-node-id", "SRP-TYP-04")


_RULES: dict[str, Callable[[Field], Iterator[Problem]]] = {
    "Payload": _payload,
    "VarUpdate": _var_update,
    "VarSpec": _var_spec,
    "VarCreate": _var_create,
    "Container": _container,
}

#: Record types that can cause a warning.
DOUBTS: dict[str, Doubt] = {
    "Payload": Doubt(("length",), lambda length: not length),
    "VarUpdate": Doubt(("value",), lambda value: not value),
    "VarSpec": Doubt(("repCnt", "descr"), lambda count, descr: not (count and descr and descr.isascii())),
    "VarCreate": Doubt(("spec.varId", "upd.varId"), lambda first, second: first != second),
    "Container": Doubt(("icNumRecords",), lambda count: count > 1),
    "ExtendedSafetyData": Doubt((), lambda: True),
}


def warnings(dissection: Dissection) -> list[Problem]:
    """Return every warning about a message that was dissected with :data:`DOUBTS`, in wire order."""
    found: list[Problem] = []
    header = dissection.root.child("bp")
    sender = header.child("senderId") if header is not None else None
    # A record is listed after the records inside it, which may have the same start.
    records = dissection.doubtful[::-1]
    records.sort(key=lambda each: each.offset)
    for record in records:
        assert isinstance(record.layout, Group)
        rule = _RULES.get(record.layout.type_name)
        found.extend(_report(record, None if sender is None else sender.value) if rule is None else rule(record))
    return found
