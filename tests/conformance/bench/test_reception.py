"""Reception of frames, and waiting in virtual time."""

from __future__ import annotations

import pytest
from dcp_conformance.definitions.pics import Pics, Testing
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.lower_tester import Incident
from dcp_conformance.upper_tester import Notification
from dcp_spec.constants import ICType

from dcp_codec.values import VarReqCreate, VarSumm

from .parts import OTHER, PERIOD, SUT, Parts, Upper


def test_a_wait_ends_at_its_deadline_and_returns_the_frames_until_then():
    parts = Parts()
    for _ in range(3):
        parts.sends()
    assert [each.seqno for each in parts.waiting.wait(2)] == [1, 2]
    assert parts.link.time == 2 * PERIOD
    assert parts.run.log == ["TC_BP_X_BV_01 heard 1", "TC_BP_X_BV_01 heard 2"]


def test_a_mark_comes_after_frames_that_have_arrived():
    parts = Parts()
    parts.sends(at=0)
    parts.sends(at=1)
    assert parts.waiting.mark() == 1
    assert parts.link.time == 0


def test_a_wait_ends_with_its_frame_and_does_not_count_as_lateness():
    parts = Parts()
    parts.sends(VarSumm(1, 1))
    parts.sends(VarReqCreate(7))
    parts.sends()
    found = parts.waiting.until_instruction(ICType.REQUEST_VARCREATES, 7)
    assert found == VarReqCreate(7)
    assert parts.link.time == 2 * PERIOD
    assert parts.steps.begin() == 2 * PERIOD
    assert parts.steps.late_ns == 0


@pytest.mark.parametrize(("periods", "waited"), [(None, 4.0), (3.0, 3.0), (1.0, 3.0)])
def test_a_wait_without_success_takes_the_time_of_a_reaction_and_the_minimum(periods: float | None, waited: float):
    parts = Parts()
    assert parts.waiting.until(lambda heard: heard, periods) is None
    assert parts.link.time == waited * PERIOD


def test_a_slow_implementation_has_more_time():
    parts = Parts(pics=Pics(pixit=Testing(reaction_periods=8.0)))
    assert parts.waiting.until(lambda heard: heard, 5.0) is None
    assert parts.link.time == 10 * PERIOD


def test_fewer_beacons_than_wanted_are_returned_after_the_time_limit():
    parts = Parts()
    parts.sends()
    assert len(parts.waiting.beacons(2)) == 1
    assert parts.link.time == 8 * PERIOD
    assert parts.waiting.beacons(0) == []


def test_frames_of_other_nodes_are_kept_apart():
    parts = Parts()
    parts.sends(VarSumm(9, 1), sender=OTHER)
    assert parts.waiting.wait(1) == []
    assert [each.sender for each in parts.receiver.others] == [OTHER]
    # The implementation may learn the variable from that node.
    assert not parts.run.identifier_pool.is_unknown(9, 0)
    assert parts.traffic.events[0].direction == "other"


def test_the_first_sender_is_the_implementation_if_its_identifier_is_unknown():
    parts = Parts()
    parts.run.sut_id = None
    parts.sends()
    parts.sends(sender=OTHER)
    assert len(parts.waiting.wait(2)) == 1
    assert parts.run.sut_id == SUT


@pytest.mark.parametrize(("node_id", "expected"), [(None, OTHER), ("02:00:00:00:00:01", SUT)])
def test_a_new_identifier_after_a_start_is_accepted_unless_the_pics_names_the_node(
    node_id: str | None, expected: bytes
):
    parts = Parts(pics=Pics(pixit=Testing(node_id=node_id)))
    parts.sends(sender=OTHER)
    parts.sends(sender=OTHER)
    parts.waiting.wait(1)
    parts.receiver.take_newcomer()
    parts.waiting.wait(1)
    assert parts.run.sut_id == expected


def test_a_frame_after_the_stimulus_ends_the_silence():
    parts = Parts()
    parts.steps.stimulated()
    parts.sends()
    parts.waiting.wait(1)
    assert not parts.steps.silent


def test_notifications_are_recorded_in_order_with_frames():
    parts = Parts()
    parts.run.upper = Upper()
    parts.run.upper.notifications.append(Notification("BP-ReceivePayload", {"length": 1}))
    parts.sends()
    parts.waiting.wait(1)
    assert [each.method for each in parts.receiver.notifications] == ["BP-ReceivePayload"]
    assert [each.direction for each in parts.traffic.events] == ["notified", "heard"]


def test_records_have_stopped_after_enough_beacons_without():
    parts = Parts()
    for records in ([VarSumm(1, 1)], [VarSumm(1, 1)], [], [], [], []):
        parts.sends(*records)
    found = parts.waiting.until_quiet(lambda heard: heard.instructions(ICType.SUMMARIES, 1))
    assert len(found) == 2
    assert parts.link.time == 5 * PERIOD


def test_one_beacon_without_is_enough_if_all_have_come():
    parts = Parts()
    for records in ([VarSumm(1, 1)], [], [], []):
        parts.sends(*records)
    parts.waiting.until_quiet(lambda heard: heard.instructions(ICType.SUMMARIES, 1), complete=lambda: True)
    assert parts.link.time == 2 * PERIOD


def test_beacons_lost_on_an_impaired_link_do_not_end_the_wait():
    parts = Parts()
    parts.sends(VarSumm(1, 1))
    parts.sends(VarSumm(1, 1), at=7)
    original = parts.link.receive

    def receive(until, also=()):
        arrival = original(until, also)
        if arrival is None and parts.link.time == 5 * PERIOD:
            parts.link.incidents.append(Incident(False, "lost", b"beacon"))
        return arrival

    parts.link.receive = receive  # type: ignore[method-assign]
    found = parts.waiting.until_quiet(lambda heard: heard.instructions(ICType.SUMMARIES, 1))
    assert len(found) == 2


@pytest.mark.parametrize(
    ("repetitions", "verdict", "shown"),
    [(2, Verdict.PASS, False), (3, Verdict.FAIL, True), (1, Verdict.FAIL, False)],
)
def test_too_many_repetitions_are_proved_and_too_few_are_missing(repetitions: int, verdict: Verdict, shown: bool):
    parts = Parts()
    for records in [[VarSumm(1, 1)]] * repetitions + [[]] * 4:
        parts.sends(*records)
    found = parts.repetitions.check(ICType.SUMMARIES, 1, 2, 0)
    assert len(found) == repetitions
    check = parts.verdicts.checks[0]
    assert (check.verdict, check.shown) == (verdict, shown)


def test_another_requirement_may_decide_when_there_is_no_record():
    parts = Parts()
    parts.repetitions.check(ICType.SUMMARIES, 1, 2, 0, "VD-PS-01", absent="VD-CMP-06")
    assert parts.verdicts.checks[0].requirements == ("VD-CMP-06",)
