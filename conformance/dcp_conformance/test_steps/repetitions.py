"""Checks of the records of a variable in several beacons: one in each beacon, and their order."""

from __future__ import annotations

from collections.abc import Sequence

from dcp_spec.constants import ICType

from dcp_codec.values import RECORD_CLASSES
from dcp_conformance.frames.received import Instruction, ReceivedBeacon
from dcp_conformance.test_system.bench import Bench


def check_one_in_each(
    bench: Bench, beacons: Sequence[ReceivedBeacon], kind: ICType, var_id: int, *requirements: str
) -> None:
    """Check that no beacon has two records of a kind about a variable."""
    twice = [heard for heard in beacons if len(heard.instructions(kind, var_id)) > 1]
    bench.none(twice, f"at most one {RECORD_CLASSES[kind].__name__} of the variable in each beacon", *requirements)


def check_order(bench: Bench, updates: Sequence[Instruction], requirement: str) -> list[int]:
    """Check that the sequence numbers of VarUpdates do not decrease; return them."""
    numbers: list[int] = [each.record.seqno for each in updates]
    bench.answered(numbers, sorted(numbers), "sequence numbers that do not decrease", requirement, frames=updates)
    return numbers
