"""Minimising: fewer steps, then less in each, as long as the effect is the same."""

from __future__ import annotations

import random

from dcp_lab.fuzz import Campaign, Effect, Frame, Limits, Minimiser, Wait
from dcp_lab.fuzz.findings.artefact import SavedTarget
from dcp_lab.fuzz.generate.samples import Samples
from dcp_lab.fuzz.reduce.anomalies import anomalies
from dcp_lab.testing.mutation_values import valid_beacons

from dcp_codec import Codec

CODEC = Codec("dcp-2.0")


def effect(at: int) -> Effect:
    return Effect("raised", f"step {at}", at, "here")


def test_only_necessary_steps_are_kept():
    def run(steps):
        marks = [step.octets for step in steps if isinstance(step, Frame)]
        return effect(len(steps) - 1) if b"a" in marks and b"b" in marks[marks.index(b"a") :] else None

    steps = [Frame(b"x"), Frame(b"a"), Wait(2.0), *[Frame(b"y")] * 40, Frame(b"b"), Wait(1.0), Frame(b"z")]
    found = Minimiser(run, effect(0)).minimise(steps)
    assert found is not None
    assert found.steps == [Frame(b"a"), Frame(b"b")]


def test_only_parts_of_a_frame_that_the_effect_needs_are_kept():
    """The anomaly stays, in the smallest frame that has it; other damage, records, values and descriptions go."""
    valid = next(each for each in valid_beacons(CODEC, random.Random(2), 20) if len(each) > 60)
    octets = bytearray(valid)
    octets[0] ^= 1
    octets[30] ^= 0xFF
    octets[40] ^= 0xFF

    def run(steps):
        return effect(0) if any(step.octets[:1] == octets[:1] for step in steps) else None

    found = Minimiser(run, effect(0), CODEC).minimise([Frame(bytes(octets), valid)])
    assert found is not None
    [step] = found.steps
    assert [each.kind for each in anomalies(CODEC, step.octets)] == ["bad-version at bp.version"]
    assert len(step.octets) <= len(Samples(CODEC).each()[0]) + 2


def test_unstructured_octets_are_shortened():
    def run(steps):
        return effect(0) if steps[0].octets[:1] == b"x" else None

    found = Minimiser(run, effect(0)).minimise([Frame(b"x" + bytes(500))])
    assert found is not None
    assert found.steps == [Frame(b"x")]


def test_unnecessary_records_are_removed():
    valid = valid_beacons(CODEC, random.Random(2), 1)[0]

    def run(steps):
        try:
            beacon = CODEC.decode(steps[0].octets)
        except ValueError:
            return None
        return effect(0) if beacon.payloads[0].vardis else None

    found = Minimiser(run, effect(0), CODEC).minimise([Frame(valid)])
    assert found is not None
    containers = CODEC.decode(found.steps[0].octets).payloads[0].vardis
    assert [len(container.records) for container in containers] == [1]


def test_another_effect_is_not_the_finding():
    def run(steps):
        return effect(0) if len(steps) > 2 else Effect("mute", "silent", 0)

    found = Minimiser(run, effect(0)).minimise([Frame(b"x")] * 8)
    assert found is not None
    assert len(found.steps) == 3
    assert found.effect.kind == "raised"


def test_an_effect_that_is_not_reproduced_is_not_minimised():
    assert Minimiser(lambda steps: None, effect(0)).minimise([Frame(b"x")]) is None


def test_the_budget_ends_minimising():
    tries = 0

    def run(steps):
        nonlocal tries
        tries += 1
        return effect(len(steps) - 1)

    found = Minimiser(run, effect(0), CODEC, budget=4).minimise([Frame(bytes(50))] * 50)
    assert found is not None
    assert tries == found.tries == 4


def test_numbers_in_a_text_do_not_distinguish_effects():
    one = Effect("unbounded", "variable 3 has number 7 value '00ff'", 2)
    assert one.signature == Effect("unbounded", "variable 12 has number 0 value ''", 9).signature
    assert one.signature != Effect("unbounded", "variable 3 is alive", 2).signature
    assert one.signature != Effect("said", "variable 3 has number 7 value '00ff'", 2).signature


class Hanging:
    """Never returns from frames with enough octets of one kind, whatever is between them."""

    name = "hanging"

    def __init__(self) -> None:
        self.hangs = 0

    def run(self, steps):
        for at, step in enumerate(steps):
            if step.octets.count(b"h") >= 32:
                self.hangs += 1
                return Effect("hang", "no end after 8 s of CPU time", at)
        return None


class Long:
    kinds = ("long",)

    def draw(self):
        return [Frame(b"h-" * 32) for _ in range(40)]


def test_hangs_are_tried_only_a_few_times():
    """Each time takes all the time that a test may have."""
    target = Hanging()
    campaign = Campaign(CODEC, target, Long(), SavedTarget("stack"), 1)
    campaign.run(Limits(findings=1))
    [artefact] = campaign.artefacts
    assert artefact.minimised
    assert len(artefact.steps) == 1
    assert 1 < target.hangs <= 31
