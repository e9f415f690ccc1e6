"""Two nodes with the identifier of the implementation on the link: their beacons cannot be told apart."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from typing import Final

from dcp_spec.constants import seqno_modulus

from dcp_conformance.test_system.bench import Bench

#: Maximum number of questions, and beacon periods in which all nodes have answered one.
_QUESTIONS, _PERIODS = 8, 2.0
#: Number of beacons of each node that show two sequences of numbers.
_BEACONS: Final = 3
#: Number of changes from one sequence to the other that no reset explains.
_CHANGES: Final = 4
#: Maximum difference of successive received numbers of one node: it may have sent beacons that were lost.
_STEP: Final = 4
#: Sequence numbers that the message lists.
_SHOWN: Final = 8


def collision(bench: Bench) -> str:
    """Return that two nodes answer with the identifier of the implementation; empty if no sign of it is there.

    The function asks a question, and more only if sequence numbers of beacons contradict a single sender.
    """
    modulus = seqno_modulus(bench.profile.types.bp_seqno.width)
    for _ in range(_QUESTIONS):
        if bench.sut.pics.vardis is not False and bench.identifiers.has_unknown_ids():
            bench.probes.ask("summary", _PERIODS)
        bench.wait(_PERIODS)
        numbers = _numbers(bench)
        if all(1 <= (after - before) % modulus <= _STEP for before, after in pairwise(numbers)):
            return ""
        if interleaved(numbers, modulus):
            who = bench.session.sut_id.hex(":") if bench.session.sut_id is not None else "one identifier"
            shown = ", ".join(map(str, numbers[-_SHOWN:]))
            return f"two nodes send as {who} on {bench.lower.name} (sequence numbers {shown}): end one of them"
    return ""


def _numbers(bench: Bench) -> list[int]:
    """Return the sequence numbers of the received beacons, without repetitions of a frame."""
    frames = dict.fromkeys((heard.octets, heard.seqno) for heard in bench.heard)
    return [number for _, number in frames if number is not None]


def interleaved(numbers: Sequence[int], modulus: int) -> bool:
    """Return whether the numbers are two increasing sequences that take turns.

    After a reset, the numbers of one node may reach and continue those before the reset: that is one change to the
    second sequence and at most one back.
    """
    last: list[int] = []
    """The last number of each sequence."""
    owners: list[int] = []
    """For each number its sequence."""
    for number in numbers:
        steps = [((number - each) % modulus, owner) for owner, each in enumerate(last)]
        following = min((step for step in steps if 1 <= step[0] <= _STEP), default=None)
        if following is not None:
            owners.append(following[1])
            last[following[1]] = number
        elif len(last) < 2:
            owners.append(len(last))
            last.append(number)
        else:
            return False
    counts = Counter(owners)
    changes = sum(before != after for before, after in pairwise(owners))
    return len(counts) == 2 and min(counts.values()) >= _BEACONS and changes >= _CHANGES
