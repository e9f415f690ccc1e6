"""Queues and buffers of the clients of BP (dcp-bp.md#subsubsec-beaconing-protocol-data-types).

The table :data:`QUEUEING` describes the queueing modes. A buffer is a queue with one place, so one class
serves all modes.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from enum import Enum
from types import MappingProxyType
from typing import Final, Literal

import msgspec
from dcp_spec.constants import QueueingMode

from .services import Registration


class Places(Enum):
    """Number of payloads that a mode keeps."""

    ONE = "one"
    MAX_ENTRIES = "maxEntries"
    UNLIMITED = "unlimited"


class ModeRule(msgspec.Struct, frozen=True, gc=False):
    """One row of the table.

    ``when_full``: effect of a new payload on a full queue. ``when_sent``: whether a payload is kept after it was put
    into a beacon. ``several``: whether allowMultiplePayloads has an effect. ``on_empty``: effect of an empty payload
    in versions where it is not only an error (1.0).
    """

    places: Places
    when_full: Literal["discard-new", "displace-oldest"] | None
    when_sent: Literal["remove", "keep"]
    several: bool
    on_empty: Literal["refuse", "clear"]


#: The queueing modes of the specification (C.4 of the protocol reference).
QUEUEING: Final[Mapping[QueueingMode, ModeRule]] = MappingProxyType(
    {
        ##= BP-QM-01
        QueueingMode.QUEUE_DROPTAIL: ModeRule(Places.MAX_ENTRIES, "discard-new", "remove", True, "refuse"),
        ##= BP-QM-02
        QueueingMode.QUEUE_DROPHEAD: ModeRule(Places.MAX_ENTRIES, "displace-oldest", "remove", True, "refuse"),
        ##= BP-QM-03 BP-QM-10
        # The only queue mode of 1.0, of indefinite length.
        QueueingMode.QUEUE: ModeRule(Places.UNLIMITED, None, "remove", False, "refuse"),
        ##= BP-QM-04
        QueueingMode.ONCE: ModeRule(Places.ONE, "displace-oldest", "remove", False, "clear"),
        ##= BP-QM-05
        QueueingMode.REPEAT: ModeRule(Places.ONE, "displace-oldest", "keep", False, "clear"),
    }
)

Submission = Literal["stored", "discarded", "displaced"]


class PayloadQueue:
    """The payloads of one client that wait for a beacon, oldest first."""

    def __init__(self, rule: ModeRule, max_entries: int) -> None:
        """``max_entries`` is used only by modes with a configurable length (BP-QM-09)."""
        self.rule = rule
        ##= BP-QM-09
        self._places = None if rule.places is Places.UNLIMITED else 1 if rule.places is Places.ONE else max_entries
        ##= DATA-12
        self._payloads: deque[bytes] = deque()

    def __len__(self) -> int:
        """Return the number of payloads; 0 or 1 for a buffer."""
        return len(self._payloads)

    def submit(self, payload: bytes) -> Submission:
        """Add a payload by the rule of the mode; return the outcome: stored, oldest displaced or discarded."""
        outcome: Submission = "stored"
        if self._places is not None and len(self._payloads) >= self._places:
            ##= BP-TXP-04
            if self.rule.when_full == "discard-new":
                return "discarded"
            ##= BP-TXP-05 BP-TXP-06
            self._payloads.popleft()
            outcome = "displaced"
        self._payloads.append(payload)
        return outcome

    def head(self) -> bytes | None:
        """Return the next payload, or None if the queue is empty."""
        return self._payloads[0] if self._payloads else None

    def sent(self) -> None:
        """Remove or keep the head, by the mode, after it was put into a beacon."""
        ##= BP-TX-05
        if self.rule.when_sent == "remove":
            self._payloads.popleft()

    def clear(self) -> None:
        """Remove all payloads."""
        self._payloads.clear()


class Client:
    """A registered client protocol: the parameters of its registration, and its payloads.

    ``queue`` is None for an unknown mode (reading X06 ``refuse-at-clear``), which keeps no payloads.
    """

    def __init__(self, registration: Registration, rule: ModeRule | None, *, several: bool) -> None:
        self.registration = registration
        self.protocol_id = registration.protocol_id
        """The protocol identifier of the registration."""
        self.stands = True
        """True until the client is deregistered."""
        ##= BP-REG-06
        self.queue = None if rule is None else PayloadQueue(rule, registration.max_entries)
        ##= BP-QM-07
        self.several = several and rule is not None and rule.several
