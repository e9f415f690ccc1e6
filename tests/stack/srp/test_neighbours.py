"""The neighbour table: statistics, queries, geometry and stamps."""

from __future__ import annotations

import pytest
from dcp_spec.profile.definition import TimestampType
from hypothesis import assume, given
from hypothesis import strategies as st

from dcp_codec.codec import get_codec
from dcp_codec.values import ExtendedSafetyData
from dcp_stack.positions.geometry import Motion, velocity_between
from dcp_stack.srp.neighbour_table import RESTART_GAP, NeighbourTable
from dcp_stack.timestamps import StampClock

S = 10**9
NODE = b"\2\0\0\0\0\1"


class Table(NeighbourTable):
    """A table that makes reports from numbers."""

    def __init__(self, profile="dcp-2.0", capacity=16):
        self.codec = get_codec(profile)
        super().__init__(self.codec.profile, capacity=capacity)

    def add(self, values, node=NODE, *, seqno=0, stamp=0, now=0, wall=0):
        data = self.codec.safety_data_type(*values)
        return self.record(ExtendedSafetyData(data, node, stamp, seqno), b"", now=now, wall=wall)


def node(number):
    return bytes([2, 0, 0, 0, 1, number])


@pytest.mark.req("SRP-NT-01")
@pytest.mark.req("SRP-NT-02")
def test_the_operations_of_the_specification():
    table = Table()
    assert table.lookup(NODE) is None
    for number in range(3):
        assert table.add((number, 0, 0), node(number)) == "new"
    assert table.add((7, 0, 0), node(1), seqno=1) == "replaced"
    assert sorted(table.list_all_node_ids()) == [node(0), node(1), node(2)]
    assert table.lookup(node(1)).ext_sd.s_data.x == 7
    assert len(table) == 3
    assert node(2) in table
    assert {entry.node_id for entry in table} == {node(0), node(1), node(2)}


@pytest.mark.req("SRP-NT-04")
def test_losses_are_counted_by_sequence_numbers():
    table = Table()
    for now, seqno in enumerate([2**32 - 2, 2**32 - 1, 2, 2, 5]):
        table.add((0, 0, 0), seqno=seqno, now=now * S)
    entry = table.lookup(NODE)
    assert (entry.received, entry.repeated, entry.lost, entry.restarts) == (4, 1, 4, 0)
    assert entry.mean_gap == pytest.approx(0.95 * (0.95 * 1 + 0.05 * 3) + 0.05 * 3)
    # The repetition is not a new report: the last interval runs from its first reception.
    assert entry.mean_interval == pytest.approx((0.95 * 1 + 0.05 * 1) * 0.95 * S + 0.05 * 2 * S)


@pytest.mark.req("SRP-NT-04")
@pytest.mark.parametrize(
    ("before", "after", "restart"),
    [(5, 4, True), (100, 0, True), (0, RESTART_GAP, True), (0, RESTART_GAP - 1, False), (2**32 - 1, 0, False)],
)
def test_restarts_do_not_count_as_losses(before, after, restart):
    table = Table()
    table.add((0, 0, 0), seqno=before)
    table.add((1, 0, 0), seqno=after, now=S)
    entry = table.lookup(NODE)
    assert entry.restarts == restart
    assert entry.lost == (0 if restart else (after - before) % 2**32 - 1)
    # Nor is there a velocity between the positions before and after a restart.
    assert (table.motion(entry).velocity is None) == restart


def test_the_capacity_holds():
    table = Table(capacity=1)
    for number in range(5):
        assert table.add((0, 0, 0), node(number)) == "new"
        assert table.list_all_node_ids() == [node(number)]
    assert table.add((0, 0, 0), node(4), seqno=1) == "replaced"
    with pytest.raises(ValueError, match="one entry"):
        Table(capacity=0)


def test_a_full_table_drops_the_neighbour_that_was_silent_for_longest():
    table = Table(capacity=3)
    for number in range(3):
        for seqno in range(2):
            table.add((0, 0, 0), node(number), seqno=seqno, now=10 * seqno + number)
    table.add((0, 0, 0), node(0), seqno=2, now=20)
    table.add((0, 0, 0), node(7), now=21)
    assert (table.displaced, sorted(table.list_all_node_ids())) == (node(1), [node(0), node(2), node(7)])


