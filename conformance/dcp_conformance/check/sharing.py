"""Judge a long recording in up to three processes: one keeps the ledger and makes the result, the others help it.

All of them read the file and decode it. One helper applies the rules about reactions, and a second one those about
single beacons. Helpers send the results of their rules, and the links between nodes.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection
from pathlib import Path

from dcp_codec.capture import CaptureError, open_capture
from dcp_codec.capture.frame import Frame
from dcp_codec.common.garbage import few_collections
from dcp_codec.common.workers import Worker, WorkerLostError

from .judge import Judge, Share

Feeder = Callable[[Sequence[Judge]], Callable[[Frame], None]]
"""Given the judges, returns the function that passes a frame to the judge of its version."""

#: Size of a file in octets from which more processes save time, and their maximum number.
_LONG, _MOST = 2_000_000, 3


def processes(path: Path, jobs: int | None) -> int:
    """Return the number of processes for a recording, 1 to 3. ``jobs``: the number that the user wants."""
    if not path.is_file():
        # The file cannot be read twice.
        return 1
    if jobs is not None:
        return min(jobs, _MOST)
    return min(len(os.sched_getaffinity(0)), _MOST) if path.stat().st_size >= _LONG else 1


class Helper:
    """A process that judges a recording by some of the rules."""

    def __init__(self, path: Path, judges: Sequence[Judge], feeder: Feeder) -> None:
        """Start the process, which passes each frame to the judge of its version."""
        self._worker = Worker(multiprocessing.get_context("fork"), _judge, path, judges, feeder)

    def shares(self) -> list[Share]:
        """Wait for the results of the judges. Raise :class:`WorkerLostError` if the process has ended by itself."""
        try:
            shares: list[Share] = self._worker.connection.recv()
        except EOFError:
            raise WorkerLostError from None
        return shares

    def end(self) -> None:
        """End the process, whether or not it is ready."""
        self._worker.end(terminate=True)


def _judge(connection: Connection, path: Path, judges: Sequence[Judge], feeder: Feeder) -> None:
    """Judge the recording, and send the results; this is the main function of the process."""
    try:
        with open_capture(path) as reader, few_collections():
            feed = feeder(judges)
            for frame in reader:
                feed(frame)
            connection.send([judge.share() for judge in judges])
    except CaptureError:
        # The other process reports it.
        return
