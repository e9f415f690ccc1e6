"""Splitting a stream of octets into lines in bounded memory, for the control interface and its clients."""

from __future__ import annotations


class LineTooLongError(ValueError):
    """A line has more octets than the reader takes."""

    def __init__(self, limit: int) -> None:
        super().__init__(f"the line is longer than {limit} octets; it was skipped")


class LineBuffer:
    """Splits octets into lines as they arrive; a line of more than ``limit`` octets is discarded."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._octets = bytearray()
        self._searched = 0
        self._discarding = False

    def __len__(self) -> int:
        return len(self._octets)

    def add(self, data: bytes) -> None:
        """Append received octets."""
        self._octets += data

    def next(self) -> bytes | None:
        """Return the next line without its end, None if there is no complete line. Raises LineTooLongError once for
        each.
        """
        end = self._octets.find(b"\n", self._searched)
        if end < 0:
            if self._discarding or len(self._octets) > self._limit:
                self._octets.clear()
                self._searched = 0
                if not self._discarding:
                    self._discarding = True
                    raise LineTooLongError(self._limit)
            self._searched = len(self._octets)
            return None
        line = bytes(self._octets[:end])
        del self._octets[: end + 1]
        self._searched = 0
        if self._discarding:
            self._discarding = False
            return self.next()
        if len(line) > self._limit:
            raise LineTooLongError(self._limit)
        return line

    def end(self) -> None:
        """Mark the end of the input; remaining octets become a line even without a line end."""
        if self._octets and not self._octets.endswith(b"\n"):
            self._octets += b"\n"
