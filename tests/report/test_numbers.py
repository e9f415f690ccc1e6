"""The numbers of a report are those of what was sent."""

from __future__ import annotations

import numpy as np
import pytest
from dcp_tables.report import analysis, variables
from dcp_tables.report.plots import short_names
from dcp_tables.report.recorded import gather
from dcp_tables.report.series import extremes, ordinal, runs, seconds_text, short, unwrapped

from .flights import CAPTURES, OTHER, START, Payload, create, gathered, name, record, report, steady, update


def test_beacons_and_loss(tmp_path):
    sent = steady(1, 20, skipped=range(50, 60)) + steady(2, 20)
    sent += [(20.5, 2, 5, (report(2, 1),)), (20.6, 2, 5, (report(2, 1),))]
    recorded = gathered(record(tmp_path / "a.pcap", sent, damaged=[3.0, 4.0]))
    time, steps = analysis.time_of(recorded), analysis.steps_of(recorded)
    one, two = analysis.senders_of(recorded, time, steps)
    assert [recorded.nodes[each.node] for each in (one, two)] == [name(1), name(2)]
    assert (one.beacons, one.lost, one.restarts, one.reports) == (190, 10, 0, 190)
    assert one.loss == pytest.approx(0.05)
    assert (two.beacons, two.lost, two.restarts) == (202, 0, 1)
    times = analysis.anomaly_times(recorded, time, steps)
    assert times["gap"].tolist() == pytest.approx([6.0])
    assert times["restart"].tolist() == pytest.approx([20.499])
    assert times["repetition"].tolist() == pytest.approx([20.599])
    assert times["malformed"].tolist() == pytest.approx([2.999, 3.999])
    kinds = [(each.kind, each.words) for each in analysis.worst(recorded, time, steps, 10)]
    assert ("gap", "10 missing before sequence number 60") in kinds
    assert ("restart", "continues with sequence number 5") in kinds
    assert [kind for kind, _ in kinds].count("malformed") == 2
    rate, loss = analysis.rates(recorded, time, steps, one.node)
    assert float(np.sum(rate) * time.width) == pytest.approx(190)
    lossy = np.flatnonzero(np.nan_to_num(loss) > 0)
    assert lossy.tolist() == [int(time.bins(np.array([START + 6_001_000_000]))[0])]


def test_sequence_numbers_wrap_and_run_per_interface(tmp_path):
    many = 1 << 32
    sent = [(n / 10, 1, (many - 3 + n) % many, (report(1, n),)) for n in range(10) if n != 4]
    recorded = gathered(record(tmp_path / "a.pcap", sent))
    assert recorded.modulus == many
    assert analysis.steps_of(recorded).lost.tolist() == [0, 0, 0, 0, 1, 0, 0, 0, 0]
    # The same beacons on a second interface are neither repeated nor lost.
    for table in (recorded.tables["beacons"],):
        for column in table:
            table[column] = np.repeat(table[column], 2)
        table["interface"] = np.tile([0, 1], 9)
    steps = analysis.steps_of(recorded)
    assert int(steps.lost.sum()) == 2
    assert not steps.repeated.any()


def test_age():
    ends = np.linspace(0, 10, 6)
    found = analysis.age(np.array([2.5, 3.0, 7.0]), ends)
    # Not heard before 2.5; 1 s old at 4; 3 at 6; 4 just before 7; 3 at the end.
    assert np.isnan(found[0])
    assert found[1:].tolist() == pytest.approx([1.0, 3.0, 4.0, 3.0])
    assert np.isnan(analysis.age(np.empty(0), ends)).all()


def test_age_of_pairs(tmp_path):
    # Node 1 reports each second, node 2 sends 0.3 s later, and never reports.
    sent = [(float(n), 1, n, (report(1, n),)) for n in range(20)]
    sent += [(n + 0.3, 2, n, (Payload(77, b"x"),)) for n in range(20)]
    recorded = gathered(record(tmp_path / "a.pcap", sent))
    nodes = [recorded.nodes.index(name(node)) for node in (1, 2)]
    middle, high = analysis.pair_ages(recorded, analysis.time_of(recorded), nodes)
    assert middle[1, 0] == pytest.approx(0.3)
    assert high[1, 0] == pytest.approx(0.3)
    assert np.isnan([middle[0, 0], middle[0, 1], middle[1, 1]]).all()


