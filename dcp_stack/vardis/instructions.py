"""Instructions for additional container types of a profile, beyond the six of the specification.

The profile describes the records (``vardis.own_containers``), so a class here defines neither the widths nor the order
of fields. A node uses an instruction if its profile has the container. It ignores the records of a container without
an instruction (``unhandled-container``).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar

from dcp_codec.values import OwnRecord

from .core import Core
from .database import DBEntry, IdQueue


class Instruction(ABC):
    """The handling of one container type at one node.

    Records are objects of :attr:`record_type`, with the fields of the profile.

    Received records are processed after those of the specification's types (VD-RX-08), and payloads are filled in the
    same order (VD-PAY-01).
    """

    container: ClassVar[str]
    """Name of the container type in the profile."""

    def __init__(self, core: Core) -> None:
        """Add :attr:`queue` to the queues of ``core.database``, which holds the variables."""
        config = core.config
        self.core = core
        layout = next(each for each in config.profile.vardis.own_containers if each.name == self.container)
        self.number = layout.number
        self.record_type = config.codec.types[layout.type_name]
        """Class of the records."""
        self.queue = core.database.queues.setdefault(self.container, IdQueue())
        """Variables about which a record is to be sent. A variable leaves it when it is deleted or created again."""

    @abstractmethod
    def receive(self, record: Any, now: int, wall: int) -> str | None:
        """Process a received record. Returns the reason (``dcp_stack.drops``) if the record is ignored."""

    @abstractmethod
    def record(self, var_id: int) -> OwnRecord:
        """Return the record to send about a variable in the queue. Does not change anything."""

    def sent(self, var_id: int) -> None:
        """Note that a payload has the record: the variable leaves the queue, unless a subclass repeats records."""
        self.queue.remove(var_id)

    # -- for subclasses -------------------------------------------------------------------------------------------

    def entry(self, var_id: int) -> DBEntry | None:
        """Return the database entry of a variable, None if the variable is unknown or deleted."""
        entry = self.core.database.lookup(var_id)
        return None if entry is None or entry.is_deleted else entry

    def size(self, record: OwnRecord) -> int:
        """Return the number of octets of a record in its container."""
        return self.core.sizes.own_record(self.number, record)

    def own_field(self, entry: DBEntry, name: str) -> Any:
        """Return the value of a field that the profile adds to VarSpec, by its name in the profile."""
        return self.core.config.own_fields.values(entry.spec)[name]

    def change_spec(self, entry: DBEntry, **fields: Any) -> None:
        """Change fields that the profile adds to VarSpec, by their names in the profile."""
        entry.spec = self.core.config.own_fields.replaced(entry.spec, fields)
