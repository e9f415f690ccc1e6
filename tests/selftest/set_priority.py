"""SET-PRIORITY of the made-up version 2.1, see walk_2_1.py: the file ``dcp_stack/vardis/set_priority.py``."""

from __future__ import annotations

from typing import Any

from dcp_stack.vardis.instructions import Instruction


class SetPriority(Instruction):
    """The producer changes the priority of a variable; receivers pass the change on once."""

    container = "SET-PRIORITY"

    def receive(self, record: Any, now: int, wall: int) -> str | None:
        entry = self.entry(record.var_id)
        if entry is None or entry.spec.prod_id == self.core.own_id:
            return "update-unknown" if entry is None else "update-own"
        if record.priority != self.own_field(entry, "priority"):
            self.change(record.var_id, record.priority)
        return None

    def change(self, var_id: int, priority: int) -> None:
        """Note the new priority and send it."""
        entry = self.entry(var_id)
        assert entry is not None
        self.change_spec(entry, priority=priority)
        self.queue.append(var_id)

    def record(self, var_id: int) -> Any:
        entry = self.entry(var_id)
        assert entry is not None
        return self.record_type(var_id=var_id, priority=self.own_field(entry, "priority"), seqno=entry.seqno)
