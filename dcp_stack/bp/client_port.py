"""Interface of BP to one client protocol of a node.

Clients outside the node may deregister SRP or VarDis and register under the same number. BP cannot distinguish its
clients and does not indicate this. The port therefore keeps its own registration and compares it with BP's.
"""

from __future__ import annotations

from dcp_spec.constants import QueueingMode
from dcp_spec.status import BPStatus

from .entity import BeaconingProtocol
from .queue import Client
from .services import NumberConfirm, RegisterConfirm, StatusConfirm


class ClientPort:
    """The services of BP for one client protocol of the same node."""

    def __init__(self, bp: BeaconingProtocol) -> None:
        self._bp = bp
        self._client: Client | None = None

    @property
    def holds(self) -> bool:
        """True if BP's registration under the number was made by this port."""
        return self._client is not None and self._client.stands

    def register(
        self,
        prot_id: int,
        name: str,
        max_payload_size: int,
        queueing_mode: QueueingMode,
        max_entries: int,
        allow_multiple_payloads: bool,
        *,
        now: int,
        wall: int,
    ) -> RegisterConfirm:
        """``BP-RegisterProtocol``."""
        confirm = self._bp.register(
            prot_id, name, max_payload_size, queueing_mode, max_entries, allow_multiple_payloads, now=now, wall=wall
        )
        if confirm.status is BPStatus.OK:
            self._client = self._bp.client(prot_id)
        return confirm

    def deregister(self, prot_id: int) -> StatusConfirm:
        """``BP-DeregisterProtocol``, also of another client's registration: a restarted protocol needs its number."""
        return self._bp.deregister(prot_id)

    def transmit_payload(self, prot_id: int, payload: bytes, *, now: int) -> StatusConfirm:
        """``BP-TransmitPayload``; if another client holds the number, answered as for an unregistered one."""
        if not self.holds:
            return StatusConfirm(BPStatus.UNKNOWN_PROTOCOL)
        return self._bp.transmit_payload(prot_id, payload, now=now)

    def query_number_buffered(self, prot_id: int) -> NumberConfirm:
        """``BP-QueryNumberBufferedPayloads``, with the same check of the registration."""
        if not self.holds:
            return NumberConfirm(BPStatus.UNKNOWN_PROTOCOL, None)
        return self._bp.query_number_buffered(prot_id)

    def next_beacon(self) -> int | None:
        """Return when BP prepares its next beacon (monotonic ns); None if none, or if another client has the number."""
        return self._bp.poll_timeout() if self.holds else None
