"""Base of the readers of all formats: iteration, progress, and the list of problems."""

from __future__ import annotations

from collections.abc import Generator, Hashable, Iterator, Mapping

from .bytesource import ByteSource, Closing
from .frame import MAX_TIME_NS, CaptureError, CaptureProblem, Frame, Reason


class ProblemLog:
    """Problems in the order of their discovery; repeated problems are counted in one entry.

    The list is therefore bounded by the kinds of problems, not by the length of the file.
    """

    def __init__(self) -> None:
        self.found: list[CaptureProblem] = []
        # key -> [index into found, count]
        self._counts: dict[Hashable, list[int]] = {}
        self._sentences: dict[Hashable, tuple[str, str]] = {}

    def add(
        self, reason: Reason, message: str, offset: int, *, needed: int = 0, available: int = 0, frame: int = 0
    ) -> None:
        """Add a problem that occurs once."""
        self.found.append(CaptureProblem(reason, message, offset, needed, available, frame))

    def count(self, key: Hashable, reason: Reason, noun: str, text: str, offset: int, frame: int) -> None:
        """Count a problem of the kind `key`; the first one determines the place. `noun`: what is counted."""
        entry = self._counts.get(key)
        if entry is not None:
            entry[1] += 1
            return
        self._counts[key] = [len(self.found), 1]
        self._sentences[key] = noun, text
        self.add(reason, f"1 {noun}{text}", offset, frame=frame)

    def settle(self) -> None:
        """Update the sentences of counted problems."""
        for key, (index, times) in self._counts.items():
            if times > 1:
                old, (noun, text) = self.found[index], self._sentences[key]
                message = counted(times, noun) + text
                self.found[index] = CaptureProblem(old.reason, message, old.offset, frame=old.frame)


class CaptureReader(Closing):
    """Frames of one capture, in file order; an iterator and a context manager.

    Iteration never raises: it ends where a file is cut off or damaged, and `problems` describes the damage.
    """

    #: "pcap", "pcapng" or "mcap".
    format: str = ""

    def __init__(self, source: ByteSource, link_types: frozenset[int]) -> None:
        self._source = source
        self._link_types = link_types
        self._log = ProblemLog()
        self._metadata: dict[str, dict[str, str]] = {}
        self._number = 0
        self._position = 0
        self._frames_read = 0
        self._frames = self._iterate()

    def _records(self) -> Iterator[Frame]:
        """Yield the frames; set `_number`, `_frames_read` and `_position` before each."""
        raise NotImplementedError

    def _iterate(self) -> Generator[Frame]:
        yield from self._records()
        if self._source.failure and not any(problem.reason == "read-error" for problem in self._log.found):
            self._cut("read-error", self._position, 0, 0)
        self._log.settle()

    def _cut(self, reason: Reason, offset: int, needed: int, available: int, what: str = "", rest: str = "") -> None:
        """Note that the stream ended too early: because the file is too short, or because reading failed."""
        if self._source.failure:
            reason, what = "read-error", f"reading stopped at octet {offset} ({self._source.failure})"
        else:
            what = f"{what} at octet {offset} needs {needed} octets, and {available} are left"
        self._note(reason, f"{what}; {rest or self._so_far()}.", offset, needed=needed, available=available)

    def _clamped(self, time_ns: int, offset: int) -> int:
        """Return the time nearest to `time_ns` that a `Frame` can have."""
        text = f", the first at octet {offset}, outside of 1970 to 2262: the nearest that is inside stands for it."
        self._tally("time-out-of-range", "time", text, offset, self._number - 1)
        return min(max(time_ns, 0), MAX_TIME_NS)

    def _damaged(self, reason: Reason, offset: int, what: str) -> bool:
        """Note damage after which the next record cannot be found; return False for the end."""
        message = f"there is {what} at octet {offset}, and no way to read on from there; {self._so_far()}."
        self._note(reason, message, offset)
        return False

    def _note(self, reason: Reason, message: str, offset: int, *, needed: int = 0, available: int = 0) -> None:
        """Note a problem that occurs once."""
        self._log.add(reason, message, offset, needed=needed, available=available, frame=self._number)

    def _tally(
        self, reason: Reason, noun: str, text: str, offset: int, frame: int | None = None, of: Hashable = None
    ) -> None:
        """Count a problem after ``frame``, by default the last one; those with the same ``of`` are reported as one."""
        key = reason if of is None else (reason, of)
        self._log.count(key, reason, noun, text, offset, self._number if frame is None else frame)

    def _so_far(self) -> str:
        return f"{counted(self._frames_read, 'frame')} before it could be read"

    def _refuse(self, message: str) -> CaptureError:
        return CaptureError(f"{self.name}: {message}")

    @property
    def name(self) -> str:
        """Return the name of the file, as the caller gave it."""
        return self._source.name

    @property
    def problems(self) -> list[CaptureProblem]:
        """Return the problems found so far; the list is complete when the iteration has ended."""
        return self._log.found

    @property
    def position(self) -> int:
        """Return the number of octets of the file that were read."""
        return self._position

    @property
    def size(self) -> int | None:
        """Return the size of the file in octets, None for pipes."""
        return self._source.size

    @property
    def metadata(self) -> Mapping[str, Mapping[str, str]]:
        """Return named records of names and values, filled while reading.

        MCAP: the metadata records of the file. pcapng: ``section`` (hardware, os, userappl) and ``interface.N`` (name,
        description, linkType, resolution). pcap: ``pcap`` (fcsLength) if frames end in a checksum.
        """
        return self._metadata

    @property
    def frames_read(self) -> int:
        """Return the number of frames yielded so far."""
        return self._frames_read

    def __iter__(self) -> Iterator[Frame]:
        # The generator itself, so that a for loop does not call __next__ of this class for each frame.
        return self._frames

    def __next__(self) -> Frame:
        return next(self._frames)

    def close(self) -> None:
        """End the iteration and close the file. May be called again."""
        self._frames.close()
        self._log.settle()
        self._source.close()


def counted(number: int, noun: str) -> str:
    """Format ``1 frame``, ``2 frames``."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"
