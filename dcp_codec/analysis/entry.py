"""One state of a variable at a node: an entry of the ledger."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from dcp_spec.constants import ICType

DELETED: Final = -1
"""In place of a sequence number: the node has deleted the variable."""
UNKNOWN: Final = -2
"""In place of a sequence number: the node has asked for the variable's creation, or has sent no record about it."""

Creation = tuple[bytes, int | None]
"""The identity of a creation: prodId, and creationTime (None before 2.0)."""
Stamp = tuple[int, int]
"""Number of a frame and its time in ns since 1970."""

#: Number of frames with the value that an entry keeps: the first ones, and the last one.
_CARRIED = 8


@dataclass(slots=True, eq=False)
class Entry:
    """One state of a variable at a node.

    ``number`` is its sequence number, or :data:`DELETED` or :data:`UNKNOWN`; ``creation`` is from the node's last
    create, None if it sent none.
    """

    node: bytes
    var_id: int
    number: int
    creation: Creation | None
    kind: ICType
    """Type of the first record with this state."""
    frame: int
    """Number of its frame."""
    time: int
    """Time of that frame, ns since 1970."""
    last: int
    """Number of the last frame with this state."""
    until: int
    """Time of that frame, ns since 1970."""
    carried: list[Stamp] = field(default_factory=list)
    """Frames in which the node sent the value (creates and updates): the first ones, and the last one."""
    values: int = 0
    """Number of these frames."""
    asked: int = 0
    """Number of its requests in this state."""
    last_asked: Stamp | None = None
    """The last one of them."""
    count: int = -1
    """Number of values of the producer up to this one; -1 if the producer had not shown the number before."""
    left: Entry | None = None
    """The state for which the producer has left this number; None while it has not."""
    newest: Entry | None = None
    """The last state of the producer with a number, up to ``until``."""
    deleted: bool = False
    """True if the producer deleted the variable by ``until``."""
    missed: int = 0
    """Number of values of the producer, up to ``until``, that the node has not followed."""

    def carry(self, frame: int, time: int) -> None:
        """Note a frame with the value."""
        self.values += 1
        if len(self.carried) < _CARRIED:
            self.carried.append((frame, time))
        else:
            self.carried[-1] = (frame, time)

    @property
    def age(self) -> int:
        """Time in ns for which the node has kept the number after the producer had left it; 0 if it has not."""
        return 0 if self.left is None else max(self.until - self.left.time, 0)
