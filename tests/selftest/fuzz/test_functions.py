"""Functions in process as targets: ours show nothing, and what they could show is noticed."""

from __future__ import annotations

import random

import pytest
from dcp_conformance.definitions.pics import load_pics
from dcp_conformance.errors import UsageError
from dcp_lab.fuzz.steps import Frame
from dcp_lab.testing.mutation import Mutator, drawn_pool
from dcp_selftest.fuzz.functions import PARTS, FunctionInputs, FunctionTarget
from dcp_selftest.fuzz.havoc import Havoc

from dcp_codec import Codec

CODEC = Codec("dcp-2.0")


@pytest.fixture
def target():
    made = FunctionTarget(CODEC)
    yield made
    made.close()


@pytest.mark.part("suite")
@pytest.mark.parametrize(
    ("part", "cases"), [("beacon", 2000), ("capture", 600), ("control", 800), ("profile", 60), ("pics", 150)]
)
def test_a_short_campaign_finds_nothing_in_our_functions(target, part, cases):
    rng = random.Random(2)
    inputs = FunctionInputs(CODEC, rng, Mutator(CODEC, rng, drawn_pool(CODEC, rng, 60)), [part])
    found = {}
    for _ in range(cases):
        steps = inputs.draw()
        assert inputs.kinds == (part,)
        effect = target.run(steps)
        if effect is not None:
            found[effect.signature] = steps[0].octets[:200]
    assert found == {}


def test_all_parts_are_drawn():
    rng = random.Random(1)
    inputs = FunctionInputs(CODEC, rng, Mutator(CODEC, rng, drawn_pool(CODEC, rng, 20)))
    drawn = {inputs.draw() and inputs.kinds[0] for _ in range(400)}
    assert drawn == set(PARTS)


def test_parts_are_named_in_any_order_and_may_be_repeated():
    drawn = []
    for parts in (("beacon", "pics"), ("pics", "beacon", "pics")):
        rng = random.Random(1)
        inputs = FunctionInputs(CODEC, rng, Mutator(CODEC, rng, drawn_pool(CODEC, rng, 20)), parts)
        drawn.append([inputs.draw() and inputs.kinds[0] for _ in range(50)])
    assert drawn[0] == drawn[1]


class Raising(Codec):
    def decode_from(self, octets, start=0):
        raise KeyError("x")


class Forgetful(Codec):
    def encode(self, beacon):
        return b""


@pytest.mark.parametrize(("wrong", "said"), [(Raising, "KeyError"), (Forgetful, "encoding is not the reverse")])
def test_a_codec_that_is_wrong_is_noticed(wrong, said):
    target = FunctionTarget(wrong("dcp-2.0"))
    try:
        effects = [target.once("beacon", octets) for octets in drawn_pool(CODEC, random.Random(1), 10)]
    finally:
        target.close()
    assert all(effect is not None and said in effect.detail for effect in effects)


def test_a_decoder_that_accepts_more_than_the_dissector_is_noticed():
    valid = drawn_pool(CODEC, random.Random(1), 10)[-1]

    class Lenient(Codec):
        def decode_from(self, octets, start=0):
            return super().decode_from(valid)

    target = FunctionTarget(Lenient("dcp-2.0"))
    try:
        effect = target.once("beacon", b"\xff" * 30)
    finally:
        target.close()
    assert effect is not None
    assert effect.kind == "disagrees"


def test_deeply_nested_arrays_in_a_pics_are_an_error_of_the_file(tmp_path):
    path = tmp_path / "deep.toml"
    path.write_text(f"[pixit]\nvar_ids = {'[' * 20_000}\n")
    with pytest.raises(UsageError, match=r"deep\.toml"):
        load_pics(path)


def test_havoc_changes_octets_and_inserts_dictionary_words():
    havoc = Havoc(random.Random(1), [b"0123456789" * 4], [b"WORD"])
    drawn = [havoc.mutate() for _ in range(300)]
    assert any(b"WORD" in each for each in drawn)
    assert len(set(drawn)) > 200
    havoc.add(b"another")
    assert any(b"noth" in havoc.mutate() for _ in range(300))
    with pytest.raises(ValueError, match="pool is empty"):
        Havoc(random.Random(1), [])


def test_frames_that_name_no_part_are_beacons(target):
    assert target.run([Frame(b""), Frame(drawn_pool(CODEC, random.Random(1), 8)[-1])]) is None
