"""Every campaign begins with each kind of structural damage, and frames can be cut while their lies are kept."""

from __future__ import annotations

import random

import msgspec
import pytest
from dcp_lab.fuzz import Frame
from dcp_lab.fuzz.generate.samples import Samples
from dcp_lab.fuzz.generate.sequence_batches import Batches
from dcp_lab.fuzz.generate.sweep import Sweep, SweepFirst
from dcp_lab.fuzz.reduce.anatomy import Anatomy
from dcp_lab.fuzz.reduce.anomalies import anomalies, kinds_of
from dcp_lab.fuzz.reduce.repairs import Repairs
from dcp_lab.fuzz.reduce.shrinking import Shrinker
from dcp_lab.testing.mutation import Mutator, drawn_pool
from dcp_lab.testing.mutation_values import valid_beacons
from dcp_spec.reasons import REASONS

from dcp_codec import Codec

from ..odd_profiles import BUILT_IN
from ..parts import every

CODEC = Codec("dcp-2.0")


def frames(name: str) -> list[bytes]:
    return [test[0].octets for test in Sweep(Codec(name)).sequences() if len(test) == 1]


@pytest.mark.parametrize("name", every(4, BUILT_IN))
def test_every_kind_of_damage_comes_within_the_first_hundred_frames(name):
    codec = Codec(name)
    found = frames(name)
    assert 200 <= len(found) <= 400
    assert max(map(len, found)) <= max(1500, codec.profile.limits.max_beacon_size)
    early = {kind for octets in found[:100] for kind in kinds_of(anomalies(codec, octets))}
    reasons = {kind.partition(" ")[0] for kind in early}
    assert {"empty-frame", "zero-count", "truncated", "many-records"} <= reasons
    # The lists of that profile have a length of their own, of which an unknown type makes another one.
    assert "unknown-type" in reasons or name == "student-2024"
    if codec.profile.bp.header:
        assert any(kind.startswith("truncated at bp.") for kind in early)
        assert {"bad-version", "bad-magic"} & reasons
    if name in ("dcp-2.0", "cpp-2.0"):
        assert {"beacon-overrun", "block-overrun", "zero-length", "empty-payload", "count-mismatch"} <= reasons


def test_most_frames_of_a_sweep_have_one_anomaly_and_are_small():
    found = [kinds_of(anomalies(CODEC, octets)) for octets in frames("dcp-2.0")]
    assert sum(kinds.total() == 1 for kinds in found) > 0.7 * len(found)
    small = [
        len(octets)
        for octets in frames("dcp-2.0")
        if not any("many" in kind for kind in kinds_of(anomalies(CODEC, octets)))
    ]
    assert sorted(small)[len(small) * 9 // 10] <= 80


def test_records_are_cut_at_every_field_of_every_kind():
    cut = {kind for octets in frames("dcp-2.0") for kind in kinds_of(anomalies(CODEC, octets)) if "truncated" in kind}
    fields = {kind.rpartition("records[].")[2] for kind in cut if "records[]." in kind}
    spec = ("varId", "prodId", "repCnt", "creationTime", "timeout", "descr.length", "descr.data")
    update = ("varId", "seqno", "value.length", "value.data")
    assert fields == {*update, *(f"spec.{name}" for name in spec), *(f"upd.{name}" for name in update)}


def test_a_sweep_ends_with_many_variables_and_many_neighbours():
    *_, variables, neighbours = Sweep(CODEC).sequences()
    created = {
        record.spec.var_id
        for step in variables
        if isinstance(step, Frame)
        for container in CODEC.decode(step.octets).payloads[0].vardis
        for record in container.records
    }
    # Some identifiers are reserved for health checks.
    assert 200 <= len(created) < 256
    reports = [step for step in neighbours if isinstance(step, Frame)]
    assert len({CODEC.decode(step.octets).payloads[0].srp.node_id for step in reports}) > 1000


class Endless:
    kinds = ("other",)

    def draw(self):
        return [Frame(b"other")]

    def keep(self, steps):
        """Not asked for."""


def test_a_resumed_campaign_continues_its_sweep_and_then_other_tests():
    whole = Sweep(CODEC).sequences()
    first, rest = SweepFirst(Endless(), CODEC), SweepFirst(Endless(), CODEC, done=7)
    drawn = [first.draw() for _ in range(7)] + [rest.draw() for _ in range(len(whole) - 7)]
    assert drawn == whole
    assert rest.kinds == ("sweep",)
    assert rest.draw() == [Frame(b"other")]
    assert rest.kinds == ("other",)


def test_tests_on_a_link_have_many_frames_of_a_sweep():
    assert len(Batches(SweepFirst(Endless(), CODEC), 20).draw()) == 20


# -- anatomy, repairs ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", every(4, BUILT_IN))
def test_removing_elements_adjusts_counts_and_lengths(name):
    codec = Codec(name)
    cut = 0
    for octets in valid_beacons(codec, random.Random(3), 40):
        beacon = codec.decode(octets)
        if len(beacon.payloads) < 2:
            continue
        anatomy = Anatomy(codec, octets)
        payloads = anatomy.at("payloads")
        left = msgspec.structs.replace(beacon, payloads=beacon.payloads[1:])
        assert anatomy.without([payloads.children[0]]) == codec.encode(left)
        cut += 1
    assert cut > 5


def test_the_error_of_a_wrong_length_is_kept():
    samples = Samples(CODEC)
    octets = samples.beacon(samples.other(bytes(10)), samples.other(bytes(20)))
    lying = octets[:11] + (1000).to_bytes(2, "big") + octets[13:]
    anatomy = Anatomy(CODEC, lying)
    shorter = anatomy.without([anatomy.at("payloads[0]")])
    assert int.from_bytes(shorter[11:13], "big") == 1000 - 14
    assert shorter[13] == 1
    one = anatomy.replaced(anatomy.at("payloads[1].data"), b"x")
    assert int.from_bytes(one[11:13], "big") == 1000 - 19


@pytest.mark.parametrize("name", every(8, BUILT_IN))
def test_each_anomaly_can_be_repaired_by_itself(name):
    codec = Codec(name)
    rng = random.Random(5)
    mutator = Mutator(codec, rng, drawn_pool(codec, rng, 40))
    repairs, shrinker = Repairs(codec), Shrinker(codec)
    assert not anomalies(codec, repairs.sound)
    seen = alone = damaged = 0
    for _ in range(60):
        octets = mutator.mutate().octets
        before = kinds_of(anomalies(codec, octets))
        for anomaly in anomalies(codec, octets):
            repaired = repairs.repaired(octets, anomaly)
            assert repaired is not None
            after = kinds_of(anomalies(codec, repaired))
            assert after <= before
            assert after[anomaly.kind] < before[anomaly.kind]
            seen += 1
            if anomaly.reason in REASONS or anomaly.reason == "empty-frame":
                damaged += 1
                isolated = shrinker.isolated(octets, anomaly)
                if isolated is not None:
                    assert set(kinds_of(anomalies(codec, isolated))) == {anomaly.kind}
                    alone += 1
    assert seen > 30
    # In a fixed area one lie is followed by others.
    assert alone >= (0.3 if name == "student-2024" else 0.85) * damaged
