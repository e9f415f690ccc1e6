"""Contents of payloads: order, sizes, repetition, round robin (B.6)."""

from __future__ import annotations

import msgspec
import pytest
from dcp_spec.constants import ICType
from hypothesis import given
from hypothesis import strategies as st

from dcp_codec import Codec, get_codec

from ..vardis_rig import (
    OTHER,
    VERSIONS,
    WALL,
    Rig,
    VarCreate,
    VarDelete,
    VarReqCreate,
    VarReqUpdate,
    VarSumm,
    VarUpdate,
)

NEW_ORDER = ["CREATE-VARIABLES", "DELETE-VARIABLES", "REQUEST-VARCREATES", "SUMMARIES", "UPDATES", "REQUEST-VARUPDATES"]
OLD_ORDER = ["CREATE-VARIABLES", "DELETE-VARIABLES", "UPDATES", "SUMMARIES", "REQUEST-VARCREATES", "REQUEST-VARUPDATES"]


def labels(rig: Rig, containers: tuple) -> list[str]:
    names = {number: name for name, number in rig.numbers.items()}
    return [names[container.ic_type] for container in containers]


def with_everything_pending(version: str = "2.0", **settings) -> Rig:
    """Variables 1 created, 2 deleted, 3 updated, 4 requested, 5 outdated at a neighbour."""
    rig = Rig(version, **settings)
    for var_id in (2, 3):
        rig.create(var_id)
    rig.receive(rig.vc(5))
    rig.drain()
    rig.delete(2)
    rig.update(3)
    rig.create(1)
    rig.receive(VarSumm(4, 0), VarSumm(5, 9))
    return rig


@pytest.mark.req("VD-PAY-01")
@pytest.mark.req("VD-IC-01")
@pytest.mark.req("VD-IC-02")
@pytest.mark.req("VD-IC-03")
@pytest.mark.parametrize("version", VERSIONS)
def test_order_of_containers(version: str) -> None:
    rig = with_everything_pending(version)
    containers = rig.sent()
    assert labels(rig, containers) == (OLD_ORDER if version == "1.0" else NEW_ORDER)
    found = [record for container in containers for record in container.records]
    expected = [
        rig.entry(1).spec.var_id,
        VarDelete(2),
        VarReqCreate(4),
        VarSumm(3, 1),
        VarSumm(5, 0),
        VarSumm(1, 0),
        VarUpdate(3, 1, b"EFGH"),
        VarReqUpdate(5, 0),
    ]
    found[0] = found[0].spec.var_id
    assert sorted(map(repr, found)) == sorted(map(repr, expected))


@pytest.mark.req("VD-IC-02")
def test_container_numbers_are_those_of_the_profile() -> None:
    rig = Rig(profile="student-2024")
    rig.vardis.create(7, None, 1, b"d", b"v", now=0, wall=WALL)
    rig.bp.take()
    rig.wait(1000)
    payload = rig.bp.take()
    assert payload is not None
    assert payload[0] == 0
    assert [container.ic_type for container in rig.codec.decode_containers(payload)] == [0, 3]


@pytest.mark.req("VD-PAY-04")
@pytest.mark.req("VD-CMP-01")
def test_no_payload_is_composed_if_nothing_is_pending() -> None:
    rig = Rig(max_summaries=0)
    rig.create(rep_cnt=1)
    assert rig.sent() != ()
    assert rig.sent() == ()
    assert len(rig.bp.submitted) == 1


