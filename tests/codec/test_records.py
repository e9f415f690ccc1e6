"""The factory of records: fields that a layout lacks, and fields that a profile adds."""

from __future__ import annotations

from pathlib import Path

from dcp_spec.constants import ICType

from dcp_codec import Codec
from dcp_codec.records import RecordFactory
from dcp_codec.values import BPHeader, VarDelete, VarReqCreate, VarReqUpdate, VarSumm, VarUpdate

from ..odd_profiles import codec_of

NODE = b"\2\0\0\0\0\1"


def test_fields_that_the_layout_lacks_are_left_out() -> None:
    old, new = RecordFactory(Codec("dcp-1.2")), RecordFactory(Codec("dcp-2.0"))
    assert [old.stamped, new.stamped] == [False, True]
    specs = [each.spec(1, NODE, 2, b"d", 7, 300) for each in (old, new)]
    assert [(each.creation_time, each.timeout) for each in specs] == [(None, None), (7, 300)]
    assert [each.header(NODE, 3) for each in (old, new)] == [BPHeader(NODE, 3), BPHeader(NODE, 3, 0x1111)]
    assert RecordFactory(Codec("student-2024")).header(NODE, 3) is None


def test_each_type_has_the_arguments_that_it_has_fields_for() -> None:
    made = RecordFactory(Codec("dcp-2.0"))
    others = [kind for kind in ICType if kind is not ICType.CREATE_VARIABLES]
    records = [made.record(kind, 1, 2, b"v") for kind in others]
    expected = [VarSumm(1, 2), VarUpdate(1, 2, b"v"), VarReqUpdate(1, 2), VarReqCreate(1), VarDelete(1)]
    assert sorted(records, key=repr) == sorted(expected, key=repr)


def test_added_fields_are_asked_for_once(tmp_path: Path) -> None:
    asked: list[str] = []

    def value(record: object, member: object) -> int | float | bytes:
        asked.append(f"{type(record).__name__}.{member.name}")  # type: ignore[attr-defined]
        return b"\1\2" if asked[-1].endswith("key") else 1

    codec = codec_of("odd-records", tmp_path)
    made = RecordFactory(codec, value)
    create = made.create(made.spec(1, NODE, 1, b"d"), 2, b"v")
    assert asked == ["VarSpec.priority", "VarSpec.key", "VarUpdate.ttl", "VarUpdate.key", "VarCreate.mark"]
    assert made.filled(create) is create
    assert (create.upd.ttl, create.upd.key) == (1, b"\1\2")  # type: ignore[attr-defined]
    assert made.report(NODE, 1, 2).extra == (1,)


def test_safety_data_has_zeros_for_other_fields(tmp_path: Path) -> None:
    made = RecordFactory(codec_of("odd-widths", tmp_path))
    data = made.report(NODE, 1, 2, {"hidden": "0102030405", "battery": 7}).s_data.as_dict()
    assert data == {"x": 0, "hidden": b"\1\2\3\4\5", "y": 0, "heading": 0, "battery": 7, "serial": 0}
