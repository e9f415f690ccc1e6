"""Which names the bench hands out, and what makes it stop when there are no more."""

from __future__ import annotations

import pytest
from dcp_conformance.definitions.pics import Pics, Testing
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.errors import NamesUsedUp
from dcp_conformance.reference.inprocess import InProcess, VirtualLowerTester, reference_config
from dcp_conformance.test_steps.bp_clients import unused_protocol_id
from dcp_conformance.test_system.bench import Bench, Session
from dcp_conformance.test_system.identifiers.pool import IdentifierPool

from ..rig import codec_of, known_cases

#: For those whose deletion takes until 100 (ns).
GONE = 100


class Ticking(VirtualLowerTester):
    """Reading the clock takes 100 ns."""

    def __init__(self, sut: InProcess) -> None:
        super().__init__(sut)
        self.ticks = 0

    def now(self) -> int:
        self.ticks += 100
        return super().now() + self.ticks


def bench_of(profile: str = "dcp-2.0", pics: Pics | None = None) -> Bench:
    codec = codec_of(profile)
    sut = InProcess(reference_config(codec))
    session = Session(codec, Ticking(sut), sut.upper_tester(), pics or Pics())
    return Bench(session, next(iter(known_cases().values())))


def timed() -> IdentifierPool:
    """As since 2.0: 16 identifiers, which stay in the database, 8 of them shared by peers."""
    return IdentifierPool(0, 15, leave=False, timed=True)


def leaving() -> IdentifierPool:
    """As up to 1.3: deleted variables leave the database."""
    return IdentifierPool(0, 15, leave=True, timed=False)


def beacons(names: IdentifierPool, count: int) -> None:
    for _ in range(count):
        names.heard((), (), GONE)


# -- what is unknown ---------------------------------------------------------------------------------------------------


def test_unknown_identifiers_are_given_from_the_top_in_turn():
    names = timed()
    assert names.unknown(3, 0) == [15, 14, 13]
    assert names.unknown(2, 0, without=(12,)) == [11, 10]
    # The tester has not created them: they are offered again after the others.
    assert names.unknown(16, 0) == [9, 8, 7, 6, 5, 4, 3, 2, 1, 0, 15, 14, 13, 12, 11, 10]


@pytest.mark.parametrize("by_peer", [True, False])
def test_a_variable_that_may_have_been_created_is_not_unknown(by_peer: bool):
    names = timed()
    names.offered(15, 7, by_peer=by_peer)
    assert 15 not in names.unknown(16, 0)
    assert names.left(0) == 15


def test_a_variable_that_only_the_database_shows_is_not_unknown():
    names = timed()
    names.heard((3,), (4,), GONE)
    assert not names.is_unknown(3, 0)
    assert not names.is_unknown(4, 0)


def test_since_2_0_a_deleted_variable_stays_known_for_good():
    names = timed()
    names.offered(3, 1)
    names.deleted(3, GONE)
    names.heard((), (3,), GONE)
    beacons(names, 100)
    assert not names.is_unknown(3, 10 * GONE)


def test_after_a_reset_everything_is_unknown_but_variables_of_an_application():
    """An application on the node creates its variable again."""
    names = timed()
    names.offered(3, 1)
    (handed,) = names.unknown(1, 0)
    names.heard((4, handed), (5,), GONE)
    names.forget()
    assert names.foreign == {4}
    assert names.left(0) == 15
    assert 4 not in names.unknown(16, 0)


def test_up_to_1_3_a_variable_is_gone_after_its_last_deletion():
    names = leaving()
    names.offered(3)
    names.heard((), (3,), GONE)
    assert not names.is_unknown(3, GONE - 1)
    assert names.is_unknown(3, GONE)


def test_an_unheard_deletion_counts_once_beacons_lack_the_variable():
    names = leaving()
    names.offered(3)
    names.deleted(3, GONE)
    beacons(names, 7)
    assert not names.is_unknown(3, GONE)
    beacons(names, 1)
    assert names.is_unknown(3, GONE)


def test_a_variable_that_is_still_announced_was_not_deleted():
    names = leaving()
    names.offered(3)
    names.deleted(3, GONE)
    beacons(names, 5)
    names.heard((3,), (), GONE)
    beacons(names, 100)
    assert not names.is_unknown(3, 10 * GONE)


def test_a_deletion_that_was_heard_counts_whatever_the_tester_asks_for_afterwards():
    names = leaving()
    names.offered(3)
    names.heard((), (3,), GONE)
    names.deleted(3, 5 * GONE)
    assert names.is_unknown(3, GONE)


def test_a_variable_that_is_created_again_is_known_again():
    names = leaving()
    names.offered(3)
    names.heard((), (3,), GONE)
    names.offered(3)
    beacons(names, 100)
    assert not names.is_unknown(3, 10 * GONE)


# -- what can be created -----------------------------------------------------------------------------------------------


