"""Minimise the stimulus of a failed case: remove frames of the tester as long as the same check still fails.

The case is executed again with a lower tester that does not send the removed frames. A check that expects an answer
also fails without its stimulus. So a frame is removed only if a conforming node still passes without it.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Final

from dcp_conformance.lower_tester import LowerTester
from dcp_conformance.model.case import Case
from dcp_conformance.model.results import CaseResult, Check
from dcp_conformance.model.verdict import Verdict

from .runner import Runner

#: Maximum number of executions of the case.
MOST_TRIES: Final = 40

Execute = Callable[[Collection[int]], CaseResult]
"""Function that executes the case without the frames of these numbers (from 0, in the tester's order of sending)."""


class DroppingLink:
    """A lower tester that does not send the frames of the numbers ``dropped``, and otherwise uses ``lower``."""

    def __init__(self, lower: LowerTester, dropped: Collection[int]) -> None:
        self._lower = lower
        self._dropped = dropped
        self._sent = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._lower, name)

    def _drops(self) -> bool:
        self._sent += 1
        return self._sent - 1 in self._dropped

    def send(self, octets: bytes, source: bytes) -> bytes:
        """Send a bearer payload unless it is dropped; return its frame in both cases. Raise ``LowerTesterError``."""
        if self._drops():
            return b"\xff" * 6 + source + b"\x00\x00" + octets
        return self._lower.send(octets, source)

    def send_frame(self, frame: bytes) -> None:
        """Send a frame unless it is dropped. Raise ``LowerTesterError``."""
        if not self._drops():
            self._lower.send_frame(frame)


@contextmanager
def without_frames(runner: Runner, dropped: Collection[int]) -> Iterator[None]:
    """Drop the frames of the numbers ``dropped`` in the runner's session within the block."""
    session = runner.session
    lower = session.lower
    session.lower = DroppingLink(lower, dropped)
    try:
        yield
    finally:
        session.lower = lower


def executor(runner: Runner, case: Case) -> Execute:
    """Return a function that executes the case with ``runner``, which must have executed the sanity case."""

    def execute(dropped: Collection[int]) -> CaseResult:
        with without_frames(runner, dropped):
            return runner.run(case)

    return execute


def minimise(check: Check, frames: Sequence[int], faulty: Execute, conforming: Execute) -> tuple[int, ...] | None:
    """Return the numbers of the frames, of ``frames``, that ``check`` needs to fail.

    ``faulty`` executes the case against the implementation, ``conforming`` against a node without a fault. At most
    :data:`MOST_TRIES` executions are made. Return None if the check does not fail again with all frames.
    """
    tries = 0

    def shows(kept: Sequence[int]) -> bool:
        nonlocal tries
        tries += 1
        dropped = frozenset(frames) - frozenset(kept)
        if dropped and conforming(dropped).verdict is not Verdict.PASS:
            return False
        return any(_is(each, check) for each in faulty(dropped).checks)

    if not shows(frames):
        return None
    kept = list(frames)
    # Try to remove large parts first: most frames of a case only prepare or repeat something.
    size = max(1, len(kept) // 2)
    while tries < MOST_TRIES:
        place = 0
        while place < len(kept) and tries < MOST_TRIES:
            fewer = kept[:place] + kept[place + size :]
            if fewer and shows(fewer):
                kept = fewer
            else:
                place += size
        if size == 1:
            break
        size = max(1, size // 2)
    return tuple(kept)


def _is(found: Check, wanted: Check) -> bool:
    """Return whether a check is the same finding; observations are not compared, because numbers and times differ."""
    return (
        found.verdict is Verdict.FAIL
        and found.expected == wanted.expected
        and bool(set(found.requirements) & set(wanted.requirements) or not wanted.requirements)
    )
