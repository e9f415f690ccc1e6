"""Faults in which an event of one protocol changes the state of another one."""

from __future__ import annotations

from dcp_spec.constants import BP_PROTID_SRP, SpecVersion

from dcp_selftest.mutants.mutant import mutant
from dcp_selftest.mutants.unseen import ALWAYS_ACTIVE, BP_ALWAYS_ACTIVE
from dcp_stack.node import Node


class Watched(Node):
    """Notices events of one protocol, and changes another one."""

    def settle(self, now: int, wall: int) -> None:
        super().settle(now, wall)
        if self.srp is not None and self.vardis is not None:
            before = self.__dict__.get("seen")
            self.seen = seen = self.watched()
            if before is not None and before != seen:
                self.changed()

    def watched(self) -> object:
        """Return the state whose change is the event."""
        return None

    def changed(self) -> None:
        """Change the other protocol."""


@mutant("of-the-silent", "VD-SCR-02", "deletes the variables of a producer whose entry it has removed")
class DeletesOfTheSilent(Node):
    def handle_timeout(self, now: int, wall: int) -> None:
        before = {each.node_id for each in self.srp.neighbours} if self.srp is not None else set()
        super().handle_timeout(now, wall)
        if self.srp is None or self.vardis is None:
            return
        database, gone = self.vardis._database, before - {each.node_id for each in self.srp.neighbours}
        for entry in database.entries.values():
            if entry.spec.prod_id in gone and not entry.is_deleted:
                database.mark_deleted(entry)


@mutant(
    "paused-with-VarDis", "SRP-NT-01", "clears its neighbour table when VarDis is deactivated", unseen=ALWAYS_ACTIVE
)
class TableOfVarDis(Watched):
    def watched(self) -> object:
        return self.vardis is not None and self.vardis.active

    def changed(self) -> None:
        if self.srp is not None:
            self.srp.neighbours.clear()


@mutant(
    "paused-report",
    "SRP-SRV-03 BP-MGT-04",
    "discards a waiting report when BP is deactivated",
    unseen=BP_ALWAYS_ACTIVE,
)
class DiscardsReport(Watched):
    def watched(self) -> object:
        return self.bp.active

    def changed(self) -> None:
        client = self.bp.client(BP_PROTID_SRP)
        if client is not None and client.queue is not None:
            client.queue.clear()


@mutant(
    "other-network",
    "VD-PC-07 BP-PAR-02",
    "forgets the variables of other nodes when BPPAR_NETWORK_ID is set",
    since=SpecVersion.V2_0,
    unseen={"1.0 1.1 1.2 1.3": "BP has no BPPAR_NETWORK_ID before 2.0"},
)
class ForgetsOfNetwork(Watched):
    def watched(self) -> object:
        return self.bp.parameters().get("BPPAR_NETWORK_ID")

    def changed(self) -> None:
        if self.vardis is not None:
            database = self.vardis._database
            for var_id, entry in list(database.entries.items()):
                if entry.spec.prod_id != self.vardis.own_node_identifier:
                    database._remove_from_queues(var_id)
                    del database.entries[var_id]
