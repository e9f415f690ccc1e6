"""Judge a long recording in two processes: one keeps the ledger and makes the result, the other one does without it.

Both read the file and decode it. The process without a ledger applies the rules about reactions, and some that judge
single beacons. It sends the results of its rules, and the links between nodes.
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

#: Size of a file in octets from which a second process saves time.
_LONG = 2_000_000


def processes(path: Path, jobs: int | None) -> int:
    """Return the number of processes for a recording: 1 or 2. ``jobs``: the number that the user wants."""
    if not path.is_file():
        # The file cannot be read twice.
        return 1
    if jobs is not None:
        return min(jobs, 2)
    return 2 if len(os.sched_getaffinity(0)) > 1 and path.stat().st_size >= _LONG else 1


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
