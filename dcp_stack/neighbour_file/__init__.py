"""The neighbour table as a memory-mapped file, for control loops that cannot wait for the answer of a node.

``docs/neighbour-file.md`` has the layout, a reader in C, and the proof that readers get consistent tables. In short:
the writer prepares a table in its own memory, copies it into one of two slots under the sequence lock of that slot, and
then marks the slot as the latest. A reader copies the latest slot, and accepts the copy if the sequence lock is
unchanged and the checksum is correct. Numbers are little-endian. Times are ns: wall since 1970, monotonic as
CLOCK_MONOTONIC.
"""

from .layout import NeighbourFileError
from .reader import FileEntry, NeighbourFileReader, NeighbourFileSnapshot
from .writer import NeighbourFileWriter

__all__ = ["FileEntry", "NeighbourFileError", "NeighbourFileReader", "NeighbourFileSnapshot", "NeighbourFileWriter"]
