"""Sizes of VarDis records on the wire and ranges of their fields, from the plan of the codec (DATA-02)."""

from __future__ import annotations

from dcp_spec.constants import ICType, seqno_modulus

from dcp_codec.codec import Codec
from dcp_codec.plan.measures import largest, least_size, longest, member, record
from dcp_codec.plan.tree import Group, Node, Scalar, Text
from dcp_codec.values import RECORD_CLASSES, Container, OwnRecord, VarCreate, VarSpec, VarUpdate


class RecordSizes:
    """Sizes on the wire in octets, and the ranges of fields that applications fill."""

    def __init__(self, codec: Codec) -> None:
        plan = codec.containers_plan
        layouts = {kind: _record(plan, each.__name__) for kind, each in RECORD_CLASSES.items()}
        spec, summary, update = (_record(plan, name) for name in ("VarSpec", "VarSumm", "VarUpdate"))
        self.ic_header = least_size(_record(plan, "Container"))
        self.var_summ = least_size(summary)
        self.var_update = least_size(update)
        """Octets of a VarUpdate without its value."""
        self.var_create = least_size(layouts[ICType.CREATE_VARIABLES])
        """Octets of a VarCreate without description and value, and without an identifier of variable length."""
        own = codec.profile.vardis.own_containers
        self.fixed: dict[ICType | str, int | None] = {kind: layout.size for kind, layout in layouts.items()} | {
            each.name: _record(plan, each.type_name).size for each in own
        }
        """Octets of each record by container type (by name for types that the profile adds), None if variable."""
        self._codec = codec
        self._own_numbers = {each.type_name: each.number for each in own}
        self._own_texts = [place for place, each in enumerate(_own_fields(spec)) if isinstance(each, Text)]
        producer = member(spec, "prodId")
        self._id_varies = isinstance(producer, Text)
        self.node_id_width = producer.size if isinstance(producer, Scalar) else None
        self.highest_var_id = largest(_scalar(summary, "varId"))
        self.highest_rep_cnt = largest(_scalar(spec, "repCnt"))
        # Layouts before 2.0 have neither field.
        self.highest_timeout = largest(_scalar(spec, "timeout")) if member(spec, "timeout") else 0
        self.highest_stamp = largest(_scalar(spec, "creationTime")) if member(spec, "creationTime") else 0
        description, value = member(spec, "descr"), member(update, "value")
        assert isinstance(description, Text)
        assert isinstance(value, Text)
        self.longest_description = longest(description)
        self.nul_terminated = description.terminated
        self.value_length_width = value.prefixes[0].size
        ##= VD-TYP-03
        self.seqno_modulus = seqno_modulus(_scalar(summary, "seqno").size)

    def update(self, value: bytes) -> int:
        """Return the octets of a VarUpdate with this value."""
        return self.var_update + len(value)

    def create(self, spec: VarSpec, value: bytes) -> int:
        """Return the octets of a VarCreate with this value."""
        producer = len(spec.prod_id) if self._id_varies else 0
        size = self.var_create + producer + len(spec.descr) + len(value)
        for place in self._own_texts:
            size += len(spec.extra[place])  # type: ignore[attr-defined]
        return size

    def own_record(self, number: int, record: OwnRecord) -> int:
        """Return the octets of a record of an added container type with this number."""
        return len(self._codec.encode_containers((Container(number, (record,)),))) - self.ic_header

    def record(self, record: VarCreate | VarUpdate | OwnRecord) -> int:
        """Return the octets of a decoded record whose type has no fixed size."""
        if isinstance(record, VarCreate):
            return self.create(record.spec, record.upd.value)
        if isinstance(record, OwnRecord):
            return self.own_record(self._own_numbers[type(record).__name__], record)
        return self.update(record.value)


def _record(plan: Node, name: str) -> Group:
    found = record(plan, name)
    assert found is not None, f"the profile has no {name}"
    return found


def _own_fields(group: Group) -> list[Node]:
    """Return the members that the profile adds to the specification's, in wire order."""
    return [each for each in group.members if isinstance(each, Scalar | Text) and each.role in ("extra", "opaque")]


def _scalar(group: Group, name: str) -> Scalar:
    found = member(group, name)
    assert isinstance(found, Scalar), f"{group.type_name} has no {name} of fixed size"
    return found