def test_forged_nodes_displace_one_another():
    """A node that reports regularly stays, and a genuine newcomer becomes one of them."""
    table = Table(capacity=50)
    genuine = [bytes([2, 0, 0, 0, 0, number]) for number in range(10)]
    for step in range(200):
        # A newcomer comes in the middle of it.
        for each in genuine if step >= 100 else genuine[:9]:
            table.add((0, 0, 0), each, seqno=step, now=step * S // 10)
        for number in range(30):
            forged = bytes([6, 6]) + (30 * step + number).to_bytes(4, "big")
            table.add((0, 0, 0), forged, now=step * S // 10 + number)
        assert len(table) <= 50
    assert all(each in table for each in genuine)
    assert table.lookup(genuine[0]).received == 200
    assert table.lookup(genuine[9]).received == 100


def test_expiry_is_strict():
    table = Table()
    table.add((0, 0, 0), now=5)
    assert table.expire(15, 10) == []
    assert table.expire(16, 10) == [NODE]
    assert len(table) == 0


def test_velocity_comes_from_the_stamps_of_the_sender():
    table = Table("cpp-2.0")
    table.add((0, 0, 0), stamp=100 * S, now=0)
    # Received after three seconds, but made two seconds after the first.
    table.add((10, -4, 0), stamp=102 * S, seqno=1, now=3 * S)
    motion = table.motion(table.lookup(NODE))
    assert (motion.velocity, motion.estimated) == ((5, -2, 0), True)


def test_without_usable_stamps_velocity_comes_from_receptions():
    table = Table("cpp-2.0")
    table.add((0, 0, 0), stamp=7, now=0)
    table.add((10, 0, 0), stamp=7, seqno=1, now=2 * S)
    assert table.motion(table.lookup(NODE)).velocity == (5, 0, 0)
    table.add((20, 0, 0), stamp=3, seqno=2, now=2 * S)
    assert table.motion(table.lookup(NODE)).velocity is None


def test_repetitions_change_neither_velocity_nor_its_time():
    table = Table("dcp-1.2")
    table.add((0, 0, 0), stamp=0, now=0)
    table.add((10, 0, 0), stamp=S, seqno=1, now=S)
    before = table.motion(table.lookup(NODE))
    table.add((10, 0, 0), stamp=S, seqno=1, now=5 * S)
    assert table.motion(table.lookup(NODE)) == before
    assert table.lookup(NODE).age(6 * S) == S


def test_reported_velocities_are_taken():
    table = Table("sim-2.0")
    table.add((1, 2, 3, 4, 5, 6), now=9)
    assert table.motion(table.lookup(NODE)) == Motion((1, 2, 3), (4, 5, 6))


def test_integers_are_positions_too():
    table = Table("student-2024")
    table.add(range(10), b"x")
    assert table.motion(table.lookup(b"x")).position == (0.0, 1.0, 2.0)


def test_snapshot_is_plain():
    table = Table("cpp-2.0")
    table.add((1, 2, 3), stamp=4 * S, wall=5 * S)
    (plain,) = table.snapshot()
    assert plain["node_id"] == "02:00:00:00:00:01"
    assert plain["safety_data"] == {"x": 1, "y": 2, "z": 3}
    assert plain["delay"] == S
    assert plain["velocity_estimated"] is False


# -- geometry ------------------------------------------------------------------------------------------------------

anything = st.floats(allow_nan=False)


points = st.tuples(anything, anything, anything)


@given(points, points)
def test_no_numbers_raise(place, other):
    velocity_between(place, other, 1)


# -- stamps --------------------------------------------------------------------------------------------------------

layouts = st.builds(
    TimestampType,
    width=st.integers(1, 8),
    signed=st.booleans(),
    unit=st.sampled_from(["s", "ms", "us", "ns", "ps"]),
    epoch=st.sampled_from(["unix", "gps", "simulation", "boot"]),
)
walls = st.integers(0, 2**63 - 1)


def period_ns(layout: TimestampType) -> int:
    """Return the period after which stamps wrap to 0, rounded down."""
    return (1 << 8 * layout.width) * 10**9 // layout.per_second


@pytest.mark.req("DATA-05")
@given(layouts, walls, walls)
def test_a_time_stamp_round_trip_is_exact_within_its_unit(layout, wall, origin):
    clock = StampClock(layout, origin=origin)
    stamp = clock.stamp(wall)
    low = -(1 << (8 * layout.width - 1)) if layout.signed else 0
    assert low <= stamp < low + (1 << 8 * layout.width)
    unit = {"s": S, "ms": 10**6, "us": 10**3, "ns": 1, "ps": 1}[layout.unit]
    assert 0 <= wall - clock.wall(stamp, near=wall) < unit + (layout.unit == "ps")


@given(layouts, walls, st.floats(-0.45, 0.45))
def test_the_nearest_time_of_a_wrapped_stamp_is_found(layout, wall, part):
    clock = StampClock(layout)
    away = int(period_ns(layout) * part)
    unit = {"s": S, "ms": 10**6, "us": 10**3, "ns": 1, "ps": 1}[layout.unit]
    assume(period_ns(layout) > 100 * unit)
    found = clock.wall(clock.stamp(wall), near=wall + away)
    assert abs(wall - found) <= unit


@given(layouts, walls, st.floats(0, 0.45))
def test_the_time_between_stamps_survives_a_wrap(layout, wall, part):
    clock = StampClock(layout)
    later = wall + int(period_ns(layout) * part)
    unit = {"s": S, "ms": 10**6, "us": 10**3, "ns": 1, "ps": 1}[layout.unit]
    assume(period_ns(layout) > 100 * unit)
    found = clock.between(clock.stamp(wall), clock.stamp(later))
    assert abs(found - (later - wall)) <= unit


@pytest.mark.parametrize(
    ("layout", "wall", "stamp"),
    [
        (TimestampType(), 1_700_000_000 * S + 5, 1_700_000_000 * S + 5),
        (TimestampType(unit="ms", width=4), 1_700_000_000 * S, 1_700_000_000_000 % 2**32),
        (TimestampType(epoch="gps", unit="s"), 315_964_801 * S, 1),
        (TimestampType(epoch="boot", unit="ps", signed=True), 7 + 100, 7_000),
        (TimestampType(width=1, unit="s", signed=True), 255 * S, -1),
    ],
)
def test_known_stamps(layout, wall, stamp):
    assert StampClock(layout, origin=100).stamp(wall) == stamp


def test_comparable_time_stamps():
    assert StampClock(TimestampType(epoch="gps")).comparable
    assert not StampClock(TimestampType(epoch="boot")).comparable
