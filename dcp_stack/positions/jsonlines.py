"""A source of positions in JSON lines from a descriptor, usually standard input: ``{"x": 1.0, "y": 2.5, "z": 30}``."""

from __future__ import annotations

import os
import select
from typing import Final

import msgspec

from dcp_codec.common.lines import LineBuffer, LineTooLongError

from .base import PositionSource, Sample
from .fields import FieldError, SafetyFields

LONGEST_LINE: Final = 65_536
"""Maximum length of a line in octets, so that input without line ends cannot exhaust memory."""
_CHUNK: Final = 65_536
_CHUNKS_PER_POLL: Final = 16


class JsonLines(PositionSource):
    """Reads one JSON object per line, with fields of the profile, roles or aliases as keys.

    Invalid lines are counted by kind (``bad-json``, ``bad-field``, ``too-long``). The descriptor is not set to
    non-blocking, because this would persist for other processes that share the terminal; it is read only if data is
    available.
    """

    def __init__(self, name: str, fields: SafetyFields, *, fd: int) -> None:
        super().__init__(name)
        self._fields = fields
        self._fd = fd
        self._lines = LineBuffer(LONGEST_LINE)
        self._line = 0

    @property
    def finished(self) -> bool:
        """Whether the end of input was reached."""
        return self._fd < 0

    def fileno(self) -> int:
        """Return the descriptor, -1 after the end of input."""
        return self._fd

    def poll_timeout(self) -> int | None:
        """Return None: only the descriptor indicates new samples."""
        return None

    def poll(self, now: int, wall: int) -> list[Sample]:  # noqa: ARG002 - the same call for every source
        """Return the samples in the lines that have arrived."""
        found: list[Sample] = []
        for _ in range(_CHUNKS_PER_POLL):
            chunk = self._read()
            if chunk is None:
                break
            self._lines.add(chunk)
            if not chunk:
                # The last line counts even without a line end.
                self._lines.end()
                self._fd = -1
            self._take(found)
        return found

    def _read(self) -> bytes | None:
        """Return available octets, None if there are none yet, and an empty string at the end of input."""
        if self._fd < 0:
            return None
        try:
            ready, _, _ = select.select([self._fd], [], [], 0)
            return os.read(self._fd, _CHUNK) if ready else None
        except BlockingIOError:
            return None
        except (OSError, ValueError) as error:
            self.complain("read-error", f"reading ended ({error})")
            return b""

    def _take(self, found: list[Sample]) -> None:
        """Append the samples of all complete lines to ``found``."""
        while True:
            try:
                line = self._lines.next()
                if line is None:
                    return
                self._line += 1
                if line.strip():
                    self._parse(line, found)
            except LineTooLongError:
                self._line += 1
                self.complain("too-long", f"line {self._line} has more than {LONGEST_LINE} octets and was ignored")

    def _parse(self, line: bytes, found: list[Sample]) -> None:
        """Append the sample of one line to ``found``, or complain about the line."""
        try:
            values = msgspec.json.decode(line)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            self.complain("bad-json", f"line {self._line} is not valid JSON and was ignored ({error})")
            return
        if not isinstance(values, dict):
            self.complain("bad-json", f"line {self._line} is not a JSON object and was ignored")
            return
        try:
            if not values:
                raise FieldError("the object is empty")
            found.append(self._fields.from_sample(values))
        except FieldError as error:
            self.complain("bad-field", f"line {self._line} was ignored: {error}")

    def close(self) -> None:
        """Stop reading. The descriptor stays open, because it belongs to the caller."""
        self._fd = -1