@pytest.mark.req("VD-SCP-02")
@pytest.mark.req("VD-CMP-06")
@pytest.mark.req("VD-CMP-09")
@pytest.mark.req("VD-CMP-10")
@pytest.mark.req("VD-PC-09")
@pytest.mark.req("VD-PU-07")
@pytest.mark.req("VD-PD-04")
@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("rep_cnt", [1, 2, 15])
def test_repetitions_are_exact_for_producers_and_consumers(version: str, rep_cnt: int) -> None:
    rig = Rig(version, max_repetitions=15)
    rig.create(1, rep_cnt=rep_cnt)
    assert rig.count(VarCreate, 1) == rep_cnt
    rig.update(1)
    assert rig.count(VarUpdate, 1) == rep_cnt
    rig.delete(1)
    assert rig.count(VarDelete, 1) == rep_cnt
    rig.receive(rig.vc(2, rep_cnt=rep_cnt))
    assert rig.count(VarCreate, 2) == rep_cnt
    rig.receive(VarUpdate(2, 1, b"v"))
    assert rig.count(VarUpdate, 2) == rep_cnt
    rig.receive(VarReqUpdate(2, 0), VarReqCreate(2))
    assert rig.entry(2).count_create == rig.entry(2).count_update == rep_cnt
    assert rig.count(VarUpdate, 2) == rep_cnt
    rig.receive(VarDelete(2))
    assert rig.count(VarDelete, 2) == rep_cnt


@pytest.mark.req("VD-SCP-02")
@pytest.mark.req("VD-CMP-06")
def test_repetitions_come_in_the_next_payloads() -> None:
    rig = Rig()
    rig.create(1, rep_cnt=3)
    rig.create(2, rep_cnt=3)
    found = [[record.spec.var_id for record in rig.records(VarCreate)] for _ in range(4)]
    assert found == [[1, 2], [1, 2], [1, 2], []]


@pytest.mark.req("VD-SCP-03")
@pytest.mark.req("VD-SCP-01")
def test_summaries_and_requests_are_not_repeated() -> None:
    rig = Rig(max_summaries=0)
    rig.receive(rig.vc(seqno=3))
    rig.drain()
    rig.receive(rig.vc(seqno=3), VarUpdate(7, 3, b"x"), VarSumm(7, 3), VarReqUpdate(7, 3))
    assert rig.sent() == ()
    rig.receive(VarReqUpdate(9, 4), VarReqCreate(8))
    assert rig.records() == [VarReqCreate(8), VarReqCreate(9)]  # own requests, not theirs
    assert rig.sent() == ()


@pytest.mark.req("VD-UPD-10")
@pytest.mark.req("VD-CMP-04")
@pytest.mark.req("VD-CMP-07")
def test_instructions_carry_the_newest_value() -> None:
    rig = Rig()
    rig.create(value=b"first", rep_cnt=2)
    rig.sent()
    for value in (b"second", b"third"):
        rig.update(value=value)
    create, summary, update = rig.records()
    assert (create.upd.seqno, create.upd.value) == (2, b"third")
    assert (summary, update) == (VarSumm(7, 2), VarUpdate(7, 2, b"third"))


@pytest.mark.req("VD-TYP-06")
@pytest.mark.req("VD-PC-10")
@pytest.mark.parametrize("version", VERSIONS)
def test_the_attributes_of_others_are_forwarded_unchanged(version: str) -> None:
    rig = Rig(version)
    sent = rig.vc(7, b"v", seqno=9, created=WALL - 12345, timeout=777, descr="ä\x01".encode())
    rig.receive(sent)
    assert rig.records(VarCreate) == [sent]
    rig.receive(VarUpdate(7, 10, b"w"))
    (forwarded,) = rig.records(VarCreate)
    assert forwarded.spec == sent.spec
    assert forwarded.upd == VarUpdate(7, 10, b"w")


@pytest.mark.req("VD-CMP-11")
@pytest.mark.req("VD-CMP-12")
@pytest.mark.req("VD-PS-01")
@pytest.mark.req("VD-PS-04")
def test_requests_are_sent_once() -> None:
    rig = Rig()
    rig.receive(rig.vc(7, seqno=3))
    rig.drain()
    rig.receive((VarSumm(7, 5), VarSumm(9, 5)))
    assert rig.records(VarReqUpdate) == [VarReqUpdate(7, 3)]
    assert rig.count(VarReqUpdate) == rig.count(VarReqCreate, 9) == 0
    rig.receive((VarSumm(7, 5), VarSumm(9, 5)))
    assert rig.records(VarReqCreate) == [VarReqCreate(9)]


