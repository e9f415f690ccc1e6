"""The receive path: two phases, order of processing, errors, circular sequence numbers (B.7)."""

from __future__ import annotations

import itertools

import pytest
from dcp_lab.testing import strategies
from hypothesis import given
from hypothesis import strategies as st

from dcp_codec import get_codec
from dcp_stack.effects import Dropped, VariableChanged

from ...parts import every
from ..vardis_rig import (
    ME,
    OTHER,
    THIRD,
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

LATER = WALL + 1

# -- two phases, order ------------------------------------------------------------------------------------------


@pytest.mark.req("VD-RX-01")
@pytest.mark.req("VD-RX-02")
@pytest.mark.req("VD-RX-08")
def test_the_order_of_containers_does_not_matter() -> None:
    results = []
    for version in VERSIONS:
        probe = Rig(version)
        containers = [
            probe.vc(1),
            VarUpdate(1, 1, b"new"),
            VarSumm(1, 1),
            VarDelete(2),
            VarReqCreate(3),
            VarReqUpdate(1, 0),
        ]
        for order in itertools.permutations(containers):
            rig = Rig(version)
            rig.receive(rig.vc(2))
            rig.receive(*order)
            assert rig.read(1) == b"new"
            assert rig.queue("reqUpdQ") == []
            assert rig.queue("reqCreateQ") == ([] if version == "1.0" else [3])
            results.append(rig.vardis.snapshot())
        assert all(result == results[0] for result in results)
        results.clear()


@pytest.mark.req("VD-RX-08")
def test_the_order_of_processing() -> None:
    rig = Rig()
    rig.receive(rig.vc(1))
    rig.receive(VarSumm(1, 9), VarUpdate(1, 9, b"v"))  # not requested, the update was there already
    assert rig.queue("reqUpdQ") == []
    rig.receive(VarUpdate(1, 10, b"w"), VarDelete(1))  # deleted first
    assert (rig.entry(1).is_deleted, rig.entry(1).seqno) == (True, 9)
    rig.receive(VarDelete(1), rig.vc(1, created=LATER))  # created again, then deleted
    assert (rig.entry(1).is_deleted, rig.entry(1).spec.creation_time) == (True, LATER)


@pytest.mark.req("VD-RX-03")
@pytest.mark.req("VD-RX-04")
@pytest.mark.req("VD-RX-09")
@pytest.mark.req("VD-IC-04")
def test_several_containers_of_a_type_and_records_in_order() -> None:
    rig = Rig()
    rig.receive(
        rig.vc(1, bytes(32)),
        (VarUpdate(1, 5, b"five"), VarUpdate(1, 6, b"six"), VarUpdate(1, 4, b"four")),
        rig.vc(2, b"x"),
        VarUpdate(2, 1, b"y"),
    )
    assert (rig.read(1), rig.read(2)) == (b"six", b"y")
    assert rig.drops() == ["update-older"]


@pytest.mark.req("VD-RX-01")
def test_an_error_changes_nothing_where_payloads_are_dropped_whole() -> None:
    rig = Rig(readings={"X34": "drop-payload"})
    found = rig.receive_octets(rig.octets((rig.vc(1),)) + b"\x09\x01\x00")
    assert rig.entry(1) is None
    assert [(drop.reason, drop.requirement) for drop in found] == [("unknown-type", "VD-RX-05")]


# -- VarCreate --------------------------------------------------------------------------------------------------


@pytest.mark.req("VD-PC-01")
@pytest.mark.req("VD-PC-02")
@pytest.mark.req("VD-PC-08")
def test_a_later_creation_replaces_and_withdraws_what_was_pending() -> None:
    rig = Rig()
    rig.receive(rig.vc(seqno=9))
    rig.receive(VarSumm(7, 12), VarReqUpdate(7, 0))
    rig.receive(rig.vc(value=b"anew", seqno=3, prod_id=THIRD, created=LATER))
    entry = rig.entry()
    assert (entry.value, entry.seqno, entry.spec.prod_id) == (b"anew", 3, THIRD)
    assert (entry.count_create, entry.count_update, rig.queue("reqUpdQ"), rig.queue("updateQ")) == (2, 0, [], [])
    rig.receive(VarDelete(7))
    rig.receive(rig.vc(value=b"alive", created=LATER + 1))
    assert (rig.read(), rig.queue("deleteQ")) == (b"alive", [])


@pytest.mark.req("VD-PC-01")
@pytest.mark.req("VD-PC-03")
@pytest.mark.req("VD-PC-04")
@pytest.mark.req("VD-PC-05")
@pytest.mark.req("VD-PC-06")
@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"upd_id": 8}, "id-mismatch"),
        ({"prod_id": ME}, "own-create"),
        ({"value": b""}, "bad-value"),
        ({"value": bytes(32)}, None),
        ({"value": bytes(33)}, "bad-value"),
        ({"descr": b""}, "bad-description"),
        ({"descr": bytes(b"d" * 32)}, None),
        ({"descr": bytes(b"d" * 33)}, "bad-description"),
        ({"rep_cnt": 0}, "bad-repcnt"),
        ({"rep_cnt": 15}, None),
        ({"rep_cnt": 16}, "bad-repcnt"),
        ({"value": b"", "descr": b"", "rep_cnt": 0}, "bad-value"),
        ({"descr": b"", "rep_cnt": 0}, "bad-description"),
        ({"prod_id": ME, "value": b""}, "own-create"),
    ],
)
def test_creations_that_are_ignored(change: dict, reason: str | None) -> None:
    rig = Rig()
    rig.receive(VarSumm(9, 1))
    before = rig.vardis.snapshot()
    found = rig.receive(rig.vc(**change))
    if reason is None:
        assert rig.entry() is not None
    else:
        assert [(drop.reason, drop.offset, drop.var_id) for drop in found] == [(reason, 2, 7)]
        assert rig.vardis.snapshot() == before


