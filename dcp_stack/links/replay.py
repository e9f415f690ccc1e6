"""A recording as a link: its frames are received again, with their original timing."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable
from pathlib import Path

from dcp_spec.profile.definition import Link as Framing

from dcp_codec.capture import CaptureError, CaptureProblem, Frame, open_capture
from dcp_codec.framing.locate import OtherTraffic, locate

from .base import LinkCounters, LinkError, Reception

log = logging.getLogger(__name__)

#: Maximum number of receptions per call, so that a fast replay does not delay the timers of the node.
PORTION = 512


class ReplayLink:
    """The link of a recording. It has no descriptor; :meth:`poll_timeout` returns the next arrival."""

    def __init__(
        self,
        path: str | Path,
        framing: Framing,
        *,
        speed: float = 1.0,
        source: bytes = b"",
        original_times: bool = False,
        max_packet_size: int = 1500,
        clock: Callable[[], int] = time.monotonic_ns,
        wall: Callable[[], int] = time.time_ns,
    ) -> None:
        """Open the recording ``path`` (pcap, pcapng, MCAP).

        ``framing`` is the position of beacons in its frames (``profile.link``). Frames keep their time distances
        divided by ``speed`` (``math.inf``: all at once). ``source`` is our own address; frames from it are left out.
        Receptions have the time of their replay or, with ``original_times``, the time in the recording. ``clock``
        (monotonic) and ``wall`` (since 1970) are in ns.

        Raises :class:`LinkError` if the file cannot be opened. Later problems of the recording are in
        :attr:`problems`.
        """
        self.name = f"replay:{path}"
        self.counters = LinkCounters()
        self.max_packet_size = max_packet_size
        self.source = source
        if not speed > 0:
            raise LinkError(f"{self.name}: speed {speed:g} is not greater than 0")
        self._speed = speed
        self._framing = framing
        self._original_times = original_times
        self._clock = clock
        self._wall = wall
        self._started: tuple[int, int] | None = None
        self._first: int | None = None
        self._next: tuple[int, Reception] | None = None
        try:
            self._capture = open_capture(path)
        except CaptureError as error:
            raise LinkError(f"{self.name}: {error}") from error
        self._finished = self._closed = False
        self._last_offset = 0

    @property
    def finished(self) -> bool:
        """Whether all frames of the recording have been received."""
        return self._finished

    @property
    def problems(self) -> list[CaptureProblem]:
        """The problems found in the recording so far; complete once :attr:`finished` is True."""
        return self._capture.problems

    @property
    def up(self) -> bool:
        """Whether the link is open."""
        return not self._closed

    def fileno(self) -> int:
        """Return -1: a recording has no descriptor to wait for."""
        return -1

    def poll_timeout(self) -> int | None:
        """Return the arrival time of the next frame in ns of the clock; None at the end. The first call starts it."""
        upcoming = self._upcoming()
        return upcoming[0] if upcoming is not None else None

    def receive(self) -> list[Reception]:
        """Return the frames that have arrived, at most ``PORTION``. The first call starts the replay."""
        receptions: list[Reception] = []
        # Before the clock is read: this call starts the replay if it has not started.
        self._upcoming()
        now = self._clock()
        while len(receptions) < PORTION:
            upcoming = self._upcoming()
            if upcoming is None or upcoming[0] > now:
                break
            self._next = None
            receptions.append(upcoming[1])
        self.counters.received += len(receptions)
        return receptions

    def send(self, octets: bytes) -> bool:
        """Count a transmission; it reaches no receiver."""
        if self._closed or len(octets) > self.max_packet_size:
            self.counters.send_errors += 1
            return False
        self.counters.sent += 1
        return True

    def close(self) -> None:
        """Close the file."""
        self._closed = True
        self._end()

    def _upcoming(self) -> tuple[int, Reception] | None:
        """Return the next frame and its arrival time; None at the end. Starts the replay if it has not started."""
        if self._finished or self._next is not None:
            return self._next
        if self._started is None:
            self._started = (self._clock(), self._wall())
        for frame in self._capture:
            octets, sender = self._payload(frame)
            if octets is None:
                self.counters.ignored += 1
                continue
            self._next = self._scheduled(frame.time_ns, octets, sender, *self._started)
            return self._next
        self._end()
        return None

    def _payload(self, frame: Frame) -> tuple[bytes | None, bytes]:
        """Return bearer payload and sender; None as payload if foreign, truncated by the recorder, or our own."""
        framing = locate(frame.data, self._framing)
        if isinstance(framing, OtherTraffic) or frame.orig_len > len(frame.data):
            return None, b""
        sender = framing.src or b""
        if self.source and sender == self.source:
            return None, sender
        return frame.data[framing.start : framing.end], sender

    def _scheduled(self, time_ns: int, octets: bytes, sender: bytes, start: int, wall: int) -> tuple[int, Reception]:
        """Return arrival time and reception of a frame recorded at ``time_ns``, for a replay started at ``start``."""
        if self._first is None:
            self._first = time_ns
        offset = time_ns - self._first
        if self._speed != 1.0:
            offset = 0 if math.isinf(self._speed) else int(offset / self._speed)
        # If timestamps in the recording decrease, the order of frames has priority.
        offset = self._last_offset = max(self._last_offset, offset)
        return start + offset, Reception(octets, time_ns if self._original_times else wall + offset, sender)

    def _end(self) -> None:
        """Close the recording, and log its problems."""
        if self._finished:
            return
        self._finished, self._next = True, None
        self._capture.close()
        for problem in self.problems:
            log.warning("%s: %s", self.name, problem.message)
