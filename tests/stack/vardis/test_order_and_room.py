"""The order of checks of services, and records that a payload has no room for (B.5, B.6)."""

from __future__ import annotations

import pytest
from dcp_spec.parameters import parameters
from dcp_spec.status import VardisStatus

from dcp_codec import get_codec
from dcp_codec.values import VarReqCreate, VarReqUpdate

from ..vardis_rig import OTHER, VERSIONS, Rig, VarCreate, VarDelete, VarSumm, VarUpdate

S = VardisStatus
LONG = bytes(33)


def _expected(rig: Rig, status: VardisStatus) -> VardisStatus:
    return status.in_version(rig.vardis._core.config.profile.spec_version)


@pytest.mark.req("VD-UPD-11")
@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("value", [LONG, b""])
def test_update_checks_the_variable_before_the_value(version: str, value: bytes):
    rig = Rig(version)
    assert rig.update(9, value) is S.VARIABLE_DOES_NOT_EXIST
    rig.receive(rig.vc(8))
    assert rig.update(8, value) is S.NOT_PRODUCER
    rig.create(7, rep_cnt=3)
    rig.delete(7)
    assert rig.update(7, value) is _expected(rig, S.VARIABLE_IS_DELETED)


@pytest.mark.req("VD-DEL-07")
@pytest.mark.req("VD-REA-05")
@pytest.mark.parametrize("version", VERSIONS)
def test_inactive_comes_first_and_the_producer_before_the_deletion(version: str):
    rig = Rig(version)
    rig.receive(rig.vc(8, rep_cnt=3))
    rig.receive(VarDelete(8))
    assert rig.delete(8) is S.NOT_PRODUCER
    rig.vardis.deactivate()
    assert {rig.delete(each) for each in (8, 9)} == {S.INACTIVE}
    assert {rig.vardis.read(each).status for each in (8, 9)} == {S.INACTIVE}
    assert {rig.update(each, value) for each in (8, 9) for value in (LONG, b"", b"-")} == {S.INACTIVE}


@pytest.mark.req("VD-SRV-03")
def test_a_confirm_means_that_the_change_has_happened():
    rig = Rig()
    rig.create(7)
    assert rig.update(7, b"new") is S.OK
    assert rig.vardis.read(7).value == b"new"
    assert rig.delete(7) is S.OK
    refused = rig.vardis.read(7)
    assert (refused.status, refused.value, refused.t_stamp) == (S.VARIABLE_IS_DELETED, None, None)


@pytest.mark.req("VD-CMP-13")
@pytest.mark.parametrize("kind", [VarUpdate, VarDelete, VarReqCreate, VarReqUpdate, VarSumm])
def test_records_without_room_stay_queued(kind: type):
    # Room for the VarCreate of variable 1 and one octet more.
    rig = Rig(max_payload_size=65, max_value_length=20, max_description_length=20, max_summaries=3)
    rig.create(1, rep_cnt=1, descr=b"d" * 20, value=b"v" * 20)
    rig.receive(rig.vc(8, rep_cnt=3, seqno=5))
    rig.drain()
    events = {
        VarUpdate: VarUpdate(8, 6, b"new"),
        VarDelete: VarDelete(8),
        VarReqCreate: VarSumm(9, 1),
        VarReqUpdate: VarSumm(8, 6),
        VarSumm: VarSumm(8, 5),
    }
    rig.receive(VarReqCreate(1), events[kind])
    full = rig.records()
    assert [type(each) for each in full] == [VarCreate]
    name = 9 if kind is VarReqCreate else 8
    expected = {VarUpdate: 3, VarDelete: 3, VarReqCreate: 1, VarReqUpdate: 1}.get(kind)
    count = rig.count(kind, name, payloads=6)
    assert count == expected if expected is not None else count > 0


@pytest.mark.req("VD-CMP-14")
@pytest.mark.parametrize("version", ["1.0", "1.1", "1.2"])
def test_purging_before_composing_removes_nothing(version: str):
    rig = Rig(version)
    rig.create(7, rep_cnt=3)
    rig.receive(rig.vc(8, rep_cnt=3))
    rig.delete(7)
    queues = {name: list(queue) for name, queue in rig.vardis._database.queues.items()}
    rig.vardis._database.purge()
    assert {name: list(queue) for name, queue in rig.vardis._database.queues.items()} == queues


@pytest.mark.req("VD-PAR-09")
@pytest.mark.parametrize("version", VERSIONS)
def test_every_parameter_of_the_version_can_be_set(version: str):
    rig = Rig(version)
    spec = get_codec(f"dcp-{version}").profile.spec_version
    named = {name for name, each in parameters().items() if each.protocol == "VD" and each.since <= spec}
    assert rig.vardis.parameters().keys() == named
    for name, value in rig.vardis.parameters().items():
        assert rig.vardis.set_parameter(name, value) is None


