"""A node: BP with SRP and VarDis as its clients, without input, output or clock.

Order of calls: :meth:`Node.start` once, then any of the input methods, and after each of them ``take_effects()`` for
the effects to carry out and ``poll_timeout()`` for the time of the next ``handle_timeout``. Applications call the
services of ``bp``, ``srp`` and ``vardis`` directly, then :meth:`Node.settle` and the same two.
"""

from __future__ import annotations

import random
from typing import Any

from dcp_spec.constants import BP_PROTID_SRP, BP_PROTID_VARDIS

from .bp.client_port import ClientPort
from .bp.entity import BeaconingProtocol
from .config import NodeConfig
from .effects import Effect, PayloadReceived, PayloadTransmitted
from .srp.entity import StateReporting
from .vardis.entity import Vardis


class Node:
    """One node of a network; every time is an int in ns (``now`` monotonic, ``wall`` since 1970)."""

    def __init__(self, config: NodeConfig, *, rng: random.Random, now: int, wall: int) -> None:
        self.config = config
        self._rng = rng
        self._effects: list[Effect] = []
        self._pending: list[Effect] = []
        self._build(now, wall)

    def _build(self, now: int, wall: int) -> None:
        config, emit = self.config, self._pending.append
        self.bp = BeaconingProtocol(config, rng=self._rng, emit=emit, now=now, wall=wall)
        self._srp_port = srp = ClientPort(self.bp)
        self._vardis_port = vardis = ClientPort(self.bp)
        self.srp = StateReporting(config, srp, emit=emit, now=now, wall=wall) if config.srp else None
        self.vardis = Vardis(config, vardis, emit=emit, now=now, wall=wall) if config.vardis else None

    def start(self, now: int, wall: int) -> None:
        """Register the client protocols; from now on the node sends a beacon whenever there are payloads."""
        if self.srp is not None:
            self.srp.start(now, wall)
        if self.vardis is not None:
            self.vardis.start(now, wall)
        initial = self.config.srp.safety_data if self.config.srp is not None else None
        if self.srp is not None and initial is not None:
            self.srp.update_safety_data(initial, now=now, wall=wall)
        self.settle(now, wall)

    def handle_frame(self, octets: bytes, *, now: int, wall: int) -> None:
        """Process a received bearer payload. Never raises, for any octets."""
        self.bp.handle_beacon(octets, now=now, wall=wall)
        self.settle(now, wall)

    def handle_timeout(self, now: int, wall: int) -> None:
        """Do everything that is due at ``now``; a call before :meth:`poll_timeout` has no effect."""
        # Clients first: a payload submitted now goes into a beacon that is due now.
        if self.srp is not None:
            self.srp.handle_timeout(now, wall)
        if self.vardis is not None:
            self.vardis.handle_timeout(now, wall)
        self.bp.handle_timeout(now, wall)
        self.settle(now, wall)

    def poll_timeout(self) -> int | None:
        """Return when ``handle_timeout`` is due next (monotonic ns), None if nothing is pending."""
        due = self.bp.poll_timeout()
        for client in (self.srp, self.vardis):
            when = None if client is None else client.poll_timeout()
            if when is not None and (due is None or when < due):
                due = when
        return due

    def take_effects(self) -> list[Effect]:
        """Return the effects since the last call, in order, without the indications that SRP and VarDis handled."""
        taken, self._effects = self._effects, []
        return taken

    def shutdown(self, now: int, wall: int) -> None:
        """Deregister the client protocols (SRP-SHD-01, VD-SHD-01 to VD-SHD-03)."""
        if self.vardis is not None:
            self.vardis.shutdown()
        if self.srp is not None:
            self.srp.shutdown()
        self.settle(now, wall)

    def reset(self, now: int, wall: int) -> None:
        """Return to the state after :meth:`start`: empty tables, counters and sequence numbers reset."""
        self._pending.clear()
        self._effects.clear()
        self._build(now, wall)
        self.start(now, wall)

    def settle(self, now: int, wall: int) -> None:
        """Deliver indications to SRP and VarDis, and the effects that these emit, in order of emission.

        Call it after calls of services of ``bp``, ``srp`` or ``vardis``.
        """
        pending = self._pending
        if not pending:
            return
        # The list grows while it is walked: a client that submits a payload may set off more.
        tell = self._effects.append
        for effect in pending:
            if (type(effect) is PayloadReceived and self._received(effect, now, wall)) or (
                type(effect) is PayloadTransmitted and self._transmitted(effect.protocol_id, now, wall)
            ):
                continue
            tell(effect)
        pending.clear()

    ##= BP-RXP-03
    # A client outside the node may have registered under the numbers of SRP and VarDis; it gets their payloads.

    def _received(self, effect: PayloadReceived, now: int, wall: int) -> bool:
        """Deliver a payload to SRP or VarDis; False if it is for a client outside the node."""
        if effect.protocol_id == BP_PROTID_SRP and self.srp is not None and self._srp_port.holds:
            self.srp.handle_payload(effect.payload, effect.sender_id, now=now, wall=wall)
            return True
        if effect.protocol_id == BP_PROTID_VARDIS and self.vardis is not None and self._vardis_port.holds:
            self.vardis.hears(effect.sender_id)
            self.vardis.handle_payload(effect.payload, now=now, wall=wall)
            return True
        return False

    def _transmitted(self, protocol_id: int, now: int, wall: int) -> bool:
        if protocol_id == BP_PROTID_VARDIS and self.vardis is not None and self._vardis_port.holds:
            self.vardis.payload_transmitted(now, wall)
            return True
        # SRP ignores this indication.
        return protocol_id == BP_PROTID_SRP and self.srp is not None and self._srp_port.holds

    def snapshot(self) -> dict[str, Any]:
        """Return the state of all entities as plain data, for displays and comparisons."""
        return {
            name: entity.snapshot()
            for name, entity in (("bp", self.bp), ("srp", self.srp), ("vardis", self.vardis))
            if entity is not None
        }