@pytest.mark.req("VD-CMP-02")
@pytest.mark.req("VD-CMP-03")
@pytest.mark.req("VD-TYP-08")
@pytest.mark.parametrize(("variables", "most"), [(30, 10), (7, 3), (3, 10), (5, 1)])
def test_summaries_go_round(variables: int, most: int) -> None:
    rig = Rig(max_summaries=most)
    for var_id in range(variables):
        rig.create(var_id, b"v", rep_cnt=1)
    rig.drain()
    found: list[int] = []
    for _ in range(variables):
        chosen = [record.var_id for record in rig.records(VarSumm)]
        assert len(chosen) == len(set(chosen)) == min(variables, most)
        found += chosen
    # Each in its turn, so every one equally often.
    assert found == [found[index % variables] for index in range(len(found))]
    assert sorted(found[:variables]) == list(range(variables))


@pytest.mark.req("VD-CMP-05")
def test_deleted_variables_are_not_summarised() -> None:
    rig = Rig()
    for var_id in (1, 2, 3):
        rig.create(var_id)
    rig.delete(2)
    assert [record.var_id for record in rig.records(VarSumm)] == [1, 3]


@pytest.mark.req("VD-PAY-02")
@pytest.mark.req("VD-PAY-06")
@pytest.mark.req("VD-CMP-08")
def test_counting_stops_at_the_first_record_that_does_not_fit() -> None:
    # VarUpdate is 3 octets and the value, its container 2 more.
    rig = Rig(max_payload_size=80, max_description_length=4, max_summaries=0)
    for var_id in (1, 2, 3, 4):
        rig.create(var_id, b"v", descr=b"d", rep_cnt=1)
    rig.drain()
    for var_id, length in ((1, 32), (2, 32), (3, 32), (4, 1)):
        rig.update(var_id, bytes(length))
    assert [record.var_id for record in rig.records(VarUpdate)] == [1, 2]
    assert [record.var_id for record in rig.records(VarUpdate)] == [3, 4]


@pytest.mark.req("VD-CMP-08")
def test_a_head_that_does_not_fit_makes_room_for_other_containers() -> None:
    rig = Rig(max_payload_size=64, max_description_length=4)
    rig.create(1, bytes(32), descr=b"d", rep_cnt=1)  # 57 octets with its container
    rig.create(2, bytes(32), descr=b"d", rep_cnt=1)
    first, second = rig.sent(), rig.sent()
    assert labels(rig, first) == labels(rig, second) == ["CREATE-VARIABLES", "SUMMARIES"]
    assert [len(container.records) for container in first] == [1, 2]
    assert second[0].records[0].spec.var_id == 2


@pytest.mark.req("VD-CMP-08")
@pytest.mark.req("VD-ROB-01")
def test_a_record_too_large_for_lowered_limits_waits_without_blocking() -> None:
    rig = Rig()
    rig.create(1, bytes(32), descr=bytes(32))
    rig.create(2, b"v", descr=b"d")
    rig.vardis.set_parameter("VARDISPAR_MAX_PAYLOAD_SIZE", 60)
    assert [record.spec.var_id for record in rig.records(VarCreate)] == [2]
    assert rig.queue("createQ") == [1, 2]
    rig.vardis.set_parameter("VARDISPAR_MAX_PAYLOAD_SIZE", 600)
    assert rig.count(VarCreate, 1) == 2


