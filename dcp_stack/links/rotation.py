"""A recorder that starts a new file at a limit of size or age, and after the disk was full."""

from __future__ import annotations

import logging
import shutil
import time
from collections.abc import Callable
from itertools import count
from pathlib import Path
from typing import Final

import msgspec

from .base import LinkError
from .recording import Recorder

log = logging.getLogger(__name__)

#: ns between two attempts to resume after a recording was interrupted.
RETRY_INTERVAL: Final = 10_000_000_000
#: Free octets required for an attempt: enough for the head of a file and its first chunks.
LEAST_FREE: Final = 4 << 20


class Limits(msgspec.Struct, frozen=True, kw_only=True):
    """The size and age of a file at which the next one starts, and the number of files to keep; None: no limit."""

    octets: int | None = None
    seconds: float | None = None
    files: int | None = None
    """Number of files of one node in the folder; the oldest are deleted."""

    def __post_init__(self) -> None:
        """Raises ValueError for a limit that is not greater than 0."""
        for name in self.__struct_fields__:
            limit = getattr(self, name)
            if limit is not None and not limit > 0:
                raise ValueError(f"the limit of {name} for a recording must be greater than 0, not {limit}")


class RotatingRecorder:
    """Records to a succession of files; has the interface of :class:`~dcp_stack.links.recording.Recorder`.

    If a file cannot be written it is closed. Every 10 s the recorder checks whether a new one can be started. Frames
    seen before that are counted in ``frames_lost`` and not recorded.
    """

    def __init__(
        self,
        make: Callable[[Path], Recorder],
        first: Path,
        following: Callable[[], Path],
        *,
        limits: Limits | None = None,
        siblings: Callable[[], list[Path]] = list,
        clock: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        """``make`` creates a file, ``following`` returns the next path, ``siblings`` all files, the oldest first.

        Raises LinkError if the first file cannot be created.
        """
        self._make = make
        self._following = following
        self._limits = limits or Limits()
        self._siblings = siblings
        self._clock = clock
        self._recorder = make(first)
        self._begun_at = self._tried_at = clock()
        self._frames_before = 0
        self.interruptions = 0
        """Number of times that a recording ended because it could not be written."""
        self.frames_lost = 0
        """Number of frames seen while no file was being written."""
        self._closed = False
        self._interrupted = False
        self._clean_up()

    @property
    def path(self) -> Path:
        """The file being written, or the last one."""
        return self._recorder.path

    @property
    def frames(self) -> int:
        """Number of frames written to all files."""
        return self._frames_before + self._recorder.frames

    @property
    def recording(self) -> bool:
        """Whether frames are being written."""
        return self._recorder.recording

    @property
    def problem(self) -> str:
        """The reason why no frames are being written; empty while they are."""
        return self._recorder.problem

    def saw(self, octets: bytes, wall: int, *, outgoing: bool, source: bytes) -> None:
        """Write one bearer payload, as :meth:`Recorder.saw`, or count it as lost."""
        if not self._recorder.recording:
            self.frames_lost += 1
            return
        self._recorder.saw(octets, wall, outgoing=outgoing, source=source)
        if not self._recorder.recording:
            self.frames_lost += 1

    def tick(self) -> None:
        """Flush recorded frames, and start the next file if it is time."""
        self._recorder.tick()
        now = self._clock()
        if self._closed:
            return
        if not self._recorder.recording:
            if not self._interrupted:
                self._interrupted = True
                self.interruptions += 1
                self._tried_at = now
            elif now - self._tried_at >= RETRY_INTERVAL:
                self._tried_at = now
                self._resume()
        elif self._is_complete(now):
            self._recorder.close()
            self._next(now)

    def close(self) -> None:
        """Finish the current file; may be called twice."""
        self._closed = True
        self._recorder.close()

    def _is_complete(self, now: int) -> bool:
        """Whether the current file has reached a limit of age or size, or was removed."""
        limits = self._limits
        if not self._recorder.frames:
            return False
        if limits.seconds is not None and now - self._begun_at >= limits.seconds * 1e9:
            return True
        if limits.octets is None:
            return False
        try:
            return self._recorder.path.stat().st_size >= limits.octets
        except OSError:
            # The file was removed: frames written to it from now on would be lost.
            return True

    def _resume(self) -> None:
        """Resume after an interruption if there is room for a new file."""
        try:
            if shutil.disk_usage(self._recorder.path.parent).free < LEAST_FREE:
                return
        except OSError:
            return
        if self._next(self._clock()):
            log.warning("recording continues in %s; %d frames were not recorded", self.path, self.frames_lost)

    def _next(self, now: int) -> bool:
        """Start the next file; return False and set ``problem`` if it cannot be created."""
        frames = self._recorder.frames
        try:
            recorder = self._make(self._following())
        except LinkError as error:
            self._recorder.problem = str(error)
            return False
        self._frames_before += frames
        self._recorder = recorder
        self._begun_at = now
        self._interrupted = False
        self._clean_up()
        return True

    def _clean_up(self) -> None:
        """Delete the oldest files beyond the limit."""
        if self._limits.files is None:
            return
        others = [path for path in self._siblings() if path != self.path]
        for path in others[: max(len(others) - self._limits.files + 1, 0)]:
            try:
                path.unlink()
            except OSError as error:
                log.warning("%s: cannot be deleted: %s", path, error.strerror)


def numbered_after(path: Path) -> Path:
    """Return ``flight-2.mcap`` for ``flight.mcap``, or the first higher number for which no file exists."""
    names = (path.with_name(f"{path.stem}-{number}{path.suffix}") for number in count(2))
    return next(each for each in names if not each.exists())


def recordings_of(folder: Path, node_id: bytes) -> list[Path]:
    """Return the recordings of a node in a folder, oldest first, found by the names of ``recording_path``."""
    found = []
    for path in folder.glob(f"{node_id.hex()}-*.mcap"):
        try:
            found.append((path.stat().st_mtime_ns, path))
        except OSError:
            continue
    return [path for _, path in sorted(found)]
