"""The radio of simulations beside closed forms: overlap, losses by length and distance, random intervals, models."""

from __future__ import annotations

import math
import statistics
from itertools import pairwise
from typing import Literal

import msgspec
import pytest
from dcp_lab.sim.scenario.definition import Create, Restart, Scenario, ScenarioError, Topology, Update
from dcp_lab.sim.scenario.loading import check, load_scenario
from dcp_lab.sim.scenario.provenance import Provenance
from dcp_lab.sim.scenario.radio import RadioTable
from dcp_lab.sim.testbed.testbed import Testbed
from dcp_lab.sim.virtual.player import Simulation

from dcp_stack.cli import main
from dcp_stack.config import BPConfig, VardisConfig
from dcp_stack.virtual.medium import SimulatedMedium, TraceDigest
from dcp_stack.virtual.quality import Quality
from dcp_stack.virtual.radio import Radio, RadioError, RadioMedium, Reception, load_model
from dcp_stack.virtual.topology import Line, Positions

US, MS = 1_000, 1_000_000
EVENT = '[[events]]\ndo = "restart"\nnode = 0\nat_s = 0\nevery_s = 1\n'
MODEL = """
class Nearest:
    '''The nearest of several senders is received.'''
    def __init__(self, factor=1.0):
        self.factor = factor
    def loss(self, reception):
        return float(any(other <= self.factor * reception.distance for _, other in reception.overlapping))
class Wrong:
    def loss(self, reception):
        return 1.5
class Broken:
    def loss(self, reception):
        return 1 / 0
class Empty:
    pass
"""


def received(medium, *sendings):
    """Broadcast (time, sender, octets), and return (time, sender, receivers) of all arrivals."""
    for now, sender, octets in sendings:
        medium.broadcast(sender, octets, now)
    return [(each.time, each.sender, each.receivers) for each in medium.arrivals(10**12)]


def test_a_frame_arrives_after_its_airtime():
    radio = Radio(bit_rate=1e6, preamble=100 * US)
    assert radio.airtime(100) == 900 * US
    medium = RadioMedium(3, radio, Quality(delay=MS), topology=Line())
    assert received(medium, (0, 1, bytes(100))) == [(MS + 900 * US, 1, (0, 2))]


def test_overlapping_transmissions_are_lost_where_both_arrive():
    # 0 and 2 cannot hear each other: hidden stations. 3 hears only 2.
    medium = RadioMedium(4, Radio(bit_rate=8e6), topology=Line())
    found = received(medium, (0, 0, bytes(100)), (99 * US, 2, bytes(100)), (300 * US, 0, bytes(100)))
    assert found == [(199 * US, 2, (3,)), (400 * US, 0, (1,))]
    counters = medium.counters
    assert (counters.expected, counters.overlapped, counters.lost, counters.delivered) == (4, 2, 0, 2)
    # In succession, without a gap.
    medium = RadioMedium(4, Radio(bit_rate=8e6), topology=Line())
    assert len(received(medium, (0, 0, bytes(100)), (100 * US, 2, bytes(100)))) == 2
    # A station sends its own frames in succession.
    medium = RadioMedium(4, Radio(bit_rate=8e6), topology=Line())
    found = received(medium, (0, 0, bytes(100)), (40 * US, 0, bytes(100)), (150 * US, 2, bytes(20)))
    assert found == [(100 * US, 0, (1,)), (170 * US, 2, (3,))]
    # A station that sends does not receive.
    medium = RadioMedium(2, Radio(bit_rate=8e6))
    assert received(medium, (0, 0, bytes(100)), (50 * US, 1, bytes(1))) == []