@pytest.mark.req("VD-IC-05")
@pytest.mark.req("VD-PAY-02")
@pytest.mark.req("VD-PAY-06")
@pytest.mark.parametrize("version", VERSIONS)
def test_every_limit_is_kept_and_used_to_the_last_octet(version: str) -> None:
    """Two containers in one payload, with the limit at every size from nothing to everything."""
    reference = with_everything_pending(version)
    reference.bp.take()
    whole = reference.octets(*(container.records for container in reference.sent()))
    order = reference.config.features.container_order
    for limit in range(1, len(whole) + 3):
        rig = with_everything_pending(version)
        rig.vardis.set_parameter("VARDISPAR_MAX_PAYLOAD_SIZE", limit)
        containers = rig.sent()  # which checks the limit
        sizes = {
            label: len(rig.octets(container.records))
            for label, container in zip(labels(rig, containers), containers, strict=True)
        }
        room = limit - sum(sizes.values())
        assert room >= 0
        # Missing records would not have fitted when their turn came.
        used = 0
        for kind in order:
            found = sizes.get(kind.label, 0)
            needed = least(rig, kind)
            if not found:
                assert used + needed > limit, (limit, kind)
            used += found
        if limit >= len(whole):
            assert rig.octets(*(container.records for container in containers)) == whole


def least(rig: Rig, kind: ICType) -> int:
    """Octets of a container with one record of those that are pending in these tests."""
    sizes = {
        ICType.CREATE_VARIABLES: (rig.vc(1),),
        ICType.DELETE_VARIABLES: (VarDelete(2),),
        ICType.REQUEST_VARCREATES: (VarReqCreate(4),),
        ICType.SUMMARIES: (VarSumm(3, 1),),
        ICType.UPDATES: (VarUpdate(3, 1, b"EFGH"),),
        ICType.REQUEST_VARUPDATES: (VarReqUpdate(5, 0),),
    }
    return len(rig.octets(sizes[kind]))


def wide(containers_per_type: str) -> Codec:
    """Variables with identifiers of two octets, so that there are more than a container holds."""
    profile = get_codec("dcp-2.0").profile
    types = msgspec.structs.replace(profile.types, var_id=msgspec.structs.replace(profile.types.var_id, width=2))
    behaviour = msgspec.structs.replace(profile.behaviour, containers_per_type=containers_per_type)
    limits = msgspec.structs.replace(profile.limits, max_vardis_payload=1400)
    return Codec(msgspec.structs.replace(profile, types=types, behaviour=behaviour, limits=limits))


@pytest.mark.req("VD-PAY-05")
@pytest.mark.req("VD-IC-04")
@pytest.mark.req("VD-PAY-03")
@pytest.mark.parametrize(("containers_per_type", "expected"), [("one", [255]), ("several", [255, 44])])
def test_more_records_than_a_container_can_hold(containers_per_type: str, expected: list[int]) -> None:
    rig = Rig(codec=wide(containers_per_type), max_summaries=400)
    for first in (0, 150):
        rig.receive(tuple(VarSumm(var_id, 0) for var_id in range(first, first + 150)[: 150 - (first > 0)]))
    containers = rig.sent()
    assert [len(container.records) for container in containers] == expected
    ids = [record.var_id for container in containers for record in container.records]
    assert len(ids) == len(set(ids))


@pytest.mark.req("VD-CMP-02")
def test_the_limit_of_summaries_is_for_the_payload() -> None:
    rig = Rig(codec=wide("several"), max_summaries=300)
    for var_id in range(320):
        rig.vardis.create(var_id, None, 1, b"d", b"v", now=0, wall=WALL)
    rig.drain()
    assert [len(container.records) for container in rig.sent()] == [255, 45]