def test_a_quarter_of_identifiers_is_reserved_for_unknown_variables():
    names = timed()
    given = []
    while (number := names.for_own(0)) is not None:
        names.offered(number, by_peer=False)
        given.append(number)
    assert given == list(range(15, 3, -1))
    assert names.left(0) == 4


def test_peers_use_their_half_of_identifiers_in_turn():
    names = timed()
    given = [names.for_peer(0, 1) for _ in range(10)]
    assert given == [0, 1, 2, 3, 4, 5, 6, 7, 0, 1]
    # The tester has created none of these.
    assert names.left(0) == 16


def test_since_2_0_peers_create_again_what_peers_have_deleted_with_an_earlier_creation_time():
    names = timed()
    for number, time in ((0, 5), (1, 6), (2, 9)):
        names.offered(number, time)
        names.deleted(number, GONE)
    names.offered(3, 1, by_peer=False)
    for number in range(4, 8):
        names.offered(number, 1)
        names.deleted(number, 2 * GONE)
    assert [names.for_peer(GONE, 7) for _ in range(3)] == [0, 1, 0]
    # Variables whose deletion may still be announced are used only if there are no others.
    assert names.for_peer(GONE, 7, without=(0, 1)) == 4
    assert names.for_peer(GONE, 7, without=(0, 1, 4, 5, 6, 7)) is None


def test_up_to_1_3_no_variable_is_created_again_before_it_is_gone():
    names = leaving()
    for number in range(16):
        names.offered(number)
    assert names.for_peer(0, 0) is None
    names.heard((), (9,), GONE)
    assert names.for_peer(GONE - 1, 0) is None
    assert names.for_peer(GONE, 0) == 9


# -- the bench ---------------------------------------------------------------------------------------------------------


def test_unknown_identifiers_are_found_while_time_passes():
    bench = bench_of("dcp-1.3")
    names = bench.session.identifier_pool
    names.heard((), (200,), 1 << 60)
    names.heard((), (201,), 0)
    found = bench.identifiers.unknown_ids(60)
    assert 200 not in found
    assert 201 in found


def test_a_variable_created_by_a_case_is_not_unknown_to_the_next():
    bench = bench_of()
    number = bench.unknown_id()
    bench.peer().create(number)
    following = Bench(bench.session, bench.case)
    assert number not in following.identifiers.unknown_ids(251)
    assert number in bench.identifiers.created


def test_a_variable_used_only_for_measuring_is_free():
    bench = bench_of()
    bench.records.sample(7)
    assert 7 in bench.identifiers.unknown_ids(252)


def test_a_refused_creation_leaves_the_identifier_free():
    bench = bench_of()
    assert not bench.call("RTDB-Create", varId=9, repCnt=0, descr="d", value="00").ok
    assert 9 in bench.identifiers.unknown_ids(252)
    assert bench.call("RTDB-Create", varId=9, repCnt=1, descr="d", value="00").ok
    assert 9 not in bench.identifiers.unknown_ids(251)
    bench.must("UT-Reset")
    assert 9 in bench.identifiers.unknown_ids(252)


def test_a_case_that_has_no_more_identifiers_says_what_would_help():
    bench = bench_of(pics=Pics(pixit=Testing(var_ids=(10, 13))))
    assert sorted(bench.identifiers.unknown_ids(4)) == [10, 11, 12, 13]
    with pytest.raises(NamesUsedUp):
        bench.identifiers.unknown_ids(5)
    check = bench.verdicts.checks[-1]
    assert check.verdict is Verdict.INCONCLUSIVE
    assert "4 of 4 are left" in check.observed
    for remedy in ("UT-Reset", "--start", "--restart", 'reset = "restart"'):
        assert remedy in check.observed


def test_a_protocol_that_may_still_be_registered_is_not_registered_again():
    bench = bench_of()
    first = unused_protocol_id(bench)
    bench.session.held_protocols.add(first + 1)
    assert unused_protocol_id(bench) == first + 2
    bench.session.held_protocols.update(range(0x7000, 0x7F00))
    with pytest.raises(NamesUsedUp):
        unused_protocol_id(bench)
    bench.session.forget()
    assert unused_protocol_id(bench) == first + 3


def test_no_peer_has_the_identifier_of_the_implementation():
    bench = bench_of()
    bench.session.sut_id = b"\x02\xdc\x90\x00\x00\x02"
    assert [bench.peer().node_id[-1] for _ in range(3)] == [1, 3, 4]


@pytest.mark.parametrize("profile", ["dcp-1.0", "dcp-2.0"])
def test_unknown_identifiers_of_a_case_are_not_used_for_its_variables(profile: str):
    bench = bench_of(profile)
    unknown = [bench.unknown_id() for _ in range(20)]
    # Just before them in the order in which peers are given identifiers.
    bench.session.identifier_pool._next_for_peers = min(unknown) - bench.session.identifier_pool.first - 2
    assert not set(bench.identifiers.var_ids(10)) & set(unknown)
    assert not {bench.identifiers.own_var_id() for _ in range(10)} & set(unknown)
