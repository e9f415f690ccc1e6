"""Implementations connected to a bench as targets: health checks, tolerated silence, findings after a crash."""

from __future__ import annotations

import random

import msgspec
import pytest
from dcp_conformance.definitions.case import all_cases
from dcp_conformance.definitions.pics import Pics
from dcp_conformance.errors import ConformanceError
from dcp_conformance.execution.runner import Runner
from dcp_conformance.execution.target import Target
from dcp_conformance.reference.inprocess import InProcess, plain_node, reference_config
from dcp_conformance.test_system.bench import Bench
from dcp_conformance.test_system.session import Session
from dcp_lab.fuzz import Campaign, Frame, Limits, Wait
from dcp_lab.fuzz.execute.live import LiveTarget, NotAliveError
from dcp_lab.fuzz.execute.liveness import lifelessness
from dcp_lab.fuzz.findings.artefact import SavedTarget
from dcp_lab.fuzz.generate.sequence_batches import Joined
from dcp_lab.fuzz.generate.sequences import Sequences
from dcp_lab.testing.mutation import Mutator, drawn_pool
from dcp_selftest.mutants.mutant import all_mutants

from dcp_codec import Codec
from dcp_stack.node import Node

CODEC = Codec("dcp-2.0")
OWN = b"\x02\x00\x00\x00\x00\x01"
#: A beacon that announces more octets than there are: M-BP-RX-15-dies crashes on it.
TOO_LONG = bytes.fromhex("01497e02dc900000011111ffff0100000001000200020100")


def opened(make=plain_node, *, upper=True) -> Target:
    sut = InProcess(reference_config(CODEC), make=make)
    session = Session(CODEC, sut.lower_tester(), sut.upper_tester() if upper else None, Pics())
    runner = Runner(session, sut)
    runner.prepare()
    return Target(CODEC, Pics(), runner, [])


def sequences(seed: int = 1) -> Sequences:
    rng = random.Random(seed)
    return Sequences(CODEC, rng, OWN, Mutator(CODEC, rng, drawn_pool(CODEC, rng, 60)))


@pytest.mark.part("suite")
@pytest.mark.parametrize("upper", [True, False])
def test_no_finding_in_our_node(upper):
    target = LiveTarget(opened(upper=upper))
    drawn = Joined(sequences(), 5)
    for _ in range(60):
        assert target.run(drawn.draw()) is None
    assert target.frames > 60


def test_a_peer_that_does_not_answer_is_not_fuzzed():
    class Silent(Node):
        heard = 0

        def handle_frame(self, octets, *, now, wall):
            Silent.heard += octets == b"frame of the fuzzer"

    target = LiveTarget(opened(lambda c, r, n, w: Silent(c, rng=r, now=n, wall=w)))
    with pytest.raises(NotAliveError, match="not healthy, so nothing was sent"):
        target.run([Frame(b"frame of the fuzzer")])
    assert Silent.heard == 0


def test_silence_is_not_a_crash_if_one_marker_is_answered():
    class Deaf(Node):
        """Hears every fourth frame."""

        count = 0

        def handle_frame(self, octets, *, now, wall):
            Deaf.count += 1
            if Deaf.count % 4 == 0:
                super().handle_frame(octets, now=now, wall=wall)

    target = LiveTarget(opened(lambda c, r, n, w: Deaf(c, rng=r, now=n, wall=w)))
    for _ in range(8):
        assert target.run([Frame(b"\1"), Wait(0.5)]) is None


def test_a_crash_is_found_and_the_peer_restarted():
    target = LiveTarget(opened(all_mutants()["M-BP-RX-15-dies"].make))
    effect = target.run([Frame(b"\0"), Frame(TOO_LONG)])
    assert effect is not None
    assert effect.kind == "dead"
    assert effect.step == 1
    assert "IndexError" in effect.detail
    assert target.run([Frame(b"\0")]) is None
    assert target.restarts == 1


def test_a_peer_that_falls_silent_is_found():
    target = LiveTarget(opened(all_mutants()["M-VD-ROB-01-mute"].make))
    drawn = sequences()
    effect = None
    for _ in range(40):
        effect = effect or target.run(drawn.garbage())
    assert effect is not None
    assert effect.kind == "mute"
    assert "none of 4 markers" in effect.detail


