"""The Beaconing Protocol (dcp-bp.md) without input or output.

Order of calls: any service request, :meth:`BeaconingProtocol.handle_beacon` or
:meth:`BeaconingProtocol.handle_timeout`, then ``poll_timeout()`` for when ``handle_timeout`` is due. Effects go to
``emit`` while a call runs, in order: ``SendBeacon``, then its ``PayloadTransmitted`` in the order of the blocks;
``PayloadReceived`` and ``Dropped`` in the order of the octets. ``now`` is monotonic ns, ``wall`` ns since 1970.

Service requests are methods that return their confirm. Two options of profiles describe other implementations and
are not used here: the confirm of BP-TransmitPayload and BP-PayloadTransmitted.indication always exist.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any

import msgspec
from dcp_spec.constants import BP_MAX_PAYLOADS, BP_SEQNO_MODULUS, QueueingMode, SpecVersion
from dcp_spec.parameters import Violation
from dcp_spec.status import BPStatus

from dcp_stack.config import NodeConfig
from dcp_stack.effects import Effect, PayloadTransmitted, SendBeacon

from .clients import ClientList
from .parameters import PERIOD, BPParameters
from .queue import QUEUEING, Client
from .receive import Receiver
from .services import (
    ListConfirm,
    NumberConfirm,
    RegisterConfirm,
    Registration,
    StatusConfirm,
    UnknownServiceError,
)
from .statistics import Counters, LossTable, NeighbourLoss
from .timing import BeaconSchedule
from .wire import BPWire

# Counters that exist from the start, independent of registrations and received frames.
_COUNTED = (
    "beacons-left-out",
    "beacons-received",
    "beacons-sent",
    "beacons-without-payload",
    "frames-received",
    "octets-received",
    "octets-sent",
)


class BeaconingProtocol:
    """The BP entity of one node."""

    def __init__(
        self,
        config: NodeConfig,
        *,
        rng: random.Random,
        emit: Callable[[Effect], None],
        now: int,
        wall: int,  # noqa: ARG002 - the same call for every core
    ) -> None:
        """``rng`` is used for the jitter only. Raises ValueError for parameters that are out of bounds."""
        ##= BP-INI-04
        self._config = config
        self._features = config.features
        readings = config.selected_readings
        self._emit = emit
        self._wire = BPWire(config)
        self._parameters = BPParameters(config)
        self._clients = ClientList()
        ##= BP-INI-03
        self._active = True
        ##= BP-INI-02 BP-HDR-12 BP-HDR-13
        self._seqno = 1 if readings.first_seqno == "increment-then-write" else self._features.first_beacon_seqno
        self._refuses_modes = readings.unknown_queueing_mode == "refuse-at-registration"
        self._counts_header = readings.packet_size == "with-header"
        self._tells_each_payload = readings.transmitted_indication == "per-payload"
        self._fills_beacons = readings.beacon_filling == "while-space-lasts"
        self._largest_protocol = (1 << (8 * config.profile.types.protocol_id.width)) - 1
        self._counters = Counters(*_COUNTED)
        self._losses = LossTable()
        self._receiver = Receiver(
            self._wire,
            self._clients,
            self._parameters,
            node_id=config.node_id,
            counters=self._counters,
            losses=self._losses,
            readings=readings,
            emit=emit,
        )
        self._schedule = BeaconSchedule(rng=rng, period=self._parameters.period, config=config.bp, now=now)

    # -- registration -----------------------------------------------------------------------------------------

    ##= BP-REG-12
    def register(
        self,
        prot_id: int,
        name: str,
        max_payload_size: int,
        queueing_mode: QueueingMode | str | int,
        max_entries: int,
        allow_multiple_payloads: bool,
        *,
        now: int,  # noqa: ARG002 - the same call for every service that takes time
        wall: int,
    ) -> RegisterConfirm:
        """``BP-RegisterProtocol.request`` (dcp-bp.md#bp-interface-service-bp-register-protocol).

        1.0 has neither ``max_entries`` nor ``allow_multiple_payloads``; they are listed but have no effect there.
        """
        self._protocol(prot_id)
        if not isinstance(name, str):
            raise TypeError(f"name must be a str, not {type(name).__name__}")
        _integer("max_payload_size", max_payload_size)
        _integer("max_entries", max_entries)
        if not isinstance(allow_multiple_payloads, bool):
            raise TypeError(f"allow_multiple_payloads must be a bool, not {type(allow_multiple_payloads).__name__}")
        mode = _mode(queueing_mode)
        rule = QUEUEING[mode] if isinstance(mode, QueueingMode) and mode in self._features.queueing_modes else None
        several = allow_multiple_payloads and self._features.allow_multiple_payloads
        ##= BP-REG-01
        registration = Registration(prot_id, name, max_payload_size, mode, wall, max_entries, allow_multiple_payloads)
        status = self._registrable(registration, known=rule is not None)
        if status is BPStatus.OK:
            ##= BP-REG-06 BP-DRG-05
            self._clients.insert(Client(registration, rule, several=several))
        ##= BP-REG-07
        own = self._config.node_id if self._features.own_id_in_register_confirm else None
        ##= BP-REG-08 BP-REG-13 DATA-10
        return RegisterConfirm(status, own)

    ##= BP-REG-09 DATA-11
    def _registrable(self, registration: Registration, *, known: bool) -> BPStatus:
        """Check the parameters of the service in the order of its steps."""
        ##= BP-REG-02
        if registration.protocol_id in self._clients:
            return BPStatus.PROTOCOL_ALREADY_REGISTERED
        ##= BP-REG-03
        # 1.0 allows 0; a negative size is never valid.
        least = 1 if self._features.version >= SpecVersion.V1_1 else 0
        if registration.max_payload_size < least:
            return BPStatus.ILLEGAL_MAX_PAYLOAD_SIZE
        ##= BP-REG-04 BP-REG-11 BP-PAR-11
        overhead = self._wire.header_size if self._features.registration_counts_bp_header else 4
        largest = self._parameters.max_packet_size - (self._wire.block_header_size + overhead)
        if registration.max_payload_size > min(largest, self._wire.max_payload):
            return BPStatus.ILLEGAL_MAX_PAYLOAD_SIZE
        ##= BP-REG-05
        mode = registration.queue_mode
        if (
            mode in (QueueingMode.QUEUE_DROPTAIL, QueueingMode.QUEUE_DROPHEAD)
            and known
            and registration.max_entries <= 0
        ):
            return BPStatus.ILLEGAL_DROPPING_QUEUE_SIZE
        ##= BP-QM-06
        # The steps have no such check (X06); after all of them it changes none of their answers.
        if not known and self._refuses_modes:
            return BPStatus.UNKNOWN_QUEUEING_MODE
        return BPStatus.OK

    def deregister(self, prot_id: int) -> StatusConfirm:
        """``BP-DeregisterProtocol.request`` (dcp-bp.md#bp-service-bp-deregister-protocol)."""
        ##= BP-DRG-01
        if self._client(prot_id) is None:
            return StatusConfirm(BPStatus.UNKNOWN_PROTOCOL)
        ##= BP-DRG-02
        self._clients.remove(prot_id)
        ##= BP-DRG-06
        return StatusConfirm(BPStatus.OK)

    def list_registered(self) -> ListConfirm:
        """``BP-ListRegisteredProtocols.request``: the registrations, without the buffered payloads."""
        ##= BP-LST-01 BP-LST-02 BP-LST-03 BP-LST-04 BP-GEN-01
        return ListConfirm(BPStatus.OK, tuple(client.registration for client in self._clients))

    def client(self, prot_id: int) -> Client | None:
        """Return the client that is registered under an identifier, or None."""
        return self._clients.get(prot_id)

    # -- payloads ---------------------------------------------------------------------------------------------

    def transmit_payload(self, prot_id: int, payload: bytes, *, now: int) -> StatusConfirm:
        """``BP-TransmitPayload.request`` (dcp-bp.md#bp-service-bp-transmit-payload).

        OK means that the payload is kept or that a full queue silently dropped it (BP-TXP-09).
        """
        client = self._client(prot_id)
        if not isinstance(payload, bytes | bytearray | memoryview):
            raise TypeError(f"payload must be bytes, not {type(payload).__name__}")
        ##= BP-TXP-08 BP-TXP-11 BP-TXP-14 BP-GEN-02
        return StatusConfirm(self._submit(client, bytes(payload), now))

    ##= BP-TXP-10
    def _submit(self, client: Client | None, payload: bytes, now: int) -> BPStatus:
        ##= BP-TXP-01 BP-REG-10
        if client is None:
            return BPStatus.UNKNOWN_PROTOCOL
        ##= BP-TXP-02
        if len(payload) > client.registration.max_payload_size:
            return BPStatus.PAYLOAD_TOO_LARGE
        queue = client.queue
        ##= BP-TXP-03 BP-TXP-12 BP-TXP-13
        if not payload:
            if self._features.empty_payload_clears_buffer and queue is not None and queue.rule.on_empty == "clear":
                queue.clear()
                return BPStatus.OK
            return BPStatus.EMPTY_PAYLOAD
        if queue is None:
            # Unknown mode: neither of the last two steps applies (X06).
            return BPStatus.UNKNOWN_QUEUEING_MODE
        outcome = queue.submit(payload)
        self._counters.count(f"payloads-{outcome}/{client.protocol_id}")
        # While inactive this changes nothing: activation restarts the schedule.
        if outcome != "discarded" and self._config.bp.triggered:
            self._schedule.trigger(now)
        ##= BP-TXP-09
        return BPStatus.OK

    def clear_buffer(self, prot_id: int) -> StatusConfirm:
        """``BP-ClearBuffer.request`` (dcp-bp.md#bp-service-bp-clear-buffer); raises UnknownServiceError in 1.0."""
        self._needs(self._features.clear_buffer, "BP-ClearBuffer", SpecVersion.V1_1)
        client = self._client(prot_id)
        ##= BP-CLR-01
        if client is None:
            return StatusConfirm(BPStatus.UNKNOWN_PROTOCOL)
        ##= BP-CLR-04
        if client.queue is None:
            return StatusConfirm(BPStatus.UNKNOWN_QUEUEING_MODE)
        ##= BP-CLR-02 BP-CLR-03
        client.queue.clear()
        ##= BP-CLR-05
        return StatusConfirm(BPStatus.OK)

    def query_number_buffered(self, prot_id: int) -> NumberConfirm:
        """``BP-QueryNumberBufferedPayloads.request`` (dcp-bp.md#bp-service-number-buffered-payloads)."""
        client = self._client(prot_id)
        ##= BP-QRY-01
        if client is None:
            return NumberConfirm(BPStatus.UNKNOWN_PROTOCOL, None)
        ##= BP-QRY-02 BP-QRY-03 BP-QRY-04
        return NumberConfirm(BPStatus.OK, 0 if client.queue is None else len(client.queue))

    # -- management -------------------------------------------------------------------------------------------

    @property
    def active(self) -> bool:
        """``bpActive``."""
        return self._active

    def activate(self, now: int) -> StatusConfirm:
        """``BP-MGMT-Activate.request``; raises UnknownServiceError before 1.2.

        The first beacon follows after one interval; for an active entity nothing changes.
        """
        self._needs(self._features.bp_activation, "BP-MGMT-Activate", SpecVersion.V1_2)
        ##= BP-MGT-05
        if not self._active:
            self._active = True
            self._schedule.restart(now)
        return StatusConfirm(BPStatus.OK)

    ##= BP-MGT-01
    def deactivate(self) -> StatusConfirm:
        """``BP-MGMT-Deactivate.request``; raises UnknownServiceError before 1.2. All services stay available."""
        self._needs(self._features.bp_activation, "BP-MGMT-Deactivate", SpecVersion.V1_2)
        ##= BP-MGT-04
        self._active = False
        return StatusConfirm(BPStatus.OK)

    def parameters(self) -> dict[str, Any]:
        """Return all parameters by their names in the specification: BPPAR_BEACON_PERIOD in ms, sizes in octets.

        Configurable parameters come first, read-only ones follow. BPPAR_NETWORK_ID exists since 2.0.
        """
        return self._parameters.as_dict()

    def set_parameter(self, name: str, value: object) -> Violation | None:
        """Set a parameter from the next beacon on; a returned violation means that the old value was kept.

        Raises ``UnknownParameterError`` for a name that is not a parameter of BP.
        """
        violation = self._parameters.set(name, value)
        ##= BP-PAR-02
        if violation is None and name == PERIOD:
            self._schedule.set_period(self._parameters.period)
        return violation

    ##= BP-MGT-06
    def counters(self) -> dict[str, int]:
        """Return the counters since the start by name; a protocol identifier or a reason follows a ``/``.

        Counters with a ``/`` exist after their first event, the others from the start. ``beacons-left-out`` counts
        slots that passed between two calls: used and unused slots together match the elapsed periods.

        Submissions by outcome are ``payloads-stored``, ``-displaced`` (kept, and the oldest one was dropped) and
        ``-discarded``.
        """
        return self._counters.as_dict()

    def losses(self) -> tuple[NeighbourLoss, ...]:
        """Return the beacon loss by sender, the longest silent first; empty if beacons have no header."""
        return self._losses.entries()

    def snapshot(self) -> dict[str, Any]:
        """Return the state as plain data."""
        parameters = self.parameters()
        return {
            "active": self._active,
            "next_seqno": self._seqno,
            "next_beacon": self.poll_timeout(),
            "parameters": {name: v.hex(":") if isinstance(v, bytes) else v for name, v in parameters.items()},
            "clients": [
                {**msgspec.to_builtins(client.registration), "buffered": len(client.queue or ())}
                for client in self._clients
            ],
            "counters": self.counters(),
            "losses": [{**msgspec.structs.asdict(entry), "node_id": entry.node_id.hex(":")} for entry in self.losses()],
        }

    # -- transmit path ----------------------------------------------------------------------------------------

    def poll_timeout(self) -> int | None:
        """Return the time of the next slot (monotonic ns), also without payloads; None while inactive.

        The schedule runs without payloads, too. If a new payload caused a beacon at once, all neighbours that react
        to the same beacon would send at the same time.
        """
        return self._schedule.due if self._active else None

    def handle_timeout(self, now: int, wall: int) -> None:  # noqa: ARG002 - the same call for every core
        """Prepare a beacon if a slot is due and there are payloads: at most one, also if several slots are due."""
        ##= BP-TX-07 BP-MGT-02
        if not self._active or now < self._schedule.due:
            return
        # One is the fewest that an implementation can choose (X45).
        most = BP_MAX_PAYLOADS if self._fills_beacons else 1
        blocks = self._clients.take(self._room(), self._wire.block_size, most)
        if left_out := self._schedule.passed(now, sent=bool(blocks)):
            self._counters.count("beacons-left-out", left_out)
        ##= BP-FMT-03
        if not blocks:
            self._counters.count("beacons-without-payload")
            ##= BP-HDR-09
            return
        octets = self._wire.build(self._seqno, self._parameters.network_id, blocks)
        self._counters.count("beacons-sent")
        self._counters.count("octets-sent", len(octets))
        seqno = self._seqno
        ##= BP-HDR-08
        self._seqno = (seqno + 1) % BP_SEQNO_MODULUS
        self._emit(SendBeacon(octets, seqno, len(blocks)))
        ##= BP-PTI-03
        told: set[int] = set()
        for protocol_id, _ in blocks:
            self._counters.count(f"payloads-sent/{protocol_id}")
            if protocol_id not in told or self._tells_each_payload:
                told.add(protocol_id)
                ##= BP-PTI-01 BP-PTI-02
                self._emit(PayloadTransmitted(protocol_id, self._schedule.due))

    def _room(self) -> int:
        """Return the octets that are free for blocks in the next beacon (X04)."""
        header, bearer = self._wire.header_size, self._parameters.uwb_max_packet_size
        counted = header if self._counts_header else 0
        # The limit of the bearer includes the header under each reading of the parameter.
        ##= UWB-05
        room = min(self._parameters.max_packet_size - counted, bearer - header)
        return room if self._wire.max_blocks is None else min(room, self._wire.max_blocks)

    # -- receive path -----------------------------------------------------------------------------------------

    def handle_beacon(self, octets: bytes, *, now: int, wall: int) -> None:  # noqa: ARG002 - as above
        """Process a received bearer payload. Never raises, for any octets."""
        ##= UWB-06
        self._counters.count("frames-received")
        self._counters.count("octets-received", len(octets))
        ##= BP-RX-13 BP-MGT-03
        if not self._active:
            self._receiver.drop("inactive")
            return
        self._receiver.receive(bytes(octets), now)

    # -- misuse -----------------------------------------------------------------------------------------------

    def _protocol(self, prot_id: int) -> int:
        """Raise for a value outside the profile's range of protocol identifiers."""
        if isinstance(prot_id, int) and not isinstance(prot_id, bool) and 0 <= prot_id <= self._largest_protocol:
            return prot_id
        _integer("prot_id", prot_id)
        raise ValueError(f"prot_id must be in 0..{self._largest_protocol}, not {prot_id}")

    def _client(self, prot_id: int) -> Client | None:
        return self._clients.get(self._protocol(prot_id))

    def _needs(self, there: bool, service: str, since: SpecVersion) -> None:
        if not there:
            raise UnknownServiceError(service, since, self._features.version)


def _integer(name: str, value: object) -> None:
    if isinstance(value, bool) or not isinstance(value, int):
        raise TypeError(f"{name} must be an int, not {type(value).__name__}")


def _mode(value: object) -> QueueingMode | str | int:
    """Return the mode of this name, or the value unchanged if there is no such mode (X06)."""
    if isinstance(value, QueueingMode):
        return value
    if isinstance(value, bool) or not isinstance(value, str | int):
        raise TypeError(f"queueing_mode must be a QueueingMode, not {type(value).__name__}")
    if isinstance(value, int):
        return value
    try:
        return QueueingMode(value)
    except ValueError:
        return value
