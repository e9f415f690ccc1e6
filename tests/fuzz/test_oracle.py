"""The independent model where long histories lead it: what the fuzzer taught about it."""

from __future__ import annotations

import pytest
from dcp_conformance.oracle import Limits, Oracle
from dcp_spec.constants import ICType, SpecVersion, features

from dcp_codec.values import VarCreate, VarDelete, VarSpec, VarSumm, VarUpdate

PEER = b"\x02\xdc\x90\x00\x00\x01"
OWN = b"\x02\x00\x00\x00\x00\x01"


@pytest.fixture
def oracle() -> Oracle:
    return Oracle(OWN, features(SpecVersion.V2_0), 1, Limits(32, 32, 15), latency=16, window=40)


def create(var_id: int, seqno: int) -> VarCreate:
    return VarCreate(VarSpec(var_id, PEER, 2, b"d", 1, 0), VarUpdate(var_id, seqno, b"v"))


def test_an_overtaken_update_is_not_due_after_sequence_numbers_wrapped(oracle):
    oracle.hear([create(1, 1)], 0, 1)
    # 173 is older than 1, so 1 has to be sent; 120 and 131 are newer, after which 1 looks newer than the sent number.
    for number, seqno in enumerate((173, 120, 131), start=2):
        oracle.hear([VarUpdate(1, seqno, b"n")], number, number)
    said = [(ICType.CREATE_VARIABLES, VarCreate(create(1, 1).spec, VarUpdate(1, 131, b"n")))]
    said += [(ICType.UPDATES, VarUpdate(1, 131, b"n"))]
    assert oracle.transmitted(said, 10, 9) == []
    assert oracle.overdue(1000) == []


def test_the_newest_update_is_due(oracle):
    oracle.hear([create(1, 1)], 0, 1)
    oracle.hear([VarUpdate(1, 2, b"n")], 1, 2)
    assert {(owed.var_id, owed.seqno) for owed in oracle.overdue(1000)} == {(1, 1), (1, 2)}


def test_overdue_records_are_reported_once_in_the_order_of_deadlines(oracle):
    oracle.hear([create(2, 0)], 0, 1)
    oracle.hear([create(1, 0)], 5, 2)
    assert oracle.overdue(40) == []
    assert [owed.var_id for owed in oracle.overdue(44)] == [2]
    assert [owed.var_id for owed in oracle.overdue(1000)] == [1]
    assert oracle.overdue(2000) == []


def test_no_record_is_due_of_a_variable_without_repetitions():
    old = Oracle(OWN, features(SpecVersion.V1_0), 1, Limits(32, 32, 15), latency=16, window=40)
    spec = VarSpec(4, PEER, 0, b"d")
    old.hear([VarCreate(spec, VarUpdate(4, 0, b"v"))], 0, 1)
    assert old.overdue(1000) == []


def test_a_creation_time_before_the_epoch_of_the_clock_is_valid():
    oracle = Oracle(OWN, features(SpecVersion.V2_0), 1, Limits(32, 32, 15), latency=16, window=40)
    for creation in (-(1 << 63), -5, 0):
        spec = VarSpec(4, PEER, 1, b"d", creation, 0)
        oracle.hear([VarCreate(spec, VarUpdate(4, 0, b"v"))], 0, 1)
        version = oracle.certain(4)
        assert version is not None
        assert version.spec == spec


def test_a_creation_that_should_have_been_rejected_is_reported_as_such(oracle):
    """Not as a wrong number or value of the one that was: it differs in who made it, when, and how often it stands."""
    oracle.hear([create(1, 1)], 0, 1)
    other = VarCreate(VarSpec(1, OWN[:-1] + b"\x09", 16, b"e", 5, 0), VarUpdate(1, 9, b"w"))
    oracle.hear([other], 20, 2)
    [complaint] = oracle.transmitted([(ICType.CREATE_VARIABLES, other)], 60, 3)
    assert complaint.requirement == "VD-PC-10"
    assert complaint.expected == "the creation of 02:dc:90:00:00:01 with repCnt 2, creationTime 1, timeout 0, descr 64"
    assert complaint.observed == "that of 02:00:00:00:00:09 with repCnt 16, creationTime 5, timeout 0, descr 65"


@pytest.mark.parametrize(
    ("kind", "record", "requirement"),
    [
        (ICType.CREATE_VARIABLES, create(1, 1), "VD-PD-04"),
        (ICType.UPDATES, VarUpdate(1, 1, b"v"), "VD-PD-04"),
        (ICType.SUMMARIES, VarSumm(1, 1), "VD-CMP-05"),
    ],
)
def test_records_of_a_deleted_variable_name_the_violated_rule(oracle, kind, record, requirement):
    """A deletion takes it out of all queues; that there are no summaries of it is a rule of its own."""
    oracle.hear([create(1, 1)], 0, 1)
    oracle.hear([VarDelete(1)], 1, 2)
    [complaint] = oracle.transmitted([(kind, record)], 100, 3)
    assert complaint.requirement == requirement
