"""Identifiers of nodes and variables for one case."""

from __future__ import annotations

import pytest
from dcp_conformance.errors import NamesUsedUp, StopCase
from dcp_conformance.test_system.identifiers.allocation import Identifiers
from dcp_conformance.test_system.identifiers.pool import IdentifierPool

from .parts import PERIOD, SUT, Parts


def test_no_virtual_node_has_the_identifier_of_the_implementation():
    parts = Parts()
    parts.run.sut_id = b"\x02\xdc\x90\x00\x00\x02"
    assert [parts.identifiers.node_id()[-1] for _ in range(3)] == [1, 3, 4]
    assert parts.identifiers.sut_id == parts.run.sut_id


def test_address_and_identifier_of_a_node_agree():
    node_id, address = Parts().identifiers.new_node()
    assert node_id == address == b"\x02\xdc\x90\x00\x00\x01"


def test_an_unknown_implementation_has_no_identifier():
    parts = Parts()
    parts.run.sut_id = None
    with pytest.raises(StopCase):
        _ = parts.identifiers.sut_id
    assert "no beacon received so far" in parts.verdicts.checks[0].observed


def test_unknown_identifiers_do_not_become_variables_of_the_case():
    parts = Parts()
    # An earlier case has used the first ones, so that the next one in turn is 6.
    earlier = Identifiers(parts.run, parts.link, parts.sut, parts.verdicts, set())
    assert earlier.var_ids(6) == [0, 1, 2, 3, 4, 5]
    identifiers = parts.identifiers
    assert identifiers.unknown_ids(10) == [15, 14, 13, 12, 11, 10, 9, 8, 7, 6]
    assert identifiers.called_unknown == {*range(6, 16)}
    assert identifiers.var_ids(2) == [0, 1]
    assert identifiers.created == {0, 1}


def test_a_created_variable_is_not_unknown_and_known_to_the_run():
    parts = Parts()
    identifiers = parts.identifiers
    identifiers.offered(15, 1)
    identifiers.created_by_others(14, application=True)
    identifiers.created_by_others(13)
    assert identifiers.unknown_id() == 12
    assert (identifiers.created, identifiers.produced) == ({15}, {14})
    assert not any(parts.run.identifier_pool.is_unknown(each, 0) for each in (13, 14, 15))


def test_a_boundary_value_is_used_once():
    parts = Parts()
    assert parts.identifiers.boundary_id("highest") == 15
    with pytest.raises(NamesUsedUp):
        parts.identifiers.boundary_id("highest")


def test_exhausted_identifiers_are_reported_with_remedies():
    parts = Parts()
    parts.run.identifier_pool = IdentifierPool(10, 13, leave=False, timed=True)
    with pytest.raises(NamesUsedUp):
        parts.identifiers.unknown_ids(5)
    observed = parts.verdicts.checks[-1].observed
    assert "4 of 4 are left" in observed
    assert all(remedy in observed for remedy in ("UT-Reset", "--start", "--restart", 'reset = "restart"'))


def test_identifiers_outside_the_range_of_the_tester_are_the_applications():
    parts = Parts()
    assert parts.identifiers.is_applications(16)
    assert not parts.identifiers.is_applications(15)


def test_a_deleted_variable_is_gone_after_its_repetitions():
    parts = Parts()
    parts.run.parameters["VARDISPAR_MAX_REPETITIONS"] = 2
    parts.link.time = 1000
    assert parts.identifiers.departure() == 1000 + 6 * PERIOD
    assert parts.run.sut_id == SUT


def test_a_variable_that_returns_after_each_reset_by_itself_is_an_applications():
    """The first beacons after a reset may have been composed before it."""
    pool = IdentifierPool(0, 15, leave=False, timed=True)
    assert pool.unknown(2, 0) == [15, 14]

    def reset_and_hear(beacon: int, var_id: int, *, own: bool = True) -> bool:
        pool.forget()
        for number in range(1, 10):
            heard = {var_id} if number == beacon else frozenset()
            pool.heard(heard, (), 0, heard if own else ())
        return var_id in pool.foreign

    assert not any(reset_and_hear(1, 15) for _ in range(5))
    # A neighbour's variable may return in a frame that a case has kept.
    assert not any(reset_and_hear(5, 15, own=False) for _ in range(5))
    assert [reset_and_hear(5, 14), reset_and_hear(5, 14)] == [False, True]
    pool.forget()
    pool.offered(15, 1)
    pool.heard({15}, (), 0)
    assert 15 not in pool.foreign
    assert 14 not in pool.unknown(15, 0)
