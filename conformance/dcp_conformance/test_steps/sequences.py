"""Comparison of sequences of which parts may be lost."""

from __future__ import annotations

from collections.abc import Iterable


def part_of(found: Iterable[object], whole: Iterable[object]) -> bool:
    """Return whether ``found`` is a subsequence of ``whole``, as after losses."""
    rest = iter(whole)
    return all(any(each == other for other in rest) for each in found)