def test_dissemination(tmp_path):
    sent = []
    for n in range(4):
        at = 2.0 * n
        said = create(7, 1, b"\x00\x05") if n == 0 else update(7, n, bytes([1, n]))
        sent += [(at, 1, n, (said,)), (at + 0.1, 2, 2 * n, (said,)), (at + 0.25, 3, n, (said,))]
        # Said again, which is not a first time.
        sent.append((at + 0.3, 2, 2 * n + 1, (said,)))
    # Long after, node 3 gives node 2 the first value again: not from the producer.
    again = create(7, 1, b"\x00\x05")
    sent += [(30.0, 3, 4, (again,)), (30.5, 2, 8, (again,))]
    recorded = gathered(record(tmp_path / "a.pcap", sent))
    time = analysis.time_of(recorded)
    values, passed = variables.dissemination(recorded, time)
    assert values.seqno.tolist() == [0, 1, 2, 3, 0]
    assert values.time.tolist() == pytest.approx([0, 2, 4, 6, 30])
    assert values.frame.tolist() == [1, 5, 9, 13, 17]
    assert values.number.tolist() == [5, 257, 258, 259, 5]
    assert values.from_producer.tolist() == [True] * 4 + [False]
    node = {number: recorded.nodes.index(name(number)) for number in (1, 2, 3)}
    counted = passed.counted
    assert passed.delay[counted & (passed.node == node[2])].tolist() == pytest.approx([0.1] * 4)
    assert passed.delay[counted & (passed.node == node[3])].tolist() == pytest.approx([0.25] * 4)
    assert set(passed.order[counted & (passed.node == node[3])].tolist()) == {2}
    (line,) = variables.lines(recorded, values, passed, 20)
    assert (line.number, line.values, line.sizes, line.value) == (7, 5, "2", b"\x01\x03")
    assert line.median == pytest.approx(0.175)
    assert variables.numeric(values, 7)


def test_wrapped_numbers_continue_and_restart_with_a_creation(tmp_path):
    """600 updates of an 8-bit number; then the variable is created again, which is not a jump of 168."""
    first = [(0.0, 1, 0, (create(7, 1, b"a", at=1),))]
    sent = first + [(n / 10, 1, n, (update(7, n % 256, b"a"),)) for n in range(1, 601)]
    sent += [(60.1, 1, 601, (create(7, 1, b"a", at=2),)), (60.2, 1, 602, (update(7, 1, b"a"),))]
    recorded = gathered(record(tmp_path / "a.pcap", sent))
    assert recorded.number_modulus == 256
    values, _ = variables.dissemination(recorded, analysis.time_of(recorded))
    rows, count, again = variables.counted(recorded, values, 7)
    assert count.tolist() == [*range(601), 0, 1]
    assert values.time[rows[again]].tolist() == pytest.approx([60.1])


def test_octets_are_all_counted():
    recorded = gather(str(CAPTURES / "c_latejoin.mcap"), "cpp-2.0", None)
    beacons = recorded.tables["beacons"]
    parts = {part.name: part.octets for part in analysis.overhead(recorded, analysis.time_of(recorded))}
    assert sum(parts.values()) == int((beacons["octets"] + beacons["around"]).sum())
    containers = recorded.tables["containers"]
    for number, text in enumerate(recorded.contents):
        own = int(containers["octets"][containers["content"] == number].sum())
        if own:
            assert parts[text] == own


def test_small_things():
    assert [seconds_text(each) for each in (0.0351, 2.5, 130, 7300)] == ["35.1 ms", "2.5 s", "2 min 10 s", "2 h 1 min"]
    assert [ordinal(each) for each in (1, 2, 3, 4, 11, 12, 21)] == ["1st", "2nd", "3rd", "4th", "11th", "12th", "21st"]
    assert runs(np.array([True, True, False, True])) == [(0, 2), (3, 4)]
    short = short_names({0: "02:00:00:00:00:01", 1: "02:00:00:00:01:01", 2: "unknown"})
    assert short == {0: "…00:01", 1: "…01:01", 2: "unknown"}
    assert short_names({0: "aabb01", 1: "aabb02"}) == {0: "…bb01", 1: "…bb02"}


