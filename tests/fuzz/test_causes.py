"""Deaths that look alike are told apart by their frames, are not sought again, and do not turn into each other."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from dcp_lab.fuzz import Campaign, Effect, Frame, Limits, Minimiser, Wait
from dcp_lab.fuzz.findings.artefact import SavedTarget
from dcp_lab.fuzz.generate.samples import Samples
from dcp_lab.fuzz.reduce.causes import cause_of
from dcp_lab.fuzz.reduce.reduction import Reduction
from dcp_lab.fuzz.steps import Call

from dcp_codec import Codec

CODEC = Codec("dcp-2.0")
SOUND = Samples(CODEC).each()[0]
DEAD = Effect("dead", "the process is gone", 0, "dead")


def dead(step: int = 0) -> Effect:
    return DEAD._replace(step=step)


def test_causes_name_the_anomalies_or_contents_of_a_beacon():
    short = Frame(b"\x01\x49")
    kind = "truncated at bp.magicNo"
    assert cause_of(CODEC, [short, Wait(1.0), Call("RTDB-Read", {"varId": 1})]) == kind
    assert cause_of(CODEC, [Frame(SOUND)]) == "a valid beacon with VarReqCreate"
    assert cause_of(CODEC, [Call("RTDB-Read", {"varId": 1})]) == "RTDB-Read"
    assert cause_of(CODEC, []) == "nothing at all"


class Dying:
    """Crashes on some frames; has no memory between tests."""

    name = "dying"

    def __init__(self, deadly: Callable[[bytes], bool]) -> None:
        self.deadly = deadly
        self.sent: list[bytes] = []

    def run(self, steps):
        for at, step in enumerate(steps):
            self.sent.append(step.octets)
            if self.deadly(step.octets):
                return dead(at)
        return None


class Drawn:
    kinds: tuple[str, ...] = ("drawn",)

    def __init__(self, *tests: list[bytes]) -> None:
        self.tests = [list(map(Frame, test)) for test in tests]

    def draw(self):
        return self.tests.pop(0)


def campaign_of(target, generator) -> Campaign:
    return Campaign(CODEC, target, generator, SavedTarget("live"), 1, by_cause=True)


def test_a_crash_of_another_cause_is_another_finding_and_known_causes_are_avoided():
    target = Dying(lambda octets: len(octets) == 2 or octets[:1] == b"\x02")
    first, second, harmless = b"\x01\x49", b"\x02" + SOUND[1:], b"\x03" * 30
    campaign = campaign_of(target, Drawn([harmless, first], [first, harmless, second], [first, first]))
    campaign.run(Limits(cases=4))
    assert len(campaign.artefacts) == 2
    assert len(set(campaign.state.findings)) == 2
    assert len(campaign.state.causes) == 2
    assert campaign.state.avoided == ["truncated at bp.magicNo", "bad-version at bp.version"]
    target.sent.clear()
    left_out = campaign.state.left_out
    campaign.run(Limits(cases=1))
    assert first not in target.sent
    assert campaign.state.left_out == left_out + 2


def test_minimising_does_not_turn_a_crash_into_another():
    """Every frame that is cut off kills, too: octets must not be left out until that is what remains."""

    def run(steps):
        octets = steps[0].octets
        return dead() if len(octets) < len(SOUND) or octets[:1] == b"\xff" else None

    frame = Frame(b"\xff" + SOUND[1:] + bytes(40))
    found = Minimiser(run, DEAD, CODEC).minimise([frame])
    assert found is not None
    assert found.steps[0].octets == b"\xff" + SOUND[1:]


def test_a_finding_is_kept_when_minimising_is_interrupted(tmp_path):
    class Interrupted(Dying):
        runs = 0

        def run(self, steps):
            self.runs += 1
            if self.runs == 4:
                raise KeyboardInterrupt
            return super().run(steps)

    campaign = campaign_of(
        Interrupted(lambda octets: octets[:1] == b"\x02"), Drawn([b"\x01", b"\x02" * 40, b"\x01"] * 8)
    )
    campaign.directory = tmp_path
    with pytest.raises(KeyboardInterrupt):
        campaign.run(Limits(cases=1))
    [artefact] = campaign.artefacts
    assert (tmp_path / f"{artefact.id}.json").exists()
    # The attempts until then have made it smaller.
    assert 1 <= artefact.frames < 3


class Counting:
    """Falls silent after five bad frames since its last start."""

    name = "counting"

    def __init__(self) -> None:
        self.bad = 0
        self.starts = 0

    def run(self, steps):
        if self.bad >= 5:
            self.bad, self.starts = 0, self.starts + 1
        for at, step in enumerate(steps):
            self.bad += step.octets == b"bad"
            if self.bad >= 5:
                return Effect("mute", "mute", at, "mute")
        return None

    def fresh(self, steps):
        self.bad, self.starts = 0, self.starts + 1
        return self.run(steps)


def test_earlier_steps_that_contribute_belong_to_a_finding():
    target = Counting()
    history = [Frame(b"bad"), Frame(b"good")] * 4
    assert target.run(history) is None
    steps = [Frame(b"good"), Frame(b"bad"), Frame(b"good")]
    effect = target.run(steps)
    assert effect is not None
    reduction = Reduction(target.run, CODEC, fresh=target.fresh)
    reduction.reduce(steps, effect, history)
    assert reduction.confirmed
    assert reduction.found is not None
    assert [step.octets for step in reduction.found.steps] == [b"bad"] * 5


def test_effects_enabled_by_an_earlier_attempt_are_not_the_finding():
    target = Counting()
    steps = [Frame(b"bad"), Frame(b"good")] * 6
    effect = target.fresh(steps)
    assert effect is not None
    reduction = Reduction(target.run, CODEC, fresh=target.fresh)
    reduction.reduce(steps, effect)
    assert reduction.confirmed
    assert reduction.found is not None
    assert [step.octets for step in reduction.found.steps] == [b"bad"] * 5
