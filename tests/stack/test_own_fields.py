"""Fields that a profile adds to records: given by applications and rules, stored and forwarded."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import click
import msgspec
import pytest

from dcp_codec import Codec
from dcp_codec.values import Container, VarCreate, VarDelete, VarSpec, VarSumm, VarUpdate
from dcp_stack.cli.var import _field
from dcp_stack.config import NodeConfig
from dcp_stack.effects import SendBeacon
from dcp_stack.node import Node
from dcp_stack.own_fields import OwnFields

from ..odd_profiles import write_profile

SPEC = VarSpec(1, bytes(6), 1, b"x", 1, 0)
CREATE = VarCreate(SPEC, VarUpdate(1, 0, b"v"))
MS = 1_000_000


@pytest.fixture
def codec(tmp_path: Path) -> Codec:
    return Codec(write_profile("odd-records", tmp_path))


@pytest.fixture
def fields(codec: Codec) -> OwnFields:
    return OwnFields(codec, {"VarUpdate.ttl": lambda update: 9 + update.seqno, "VarUpdate.colour": lambda _: 1})


def test_values_are_zero_until_they_are_given(fields: OwnFields) -> None:
    assert fields.values(fields.filled(SPEC)) == {"priority": 0, "key": b"\0\0"}
    given = fields.replaced(SPEC, fields.parsed({"key": "0102"}))
    assert fields.shown(given) == {"priority": 0, "key": "0102"}
    assert fields.values(fields.replaced(given, {"priority": 3})) == {"priority": 3, "key": b"\1\2"}


def test_rules_give_the_values_of_own_records(fields: OwnFields) -> None:
    assert fields.values(fields.filled(VarUpdate(1, 2, b""))) == {"ttl": 11, "key": b"\0\0"}
    assert fields.values(fields.replaced(VarUpdate(1, 2, b"x"), {"ttl": 7})) == {"ttl": 7, "key": b"\0\0"}


def test_a_name_of_several_parts_is_set_in_each(fields: OwnFields) -> None:
    made = fields.replaced(CREATE, {"key": b"\1\2", "ttl": 3, "mark": 0.5})
    assert fields.values(made) == {"mark": 0.5}
    assert (fields.values(made.spec), fields.values(made.upd)) == (
        {"priority": 0, "key": b"\1\2"},
        {"ttl": 3, "key": b"\1\2"},
    )


def test_values_of_stored_records_are_shown(fields: OwnFields) -> None:
    made, kept = fields.replaced(CREATE, {"priority": 4, "mark": 0.5}), dict[str, Any]()
    fields.keep(kept, made)
    assert fields.shown(made.spec, kept) == {"ttl": 9, "key": "0000", "mark": 0.5, "priority": 4}


@pytest.mark.parametrize(
    ("record", "given", "message"),
    [
        (SPEC, {"colour": 1}, r"no field 'colour' of its own \(it has: priority, key\)"),
        (SPEC, {"priority": 256}, "256 is not in 0..255"),
        (SPEC, {"key": b"\1"}, "spec.key"),
        (VarUpdate(1, 0, b"x"), {"priority": 1}, r"no field 'priority' .*it has: ttl, key"),
        (CREATE, {"ttl": -1}, "upd.ttl"),
    ],
)
def test_values_that_cannot_be_encoded_are_refused(
    fields: OwnFields, record: Any, given: dict[str, int | bytes], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        fields.replaced(record, given)


def test_wrong_hexadecimal_digits_are_refused(fields: OwnFields) -> None:
    with pytest.raises(ValueError, match="field 'key': octets are given as hexadecimal digits, not 'zz'"):
        fields.parsed({"key": "zz"})


def test_fields_on_the_command_line() -> None:
    assert [_field(each) for each in ("a=3", "b=1.5", "c=0x0a")] == [("a", 3), ("b", 1.5), ("c", "0a")]
    for wrong in ("a", "=3", "a=x"):
        with pytest.raises(click.BadParameter):
            _field(wrong)


class Rig:
    """A node, and the records and reports that it sends."""

    def __init__(self, codec: Codec, **rules: Any) -> None:
        self.codec, self.now = codec, 0
        rules = {name.replace("_", "."): (lambda _, value=value: value) for name, value in rules.items()}
        config = NodeConfig(node_id=b"\2" * 6, codec=codec, field_rules=rules)
        self.node = Node(config, rng=random.Random(1), now=0, wall=0)
        self.node.start(0, 0)
        self.vardis = self.node.vardis

    def hear(self, *records: Any) -> None:
        numbers = self.codec.profile.vardis.container_types.by_name()
        for record in records:
            octets = self.codec.encode_containers((Container(numbers[record.IC_TYPE.label], (record,)),))
            self.vardis.handle_payload(octets, now=self.now, wall=self.now)

    def sent(self, seconds: float = 1) -> list[Any]:
        found: list[Any] = []
        end = self.now + round(seconds * 1000) * MS
        while self.now < end:
            self.now += 10 * MS
            self.node.handle_timeout(self.now, self.now)
            for effect in self.node.take_effects():
                if isinstance(effect, SendBeacon):
                    for payload in self.codec.decode(effect.octets).payloads:
                        found += [payload.srp] if payload.srp else []
                        found += [record for each in payload.vardis or () for record in each.records]
        return found


def test_a_node_forwards_the_fields_of_each_record(codec: Codec) -> None:
    rig, extended = Rig(codec), codec.types.extended
    spec = extended(VarSpec(1, b"\3" * 6, 1, b"x", 1, 0), (5, b"ab"))
    create = extended(VarCreate(spec, extended(VarUpdate(1, 3, b"v"), (6, b"cd"))), (0.5,))
    update, delete = extended(VarUpdate(1, 4, b"w"), (7, b"ef")), extended(VarDelete(1), (8,))
    for record in (create, update, delete):
        rig.hear(record)
        assert record in rig.sent()
    later = msgspec.structs.replace(spec, creation_time=2)
    rig.hear(msgspec.structs.replace(create, spec=later, extra=(1.5,)))
    assert [each.extra for each in rig.sent() if isinstance(each, VarCreate)] == [(1.5,)]


def test_records_of_the_node_have_the_values_of_rules_and_applications(codec: Codec) -> None:
    rig = Rig(codec, VarUpdate_ttl=9, VarSumm_age=300, VarReqCreate_reason=2, ExtendedSafetyData_battery=77)
    times = {"now": 0, "wall": 0}
    rig.vardis.create(1, None, 1, b"d", b"v", own_fields={"priority": 3}, **times)
    rig.node.srp.update_safety_data({each.name: 0 for each in codec.profile.srp.safety_data}, **times)
    rig.hear(VarSumm(2, 1))
    sent = rig.sent()
    kinds = {type(each).__name__: each for each in sent}
    assert (kinds["VarCreate"].spec.priority, kinds["VarCreate"].upd.ttl) == (3, 9)
    assert (kinds["VarSumm"].age, kinds["VarReqCreate"].reason) == (300, 2)
    assert kinds["ExtendedSafetyData"].extra == (77,)
    rig.vardis.update_with_fields(1, b"w", {"ttl": 1}, now=rig.now, wall=rig.now)
    assert [each.ttl for each in rig.sent() if isinstance(each, VarUpdate)] == [1]
    rig.vardis.update(1, b"x", now=rig.now, wall=rig.now)
    assert [each.ttl for each in rig.sent() if isinstance(each, VarUpdate)] == [9]
    with pytest.raises(ValueError, match="256"):
        rig.vardis.update_with_fields(1, b"y", {"ttl": 256}, now=rig.now, wall=rig.now)
    assert rig.vardis.read(1).value == b"x"
