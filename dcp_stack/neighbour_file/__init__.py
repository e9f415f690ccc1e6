"""The neighbour table as a memory-mapped file, for control loops that cannot wait for a node to answer.

The layout, how to read it from C, and why no reader ever sees a torn table are in ``docs/neighbour-file.md``. In
short: the writer prepares a table elsewhere, copies it into one of two slots under the sequence lock of that slot,
and then says which slot is the latest. A reader copies the latest slot and accepts the copy if the lock did not move
and the checksum fits. Numbers are little-endian; times are ns, wall since 1970 and monotonic as CLOCK_MONOTONIC.
"""

from .layout import NeighbourFileError
from .reader import FileEntry, NeighbourFileReader, NeighbourFileSnapshot
from .writer import NeighbourFileWriter

__all__ = ["FileEntry", "NeighbourFileError", "NeighbourFileReader", "NeighbourFileSnapshot", "NeighbourFileWriter"]
