"""Restarts that sequence numbers show, for the judge of recordings."""

from __future__ import annotations

from dcp_conformance.check.senders import Senders

WHO = b"\x02\0\0\0\0\x01"
PERIOD = 100_000_000


def lives(*numbers: int) -> list[int]:
    """The life of a sender after each of its beacons."""
    senders = Senders(8)
    found = []
    for place, number in enumerate(numbers):
        senders.feed(WHO, number, place * PERIOD)
        found.append(senders.life(WHO))
    return found


def test_a_restart_after_a_single_beacon():
    assert lives(0, 0, 1, 2) == [0, 1, 1, 1]
    assert lives(0, 0, 0, 1) == [0, 1, 2, 2]


def test_a_late_repeated_number_is_not_a_restart():
    assert lives(0, 1, 2, 2, 3) == [0, 0, 0, 0, 0]


def test_a_restart_after_many_beacons():
    assert lives(7, 8, 9, 0, 1, 2) == [0, 0, 0, 1, 1, 1]
    assert lives(7, 8, 9, 0, 0, 1) == [0, 0, 0, 1, 2, 2]