@pytest.mark.req("VD-PAY-03")
@pytest.mark.req("VD-IC-05")
@pytest.mark.req("VD-PAY-02")
@given(st.data())
def test_any_pending_instructions_fit_and_are_distinct(data: st.DataObject) -> None:
    limit = data.draw(st.integers(70, 300))
    rig = Rig(max_payload_size=limit, max_description_length=8, max_summaries=data.draw(st.integers(0, 30)))
    for _ in range(data.draw(st.integers(0, 30))):
        var_id = data.draw(st.integers(0, 9))
        match data.draw(st.sampled_from("cudrsq")):
            case "c":
                rig.create(
                    var_id, data.draw(st.binary(min_size=1, max_size=32)), descr=b"d" * data.draw(st.integers(1, 8))
                )
            case "u":
                rig.update(var_id, data.draw(st.binary(min_size=1, max_size=32)))
            case "d":
                rig.delete(var_id)
            case "r":
                rig.receive(VarReqCreate(var_id), VarReqUpdate(var_id, 255))
            case "s":
                rig.receive(rig.vc(var_id + 10), VarSumm(var_id + 10, 3))
            case "q":
                for container in rig.sent():
                    ids = [r.spec.var_id if isinstance(r, VarCreate) else r.var_id for r in container.records]
                    assert len(ids) == len(set(ids)) <= 255
    rig.drain(400)


@pytest.mark.req("VD-CMP-06")
def test_a_received_repetition_count_of_zero_is_stored_and_not_repeated_before_1_2() -> None:
    for version in ("1.0", "1.1"):
        rig = Rig(version)
        rig.receive(rig.vc(rep_cnt=0, prod_id=OTHER))
        assert rig.read() == b"ABCD"
        rig.receive(VarUpdate(7, 1, b"w"), VarReqCreate(7))
        assert rig.records() == [VarSumm(7, 1)]
        rig.receive(VarDelete(7))
        assert rig.entry() is None
        assert rig.sent() == ()


def test_purging_changes_nothing_where_queues_are_right() -> None:
    for readings in ({}, {"X17": "purge-first"}):
        rig = Rig(readings=readings)
        rig.create(1)
        rig.receive(rig.vc(2), VarSumm(3, 1), VarSumm(2, 9))
        rig.delete(1)
        assert [type(record).__name__ for record in rig.records()] == [
            "VarCreate",
            "VarDelete",
            "VarReqCreate",
            "VarSumm",
            "VarReqUpdate",
        ]


@pytest.mark.req("VD-Q-01")
@pytest.mark.req("DATA-12")
def test_queues_are_first_in_first_out() -> None:
    rig = Rig(max_summaries=0, max_repetitions=2)
    order = [5, 3, 9, 1]
    for var_id in order:
        rig.create(var_id)
    rig.receive(tuple(VarSumm(100 + var_id, 0) for var_id in order))
    assert [record.spec.var_id for record in rig.sent()[0].records] == order
    rig.create(3)  # withdrawn and put to the tail
    assert [record.spec.var_id for record in rig.records(VarCreate)] == [5, 9, 1, 3]
    for var_id in order:
        rig.update(var_id)
    rig.update(5)  # stays where it is
    assert [record.var_id for record in rig.records(VarUpdate)] == order
    for var_id in order:
        rig.delete(var_id)
    assert [record.var_id for record in rig.records(VarDelete)] == order


@pytest.mark.req("VD-CMP-06")
@pytest.mark.req("VD-CMP-09")
@pytest.mark.req("VD-CMP-10")
def test_repetitions_are_queued_after_waiting_records() -> None:
    rig = Rig(max_payload_size=60, max_description_length=4, max_summaries=0)
    for var_id in (1, 2, 3):
        rig.create(var_id, bytes(30), descr=b"d", rep_cnt=2)
    assert [rig.records()[0].spec.var_id for _ in range(6)] == [1, 2, 3, 1, 2, 3]
    for var_id in (1, 2, 3):
        rig.update(var_id, bytes(31))
    assert [rig.records()[0].var_id for _ in range(6)] == [1, 2, 3, 1, 2, 3]
    rig.vardis.set_parameter("VARDISPAR_MAX_PAYLOAD_SIZE", 3)
    for var_id in (1, 2, 3):
        rig.delete(var_id)
    assert [rig.records()[0].var_id for _ in range(6)] == [1, 2, 3, 1, 2, 3]