@pytest.mark.req("VD-PC-04")
@pytest.mark.req("VD-PC-05")
@pytest.mark.req("VD-PC-06")
@pytest.mark.req("VD-PU-04")
@pytest.mark.parametrize(
    ("version", "taken"),
    [
        ("1.0", {"empty", "long", "no description", "long description", "repcnt"}),
        ("1.1", {"empty", "no description", "repcnt"}),
        ("1.2", set()),
        ("1.3", set()),
        ("2.0", set()),
    ],
)
def test_lengths_are_checked_as_the_version_asks(version: str, taken: set[str]) -> None:
    rig = Rig(version, max_repetitions=15)
    records = {
        "empty": rig.vc(1, b""),
        "long": rig.vc(2, bytes(33)),
        "no description": rig.vc(3, descr=b""),
        "long description": rig.vc(4, descr=b"d" * 33),
        "repcnt": rig.vc(5, rep_cnt=200),
    }
    rig.receive(tuple(records.values()))
    assert {name for name, record in records.items() if rig.entry(record.spec.var_id)} == taken
    rig.receive(rig.vc(6))
    rig.receive(VarUpdate(6, 1, b""))
    assert (rig.entry(6).seqno == 1) == ("empty" in taken)
    rig.receive(VarUpdate(6, 2, bytes(33)))
    assert (rig.entry(6).seqno == 2) == ("long" in taken)


def test_the_identifier_in_the_update_of_a_creation_can_be_ignored() -> None:
    rig = Rig(readings={"X14": "ignore-update-id"})
    rig.receive(rig.vc(7, upd_id=8))
    assert (rig.read(7), rig.entry(8)) == (b"ABCD", None)
    assert rig.records(VarCreate) == [rig.vc(7)]


# -- sequence numbers -------------------------------------------------------------------------------------------

DISTANCES = {0: "equal", 1: "newer", 2: "newer", 127: "newer", 128: "half", 129: "older", 254: "older", 255: "older"}