@pytest.mark.req("VD-TYP-09")
def test_another_node_can_neither_update_nor_delete_by_its_application():
    rig = Rig()
    rig.receive(rig.vc(8, prod_id=OTHER))
    assert rig.update(8) is S.NOT_PRODUCER
    assert rig.delete(8) is S.NOT_PRODUCER


@pytest.mark.req("VD-RX-10")
@pytest.mark.req("VD-RX-11")
@pytest.mark.parametrize("version", ["1.0", "1.1"])
def test_up_to_1_1_the_containers_before_a_bad_one_are_processed(version: str):
    rig = Rig(version)
    rig.receive_octets(rig.octets((VarSumm(9, 1),)) + b"\xff\x01\x00")
    assert rig.queue("reqCreateQ") == [9]
    # Records after it are not processed, in 1.1; in 1.0 the end of a container of unknown type is not known.
    rig.receive_octets(b"\xff\x01\x00" + rig.octets((VarSumm(10, 1),)))
    assert rig.queue("reqCreateQ") == [9]


# -- readings ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("reading", "deleted"), [("goes-on", True), ("pauses-while-inactive", False)])
def test_scrubbing_of_an_inactive_node(reading: str, deleted: bool):
    rig = Rig(readings={"X36": reading})
    rig.create(7, timeout=500)
    rig.vardis.deactivate()
    rig.wait(3000)
    entry = rig.vardis.entry(7)
    assert entry is not None
    assert entry.is_deleted is deleted
    rig.vardis.activate()
    rig.wait(1000)
    assert entry.is_deleted


@pytest.mark.parametrize(("reading", "left"), [("stay-queued", 2), ("are-dropped", 0)])
def test_pending_records_of_a_deactivated_node(reading: str, left: int):
    rig = Rig(readings={"X37": reading})
    rig.receive(rig.vc(8, rep_cnt=2), VarSumm(9, 1))
    rig.vardis.deactivate()
    rig.vardis.check_invariants()
    rig.vardis.activate()
    assert rig.queue("summaryQ") == [8]
    assert bool(rig.queue("reqCreateQ")) is bool(left)
    assert rig.count(VarCreate, 8, payloads=4) == left


@pytest.mark.parametrize(("reading", "version", "left"), [("are-dropped", "1.3", 0), ("stay-queued", "1.3", 1)])
def test_up_to_1_3_a_dropped_deletion_is_not_repeated(reading: str, version: str, left: int):
    rig = Rig(version, readings={"X37": reading})
    rig.create(7)
    rig.delete(7)
    rig.vardis.deactivate()
    assert len(rig.vardis._database) == left


def test_a_clock_that_is_set_decides_only_where_every_time_is_the_system_time():
    for reading, kept, earlier in (("steady-clock", True, False), ("system-clock", False, True)):
        rig = Rig(readings={"X38": reading})
        rig.create(7, timeout=60_000)
        rig.wall_offset += 24 * 3600 * 1_000_000_000
        rig.wait(1000)
        entry = rig.vardis.entry(7)
        assert entry is not None
        assert entry.is_deleted is not kept
        created = entry.spec.creation_time
        rig.wall_offset -= 48 * 3600 * 1_000_000_000
        rig.create(7)
        assert (rig.entry(7).spec.creation_time < created) is earlier


@pytest.mark.parametrize(("value", "taken"), [(0, 1), (16, 15), (7, 7)])
def test_the_nearest_legal_value_is_taken_under_that_reading(value: int, taken: int):
    rig = Rig(readings={"X39": "nearest-value"})
    assert rig.vardis.set_parameter("VARDISPAR_MAX_REPETITIONS", value) is None
    assert rig.vardis.parameters()["VARDISPAR_MAX_REPETITIONS"] == taken
    assert rig.vardis.set_parameter("VARDISPAR_MAX_REPETITIONS", "many") is not None


@pytest.mark.parametrize(("reading", "size"), [("register-anew", 500), ("registered-size", 100)])
def test_a_larger_payload_needs_another_registration(reading: str, size: int):
    rig = Rig(max_payload_size=100, max_value_length=30, max_description_length=30, readings={"X41": reading})
    assert rig.vardis.set_parameter("VARDISPAR_MAX_PAYLOAD_SIZE", 500) is None
    rig.create(1)
    assert rig.records(VarCreate)
    assert rig.vardis._registered_size == size
