"""Probes, teaching of variables, and control of the implementation."""

from __future__ import annotations

import pytest
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.errors import ConformanceError, StopCase
from dcp_conformance.interconnection.contact import Contact

from dcp_codec.values import VarReqCreate

from .parts import PERIOD, Parts


def answering(parts: Parts, after: int = 1) -> None:
    """Let the implementation request the variable of each probe from the n-th on."""
    probes = 0

    def answer() -> None:
        nonlocal probes
        probes += 1
        if probes >= after:
            parts.sends(VarReqCreate(16 - probes))

    parts.link.on_send = answer


def test_a_probe_is_answered_with_a_request_for_its_variable():
    parts = Parts()
    answering(parts)
    assert parts.probes.probe()
    parts.link.on_send = lambda: None
    parts.sends(VarReqCreate(15))
    assert not parts.probes.probe()


def test_a_probe_uses_a_kind_of_stimulus_that_was_answered():
    parts = Parts()
    parts.run.known.contact = Contact(3, 3, frozenset({"create"}), frozenset({"summary"}))
    peer = parts.peers.new()
    parts.sends(parts.records.sample(0, peer.node_id))
    assert parts.probes.probe()
    # The record of an earlier sign of life is not an answer.
    parts.sends(parts.records.sample(0, peer.node_id))
    assert not parts.probes.probe()


def test_two_probes_without_an_answer_fail_and_one_is_enough():
    parts = Parts()
    answering(parts, after=2)
    parts.probes.require_alive("a damaged beacon")
    assert parts.verdicts.verdict() is Verdict.PASS
    parts = Parts()
    with pytest.raises(StopCase):
        parts.probes.require_alive("a damaged beacon")
    assert parts.verdicts.checks[0].observed == "no answer to two probes"


def test_a_variable_is_learnt_when_its_last_repetition_was_received():
    parts = Parts()
    peer = parts.peers.new()
    create = peer.create(3, rep_cnt=2)
    for records in ([create], [create], [], []):
        parts.sends(*records)
    parts.teaching.learn(peer, create)
    assert parts.link.time == 3 * PERIOD
    assert parts.verdicts.checks == []


def test_a_variable_that_is_not_forwarded_is_named():
    parts = Parts()
    peer = parts.peers.new()
    with pytest.raises(StopCase):
        parts.teaching.learn(peer, peer.create(3), peer.create(5))
    assert parts.verdicts.checks[0].verdict is Verdict.INCONCLUSIVE
    assert parts.verdicts.checks[0].observed.startswith("none of 3, 5")


def test_many_creations_take_one_period_for_each_payload():
    parts = Parts()
    size = parts.builder.record_size(parts.records.sample())
    parts.run.parameters["VARDISPAR_MAX_PAYLOAD_SIZE"] = parts.builder.container_header_size + 2 * size
    assert parts.teaching.periods(1) == parts.sut.reaction
    assert parts.teaching.periods(5) == parts.sut.reaction + 2


# -- control -----------------------------------------------------------------------------------------------------------


def test_a_restart_ends_with_an_answer():
    parts = Parts()
    parts.run.restart = lambda: parts.run.log.append("restarted")
    answering(parts, after=3)
    parts.control.restart()
    assert parts.run.log[:2] == ["restarted", "forget"]
    assert len(parts.link.sent) == 3


def test_a_restart_without_a_command_or_an_answer_is_inconclusive():
    parts = Parts()
    with pytest.raises(StopCase):
        parts.control.restart()
    parts.run.restart = lambda: None
    with pytest.raises(StopCase):
        parts.control.restart()
    observed = [each.observed for each in parts.verdicts.checks]
    assert observed == ["no command to restart it", "no answer to five probes"]


def test_the_link_is_up_again_however_the_block_ends():
    parts = Parts()
    states: list[bool] = []
    parts.run.switch_link = states.append
    with pytest.raises(StopCase), parts.control.link_down():
        parts.verdicts.inconclusive("something", "nothing")
    assert states == [False, True]
    assert parts.run.log == ["interrupted", "interrupted"]


def test_a_link_that_cannot_be_switched_is_inconclusive():
    parts = Parts()

    def fail(_up: bool) -> None:
        raise ConformanceError("ip: no such device")

    parts.run.switch_link = fail
    with pytest.raises(StopCase), parts.control.link_down():
        pass
    assert parts.verdicts.checks[0].observed == "ip: no such device"