class TestExtremes:
    def test_a_few_points_are_kept_unchanged(self):
        assert extremes(np.arange(40.0), np.arange(40.0), 10).tolist() == list(range(40))

    def test_one_late_value_among_a_million_is_kept(self):
        x = np.arange(1_000_000) / 10
        y = np.sin(x)
        y[123_457], y[765_432] = 50, -50
        kept = extremes(x, y, 200)
        assert {123_457, 765_432, 0, x.size - 1} <= set(kept.tolist())
        assert kept.size <= 4 * 200

    def test_each_piece_keeps_its_least_greatest_first_and_last(self):
        rng = np.random.default_rng(1)
        x, y = np.sort(rng.uniform(0, 100, 5000)), rng.normal(size=5000)
        y[rng.integers(0, 5000, 500)] = np.nan
        kept = extremes(x, y, 50)
        piece = np.minimum(((x - x[0]) * (50 / (x[-1] - x[0]))).astype(int), 49)
        for each in range(50):
            own = np.flatnonzero(piece == each)
            drawn = np.intersect1d(own, kept)
            assert np.nanmin(y[drawn]) == np.nanmin(y[own])
            assert np.nanmax(y[drawn]) == np.nanmax(y[own])
            assert {own[0], own[-1]} <= set(drawn.tolist())

    def test_a_thinned_sawtooth_keeps_its_direction(self):
        """The picture that thinning by every Nth point made of wrapping numbers: it fell."""
        count = np.arange(500_000)
        drawn = unwrapped(count % 256, 256)[extremes(count / 10, unwrapped(count % 256, 256), 500)]
        assert (np.diff(drawn) > 0).all()
        assert drawn[-1] == 499_999

    def test_no_time_at_all(self):
        assert extremes(np.zeros(100), np.arange(100.0), 5).tolist() == [0, 99]


class TestUnwrapped:
    @pytest.mark.parametrize("modulus", [256, 65536, 1 << 32])
    def test_every_width(self, modulus):
        numbers = np.arange(modulus - 3, modulus + 4) % modulus
        assert unwrapped(numbers, modulus).tolist() == list(range(modulus - 3, modulus + 4))

    def test_a_step_back_is_kept(self):
        assert unwrapped(np.array([5, 4, 6]), 256).tolist() == [5, 4, 6]

    def test_no_numbers(self):
        assert unwrapped(np.array([], np.int64), 256).tolist() == []


def test_a_node_that_was_away_for_long_has_lost_beacons(tmp_path):
    sent = [(0.0, 1, 5, OTHER), (300.0, 1, 3005, OTHER), (300.1, 1, 3, OTHER), (300.2, 1, 2**31 + 3, OTHER)]
    steps = analysis.steps_of(gathered(record(tmp_path / "a.pcap", sent)))
    assert steps.lost.tolist() == [0, 2999, 0, 0]
    assert steps.restart.tolist() == [False, False, True, True]


def test_senders_on_several_interfaces(tmp_path):
    """The first beacon of a sender on each interface does not give a rate."""
    recorded = gathered(record(tmp_path / "a.pcap", steady(1, 10)))
    table = recorded.tables["beacons"]
    time = analysis.time_of(recorded)
    (alone,) = analysis.senders_of(recorded, time, analysis.steps_of(recorded))
    table["interface"] = np.arange(table["node"].size, dtype=np.uint32) % 2 * (2**32 - 1)
    (both,) = analysis.senders_of(recorded, time, analysis.steps_of(recorded))
    assert alone.rate * (both.beacons - 2) == pytest.approx(both.rate * (alone.beacons - 1))


def test_numbers_have_no_exponent():
    """A pair that lost everything lost 100 %, not 1e+02 %."""
    assert [short(number, 2) for number in (0, 0.123, 12.3, 99.4, 99.6, 100, 1234.5)] == [
        *("0", "0.12", "12", "99", "100", "100"),
        "1,234",
    ]
    assert [short(number) for number in (0.1234, 999.4, 999.7, 12345)] == ["0.123", "999", "1,000", "12,345"]
    assert seconds_text(0.9997) == "1,000 ms"
