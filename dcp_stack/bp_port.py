"""The services of BP that SRP and VarDis use, and their confirms; both depend on no other part of BP."""

from __future__ import annotations

from typing import Protocol

import msgspec
from dcp_spec.constants import QueueingMode
from dcp_spec.status import BPStatus


class StatusConfirm(msgspec.Struct, frozen=True, gc=False):
    """A confirm with a status only."""

    status: BPStatus


class RegisterConfirm(msgspec.Struct, frozen=True, gc=False):
    """``BP-RegisterProtocol.confirm``; ``own_node_identifier`` is None in 1.0, whose confirm lacks it (BP-REG-07)."""

    status: BPStatus
    own_node_identifier: bytes | None


class NumberConfirm(msgspec.Struct, frozen=True, gc=False):
    """``BP-QueryNumberBufferedPayloads.confirm``; ``number`` is None unless the status is OK."""

    status: BPStatus
    number: int | None


class BPPort(Protocol):
    """Interface of BP to one client protocol; ``bp.client_port.ClientPort`` implements it. Times are ns."""

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

    def deregister(self, prot_id: int) -> StatusConfirm:
        """``BP-DeregisterProtocol``."""

    def transmit_payload(self, prot_id: int, payload: bytes, *, now: int) -> StatusConfirm:
        """``BP-TransmitPayload``."""

    def query_number_buffered(self, prot_id: int) -> NumberConfirm:
        """``BP-QueryNumberBufferedPayloads``."""

    def next_beacon(self) -> int | None:
        """Return when BP prepares its next beacon (monotonic ns); None if it prepares none for this client.

        This is ``nextBeaconGenerationEpoch`` of the latest BP-PayloadTransmitted.indication, corrected if the beacon
        was moved since (a changed period, a triggered beacon, a beacon without a payload of this client).
        """
