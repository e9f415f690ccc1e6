"""The permitted number of repetitions is stored for a bounded number of instructions, the latest ones."""

from __future__ import annotations

from dcp_conformance.oracle.repetitions import Repetitions
from dcp_spec.constants import ICType

UPDATES, CREATES = ICType.UPDATES, ICType.CREATE_VARIABLES


def test_a_reused_sequence_number_is_not_the_oldest():
    """Numbers come again; what there is a reason to say is not what is forgotten."""
    repetitions = Repetitions()
    numbers = range(0, 256, 2)
    for time, number in enumerate([*numbers, 0]):
        repetitions.arm((UPDATES, number), 3, time)
    repetitions.arm((CREATES, 0), 3, 1000)
    count, allowed = repetitions.count((UPDATES, 0))
    assert (count, allowed >= 3) == (1, True)
    assert repetitions.count((CREATES, 0)) == (1, 3)


def test_stored_instructions_are_bounded():
    repetitions = Repetitions()
    for number in range(10_000):
        repetitions.arm((UPDATES, number), 1, number)
        repetitions.arm((CREATES, 0), 1, number)
    assert len(repetitions) < 200
    assert repetitions.count((UPDATES, 9_999)) == (1, 1)
    assert repetitions.allowed((CREATES, 0)) >= 1
