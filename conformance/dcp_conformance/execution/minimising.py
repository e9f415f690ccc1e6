"""Minimise the stimulus of a failed case: leave out frames of the tester as long as the same check still fails.

The case is executed again, and a link drops chosen frames before they are sent. A check that expects an answer also
fails if the stimulus never arrives: so a frame is left out only if a conforming node still passes without it.
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

#: Executions of a case for one stimulus; each takes as long as the case.
MOST_TRIES: Final = 40

Execute = Callable[[Collection[int]], CaseResult]
"""Executes the case without the frames at these places (from 0, in the order in which the tester sends them)."""


class DroppingLink:
    """A lower tester that does not send chosen frames; everything else is that of ``lower``."""

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
        """As the lower tester's; a dropped frame is returned as if it had been sent. Raises ``LowerTesterError``."""
        if self._drops():
            return b"\xff" * 6 + source + b"\x00\x00" + octets
        return self._lower.send(octets, source)

    def send_frame(self, frame: bytes) -> None:
        """As the lower tester's. Raises ``LowerTesterError``."""
        if not self._drops():
            self._lower.send_frame(frame)


@contextmanager
def without_frames(runner: Runner, dropped: Collection[int]) -> Iterator[None]:
    """The runner's session does not send these frames within the block."""
    session = runner.session
    lower = session.lower
    session.lower = DroppingLink(lower, dropped)
    try:
        yield
    finally:
        session.lower = lower


def executor(runner: Runner, case: Case) -> Execute:
    """Executions of a case by a runner that has run the sanity case before."""

    def execute(dropped: Collection[int]) -> CaseResult:
        with without_frames(runner, dropped):
            return runner.run(case)

    return execute


def minimise(check: Check, frames: Sequence[int], faulty: Execute, conforming: Execute) -> tuple[int, ...] | None:
    """The frames of the tester that are needed for ``check`` to fail, a part of ``frames``.

    ``faulty`` executes the case against the implementation, ``conforming`` against a node without a fault. Returns None
    if the check does not fail again even with all frames. At most :data:`MOST_TRIES` executions.
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
    # Large parts first: most frames of a case only prepare, or repeat.
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
    """Whether a check is the same finding: what is observed may differ, since numbers and times do."""
    return (
        found.verdict is Verdict.FAIL
        and found.expected == wanted.expected
        and bool(set(found.requirements) & set(wanted.requirements) or not wanted.requirements)
    )
