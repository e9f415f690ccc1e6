"""The stack in process as a target: our node shows nothing, and nodes with faults show them, in few frames."""

from __future__ import annotations

import random

import pytest
from dcp_conformance.errors import UsageError
from dcp_lab.fuzz import Campaign, Frame, Limits, Wait
from dcp_lab.fuzz.execute.stack import StackTarget
from dcp_lab.fuzz.findings.artefact import SavedTarget
from dcp_lab.fuzz.generate.sequence_batches import Joined
from dcp_lab.fuzz.generate.sequences import Sequences
from dcp_lab.testing.mutation import Mutator, drawn_pool
from dcp_selftest.fuzz.targets import stack_target

from dcp_codec import Codec
from dcp_stack.node import Node

from ..parts import also


def campaign_on(target: StackTarget, seed: int = 1) -> Campaign:
    codec, rng = target.codec, random.Random(seed)
    mutator = Mutator(codec, rng, drawn_pool(codec, rng, 80))
    sequences = Sequences(codec, rng, target.own_id, mutator)
    saved = SavedTarget("stack", target.name)
    return Campaign(codec, target, sequences, saved, seed, mutator=mutator)


@pytest.mark.parametrize("profile", ["dcp-2.0", *also("suite", "dcp-1.0", "dcp-1.3", "cpp-2.0", "student-2024")])
def test_a_short_campaign_finds_nothing_in_our_node(profile):
    campaign = campaign_on(StackTarget(Codec(profile)))
    state = campaign.run(Limits(cases=400))
    assert state.findings == {}
    assert state.cases == 400
    assert len(state.kinds) > 5


@pytest.mark.part("suite")
@pytest.mark.parametrize(
    ("mutant", "kind", "frames"),
    [
        ("M-BP-RX-15-dies", "raised", 1),
        ("M-VD-ROB-01-dies-of-type", "raised", 1),
        ("M-VD-ROB-01-dies-of-text", "raised", 1),
        ("M-DATA-01-swapped-length", "bad-beacon", 1),
    ],
)
def test_mutants_are_found_and_shown_in_few_frames(mutant, kind, frames):
    target = stack_target(Codec("dcp-2.0"), mutant)
    campaign = campaign_on(target)
    campaign.run(Limits(cases=1500, findings=1))
    [artefact] = campaign.artefacts
    assert artefact.effect.kind == kind
    assert artefact.frames <= frames
    assert artefact.minimised
    # Our unchanged node shows no effect.
    assert StackTarget(target.codec).run(artefact.as_steps()) is None


def test_a_mutant_that_falls_silent_is_found():
    steps = [Frame(b"\0" * 40)] * 25
    effect = stack_target(Codec("dcp-2.0"), "M-BP-RX-16-mute").run(steps)
    assert effect is not None
    assert effect.kind == "mute"


def test_a_hanging_node_is_stopped():
    class Endless(Node):
        def handle_frame(self, octets, *, now, wall):
            while octets == b"stop":
                pass

    target = StackTarget(Codec("dcp-2.0"), make=lambda c, r, n, w: Endless(c, rng=r, now=n, wall=w), time_limit=0.2)
    effect = target.run([Frame(b"stop")])
    assert effect is not None
    assert effect.kind == "hang"
    # And the next sequence has all of its time.
    assert target.run([Wait(0.1)]) is not None


def test_an_exception_between_inputs_does_not_crash_the_tester():
    class Broken(Node):
        def poll_timeout(self):
            raise ZeroDivisionError("no deadline")

    target = StackTarget(Codec("dcp-2.0"), make=lambda c, r, n, w: Broken(c, rng=r, now=n, wall=w))
    effect = target.run([Wait(1.0)])
    assert effect is not None
    assert effect.signature == "raised: ZeroDivisionError in poll_timeout"


def test_all_kinds_of_sequences_are_drawn_reproducibly():
    codec = Codec("dcp-2.0")

    def drawn(seed: int) -> tuple[list, set[str]]:
        rng = random.Random(seed)
        sequences = Sequences(codec, rng, b"\2\0\0\0\0\1", Mutator(codec, rng, drawn_pool(codec, rng, 40)))
        found, kinds = [], set()
        for _ in range(600):
            found.append(sequences.draw())
            kinds.update(sequences.kinds)
        return found, kinds

    one, kinds = drawn(4)
    assert kinds >= {
        *("mixed", "mutated", "records", "spoofed-sender", "services", "reports"),
    }
    assert one == drawn(4)[0]


def test_floods_and_full_databases_do_no_harm():
    codec = Codec("dcp-2.0")
    rng = random.Random(1)
    target = StackTarget(codec, time_limit=60)
    sequences = Sequences(codec, rng, target.own_id, Mutator(codec, rng, drawn_pool(codec, rng, 40)))
    assert target.run(sequences.neighbour_flood()) is None
    assert target.run(sequences.all_variables()) is None
    assert target.run(sequences.largest()) is None
    assert target.run(sequences.garbage()) is None
    assert len(Joined(sequences, 5).draw()) >= 5


def test_a_recording_is_mutated():
    codec = Codec("dcp-2.0")
    rng = random.Random(1)
    recorded = drawn_pool(codec, random.Random(9), 12)
    sequences = Sequences(codec, rng, b"\2\0\0\0\0\1", Mutator(codec, rng, recorded), recorded)
    steps = sequences.recording()
    assert {step.octets for step in steps} & set(recorded)
    assert "recording" in {sequences.draw() and sequences.kinds[0] for _ in range(300)}


def test_a_mutant_that_does_not_exist_is_refused():
    with pytest.raises(UsageError, match="no mutant"):
        stack_target(Codec("dcp-2.0"), "M-NOTHING")
