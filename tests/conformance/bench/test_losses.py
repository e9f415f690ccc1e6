"""Losses of the tester: gaps, dropped frames, effects of an impaired link, lateness."""

from __future__ import annotations

import pytest
from dcp_conformance.lower_tester import Incident

from .parts import PERIOD, Parts


def gaps(*seqnos: int | None) -> str:
    """Return the gaps between beacons with these sequence numbers; None: not a beacon."""
    parts = Parts()
    parts.hear(*(b"\x01" if each is None else parts.beacon(each) for each in seqnos))
    return parts.losses.gaps()


@pytest.mark.parametrize("seqnos", [(1, 2, 3), (2**32 - 1, 0), (1, 8), (5, 0), (1, None, 3), ()])
def test_no_loss(seqnos: tuple[int | None, ...]):
    """Consecutive numbers, a jump of the implementation's own, a restart, and a frame without a readable number."""
    assert gaps(*seqnos) == ""


@pytest.mark.parametrize(
    ("seqnos", "text"),
    [
        ((1, 3), "sequence number 3 follows 1"),
        ((1, 7), "sequence number 7 follows 1"),
        # One of the two missing beacons was received, but is damaged.
        ((1, None, 4), "sequence number 4 follows 1"),
    ],
)
def test_a_missing_number_is_a_loss(seqnos: tuple[int | None, ...], text: str):
    assert gaps(*seqnos) == text


def test_an_implementation_that_counts_in_steps_of_two_loses_nothing():
    parts = Parts()
    for seqno in range(0, 40, 2):
        parts.counting.heard(seqno)
    parts.hear(parts.beacon(1), parts.beacon(3))
    assert parts.losses.gaps() == ""
    parts.hear(parts.beacon(6))
    assert parts.losses.gaps() == "sequence number 6 follows 3"


def test_dropped_frames_are_added_up():
    parts = Parts()
    parts.link.dropped = 2
    parts.losses.take_incidents()
    parts.link.dropped = 1
    assert parts.losses.own() == "the kernel dropped 3 frames"
    assert parts.losses.explain_all()


def test_lateness_of_more_than_a_period_counts_except_for_sequence_numbers():
    parts = Parts()
    parts.steps.late_ns = PERIOD
    assert parts.losses.own() == ""
    parts.steps.late_ns = 2 * PERIOD
    assert parts.losses.own() == "it acted late by 200 ms"
    assert parts.losses.own(numbers=True) == ""


def test_lateness_does_not_explain_a_gap():
    parts = Parts()
    parts.steps.late_ns = 2 * PERIOD
    assert parts.losses.explain_all()
    parts.hear(parts.beacon(1), parts.beacon(3))
    assert not parts.losses.explain_all()


def test_a_lost_stimulus_misleads_and_a_lost_beacon_does_not():
    parts = Parts()
    parts.link.incidents.append(Incident(False, "lost", b"beacon"))
    assert parts.losses.of_link == 1
    assert parts.losses.misleading() == ""
    parts.link.incidents.append(Incident(True, "lost", b"stimulus"))
    assert parts.losses.misleading() != ""
    assert parts.losses.of_link == 1
    # Each is recorded once.
    assert len(parts.traffic.events) == 2


def test_only_a_lost_beacon_explains_a_missing_sequence_number():
    parts = Parts()
    parts.link.incidents.append(Incident(True, "lost", b"stimulus"))
    assert parts.losses.own() != ""
    assert parts.losses.own(numbers=True) == ""