@pytest.mark.req("VD-TYP-03")
@pytest.mark.req("VD-PU-05")
@pytest.mark.req("VD-PU-06")
@pytest.mark.req("VD-PU-07")
@pytest.mark.req("VD-PS-02")
@pytest.mark.req("VD-PS-03")
@pytest.mark.req("VD-PS-04")
@pytest.mark.req("VD-RU-03")
@pytest.mark.req("VD-RU-04")
@pytest.mark.parametrize("half", ["half-range-neither", "half-range-answered", "half-range-older"])
@pytest.mark.parametrize("stored", [0, 1, 100, 127, 128, 200, 254, 255])
@pytest.mark.parametrize("distance", DISTANCES)
def test_distances(distance: int, stored: int, half: str) -> None:
    received = (stored + distance) % 256
    relation = DISTANCES[distance]
    if relation == "half":
        relation = "older" if half == "half-range-older" else "newer"

    def node() -> Rig:
        rig = Rig(readings={"X28": half})
        rig.receive(rig.vc(value=b"old", seqno=stored))
        rig.drain()
        return rig

    rig = node()
    rig.receive(VarUpdate(7, received, b"new"))
    assert (rig.read() == b"new") == (relation == "newer")
    assert (rig.entry().seqno == received) == (relation != "older")
    assert rig.entry().count_update == (0 if relation == "equal" else 2)
    rig = node()
    rig.receive(VarSumm(7, received))
    assert rig.queue("reqUpdQ") == ([7] if relation == "newer" else [])
    assert rig.entry().count_update == (2 if relation == "older" else 0)
    rig = node()
    rig.receive(VarReqUpdate(7, received))
    answered = half != "half-range-neither" if distance == 128 else relation == "older"
    assert rig.entry().count_update == (2 if answered else 0)


def test_the_profile_determines_the_meaning_of_half_the_range_by_default() -> None:
    for readings, answered in (({}, True), ({"X28": "half-range-neither"}, False)):
        rig = Rig(profile="cpp-2.0", readings=readings)
        rig.receive(rig.vc(seqno=128))
        rig.drain()
        rig.receive(VarReqUpdate(7, 0))
        assert bool(rig.entry().count_update) == answered


@pytest.mark.req("VD-PU-07")
@pytest.mark.req("VD-PU-08")
@pytest.mark.req("VD-DB-03")
def test_a_newer_update_answers_the_own_request() -> None:
    rig = Rig()
    rig.receive(rig.vc())
    rig.receive(VarSumm(7, 2))
    rig.now += 99
    found = rig.receive(VarUpdate(7, 2, b"two"))
    assert found == [VariableChanged("updated", 7, 2, b"two", OTHER)]
    assert (rig.queue("reqUpdQ"), rig.entry().t_stamp) == ([], WALL + 99)


# -- reasons ----------------------------------------------------------------------------------------------------


@pytest.mark.req("VD-PD-01")
@pytest.mark.req("VD-PD-02")
@pytest.mark.req("VD-PD-03")
@pytest.mark.req("VD-PU-02")
@pytest.mark.req("VD-PU-03")
@pytest.mark.req("VD-RU-02")
@pytest.mark.req("VD-RC-02")
@pytest.mark.req("VD-PS-02")
def test_every_ignored_record_has_a_reason_and_a_place() -> None:
    rig = Rig()
    rig.create(1)
    rig.create(2)
    rig.delete(2)
    rig.receive(rig.vc(3))
    groups = (
        (VarDelete(9), VarDelete(2), VarDelete(1)),
        (VarUpdate(9, 0, b"value"), VarUpdate(2, 1, b"v"), VarUpdate(1, 1, b"v"), VarUpdate(3, 0, b"v")),
        (VarSumm(2, 1), VarSumm(1, 1), VarSumm(3, 0)),
        (VarReqCreate(2),),
        (VarReqUpdate(2, 0), VarReqUpdate(3, 0)),
    )
    found = rig.receive(*groups)
    assert [(drop.reason, drop.offset, drop.var_id) for drop in found] == [
        ("delete-unknown", 2, 9),
        ("delete-deleted", 3, 2),
        ("delete-own", 4, 1),
        ("update-unknown", 7, 9),
        ("update-deleted", 15, 2),
        ("update-own", 19, 1),
        ("update-equal", 23, 3),
        ("summary-deleted", 29, 2),
        ("summary-own", 31, 1),
        ("summary-equal", 33, 3),
        ("create-request-deleted", 37, 2),
        ("update-request-deleted", 40, 2),
        ("update-request-not-behind", 42, 3),
    ]
    assert {drop.layer for drop in found} == {"vardis"}


