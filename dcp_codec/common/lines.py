"""Lines out of a stream of octets, in bounded memory: what the control interface and its clients speak."""

from __future__ import annotations


class LineTooLongError(ValueError):
    """A line has more octets than the reader takes."""

    def __init__(self, limit: int) -> None:
        super().__init__(f"the line is longer than {limit} octets; it was skipped")


class LineBuffer:
    """Splits octets into lines as they come; keeps nothing of a line of more than ``limit`` octets."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._octets = bytearray()
        self._searched = 0
        self._discarding = False

    def __len__(self) -> int:
        return len(self._octets)

    def add(self, data: bytes) -> None:
        """Take octets."""
        self._octets += data

    def next(self) -> bytes | None:
        """The next line without its end; None if no whole line is there. Raises LineTooLongError, once for each."""
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
        """Nothing more will come: what is there is a line, also without its end."""
        if self._octets and not self._octets.endswith(b"\n"):
            self._octets += b"\n"
