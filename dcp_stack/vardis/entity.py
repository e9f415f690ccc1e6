"""VarDis, the dissemination of variables, without input or output of its own (dcp-vardis.md).

Order of calls: :meth:`Vardis.start`, then inputs and services in any order, and after each ``poll_timeout()`` for when
``handle_timeout`` is due next. Times are int ns: ``now`` monotonic, ``wall`` since 1970. Octets from others never
raise; what an application gets wrong beyond what a status can say raises ValueError.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

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
from .database import DBEntry
from .delivery import Obstacle
from .known_instructions import instructions_of
from .receive import Receiver
from .services import VariableServices
from .state_table import Action, Event
from .wire import Extractor


class Vardis(VariableServices):
    """One VarDis entity. ``emit`` takes ``VariableChanged`` and ``Dropped``, at the moment they happen."""

    def __init__(
        self,
        config: NodeConfig,
        bp: BPPort,
        *,
        emit: Callable[[Effect], None],
        now: int,
        wall: int,
    ) -> None:
        """Raises ValueError if ``config`` has no VarDis, or parameters that are out of bounds."""
        core = Core(config, emit)
        super().__init__(core, bp)
        self._parameters = core.parameters
        self._database = core.database
        self.instructions = instructions = {each.container: each for each in instructions_of(core)}
        """Those for container types of the profile's own, by the name of the type."""
        self._composer = Composer(core, instructions)
        self._extractor = Extractor(config, core.sizes)
        self._receiver = Receiver(core, instructions)
        self._has_scrubbing = core.features.creation_time
        self._timed_out_at_timeout = config.reading("X27") == "at-least"
        self._scrubbing_pauses = config.reading("X36") == "pauses-while-inactive"
        self._pending_is_dropped = config.reading("X37") == "are-dropped"
        self._registers_anew = config.reading("X41") == "register-anew"
        self._composes_ahead = config.reading("X54") == "before-the-beacon"
        self._lead = round(core.settings.compose_lead_ms * MS)
        self._indicated = False
        """Whether BP has sent a payload since the last look at its buffer."""
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
        """Register with BP and begin, with an empty database. Returns the status of the registration.

        With another status than OK VarDis stays inactive, and :meth:`start` can be called again.
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
        ##= VD-INI-02
        confirm = self._bp.register(
            BP_PROTID_VARDIS,
            f"VarDis -- Variable Dissemination Protocol V{self._core.config.named_version}",
            size,
            ##= VD-INI-07
            ##= VD-INI-08
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
            # In 1.0 the confirm does not tell; the node was then configured with its identifier.
            self._core.own_id = confirm.own_node_identifier or self._core.config.node_id
        return confirm.status

    def shutdown(self) -> None:
        """Deregister from BP and forget everything; :meth:`start` begins anew."""
        ##= VD-SHD-01
        self._core.active = False
        ##= VD-SHD-02
        if self.registered:
            self._bp.deregister(BP_PROTID_VARDIS)
        self.registered = False
        ##= VD-SHD-03
        self._database.clear()

    def activate(self) -> Confirm:
        """``VD-MGMT-Activate``: resume with the database as it is. INACTIVE if VarDis is not registered with BP."""
        ##= VD-MGT-05
        ##= VD-MGT-06
        self._core.active = self.registered
        return Confirm(VardisStatus.OK if self.active else VardisStatus.INACTIVE)

    def deactivate(self) -> Confirm:
        """``VD-MGMT-Deactivate``: send, receive and serve nothing until activated; scrubbing goes on (X36)."""
        ##= VD-MGT-01
        self._core.active = False
        if self._pending_is_dropped:
            self._database.drop_pending()
        return Confirm(VardisStatus.OK)

    @property
    def own_node_identifier(self) -> bytes:
        """``ownNodeIdentifier``, as BP told it."""
        return self._core.own_id

    def parameters(self) -> dict[str, int]:
        """The current parameters by the specification's names; lengths and sizes in octets, periods in ms."""
        return self._parameters.as_dict()

    def set_parameter(self, name: str, value: object) -> Violation | None:
        """Change a parameter at once, for what comes; None, or why the value is not valid (VD-PAR-01 to VD-PAR-08).

        A larger payload than VarDis is registered with takes effect with the first payload after BP has sent all that
        it holds, when VarDis registers anew. Raises ``UnknownParameterError`` for a name that VarDis does not have.
        """
        return self._parameters.set(name, value)

    # -- inputs -------------------------------------------------------------------------------------------------

    def handle_payload(self, payload: bytes, *, now: int, wall: int) -> None:
        """BP received a payload of a neighbour. Never raises, whatever the octets are."""
        ##= VD-MGT-03
        if not self.active:
            self._core.emit(Dropped("vardis", "vardis-inactive", DROPS["vardis-inactive"][0]))
            return
        ##= VD-ROB-01
        ##= VD-RX-01
        self._receiver.process(self._extractor.extract(payload), now=now, wall=wall)

    def payload_transmitted(self, now: int, wall: int) -> None:
        """``BP-PayloadTransmitted.indication``: compose the next payload, just before its beacon or at once (X54)."""
        ##= VD-RUN-01
        if self._composes_ahead and self._bp.next_beacon() is not None:
            self._indicated = True
        elif self.active:
            self._generate(now, wall)

    def handle_timeout(self, now: int, wall: int) -> None:
        """Time has come, or passed; calling too early does no harm."""
        self._wall = wall
        if self._scrubs:
            period = self._parameters.scrubbing_period_ms * MS
            ##= VD-SCR-01
            if now - self._last_scrub >= period:
                self._last_scrub = now - (now - self._last_scrub) % period
                self._scrub(now)
        ##= VD-RUN-02
        ##= VD-RUN-03
        ##= VD-MGT-02
        if self.active and now >= self._next_look():
            period = self._parameters.buffer_check_period_ms * MS
            self._last_check = now - (now - self._last_check) % period
            self._indicated = False
            buffered = self._bp.query_number_buffered(BP_PROTID_VARDIS)
            if buffered.status.is_ok and buffered.number == 0:
                self._generate(now, wall)

    def poll_timeout(self) -> int | None:
        """When ``handle_timeout`` is due next (monotonic ns), None when VarDis is not running."""
        due = None
        if self._core.active:
            due = self._next_look()
        if self._scrubs:
            scrub = self._last_scrub + self._parameters.scrubbing_period_ms * MS
            if due is None or scrub < due:
                due = scrub
        return due

    def _next_look(self) -> int:
        """When VarDis looks at BP's buffer next, and composes a payload if it is empty.

        Composing ahead of the beacon (X54), it puts a look off until just before the next beacon, so that whatever
        arrives before then is in the payload. After an indication it looks then even if the period has not passed.
        """
        check = self._last_check + self._parameters.buffer_check_period_ms * MS
        beacon = self._bp.next_beacon() if self._composes_ahead else None
        if beacon is None:
            return check
        ahead = beacon - self._lead
        return ahead if self._indicated else max(check, ahead)

    @property
    def _scrubs(self) -> bool:
        return self._has_scrubbing and self.registered and (self._core.active or not self._scrubbing_pauses)

    def _generate(self, now: int, wall: int) -> None:
        """Compose the next payload and hand it to BP."""
        self._fit_registration(now, wall)
        containers = self._composer.compose(min(self._parameters.max_payload_size, self._registered_size))
        ##= VD-PAY-04
        if containers:
            payload = self._core.config.codec.encode_containers(containers)
            self._bp.transmit_payload(BP_PROTID_VARDIS, payload, now=now)

    def _fit_registration(self, now: int, wall: int) -> None:
        """Register anew when the maximum payload has grown; only while BP holds nothing, which would be lost."""
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
        """Delete the variables that nobody has updated for longer than their timeout."""
        for entry in list(self._database.entries.values()):
            timeout = (entry.spec.timeout or 0) * MS
            ##= VD-SCR-02
            if not timeout:
                continue
            ##= VD-SCR-03 | exception: the age is that of a clock which is never set, not of the system time (X38)
            age = now - entry.refreshed if self._steady else self._wall - entry.t_stamp
            if age < timeout or (age == timeout and not self._timed_out_at_timeout):
                continue
            ##= VD-SCR-04
            ##= VD-SCR-05
            if self._core.cell(Event.TIMED_OUT, entry).action is Action.DELETE:
                self._database.mark_deleted(entry)
                self._core.changed("deleted", entry)

    # -- looking at it ------------------------------------------------------------------------------------------

    def entry(self, var_id: int) -> DBEntry | None:
        """What the database holds of a variable now, whether VarDis serves or not; it is not a service, nor a copy."""
        return self._database.lookup(var_id)

    def hears(self, sender: bytes) -> None:
        """The payload that comes next was sent by this neighbour; BP's indication does not say."""
        self._core.delivery.peer = sender

    def obstacles(self, now: int) -> list[Obstacle]:
        """The variables that do not get through to neighbours, and why; usually none."""
        return self._core.delivery.obstacles(now)

    def snapshot(self) -> dict[str, Any]:
        """The state as plain data: octets in hexadecimal, times in ns, everything else under its own name."""
        return {
            "active": self.active,
            "registered": self.registered,
            "ownNodeIdentifier": self._core.own_id.hex(":"),
            "parameters": self.parameters(),
            "max_variables": self._core.max_variables,
            **self._database.snapshot(),
        }

    def queue_lengths(self) -> dict[str, int]:
        """How many variables wait in each queue, by the specification's names."""
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