@pytest.mark.req("VD-RU-01")
@pytest.mark.req("VD-RC-01")
def test_requests_for_unknown_variables_are_dropped_in_1_0() -> None:
    rig = Rig("1.0")
    rig.receive(VarReqUpdate(7, 0), VarReqCreate(7))
    assert rig.drops() == ["create-request-unknown", "update-request-unknown"]


# -- errors -----------------------------------------------------------------------------------------------------

POLICIES = ["keep-prefix", "drop-payload", "skip-container"]


@pytest.mark.req("VD-RX-05")
@pytest.mark.req("VD-RX-06")
@pytest.mark.parametrize("policy", POLICIES)
@pytest.mark.parametrize("bad", [b"\x00\x01", b"\x07\x01", b"\xff\xff", b"\x05\x00", b"\x01\x00"])
def test_bad_containers(bad: bytes, policy: str) -> None:
    rig = Rig(readings={"X34": policy})
    first, second = rig.octets((VarSumm(1, 0),)), rig.octets((VarSumm(2, 0),))
    found = rig.receive_octets(first + bad + second)
    no_records = bad[1] == 0
    expected = {
        "keep-prefix": [1],
        "drop-payload": [],
        "skip-container": [1, 2] if no_records else [1],
    }
    assert rig.queue("reqCreateQ") == expected[policy]
    reason, requirement = ("zero-count", "VD-RX-06") if no_records else ("unknown-type", "VD-RX-05")
    assert [(drop.reason, drop.requirement) for drop in found] == [(reason, requirement)]


@pytest.mark.req("VD-RX-06")
def test_many_bad_containers_are_skipped_one_by_one() -> None:
    rig = Rig("1.0")
    good = rig.octets((VarSumm(2, 0),))
    found = rig.receive_octets(b"\x05\x00" + good + b"\x01\x00\x02\x00" + rig.octets((VarSumm(3, 0),)) + b"\x05\x00")
    assert rig.queue("reqCreateQ") == [2, 3]
    assert [drop.offset for drop in found] == [1, 7, 9, 15]


@pytest.mark.req("VD-RX-07")
@pytest.mark.parametrize("policy", POLICIES)
def test_payloads_cut_off_at_every_octet(policy: str) -> None:
    probe = Rig()
    creates = (probe.vc(1, b"one"), probe.vc(2, b"twotwo"), probe.vc(3, b"3"))
    payload = probe.octets(creates, (VarSumm(8, 0), VarSumm(9, 0)))
    ends = [2]
    for record in creates:
        ends.append(ends[-1] + len(probe.octets((record,))) - 2)
    for length in range(len(payload)):
        rig = Rig(readings={"X34": policy})
        found = rig.receive_octets(payload[:length])
        known = [var_id for var_id in (1, 2, 3) if rig.entry(var_id)]
        complete = length in (0, ends[-1])
        assert (not any(isinstance(drop, Dropped) for drop in found)) == complete
        if complete:
            assert known == [1, 2, 3][: 3 if length else 0]
        elif policy == "keep-prefix":
            # Records before the error, in whole containers or not.
            assert known == [var_id for var_id, end in zip((1, 2, 3), ends[1:], strict=True) if end <= length]
            assert rig.queue("reqCreateQ") == ([8] if length == len(payload) - 1 or length == len(payload) - 2 else [])
        elif policy == "drop-payload":
            assert known == []
        else:
            assert known == ([1, 2, 3] if length >= ends[-1] else [])
            assert rig.queue("reqCreateQ") == []


