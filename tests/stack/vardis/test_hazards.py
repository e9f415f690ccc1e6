"""Harmful effects of nodes that follow the specification to the letter (H1 to H4 and H7 to H9 of the readings).

These are not faults of a node. They are written down so that a change which removes one does not go unnoticed.
"""

from __future__ import annotations

import pytest
from dcp_spec.status import VardisStatus

from ..vardis_rig import (
    ME,
    OTHER,
    THIRD,
    WALL,
    Rig,
    VarCreate,
    VarDelete,
    VarReqCreate,
    VarReqUpdate,
    VarSumm,
    VarUpdate,
)


def exchange(one: Rig, other: Rig, rounds: int = 1) -> None:
    """Each in turn sends what it has to say."""
    for _ in range(rounds):
        for sender, receiver in ((one, other), (other, one)):
            containers = sender.sent()
            if containers:
                receiver.receive_octets(sender.codec.encode_containers(containers))


@pytest.mark.req("VD-RC-01")
def test_two_nodes_ask_each_other_for_ever() -> None:
    """H1."""
    one, other = Rig(), Rig(node_id=OTHER)
    one.receive(VarSumm(7, 0))
    exchange(one, other, 20)
    assert one.records(VarReqCreate) == [VarReqCreate(7)]


@pytest.mark.req("VD-PC-03")
def test_a_restarted_producer_requests_its_own_variable_without_success() -> None:
    """H2."""
    one, other = Rig(), Rig(node_id=OTHER)
    one.create()
    exchange(one, other, 3)
    restarted = Rig()
    exchange(restarted, other, 10)
    assert restarted.entry() is None
    assert restarted.drops().count("own-create") > 5


@pytest.mark.req("VD-PD-03")
@pytest.mark.req("VD-PD-04")
def test_a_deletion_ignored_by_the_producer_splits_a_variable_until_it_is_created_again() -> None:
    """H3."""
    one, other = Rig(), Rig(node_id=OTHER)
    one.create()
    exchange(one, other, 3)
    one.receive(VarDelete(7))
    other.receive(VarDelete(7))
    one.update()
    one.receive(VarReqCreate(7))
    exchange(one, other, 10)
    assert (one.read(), other.read()) == (b"EFGH", VardisStatus.VARIABLE_IS_DELETED)
    one.create(value=b"anew")
    exchange(one, other, 3)
    assert other.read() == b"anew"


@pytest.mark.req("VD-PC-01")
def test_a_producer_can_be_replaced() -> None:
    """H4."""
    rig = Rig()
    rig.create()
    rig.receive(rig.vc(value=b"mine", prod_id=THIRD, created=WALL + 1))
    assert rig.read() == b"mine"
    assert rig.update() is VardisStatus.NOT_PRODUCER
    assert rig.create() is VardisStatus.VARIABLE_EXISTS


@pytest.mark.req("VD-PC-01")
@pytest.mark.req("VD-CRE-03")
@pytest.mark.parametrize("deleted", [False, True])
def test_a_missed_new_creation_goes_unnoticed(deleted: bool) -> None:
    """H7. Only a VarCreate has a creation time; a node with the earlier variable does not ask for the new one."""
    one, other = Rig(), Rig(node_id=OTHER)
    one.create(value=b"before")
    for _ in range(9):
        one.update(value=b"before")
    exchange(one, other, 3)
    if deleted:
        one.delete()
        exchange(one, other, 3)
    one.create(value=b"anew", rep_cnt=1)
    assert len(one.records(VarCreate)) == 1  # lost
    exchange(one, other, 20)
    one.update(value=b"later")
    exchange(one, other, 20)
    assert one.read() == b"later"
    assert other.read() == (VardisStatus.VARIABLE_IS_DELETED if deleted else b"before")


@pytest.mark.req("VD-PU-07")
def test_a_value_of_an_earlier_creation_can_seem_newer() -> None:
    """H8. An update that was composed before its sender heard of the new creation."""
    rig = Rig()
    rig.receive(rig.vc(value=b"anew", seqno=0, created=WALL + 1))
    rig.receive(VarUpdate(7, 9, b"before"))
    assert rig.read() == b"before"
    rig.receive(VarSumm(7, 0))  # of the producer, which ignores the update
    assert rig.records(VarUpdate) == [VarUpdate(7, 9, b"before")]
    assert rig.records(VarReqUpdate) == []
    assert rig.entry().spec.prod_id == OTHER != ME


@pytest.mark.req("VD-PU-06", "VD-PS-03", "VD-PU-03")
def test_a_consumer_that_missed_half_the_range_starves() -> None:
    """H9."""
    one, other = Rig(), Rig(node_id=OTHER)
    one.create(value=b"first")
    exchange(one, other, 3)
    for number in range(129):
        one.update(value=b"%d" % number)
    exchange(one, other, 5)
    assert (one.read(), other.read()) == (b"128", b"first")
    assert "update-own" in one.drops()  # the producer ignores it
    for number in range(129, 256):
        one.update(value=b"%d" % number)
        exchange(one, other, 2)
        assert other.read() == b"first"
    # The number is that of the first value again; the next one is newer.
    one.update(value=b"caught up")
    exchange(one, other, 2)
    assert other.read() == b"caught up"
