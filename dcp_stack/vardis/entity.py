"""The VarDis entity of a node, without input or output of its own (dcp-vardis.md).

Order of calls: :meth:`Vardis.start`, then inputs and services in any order. After each of them ``poll_timeout()``
returns the time at which ``handle_timeout`` is due next. Times are int ns: ``now`` monotonic, ``wall`` since 1970.
Received octets never raise. Arguments of an application that no status covers raise ValueError.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import msgspec
from dcp_spec.constants import BP_PROTID_VARDIS
from dcp_spec.parameters import Violation
from dcp_spec.status import BPStatus, VardisStatus

from dcp_stack.bp_port import BPPort
from dcp_stack.config import MS, NodeConfig
from dcp_stack.drops import DROPS
from dcp_stack.effects import Dropped, Effect

from .compose import Composer
from .confirms import Confirm
from .core import Core
from .database import DatabaseState, DBEntry
from .delivery import DeliveryState, Obstacle
from .known_instructions import instructions_of
from .receive import Receiver
from .services import VariableServices
from .state_table import Action, Event
from .wire import Extractor


class VardisState(msgspec.Struct, frozen=True, gc=False):
    """The content of a VarDis entity (:meth:`Vardis.save`). Equal contents are equal and have the same hash.

    ``timers``: times of the last buffer check and the last scrubbing (monotonic ns), whether BP has sent a payload
    since, and the wall time of the last timeout.
    """

    active: bool
    database: DatabaseState
    delivery: DeliveryState
    timers: tuple[int, int, bool, int]


class Vardis(VariableServices):
    """One VarDis entity. It calls ``emit`` with ``VariableChanged`` and ``Dropped`` as they occur."""

    def __init__(
        self,
        config: NodeConfig,
        bp: BPPort,
        *,
        emit: Callable[[Effect], None],
        now: int,
        wall: int,
    ) -> None:
        """Initialise an inactive entity. Raises ValueError if ``config`` has no VarDis or invalid parameters of it."""
        core = Core(config, emit)
        super().__init__(core, bp)
        self._parameters = core.parameters
        self._database = core.database
        self.instructions = instructions = {each.container: each for each in instructions_of(core)}
        """Instructions for the profile's additional container types, by the name of the type."""
        self._composer = Composer(core, instructions)
        self._extractor = Extractor(config, core.sizes)
        self._receiver = Receiver(core, instructions)
        self._has_scrubbing = core.features.creation_time
        readings = core.readings
        self._timed_out_at_timeout = readings.exact_timeout == "at-least"
        self._scrubbing_pauses = readings.inactive_scrubbing == "pauses-while-inactive"
        self._pending_is_dropped = readings.pending_at_deactivation == "are-dropped"
        self._registers_anew = readings.raised_payload_size == "register-anew"
        self._composes_ahead = readings.composition_time == "before-the-beacon"
        self._lead = round(core.settings.compose_lead_ms * MS)
        self._indicated = False
        """Whether BP has sent a payload since its buffer was last checked."""
        self._registered_size = 0
        self._last_check = now
        self._last_scrub = now
        self._wall = wall

    @property
    def active(self) -> bool:
        """``vardisActive``."""
        return self._core.active

    # -- life cycle ---------------------------------------------------------------------------------------------

    def start(self, now: int, wall: int) -> BPStatus:
        """Register with BP and become active with an empty database; returns the status of the registration.

        Unless it is OK, VarDis stays inactive; :meth:`start` may then be called again.
        """
        ##= VD-INI-01
        self._core.active = False
        size = self._parameters.max_payload_size
        status = self._register(size, now, wall)
        if status is BPStatus.PROTOCOL_ALREADY_REGISTERED:
            ##= VD-INI-03
            self._bp.deregister(BP_PROTID_VARDIS)
            status = self._register(size, now, wall)
        ##= VD-INI-04
        self._database.clear()
        self._core.delivery.clear()
        if not status.is_ok:
            return status
        ##= VD-INI-06
        self._last_scrub = now
        self._last_check = now
        self._indicated = False
        self._core.active = True
        return status

    def _register(self, size: int, now: int, wall: int) -> BPStatus:
        """Register with BP for payloads of at most ``size`` octets; returns the status."""
        ##= VD-INI-02
        confirm = self._bp.register(
            BP_PROTID_VARDIS,
            f"VarDis -- Variable Dissemination Protocol V{self._core.config.named_version}",
            size,
            ##= VD-INI-07 VD-INI-08
            self._core.features.vardis_queueing_mode,
            self._core.settings.bp_queue_entries,
            False,
            now=now,
            wall=wall,
        )
        self.registered = confirm.status.is_ok
        if self.registered:
            self._registered_size = size
            ##= VD-INI-05
            # The confirm of 1.0 lacks the identifier; the configured one is used.
            self._core.own_id = confirm.own_node_identifier or self._core.config.node_id
        return confirm.status

    def shutdown(self) -> None:
        """Deregister from BP and clear the database; :meth:`start` may be called again."""
        ##= VD-SHD-01
        self._core.active = False
        ##= VD-SHD-02
        if self.registered:
            self._bp.deregister(BP_PROTID_VARDIS)
        self.registered = False
        ##= VD-SHD-03
        self._database.clear()

    def activate(self) -> Confirm:
        """``VD-MGMT-Activate``: resume with the unchanged database.

        Returns INACTIVE if VarDis is not registered with BP.
        """
        ##= VD-MGT-05 VD-MGT-06
        self._core.active = self.registered
        return Confirm(VardisStatus.OK if self.active else VardisStatus.INACTIVE)

    def deactivate(self) -> Confirm:
        """``VD-MGMT-Deactivate``: stop sending, receiving and serving requests; scrubbing may continue (X36)."""
        ##= VD-MGT-01
        self._core.active = False
        if self._pending_is_dropped:
            self._database.drop_pending()
        return Confirm(VardisStatus.OK)

    @property
    def own_node_identifier(self) -> bytes:
        """``ownNodeIdentifier`` from the confirm of BP, or the configured one if the confirm lacks it."""
        return self._core.own_id

    def parameters(self) -> dict[str, int]:
        """Return the current parameters by the specification's names; lengths and sizes in octets, periods in ms."""
        return self._parameters.as_dict()

    def set_parameter(self, name: str, value: object) -> Violation | None:
        """Change a parameter at once; returns None, or the violated bound (VD-PAR-01 to VD-PAR-08).

        To use payloads larger than registered, VarDis registers again as soon as BP holds no payload of it (X41).
        Raises ``UnknownParameterError`` if VarDis has no parameter of this name.
        """
        return self._parameters.set(name, value)

    # -- inputs -------------------------------------------------------------------------------------------------

    def handle_payload(self, payload: bytes, *, now: int, wall: int) -> None:
        """Process a payload that BP received from a neighbour. Never raises, even for invalid octets."""
        ##= VD-MGT-03
        if not self.active:
            self._core.emit(Dropped("vardis", "vardis-inactive", DROPS["vardis-inactive"][0]))
            return
        ##= VD-ROB-01 VD-RX-01
        self._receiver.process(self._extractor.extract(payload), now=now, wall=wall)

    def payload_transmitted(self, now: int, wall: int) -> None:
        """Process ``BP-PayloadTransmitted.indication``: compose the next payload at once or before its beacon (X54)."""
        ##= VD-RUN-01
        if self._composes_ahead and self._bp.next_beacon() is not None:
            self._indicated = True
        elif self.active:
            self._generate(now, wall)

    def handle_timeout(self, now: int, wall: int) -> None:
        """Scrub the database and check the buffer of BP, if they are due. A call before they are due has no effect."""
        self._wall = wall
        if self._scrubs:
            period = self._parameters.scrubbing_period_ms * MS
            ##= VD-SCR-01
            if now - self._last_scrub >= period:
                self._last_scrub = now - (now - self._last_scrub) % period
                self._scrub(now)
        ##= VD-RUN-02 VD-RUN-03 VD-MGT-02
        if self.active and now >= self._next_look():
            period = self._parameters.buffer_check_period_ms * MS
            self._last_check = now - (now - self._last_check) % period
            self._indicated = False
            buffered = self._bp.query_number_buffered(BP_PROTID_VARDIS)
            if buffered.status.is_ok and buffered.number == 0:
                self._generate(now, wall)

    def poll_timeout(self) -> int | None:
        """Return when ``handle_timeout`` is due next (monotonic ns), None while VarDis has nothing to do."""
        due = None
        if self._core.active:
            due = self._next_look()
        if self._scrubs:
            scrub = self._last_scrub + self._parameters.scrubbing_period_ms * MS
            if due is None or scrub < due:
                due = scrub
        return due

    def _next_look(self) -> int:
        """Return when VarDis next checks the buffer of BP (monotonic ns), to compose a payload if it is empty.

        Under reading X54 ``before-the-beacon`` the check is delayed until just before the next beacon, so that the
        payload includes all records received before. After an indication it does not wait for the period to pass.
        """
        check = self._last_check + self._parameters.buffer_check_period_ms * MS
        beacon = self._bp.next_beacon() if self._composes_ahead else None
        if beacon is None:
            return check
        ahead = beacon - self._lead
        return ahead if self._indicated else max(check, ahead)

    @property
    def _scrubs(self) -> bool:
        """Whether scrubbing runs in the current state (X36)."""
        return self._has_scrubbing and self.registered and (self._core.active or not self._scrubbing_pauses)

    def _generate(self, now: int, wall: int) -> None:
        """Compose the next payload and submit it to BP."""
        self._fit_registration(now, wall)
        containers = self._composer.compose(min(self._parameters.max_payload_size, self._registered_size))
        ##= VD-PAY-04
        if containers:
            payload = self._core.config.codec.encode_containers(containers)
            self._bp.transmit_payload(BP_PROTID_VARDIS, payload, now=now)

    def _fit_registration(self, now: int, wall: int) -> None:
        """Register again if the maximum payload size was raised (X41).

        Waits until BP holds no payload of VarDis, because deregistration would discard it.
        """
        wanted = self._parameters.max_payload_size
        if not self._registers_anew:
            return
        if wanted <= self._registered_size or self._bp.query_number_buffered(BP_PROTID_VARDIS).number:
            return
        registered = self._registered_size
        self._bp.deregister(BP_PROTID_VARDIS)
        if not self._register(wanted, now, wall).is_ok and not self._register(registered, now, wall).is_ok:
            self.shutdown()

    def _scrub(self, now: int) -> None:
        """Delete the variables whose last creation or update is older than their timeout."""
        for entry in list(self._database.entries.values()):
            timeout = (entry.spec.timeout or 0) * MS
            ##= VD-SCR-02
            if not timeout:
                continue
            ##= VD-SCR-03 | exception: the age is measured by a steady clock, not by the system time (X38)
            age = now - entry.refreshed if self._steady else self._wall - entry.t_stamp
            if age < timeout or (age == timeout and not self._timed_out_at_timeout):
                continue
            ##= VD-SCR-04 VD-SCR-05
            if self._core.cell(Event.TIMED_OUT, entry).action is Action.DELETE:
                self._database.mark_deleted(entry)
                self._core.changed("deleted", entry)

    # -- saving -------------------------------------------------------------------------------------------------

    def save(self) -> VardisState:
        """Return the content of this entity as a value.

        Parameters, the registration with BP, and the payload that BP holds are not part of it.
        """
        timers = (self._last_check, self._last_scrub, self._indicated, self._wall)
        return VardisState(self.active, self._database.save(), self._core.delivery.save(), timers)

    def restore(self, state: VardisState) -> None:
        """Replace the content by a saved one, of an entity with the same profile, identifier and parameters.

        From now on this entity behaves as the saved one. Call it after :meth:`start`.
        """
        self._core.active = state.active
        self._database.restore(state.database)
        self._core.delivery.restore(state.delivery)
        self._last_check, self._last_scrub, self._indicated, self._wall = state.timers

    # -- inspection ---------------------------------------------------------------------------------------------

    def entry(self, var_id: int) -> DBEntry | None:
        """Return the database entry of a variable, None if unknown. Unlike a service it also works while inactive.

        The entry is not a copy.
        """
        return self._database.lookup(var_id)

    def hears(self, sender: bytes) -> None:
        """Set the sender of the next payload, which the indication of BP lacks. Used for :meth:`obstacles` only."""
        self._core.delivery.peer = sender

    def obstacles(self, now: int) -> list[Obstacle]:
        """Return the variables that neighbours do not accept, with the reasons; usually empty."""
        return self._core.delivery.obstacles(now)

    def snapshot(self) -> dict[str, Any]:
        """Return the state as plain data: octets in hexadecimal, times in ns, parameters in their own units."""
        return {
            "active": self.active,
            "registered": self.registered,
            "ownNodeIdentifier": self._core.own_id.hex(":"),
            "parameters": self.parameters(),
            "max_variables": self._core.max_variables,
            **self._database.snapshot(),
        }

    def queue_lengths(self) -> dict[str, int]:
        """Return the number of variables in each queue, by the specification's names."""
        return {name: len(queue) for name, queue in self._database.queues.items()}

    def check_invariants(self) -> None:
        """Raises AssertionError if the state contradicts itself (section C.5 of the protocol reference)."""
        assert self.registered or not self.active, "active without being registered"
        assert self.registered or not len(self._database), "variables without being registered"
        assert len(self._database) <= self._core.max_variables, "more variables than allowed"
        assert len(self._database.req_create_q) <= self._core.max_variables, "more requests than allowed"
        self._database.check_invariants()
        for var_id, entry in self._database.entries.items():
            assert 0 <= entry.seqno < self._core.sizes.seqno_modulus, (
                f"variable {var_id} has sequence number {entry.seqno}"
            )
            if entry.spec.prod_id == self.own_node_identifier:
                assert var_id not in self._database.req_upd_q, f"own variable {var_id} is requested"