def test_a_finding_is_kept_although_the_peer_stays_dead(tmp_path):
    target = LiveTarget(opened(all_mutants()["M-BP-RX-15-dies"].make))
    assert target.control is not None
    target.control.can_restart = False
    campaign = Campaign(CODEC, target, Joined(sequences(), 10), SavedTarget("live"), 1, directory=tmp_path)
    with pytest.raises(NotAliveError, match="no command to restart"):
        campaign.run(Limits(cases=50, findings=1))
    [artefact] = campaign.artefacts
    assert not artefact.minimised
    assert (tmp_path / f"{artefact.id}.json").exists()


#: A frame that the nodes below cannot stand.
BAD = b"the last straw"


class Frail(Node):
    """Hears nothing any more after a bad frame; not in its first seconds either, from its second life on."""

    lives = 0
    slow_ns = 0

    def __init__(self, config, *, rng, now, wall):
        super().__init__(config, rng=rng, now=now, wall=wall)
        type(self).lives += 1
        self.deaf_until = now + self.slow_ns if self.lives > 1 else 0

    def handle_frame(self, octets, *, now, wall):
        if octets == BAD:
            self.deaf_until = 1 << 62
        if now >= self.deaf_until:
            super().handle_frame(octets, now=now, wall=wall)


def frail(slow_ns: int = 0) -> Target:
    kind = type("Frail", (Frail,), {"lives": 0, "slow_ns": slow_ns})
    return opened(lambda c, r, n, w: kind(c, rng=r, now=n, wall=w), upper=False)


@pytest.mark.parametrize("slow", [0, 3])
def test_a_silent_peer_is_restarted_once_and_waited_for(slow):
    target = LiveTarget(frail(slow * 1_000_000_000))
    assert target.run([Frame(b"\1")]) is None
    effect = target.run([Frame(b"\1"), Frame(BAD)])
    assert effect is not None
    assert effect.signature == "mute: mute"
    assert target.run([Frame(b"\1")]) is None
    assert target.restarts == 1


def test_an_externally_restarted_peer_is_waited_for():
    """An external start may be slow, on a busy machine too."""

    class Absent(Node):
        back_at = 0

        def handle_frame(self, octets, *, now, wall):
            if octets == BAD:
                self.back_at = now + 6_000_000_000
            if now >= self.back_at:
                super().handle_frame(octets, now=now, wall=wall)

    where = opened(lambda c, r, n, w: Absent(c, rng=r, now=n, wall=w), upper=False)
    where.runner.control = None
    target = LiveTarget(where)
    assert target.run([Frame(b"\1")]) is None
    effect = target.run([Frame(BAD)])
    assert effect is not None
    assert effect.signature == "mute: mute"
    assert target.run([Frame(b"\1")]) is None
    assert target.restarts == 0


def test_an_unhealthy_peer_after_a_restart_ends_the_campaign_with_its_findings(tmp_path):
    target = LiveTarget(frail(1 << 62))
    generator = type("Drawn", (), {"kinds": ("drawn",), "draw": lambda self: [Frame(b"\1"), Frame(BAD)]})()
    campaign = Campaign(CODEC, target, generator, SavedTarget("live"), 1, directory=tmp_path, by_cause=True)
    with pytest.raises(NotAliveError, match="not healthy after its restart"):
        campaign.run(Limits(cases=5))
    assert len(list(tmp_path.glob("mute-*.json"))) == 1


def test_a_peer_damaged_by_an_earlier_campaign_is_restarted_first():
    where = frail()
    where.runner.session.lower.send(BAD, b"\x02\xdc\x90\0\0\1")
    target = LiveTarget(where)
    assert target.run([Frame(b"\1")]) is None
    assert target.restarts == 1


def test_a_failed_restart_is_reported():
    target = LiveTarget(opened(all_mutants()["M-BP-RX-15-dies"].make, upper=False))
    assert target.run([Frame(TOO_LONG)]) is not None

    class Broken:
        can_restart = True

        def alive(self):
            return False

        def why_dead(self):
            return "it is dead"

        def restart(self):
            raise ConformanceError("--restart: the command ended with exit status 1")

    target.control = Broken()
    with pytest.raises(NotAliveError, match="cannot be restarted: --restart: the command ended with exit status 1"):
        target.run([Frame(b"\1")])


def test_a_node_without_vardis_is_alive_if_it_sends_beacons():
    where = opened(upper=False)
    where.runner.session.pics = msgspec.structs.replace(
        where.runner.session.pics, pics=msgspec.structs.replace(where.runner.session.pics.pics, vardis=False)
    )
    upper = where.runner.control.upper_tester()
    upper.call("SRP-UpdateSafetyData", {"sData": {"x": 1.0, "y": 2.0, "z": 3.0}})
    assert lifelessness(Bench(where.runner.session, next(iter(all_cases().values()))), None) is None
