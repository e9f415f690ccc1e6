"""Mutations of valid messages: reproducible, each says what it did, and all that is possible is reached."""

from __future__ import annotations

import random

import pytest
from dcp_lab.testing.mutation import FIELD_CLASSES, STRUCTURE_CLASSES, Mutator, drawn_pool
from dcp_lab.testing.mutation_values import ValidValues, valid_beacons

from dcp_codec import Codec, DecodeError

from ..odd_profiles import BUILT_IN, codec_of
from ..parts import every


@pytest.fixture(params=every(4, BUILT_IN))
def codec(request) -> Codec:
    return Codec(request.param)


def mutator_of(codec: Codec, seed: int = 1, count: int = 60) -> Mutator:
    rng = random.Random(seed)
    return Mutator(codec, rng, drawn_pool(codec, rng, count))


def test_drawn_beacons_are_valid_and_fill_containers(codec):
    found = [codec.decode(octets) for octets in valid_beacons(codec, random.Random(3), 80)]
    kinds = {container.ic_type for each in found for payload in each.payloads for container in payload.vardis or ()}
    assert len(kinds) == 6
    records = [len(c.records) for each in found for payload in each.payloads for c in payload.vardis or ()]
    assert max(records) > 60


def test_boundaries_of_numbers_are_favoured():
    values = ValidValues(Codec("dcp-2.0"), random.Random(1))
    drawn = [values.number(2) for _ in range(400)]
    for edge in (0, 1, 0xFFFE, 0xFFFF):
        assert drawn.count(edge) > 10


def test_the_same_seed_makes_the_same_octets(codec):
    one, other, third = (mutator_of(codec, seed) for seed in (5, 5, 6))
    octets = [one.mutate().octets for _ in range(200)]
    assert octets == [other.mutate().octets for _ in range(200)]
    assert octets != [third.mutate().octets for _ in range(200)]


def test_every_mutation_describes_itself_and_starts_with_a_valid_message(codec):
    mutator = mutator_of(codec)
    for _ in range(500):
        made = mutator.mutate()
        assert set(made.touched) <= mutator.possible
        codec.decode(made.source)
        if all(name in FIELD_CLASSES for _, name in made.touched):
            assert len(made.octets) == len(made.source)


def test_all_pairs_of_field_and_class_are_reached(codec):
    mutator = mutator_of(codec)
    for _ in range(6000):
        mutator.mutate()
    missing = {touch for touch in mutator.possible if not mutator.reached[touch]}
    # Where a message is cut is drawn by octets: short fields of rare records come late.
    assert {name for _, name in missing} <= {"cut"}
    assert {name for _, name in mutator.possible} >= {*FIELD_CLASSES, *STRUCTURE_CLASSES} - {"swapped", "unknown"}


def test_pairs_that_are_missing_come_first():
    mutator = mutator_of(Codec("dcp-2.0"))
    fields = {touch for touch in mutator.possible if touch[1] in FIELD_CLASSES}
    for _ in range(1500):
        mutator.mutate()
    assert not {touch for touch in fields if not mutator.reached[touch]}


def test_a_message_is_cut_at_every_octet():
    codec = Codec("dcp-2.0")
    octets = valid_beacons(codec, random.Random(1), 8)[-1]
    mutator = Mutator(codec, random.Random(2), [octets])
    cut = {len(made.octets) for made in (mutator.mutate() for _ in range(60 * len(octets)))}
    assert cut >= set(range(len(octets)))


def test_unknown_types_are_none_of_the_profile():
    codec = Codec("dcp-2.0")
    mutator = mutator_of(codec)
    known = set(codec.profile.vardis.container_types.by_name().values())
    options = [p.options["unknown"] for s in mutator.sources for p in s.places if p.path.endswith(".icType")]
    assert options
    assert not {int.from_bytes(each) for each in options} & known


def test_octets_without_a_valid_message_can_be_mutated():
    codec = Codec("dcp-2.0")
    with pytest.raises(DecodeError):
        codec.decode(b"\1\2\3")
    mutator = Mutator(codec, random.Random(1), [b"\1\2\3"])
    assert len({mutator.mutate().octets for _ in range(50)}) > 10
    with pytest.raises(ValueError, match="pool is empty"):
        Mutator(codec, random.Random(1), [b""])


def test_added_elements_are_mutated():
    codec = Codec("dcp-2.0")
    first, second = valid_beacons(codec, random.Random(1), 8)[-2:]
    mutator = Mutator(codec, random.Random(1), [first])
    mutator.add(second)
    assert {mutator.mutate().source for _ in range(100)} == {first, second}


def test_fields_and_containers_that_a_profile_adds_are_drawn(tmp_path):
    codec = codec_of("odd-own", tmp_path)
    values = ValidValues(codec, random.Random(1))
    drawn = [record for _ in range(200) for record in values.container().records]
    kinds = {type(each).__name__ for each in drawn}
    assert {"GeoFence", "Ping"} < kinds
    for name in ("VarSumm", "VarReqCreate", "VarCreate", "VarDelete"):
        assert len({each.extra for each in drawn if type(each).__name__ == name}) > 3, name
    assert all(codec.decode(octets) for octets in valid_beacons(codec, random.Random(3), 80))
