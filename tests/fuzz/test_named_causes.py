"""The cause that a finding names is what kills, whatever else is in the frame; what it does not need is gone."""

from __future__ import annotations

import random

import pytest
from dcp_lab.fuzz import Campaign, Frame, Limits
from dcp_lab.fuzz.execute.live import LiveTarget
from dcp_lab.fuzz.findings.artefact import SavedTarget
from dcp_lab.fuzz.generate.samples import Samples
from dcp_lab.fuzz.generate.sequence_batches import Batches
from dcp_lab.fuzz.generate.sequences import Sequences
from dcp_lab.fuzz.generate.sweep import SweepFirst
from dcp_lab.testing.mutation import Mutator, drawn_pool
from dcp_selftest.mutants import all_mutants

from ..parts import every
from .fragile import CODEC, FAULTS, make_of, mixed, opened

OWN = b"\x02\x00\x00\x00\x00\x01"
SEEDS = range(10)


class Mixed:
    """Frames with several kinds of damage, one of four with the fault."""

    kinds = ("mixed",)

    def __init__(self, rng: random.Random, fault: str) -> None:
        self.rng = rng
        self.fault = fault
        self.others = [name for name in FAULTS if name not in (fault, "empty-frame")]

    def draw(self):
        frames = [mixed(self.rng, self.rng.choice(self.others)) for _ in range(3)]
        frames.insert(self.rng.randrange(4), mixed(self.rng, self.fault))
        return frames

    def keep(self, steps):
        """Nothing is mutated here."""


def campaign_on(make, generator, seed=1) -> Campaign:
    target = LiveTarget(opened(make))
    saved = SavedTarget("live", target.name)
    return Campaign(CODEC, target, generator, saved, seed, by_cause=True, budget=200, fresh=target.run_after_restart)


@pytest.mark.parametrize("seed", every(10, SEEDS))
@pytest.mark.parametrize("fault", every(6, FAULTS))
def test_the_deadly_anomaly_is_named_and_is_the_only_one_kept(fault, seed):
    make = make_of(deadly=[fault]) if seed % 2 else make_of(silent=[fault])
    campaign = campaign_on(make, Mixed(random.Random(seed), fault), seed)
    campaign.run(Limits(cases=8, findings=1))
    [artefact] = campaign.artefacts
    assert artefact.cause is not None
    assert artefact.cause.title.startswith(FAULTS[fault])
    assert "," not in artefact.cause.title
    assert artefact.cause.proven
    assert artefact.frames == 1
    assert artefact.octets <= 50
    if fault != "empty-frame":
        assert artefact.cause.also
    # Each trial that kills costs a restart, which takes seconds for some implementations.
    assert campaign.target.restarts <= 12


@pytest.mark.parametrize("seed", every(10, SEEDS))
@pytest.mark.parametrize(
    ("mutant", "fault"),
    [
        ("M-BP-RX-15-dies", "length-beyond-the-frame"),
        ("M-BP-RX-16-dies-of-empty", "empty-vardis-block"),
        ("M-VD-ROB-01-dies-of-zero", "count-0"),
        ("M-VD-ROB-01-dies-of-type", "unknown-type"),
    ],
)
def test_the_anomaly_is_named_for_nodes_without_other_faults(mutant, fault, seed):
    campaign = campaign_on(all_mutants()[mutant].make, Mixed(random.Random(seed), fault), seed)
    campaign.run(Limits(cases=60, findings=1))
    [artefact] = campaign.artefacts
    assert artefact.cause is not None
    assert artefact.cause.title.startswith(FAULTS[fault])
    assert artefact.octets <= 50


def test_a_header_alone_is_not_two_causes():
    """That no block follows is not a part of a death by the length of the header."""
    bare = Frame(Samples(CODEC).each()[0][:18])
    campaign = campaign_on(make_of(deadly=["length-beyond-the-frame"]), One([bare]))
    campaign.run(Limits(cases=1))
    [artefact] = campaign.artefacts
    assert artefact.cause is not None
    assert artefact.cause.title == "beacon-overrun at bp.length"
    assert artefact.cause.also == ("count-mismatch at bp.numPayloads",)


class One:
    kinds = ("one",)

    def __init__(self, steps) -> None:
        self.steps = steps

    def draw(self):
        return self.steps

    def keep(self, steps):
        """Nothing is mutated here."""


def test_anomalies_that_accompanied_a_deadly_one_are_still_sent():
    campaign = campaign_on(make_of(deadly=["empty-vardis-block"]), Mixed(random.Random(1), "empty-vardis-block"))
    campaign.run(Limits(cases=8))
    [artefact] = campaign.artefacts
    assert artefact.cause is not None
    assert campaign.state.avoided == [FAULTS["empty-vardis-block"]]
    sent = campaign._drawn()
    assert sent
    assert any(FAULTS["unknown-type"] in artefact.cause.also for artefact in campaign.artefacts)
    left = Frame(mixed(random.Random(3), "unknown-type").octets)
    campaign._left = [left, *mixed_with(random.Random(5), "empty-vardis-block")]
    assert campaign._drawn() == [left]


def mixed_with(rng: random.Random, fault: str) -> list[Frame]:
    return [mixed(rng, fault) for _ in range(3)]


@pytest.mark.part("suite")
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_findings_of_one_fault_are_one_cause_and_all_faults_are_found_soon(seed):
    """A node with seven faults: seven causes come out, however many fields there are to cut a record at."""
    rng = random.Random(seed)
    mutator = Mutator(CODEC, rng, drawn_pool(CODEC, rng, 60))
    sequences = SweepFirst(Sequences(CODEC, rng, OWN, mutator), CODEC)
    faults = [fault for fault in FAULTS if fault != "unknown-type"]
    campaign = campaign_on(make_of(deadly=faults, silent=["unknown-type"]), Batches(sequences, 20), seed)
    campaign.run(Limits(cases=40))
    causes = campaign.state.causes
    by_fault = {fault: [each for each in causes.values() if each.title.startswith(FAULTS[fault])] for fault in FAULTS}
    assert all(len(found) == 1 for found in by_fault.values()), {each.title: each.findings for each in causes.values()}
    assert sum(map(len, by_fault.values())) == len(causes)
    [cut] = by_fault["cut"]
    assert 1 < cut.findings <= 3
    assert all(each.octets <= 50 for each in causes.values())
    assert sum(each.findings for each in causes.values()) == len(campaign.artefacts)
