"""Positions as JSON lines from a descriptor, usually standard input: ``{"x": 1.0, "y": 2.5, "z": 30}``."""

from __future__ import annotations

import os
import select
from typing import Final

import msgspec

from .base import Sample, Source
from .fields import FieldError, SafetyFields

LONGEST_LINE: Final = 65_536
"""Octets; what is longer is no position, and may not take up memory until a line ends."""
_CHUNK: Final = 65_536
_CHUNKS_PER_POLL: Final = 16


class JsonLines(Source):
    """One object per line, with fields of the profile, roles or aliases as keys.

    Lines that are no such object are counted under their kind (``bad-json``, ``bad-field``, ``too-long``). The
    descriptor is not set to non-blocking, which would outlast us in whoever shares the terminal; it is read only
    when something is there.
    """

    def __init__(self, name: str, fields: SafetyFields, *, fd: int) -> None:
        super().__init__(name)
        self._fields = fields
        self._fd = fd
        self._rest = bytearray()
        self._skipping = False
        self._line = 0

    @property
    def finished(self) -> bool:
        """Whether the other end has closed."""
        return self._fd < 0

    def fileno(self) -> int:
        """The descriptor, -1 after its end."""
        return self._fd

    def poll_timeout(self) -> int | None:
        """The descriptor alone tells."""
        return None

    def poll(self, now: int, wall: int) -> list[Sample]:  # noqa: ARG002 - the same call for every source
        """The samples in what has arrived."""
        found: list[Sample] = []
        for _ in range(_CHUNKS_PER_POLL):
            chunk = self._read()
            if chunk is None:
                break
            if not chunk:
                # A last line without its end is a line all the same.
                chunk, self._fd = b"\n", -1
            self._take(chunk, found)
            if self._fd < 0:
                break
        return found

    def _read(self) -> bytes | None:
        """What is there, None if nothing is, no octets at the end."""
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

    def _take(self, chunk: bytes, found: list[Sample]) -> None:
        self._rest += chunk
        *lines, rest = self._rest.split(b"\n")
        for line in lines:
            self._line += 1
            if self._skipping or len(line) > LONGEST_LINE:
                self._skipping = False
                self.complain("too-long", f"line {self._line} has more than {LONGEST_LINE} octets and was ignored")
            elif line.strip():
                self._parse(bytes(line), found)
        if len(rest) > LONGEST_LINE:
            self._skipping, rest = True, bytearray()
        self._rest = rest

    def _parse(self, line: bytes, found: list[Sample]) -> None:
        try:
            values = msgspec.json.decode(line)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            self.complain("bad-json", f"line {self._line} is no JSON and was ignored ({error})")
            return
        if not isinstance(values, dict):
            self.complain("bad-json", f"line {self._line} is no JSON object and was ignored")
            return
        try:
            if not values:
                raise FieldError("the object is empty")
            found.append(self._fields.from_sample(values))
        except FieldError as error:
            self.complain("bad-field", f"line {self._line} was ignored: {error}")

    def close(self) -> None:
        """Read no more; the descriptor belongs to the caller."""
        self._fd = -1
