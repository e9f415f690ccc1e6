"""Faults of BP that show only with many payloads, without payloads, or when BP is activated and deactivated."""

from __future__ import annotations

from collections.abc import Callable

from dcp_selftest.mutants.bp.receive import Blocks, Ends
from dcp_selftest.mutants.family import after, assign, attributes, before, instead
from dcp_selftest.mutants.mutant import mutant
from dcp_selftest.mutants.unseen import BP_ALWAYS_ACTIVE, ONE_PAYLOAD
from dcp_stack.bp.clients import Chosen, ClientList
from dcp_stack.bp.entity import BeaconingProtocol
from dcp_stack.bp.services import StatusConfirm


class _Dummy(ClientList):
    dummy = b"\0"

    def take(self, room: int, size: Callable[[bytes], int], most: int) -> Chosen:
        return super().take(room, size, most) or [(0xFFFF, self.dummy)]


dummy = attributes(_Dummy, __name__)
dummy("heartbeat", "BP-FMT-03", "sends a block of an unregistered protocol when no client has a payload", dummy=b"\0")
dummy("empty-heartbeat", "BP-FMT-03", "sends an empty block of an unregistered protocol when no client has a payload",
    dummy=b"")  # fmt: skip


@mutant(
    "several",
    "BP-FMT-02 BP-TX-04",
    "puts a whole queue into a beacon if allowMultiplePayloads is true",
    unseen=ONE_PAYLOAD,
)
class SeveralIgnoresRoom(ClientList):
    def take(self, room: int, size: Callable[[bytes], int], most: int) -> Chosen:
        chosen = super().take(room, size, most)
        for client in self:
            if client.several and client.queue is not None:
                while (payload := client.queue.head()) is not None and client.queue.rule.when_sent == "remove":
                    chosen.append((client.protocol_id, payload))
                    client.queue.sent()
        return chosen


before(BeaconingProtocol, BeaconingProtocol.activate)("activated", "BP-HDR-08",
    "restarts sequence numbers when it is activated",
    lambda self, now: assign(self, _seqno=0), unseen=BP_ALWAYS_ACTIVE)  # fmt: skip


before(BeaconingProtocol, BeaconingProtocol.activate)("slots-while-inactive", "BP-HDR-09 BP-HDR-08",
    "counts the beacons that it would have sent while it was inactive",
    lambda self, now: self._active or assign(self,
        _seqno=self._seqno + max(0, now - self._schedule.due) // self._parameters.period),
    unseen=BP_ALWAYS_ACTIVE)  # fmt: skip


@mutant("clears", "BP-MGT-05", "clears all buffers when it is activated although it is active")
class ReactivateClears(BeaconingProtocol):
    def activate(self, now: int) -> StatusConfirm:
        for client in self._clients if self._active else ():
            if client.queue is not None:
                client.queue.clear()
        return super().activate(now)


instead(Blocks, Blocks.chosen)("eight", "BP-RX-07", "processes at most eight blocks of a beacon",
    lambda self, blocks: blocks[:8])  # fmt: skip


after(Ends, Ends.ends)("empty-ends", "BP-RX-08", "stops at a block of length 0 of an unregistered protocol",
    lambda self, unknown, block: unknown and not block.payload)  # fmt: skip