def test_overlap_counts_with_a_delay_of_the_connection_too():
    medium = RadioMedium(3, Radio(preamble=MS), Quality(delay=50 * MS, duplicate=1.0), topology=Line())
    assert received(medium, (0, 0, b"a"), (MS // 2, 2, b"b"), (20 * MS, 0, b"c"))[0][1:] == (0, (1,))
    counters = medium.counters
    assert (counters.expected, counters.duplicated, counters.overlapped, counters.delivered) == (3, 3, 4, 2)


def test_without_airtime_a_radio_changes_nothing():
    found = []
    for kind in (SimulatedMedium, lambda *args, **more: RadioMedium(args[0], Radio(), *args[1:], **more)):
        trace = TraceDigest()
        medium = kind(5, Quality(loss=0.3, jitter=MS), topology=Line(), seed=3, observer=trace)
        received(medium, *((at * MS, at % 5, bytes([at])) for at in range(200)))
        found.append((trace.hexdigest(), medium.counters))
    assert found[0] == found[1]


def test_loss_by_distance_is_interpolated():
    radio = Radio(losses=[(10, 0.1), (20, 0.5), (40, 1.0)])
    for distance, loss in ((0, 0.1), (10, 0.1), (15, 0.3), (20, 0.5), (30, 0.75), (40, 1.0), (99, 1.0), (None, 0.0)):
        assert radio.distance_loss(distance) == pytest.approx(loss)
    places = Positions([(0, 0, 0), (15, 0, 0), (30, 0, 0), (0, 40, 0)], 50)
    assert places.distance(1, 2) == 15
    medium = RadioMedium(4, radio, topology=places)
    assert medium.carried_to(0) == (1, 2)
    n = 4000
    shares = [0, 0, 0, 0]
    for _, _, receivers in received(medium, *((at * MS, 0, b"x") for at in range(n))):
        for each in receivers:
            shares[each] += 1
    for node, kept in ((1, 0.7), (2, 0.25), (3, 0.0)):
        assert abs(shares[node] / n - kept) <= 4 * math.sqrt(kept * (1 - kept) / n)


def test_loss_by_length():
    n = 4000
    for octets in (25, 100):
        kept = (1 - 1e-3) ** (8 * octets)
        medium = RadioMedium(2, Radio(bit_error_rate=1e-3), seed=octets)
        found = len(received(medium, *((at * MS, 0, bytes(octets)) for at in range(n)))) / n
        assert abs(found - kept) <= 4 * math.sqrt(kept * (1 - kept) / n)
        assert medium.counters.lost == n - medium.counters.delivered


def test_frames_to_stations_that_are_off_are_missed():
    medium = RadioMedium(3, Radio(preamble=MS), topology=Line())
    medium.switch(1, up=False)
    assert received(medium, (0, 0, b"a"), (0, 2, b"b")) == []
    assert (medium.counters.missed, medium.counters.overlapped) == (2, 0)


def test_pure_aloha():
    """With N stations that send at rate g independently, a frame of length a survives with exp(-2 (N - 1) g a)."""
    nodes, period_ms, preamble_us = 5, 50, 1000.0
    scenario = Scenario(
        nodes=nodes,
        duration_s=120,
        srp=False,
        bp=BPConfig(beacon_period_ms=period_ms, intervals="exponential"),
        radio=RadioTable(preamble_us=preamble_us),
        # Each node has something to send in each beacon: summaries.
        events=tuple(Create(at_s=0.2, node=node, variable=node, text="x") for node in range(nodes)),
    )
    report = Simulation(scenario).run()
    assert report.met
    theory = math.exp(-2 * (nodes - 1) * preamble_us / (period_ms * 1000))
    assert report.shares["delivered"] == pytest.approx(theory, abs=0.01)
    assert report.shares["overlapped"] == pytest.approx(1 - theory, abs=0.01)


def beacon_intervals(intervals: Literal["exponential", "fixed"], seconds: float) -> list[int]:
    """Return the intervals in ns between the beacons of a node that always has something to send."""
    moments: list[int] = []
    create = Create(at_s=0.2, node=0, variable=1, text="x")
    bp = BPConfig(intervals=intervals)
    simulation = Simulation(Scenario(nodes=1, duration_s=seconds, srp=False, bp=bp, events=(create,)))
    simulation.network.stations[0].watchers.append(Watcher(simulation, moments))
    simulation.run()
    return [after - before for before, after in pairwise(moments)]


class TestIntervals:
    def test_exponential_beacon_intervals(self):
        """Their coefficient of variation is 1, and the mean is the period."""
        found = [each / 1e9 for each in beacon_intervals("exponential", 400)]
        assert len(found) > 3000
        assert statistics.fmean(found) == pytest.approx(0.1, rel=4 / math.sqrt(len(found)))
        assert statistics.stdev(found) == pytest.approx(0.1, rel=0.08)

    def test_fixed_beacon_intervals(self):
        assert set(beacon_intervals("fixed", 5)) == {100 * MS}

    def test_the_delay_of_a_hop_is_a_whole_mean_interval(self):
        """Exponential intervals have no memory: the wait for the next beacon is B, not B/2."""
        report = Simulation(
            Scenario(
                nodes=3,
                duration_s=400,
                topology=Topology(kind="line"),
                srp=False,
                bp=BPConfig(intervals="exponential"),
                # The default, 50 ms, is longer than many intervals: VarDis would miss these beacons.
                vardis=VardisConfig(max_summaries=0, buffer_check_period_ms=1),
                events=(
                    Create(at_s=0.5, node=0, variable=1, text="0"),
                    Update(at_s=2.0, every_s=1.9, node=0, variable=1, text="{n}"),
                ),
            )
        ).run()
        for hops in (1, 2):
            row = next(each for each in report.delays if (each.kind, each.hops) == ("update", hops))
            assert row.mean_ms == pytest.approx(100 * hops, abs=4 * 100 * math.sqrt(hops / row.received))

    def test_random_events_are_a_poisson_process(self):
        scenario = Scenario(
            nodes=1,
            duration_s=10_000,
            events=(
                Restart(at_s=0, node=0, every_s=2.0, intervals="exponential"),
                Restart(at_s=5.0, node=0, every_s=2.0, times=4, intervals="exponential"),
                Restart(at_s=1.0, node=0, every_s=2.0, times=3),
            ),
        )
        timeline = scenario.timeline()
        first, second, fixed = ([at for at, _, event in timeline if event is one] for one in scenario.events)
        assert (len(second), second[0], fixed) == (4, 5 * 10**9, [10**9, 3 * 10**9, 5 * 10**9])
        assert abs(len(first) - 5000) < 4 * math.sqrt(5000)
        counts = [0] * 1000
        for at in first:
            counts[min(at // 10**10, 999)] += 1
        # Index of dispersion: variance and mean of a Poisson distribution are equal.
        assert statistics.variance(counts) / statistics.fmean(counts) == pytest.approx(1, abs=4 * math.sqrt(2 / 1000))
        assert timeline == scenario.timeline()
        other = msgspec.structs.replace(scenario, seed=2).timeline()
        assert [at for at, _, event in other if event is scenario.events[0]] != first


class Watcher:
    """Notes the times of beacons."""

    def __init__(self, simulation, moments):
        self.simulation, self.moments = simulation, moments

    def saw(self, _octets, _wall, *, outgoing, source):
        self.moments.append(self.simulation.network.now)


class TestModels:
    @pytest.fixture
    def model(self, tmp_path):
        path = tmp_path / "model.py"
        path.write_text(MODEL)
        return path

    def test_a_model_decides_about_overlap(self, model):
        radio = Radio(preamble=MS, model=load_model(f"{model}:Nearest", {}))
        places = Positions([(0, 0, 0), (10, 0, 0), (30, 0, 0)], 100)
        medium = RadioMedium(3, radio, topology=places)
        # 1 is nearer to 0 than to 2. The senders themselves do not receive: they are at no distance from themselves.
        assert received(medium, (0, 0, b"a"), (0, 2, b"b")) == [(MS, 0, (1,))]
        assert medium.counters.lost == 3
        patient = Radio(preamble=MS, model=load_model(f"{model}:Nearest", {"factor": 3.0}))
        assert received(RadioMedium(3, patient, topology=places), (0, 0, b"a"), (0, 2, b"b")) == []

    def test_the_model_of_a_scenario(self, model, tmp_path, capsys):
        scenario = tmp_path / "scenario.toml"
        text = 'nodes = 3\nduration_s = 2\n[topology]\nkind = "positions"\nrange_m = 99\n'
        text += "positions = [[0, 0, 0], [10, 0, 0], [30, 0, 0]]\n[bp]\nintervals = 'fixed'\n"
        text += "[[tracks]]\nsource = 'track:line,speed=0'\n[radio]\npreamble_us = 1000\nmodel = 'model.py:%s'\n"
        scenario.write_text(text % "Nearest")
        assert Simulation(load_scenario(scenario)).run().met
        hashes = []
        for content in (MODEL, MODEL + "# changed\n"):
            model.write_text(content)
            loaded = load_scenario(scenario)
            hashes.append(Provenance.of(loaded, Simulation(loaded).codec).scenario_sha256)
        assert hashes[0] != hashes[1]
        for name, problem in (
            ("Wrong", "Wrong.loss returned 1.5, which is not a probability in 0..1"),
            ("Broken", "Broken.loss raised ZeroDivisionError: division by zero"),
            ("Empty", "radio.model: Empty has no method loss(reception)"),
            ("None", "model.py has no class None"),
        ):
            scenario.write_text(text % name)
            with pytest.raises(SystemExit) as ended:
                main(["simulate", str(scenario)])
            assert ended.value.code == 2
            assert problem in capsys.readouterr().err

    def test_models_that_cannot_be_loaded(self, tmp_path):
        (tmp_path / "bad.py").write_text("1 +")
        for name, options, problem in (
            ("Model", {}, "neither module:Class nor FILE.py:Class"),
            ("nowhere.py:Model", {}, "there is no file nowhere.py"),
            ("no_such_module:Model", {}, "no_such_module cannot be imported: ModuleNotFoundError"),
            (f"{tmp_path / 'bad.py'}:Model", {}, "cannot be imported: SyntaxError"),
            ("fractions:Fraction", {"half": 1}, "Fraction cannot be made with these options: TypeError"),
        ):
            with pytest.raises(RadioError, match=problem):
                load_model(name, options)

    def test_a_model_of_an_installed_module(self):
        assert Reception.__module__ == "dcp_stack.virtual.radio"
        assert RadioTable(model="statistics:NormalDist").model_sha256() is not None
        assert RadioTable(model="no_such_module:Model").model_sha256() is None


def test_invalid_radios_are_refused():
    for keys, problem in (
        ({"bit_rate": -1}, "radio: bit_rate: must be finite and at least 0 bit/s, not -1"),
        ({"preamble_us": math.inf}, "radio.preamble_us: must be finite and at least 0, not inf"),
        ({"bit_error_rate": 2.0}, "radio: bit_error_rate: 2 is not within 0..1"),
        ({"loss": ((0, 2),)}, r"radio: loss: \[0, 2\] is not a distance"),
        ({"loss": ((5, 0), (5, 1))}, "radio: loss: the distances must ascend"),
        ({"loss": ((5, 0), (6, 1))}, "radio.loss: distances need positions"),
        ({"options": {"a": 1}}, "radio: options: they are those of a model, which is missing"),
    ):
        with pytest.raises(ScenarioError, match=problem):
            check(Scenario(nodes=2, duration_s=1, radio=RadioTable(**keys)))
    event = Restart(at_s=0, node=0, intervals="exponential")
    with pytest.raises(ScenarioError, match=r"events\[0\].intervals: requires every_s, the mean interval"):
        check(Scenario(nodes=1, duration_s=1, events=(event,)))


def test_unknown_keys_have_a_hint(tmp_path):
    path = tmp_path / "scenario.toml"
    path.write_text("nodes = 1\nduration_s = 1\n[radio]\nbitrate = 3\n")
    with pytest.raises(ScenarioError, match=r"radio: unknown key `bitrate`; did you mean bit_rate\?"):
        load_scenario(path)
    path.write_text("nodes = 1\nduration_s = 1\n[bp]\nintervals = 'poisson'\n")
    with pytest.raises(ScenarioError, match=r"bp\.intervals: Invalid .* 'poisson'; the values are uniform, fixed, exp"):
        load_scenario(path)
    path.write_text(f"nodes = 1\nduration_s = 1\n{EVENT}intervals = 'poisson'\n")
    with pytest.raises(ScenarioError, match=r"events\[0\].intervals: .* the values are fixed, exponential"):
        load_scenario(path)


def test_a_testbed_refuses_a_radio(tmp_path):
    with pytest.raises(ScenarioError, match="radio: a testbed has no radio"):
        Testbed(Scenario(nodes=2, duration_s=1, radio=RadioTable(bit_rate=1e6)), tmp_path, keep=False)
