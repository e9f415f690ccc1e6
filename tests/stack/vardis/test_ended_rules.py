"""Rules of VarDis that ended with 1.0, 1.1 or 1.3."""

from __future__ import annotations

import pytest
from dcp_spec.constants import QueueingMode
from dcp_spec.status import VardisStatus

from dcp_codec.values import VarReqCreate, VarReqUpdate

from ..vardis_rig import OTHER, Rig, VarCreate, VarDelete, VarSumm, VarUpdate

S = VardisStatus
BEFORE_2_0 = ("1.0", "1.1", "1.2", "1.3")


@pytest.mark.req("VD-CRE-16")
@pytest.mark.parametrize("version", BEFORE_2_0)
def test_an_identifier_in_the_database_is_refused(version: str):
    rig = Rig(version)
    rig.create(7, rep_cnt=3)
    rig.receive(rig.vc(8, prod_id=OTHER))
    assert {rig.create(each) for each in (7, 8)} == {S.VARIABLE_EXISTS}
    rig.delete(7)
    assert rig.create(7) is S.VARIABLE_EXISTS


@pytest.mark.req("VD-DEL-08")
@pytest.mark.parametrize("version", BEFORE_2_0)
def test_the_last_var_delete_removes_the_entry(version: str):
    rig = Rig(version)
    rig.create(7, rep_cnt=2)
    rig.delete(7)
    assert rig.count(VarDelete, 7, payloads=1) == 1
    assert rig.vardis.describe_variable(7).status is S.OK
    assert rig.count(VarDelete, 7, payloads=3) == 1
    assert rig.vardis.describe_variable(7).status is S.VARIABLE_DOES_NOT_EXIST
    assert rig.create(7) is S.OK


@pytest.mark.req("VD-DEL-09")
@pytest.mark.req("VD-UPD-12")
@pytest.mark.req("VD-REA-06")
@pytest.mark.parametrize("version", BEFORE_2_0)
def test_services_report_that_a_variable_is_being_deleted(version: str):
    rig = Rig(version)
    rig.create(7, rep_cnt=3)
    rig.delete(7)
    answers = {rig.delete(7), rig.update(7), rig.vardis.read(7).status}
    assert answers == {S.VARIABLE_BEING_DELETED}


@pytest.mark.req("VD-PC-11")
@pytest.mark.parametrize("version", BEFORE_2_0)
def test_a_var_create_of_a_known_variable_changes_nothing(version: str):
    rig = Rig(version)
    rig.receive(rig.vc(8, prod_id=OTHER, rep_cnt=3, seqno=5))
    before = rig.vardis.describe_variable(8).entry
    rig.receive(rig.vc(8, prod_id=b"\x02\0\0\0\0\x55", rep_cnt=1, seqno=9, value=b"other"))
    assert rig.vardis.describe_variable(8).entry == before
    rig.receive(VarDelete(8))
    rig.receive(rig.vc(8, prod_id=OTHER, seqno=9))
    assert rig.count(VarCreate, 8, payloads=1) == 0
    assert rig.vardis.read(8).status is S.VARIABLE_BEING_DELETED


@pytest.mark.req("VD-RU-05")
@pytest.mark.req("VD-RC-04")
@pytest.mark.parametrize("version", ["1.0", "1.1"])
def test_requests_for_an_unknown_variable_are_ignored_in_1_0(version: str):
    rig = Rig(version)
    rig.receive(VarReqUpdate(9, 1), VarReqCreate(10))
    assert sorted(rig.queue("reqCreateQ")) == ([] if version == "1.0" else [9, 10])


@pytest.mark.req("VD-PAY-07")
def test_the_order_of_containers_in_1_0():
    rig = Rig("1.0")
    for each in (1, 2, 3):
        rig.receive(rig.vc(each, prod_id=OTHER, seqno=3))
    rig.drain()
    rig.create(7)
    rig.receive(VarDelete(1), VarUpdate(2, 4, b"new"), VarSumm(3, 4), VarSumm(9, 1))
    kinds = list(dict.fromkeys(type(each) for each in rig.records()))
    assert kinds == [VarCreate, VarDelete, VarUpdate, VarSumm, VarReqCreate, VarReqUpdate]


@pytest.mark.req("VD-INI-07")
@pytest.mark.req("VD-INI-08")
@pytest.mark.parametrize(("version", "mode"), [("1.0", QueueingMode.ONCE), ("1.1", QueueingMode.QUEUE_DROPTAIL)])
def test_the_queueing_mode_of_1_0_and_1_1(version: str, mode: QueueingMode):
    registration = Rig(version).bp.registration
    assert registration is not None
    assert registration[3] is mode


@pytest.mark.req("VD-PAR-10")
def test_repetitions_have_no_upper_bound_in_1_1():
    vardis = Rig("1.1").vardis
    assert vardis.set_parameter("VARDISPAR_MAX_REPETITIONS", 200) is None
    assert vardis.set_parameter("VARDISPAR_MAX_REPETITIONS", 0) is not None