@pytest.mark.req("VD-RX-05")
def test_policies_of_profiles() -> None:
    for profile, expected in (("dcp-2.0", [1]), ("cpp-2.0", []), ("dcp-1.1", [1]), ("dcp-1.0", [1, 2])):
        rig = Rig(profile=profile)
        rig.receive_octets(rig.octets((VarSumm(1, 0),)) + b"\x05\x00" + rig.octets((VarSumm(2, 0),)))
        assert rig.queue("reqCreateQ") == expected, profile


# -- nothing hurts ----------------------------------------------------------------------------------------------

PROFILES = ["dcp-1.0", "dcp-1.1", "dcp-1.2", "dcp-1.3", "dcp-2.0", "cpp-2.0", "sim-1.0", "sim-2.0", "student-2024"]


def works(rig: Rig) -> None:
    """The entity still does what it should."""
    rig.vardis.check_invariants()
    used = {found.spec.var_id for found in rig.vardis.describe_database().variables}
    var_id = next(candidate for candidate in range(256) if candidate not in used)
    own = rig.config.node_id
    assert rig.vardis.create(var_id, own, 1, b"d", b"v", now=rig.now, wall=rig.wall).status.is_ok
    assert rig.vardis.read(var_id).value == b"v"
    rig.wait(200)
    while (payload := rig.bp.take()) is not None:
        containers = rig.codec.decode_containers(payload)
        if any(var_id == getattr(record, "spec", record).var_id for found in containers for record in found.records):
            return
        rig.wait(200)
    raise AssertionError("the variable was never sent")


@pytest.mark.req("VD-ROB-01")
@pytest.mark.parametrize("profile", every(4, PROFILES))
@pytest.mark.parametrize("policy", POLICIES)
@given(data=st.data())
def test_arbitrary_octets(profile: str, policy: str, data: st.DataObject) -> None:
    rig = Rig(profile=profile, readings={"X34": policy})
    for payload in data.draw(st.lists(st.binary(max_size=80), max_size=4)):
        rig.receive_octets(payload)
    works(rig)


@pytest.mark.req("VD-ROB-01")
@pytest.mark.req("VD-RX-07")
@pytest.mark.parametrize("profile", every(4, PROFILES))
@given(data=st.data())
def test_mutated_payloads(profile: str, data: st.DataObject) -> None:
    codec = get_codec(profile)
    octets = strategies.containers(codec).map(codec.encode_containers)
    rig = Rig(profile=profile, readings={"X34": data.draw(st.sampled_from(POLICIES))})
    for _ in range(data.draw(st.integers(1, 4))):
        rig.receive_octets(data.draw(st.one_of(octets, strategies.mutations(octets))))
        rig.vardis.payload_transmitted(rig.now, rig.wall)
        rig.wait(data.draw(st.sampled_from((1, 60, 2000))))
        rig.bp.take()
    works(rig)


# -- creation times from the future -----------------------------------------------------------------------------


def in_ms(rig: Rig, ms: int) -> int:
    """A creation time so many ms ahead of the clock of the node."""
    return rig.wall + ms * 1_000_000


def test_without_a_bound_any_creation_time_is_taken() -> None:
    rig = Rig()
    rig.receive(rig.vc(7, created=in_ms(rig, 3_600_000)))
    assert rig.changes() == [("created", 7)]


@pytest.mark.parametrize(("ahead_ms", "taken"), [(-86_400_000, True), (0, True), (60_000, True), (60_001, False)])
def test_a_bound_for_creation_times_ahead_of_the_own_clock(ahead_ms, taken) -> None:
    rig = Rig(max_creation_ahead_s=60.0)
    rig.receive(rig.vc(7, created=in_ms(rig, ahead_ms)))
    assert rig.drops() == ([] if taken else ["creation-ahead"])
    assert isinstance(rig.read(7), bytes) == taken


def test_a_bound_must_not_be_negative() -> None:
    with pytest.raises(ValueError, match="max_creation_ahead_s"):
        Rig(max_creation_ahead_s=-1.0)
