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

from dcp_codec.values import VarSpec

from .config import MS, NodeConfig
from .drops import DROPS
from .effects import Dropped, Effect, VariableChanged
from .timestamps import StampClock
from .vardis_compose import Composer
from .vardis_db import Database, DBEntry
from .vardis_parameters import VardisParameters
from .vardis_receive import Receiver, Sequence
from .vardis_services import (
    BPPort,
    Confirm,
    DescribeDatabaseConfirm,
    DescribedVariable,
    DescribeVariableConfirm,
    ReadConfirm,
    VariableEntry,
)
from .vardis_table import Action, Event, table
from .vardis_wire import Extractor, RecordSizes, half_range

__all__ = ["BPPort", "Vardis"]


class Vardis:
    """One VarDis entity. ``emit`` takes ``VariableChanged`` and ``Dropped``, at the moment they happen."""

    def __init__(
        self,
        config: NodeConfig,
        bp: BPPort,
        *,
        emit: Callable[[Effect], None],
        now: int,
        wall: int,  # noqa: ARG002
    ) -> None:
        """Raises ValueError if parameters in ``config.vardis`` are out of bounds."""
        ##= VD-INI-01
        self.active = False
        self.registered = False
        settings = config.vardis
        self._parameters = VardisParameters(config)
        assert settings is not None
        self._config = config
        self._bp = bp
        self._emit = emit
        self._queue_entries = settings.bp_queue_entries
        self._max_variables = min(settings.max_variables, config.profile.limits.max_variables or settings.max_variables)
        features = config.features
        self._has_scrubbing = features.creation_time
        self._timed_out_at_timeout = config.reading("X27") == "at-least"
        self._refuses_empty_description = config.reading("X21") == "refuse-locally"
        # The wall clock counts from 1970 in every profile: a start of the node must not make creations look earlier.
        self._clock = StampClock(config.profile.types.timestamp)
        self._sizes = RecordSizes(config.profile)
        self._sequence = Sequence(self._sizes.seqno_modulus, half_range(config))
        self._table = table(config)
        self._database = Database(remove_deleted=features.removed_after_deletion)
        self._composer = Composer(config, self._database, self._parameters, self._sizes)
        self._extractor = Extractor(config, self._sizes)
        self._receiver = Receiver(
            config,
            self._database,
            self._parameters,
            self._table,
            self._sequence,
            max_variables=self._max_variables,
            emit=emit,
        )
        self._registered_size = 0
        self._last_check = now
        self._last_scrub = now

    # -- life cycle ---------------------------------------------------------------------------------------------

    def start(self, now: int, wall: int) -> BPStatus:
        """Register with BP and begin, with an empty database. Returns the status of the registration.

        With another status than OK VarDis stays inactive, and :meth:`start` can be called again.
        """
        ##= VD-INI-01
        self.active = False
        size = self._parameters.max_payload_size
        status = self._register(size, now, wall)
        if status is BPStatus.PROTOCOL_ALREADY_REGISTERED:
            ##= VD-INI-03
            self._bp.deregister(BP_PROTID_VARDIS)
            status = self._register(size, now, wall)
        if not status.is_ok:
            return status
        ##= VD-INI-04
        self._database.clear()
        ##= VD-INI-06
        self._last_scrub = now
        self._last_check = now
        self.active = True
        return status

    def _register(self, size: int, now: int, wall: int) -> BPStatus:
        ##= VD-INI-02
        confirm = self._bp.register(
            BP_PROTID_VARDIS,
            f"VarDis -- Variable Dissemination Protocol V{self._config.profile.spec_version}",
            size,
            self._config.features.vardis_queueing_mode,
            self._queue_entries,
            False,
            now=now,
            wall=wall,
        )
        self.registered = confirm.status.is_ok
        if self.registered:
            self._registered_size = size
            ##= VD-INI-05
            # In 1.0 the confirm does not tell; the node was then configured with its identifier.
            self._receiver.own_id = confirm.own_node_identifier or self._config.node_id
        return confirm.status

    def shutdown(self) -> None:
        """Deregister from BP and forget everything; :meth:`start` begins anew."""
        ##= VD-SHD-01
        self.active = False
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
        self.active = self.registered
        return Confirm(VardisStatus.OK if self.active else VardisStatus.INACTIVE)

    def deactivate(self) -> Confirm:
        """``VD-MGMT-Deactivate``: send, receive and serve nothing until activated; scrubbing goes on."""
        ##= VD-MGT-01
        self.active = False
        return Confirm(VardisStatus.OK)

    @property
    def own_node_identifier(self) -> bytes:
        """``ownNodeIdentifier``, as BP told it."""
        return self._receiver.own_id

    def parameters(self) -> dict[str, int]:
        """The current parameters by the specification's names; lengths and sizes in octets, periods in ms."""
        return self._parameters.as_dict()

    def set_parameter(self, name: str, value: object) -> Violation | None:
        """Change a parameter at once, for what comes; None, or why the value is not valid (VD-PAR-01 to VD-PAR-08).

        A larger payload than VarDis is registered with takes effect with the first payload after BP has sent all that
        it holds, when VarDis registers anew. Raises ``UnknownParameterError`` for a name that VarDis does not have.
        """
        return self._parameters.set(name, value)

    # -- services for applications ------------------------------------------------------------------------------
    ##= VD-SRV-01
    ##= VD-SRV-02
    ##= DATA-10
    # A confirm is what the call returns, so it gets to the application that asked, whoever else does.

    def create(
        self,
        var_id: int,
        prod_id: bytes | None,
        rep_cnt: int,
        descr: bytes,
        value: bytes,
        timeout_ms: int = 0,
        *,
        now: int,
        wall: int,
    ) -> Confirm:
        """``RTDB-Create``. ``descr`` is UTF-8; ``timeout_ms`` 0 is never (always, before 2.0).

        Beyond the specification: VALUE-TOO-LONG (DESCRIPTION-TOO-LONG where no value helps) for a variable whose
        VarCreate fits into no payload, and INACTIVE, the only status that says "not now", for one variable more than
        the node keeps. Raises ValueError for what the fields of a VarSpec cannot express.
        """
        self._check_expressible(var_id, prod_id, descr, timeout_ms)
        ##= VD-CRE-01
        ##= VD-CRE-13
        ##= VD-MGT-04
        ##= DATA-11
        if not self.active:
            return self._confirm(VardisStatus.INACTIVE)
        entry = self._database.lookup(var_id)
        cell = self._table[Event.APP_CREATE][self._receiver.state(entry)]
        if cell.status is not None:
            return self._confirm(cell.status)
        ##= VD-CRE-04
        ##= DATA-08
        if len(descr) > self._parameters.longest_description:
            return self._confirm(VardisStatus.VARIABLE_DESCRIPTION_TOO_LONG)
        ##= VD-CRE-15
        if not descr and self._refuses_empty_description:
            return self._confirm(VardisStatus.VARIABLE_DESCRIPTION_TOO_LONG)
        if status := self._refused_value(value):
            return self._confirm(status)
        ##= VD-CRE-07
        if not 1 <= rep_cnt <= min(self._parameters.max_repetitions, self._sizes.highest_rep_cnt):
            return self._confirm(VardisStatus.ILLEGAL_REPCOUNT)
        creation_time = self._creation_time(entry, wall)
        ##= VD-TYP-04
        ##= VD-TYP-05
        spec = VarSpec(
            var_id=var_id,
            ##= VD-CRE-08
            prod_id=self._producer(prod_id),
            rep_cnt=rep_cnt,
            descr=descr,
            creation_time=creation_time,
            timeout=timeout_ms if self._has_scrubbing else None,
        )
        if status := self._refused_size(spec, value):
            return self._confirm(status)
        if entry is None and len(self._database) >= self._max_variables:
            return self._confirm(VardisStatus.INACTIVE)
        if creation_time is not None and creation_time > self._sizes.highest_stamp:
            # The variable was created at the end of time; there is nothing later.
            return self._confirm(VardisStatus.VARIABLE_EXISTS)
        ##= VD-CRE-10
        ##= VD-CRE-11
        ##= VD-CRE-12
        self._changed("created", self._database.insert(spec, value, 0, now=now, wall=wall))
        ##= VD-CRE-14
        return self._confirm(VardisStatus.OK)

    def update(self, var_id: int, value: bytes, *, now: int, wall: int) -> Confirm:
        """``RTDB-Update``."""
        ##= VD-UPD-01
        if not self.active:
            return self._confirm(VardisStatus.INACTIVE)
        entry = self._database.lookup(var_id)
        cell = self._table[Event.APP_UPDATE][self._receiver.state(entry)]
        if cell.status is not None or entry is None:
            return self._confirm(cell.status or VardisStatus.VARIABLE_DOES_NOT_EXIST)
        status = self._refused_value(value) or self._refused_size(entry.spec, value)
        if status is not None:
            return self._confirm(status)
        ##= VD-UPD-07
        ##= VD-UPD-08
        ##= VD-UPD-09
        self._database.store(entry, value, self._sequence.after(entry.seqno), now=now, wall=wall)
        self._changed("updated", entry)
        return self._confirm(VardisStatus.OK)

    def delete(self, var_id: int, *, now: int, wall: int) -> Confirm:  # noqa: ARG002 - every service takes the time
        """``RTDB-Delete``."""
        ##= VD-DEL-01
        if not self.active:
            return self._confirm(VardisStatus.INACTIVE)
        entry = self._database.lookup(var_id)
        cell = self._table[Event.APP_DELETE][self._receiver.state(entry)]
        if cell.status is not None or entry is None:
            return self._confirm(cell.status or VardisStatus.VARIABLE_DOES_NOT_EXIST)
        ##= VD-DEL-05
        self._database.mark_deleted(entry)
        self._changed("deleted", entry)
        return self._confirm(VardisStatus.OK)

    def read(self, var_id: int) -> ReadConfirm:
        """``RTDB-Read``."""
        ##= VD-REA-01
        if not self.active:
            return ReadConfirm(VardisStatus.INACTIVE)
        entry = self._database.lookup(var_id)
        cell = self._table[Event.APP_READ][self._receiver.state(entry)]
        if cell.action is not Action.READ or entry is None:
            return ReadConfirm(self._confirm(cell.status or VardisStatus.VARIABLE_DOES_NOT_EXIST).status)
        ##= VD-REA-04
        return ReadConfirm(VardisStatus.OK, entry.value, entry.t_stamp)

    def describe_database(self) -> DescribeDatabaseConfirm:
        """``RTDB-DescribeDatabase``: all variables, deleted ones included."""
        ##= VD-DDB-01
        if not self.active:
            return DescribeDatabaseConfirm(VardisStatus.INACTIVE)
        ##= VD-DDB-02
        ##= VD-DDB-03
        entries = self._database.entries.values()
        listed = tuple(DescribedVariable(entry.spec, entry.is_deleted, entry.t_stamp) for entry in entries)
        return DescribeDatabaseConfirm(VardisStatus.OK, listed)

    def describe_variable(self, var_id: int) -> DescribeVariableConfirm:
        """``RTDB-DescribeVariable``: the whole entry, also of a deleted variable."""
        ##= VD-DVA-01
        if not self.active:
            return DescribeVariableConfirm(VardisStatus.INACTIVE)
        entry = self._database.lookup(var_id)
        ##= VD-DVA-02
        if entry is None:
            return DescribeVariableConfirm(VardisStatus.VARIABLE_DOES_NOT_EXIST)
        ##= VD-DVA-03
        shown = {name: getattr(entry, name) for name in VariableEntry.__struct_fields__}
        return DescribeVariableConfirm(VardisStatus.OK, VariableEntry(**shown))

    def _confirm(self, status: VardisStatus) -> Confirm:
        """With the code that the version has for it: two were renamed."""
        return Confirm(status.in_version(self._config.profile.spec_version))

    def _check_expressible(self, var_id: int, prod_id: bytes | None, descr: bytes, timeout_ms: int) -> None:
        sizes = self._sizes
        ##= VD-TYP-01
        if not 0 <= var_id <= sizes.highest_var_id:
            raise ValueError(f"a variable identifier is 0 to {sizes.highest_var_id}, not {var_id}")
        if prod_id is not None and sizes.node_id_width not in (None, len(prod_id)):
            raise ValueError(f"a node identifier has {sizes.node_id_width} octets, not {len(prod_id)}")
        if sizes.nul_terminated and b"\0" in descr:
            raise ValueError("a description of this profile ends with NUL and cannot contain it")
        highest = sizes.highest_timeout if self._has_scrubbing else 0
        if not 0 <= timeout_ms <= highest:
            raise ValueError(f"a timeout is 0 to {highest} ms, not {timeout_ms}")

    def _refused_value(self, value: bytes) -> VardisStatus | None:
        ##= VD-CRE-05
        ##= VD-UPD-05
        if len(value) > self._parameters.max_value_length:
            return VardisStatus.VALUE_TOO_LONG
        ##= VD-CRE-06
        ##= VD-UPD-06
        return None if value else VardisStatus.EMPTY_VALUE

    def _refused_size(self, spec: VarSpec, value: bytes) -> VardisStatus | None:
        """Why no payload can ever hold the variable: parameters can allow lengths that are too much together (X23)."""
        longest = self._sizes.longest_description
        room = self._parameters.max_payload_size - self._sizes.ic_header
        if (longest is not None and len(spec.descr) > longest) or self._sizes.create(spec, b"\0") > room:
            return VardisStatus.VARIABLE_DESCRIPTION_TOO_LONG
        return VardisStatus.VALUE_TOO_LONG if self._sizes.create(spec, value) > room else None

    def _producer(self, given: bytes | None) -> bytes:
        """Up to 1.1 the application is trusted to give its own node's identifier."""
        if given is None or self._config.features.producer_set_by_vardis:
            return self._receiver.own_id
        return given

    def _creation_time(self, entry: DBEntry | None, wall: int) -> int | None:
        """The current time, but later than any creation of the variable that is known here.

        Others ignore a creation that is not later, so a second one within a unit of the profile, or after the clock
        was set back, takes the next stamp.
        """
        if not self._config.features.creation_time:
            return None
        ##= VD-CRE-09
        stamp = self._clock.stamp(wall)
        known = entry.spec.creation_time if entry is not None else None
        return stamp if known is None else max(stamp, known + 1)

    # -- inputs -------------------------------------------------------------------------------------------------

    def handle_payload(self, payload: bytes, *, now: int, wall: int) -> None:
        """BP received a payload of a neighbour. Never raises, whatever the octets are."""
        ##= VD-MGT-03
        if not self.active:
            self._emit(Dropped("vardis", "vardis-inactive", DROPS["vardis-inactive"][0]))
            return
        ##= VD-ROB-01
        self._receiver.process(self._extractor.extract(payload), now=now, wall=wall)

    def payload_transmitted(self, now: int, wall: int) -> None:
        """``BP-PayloadTransmitted.indication``: the next payload can be handed down."""
        ##= VD-RUN-01
        self._generate(now, wall)

    def handle_timeout(self, now: int, wall: int) -> None:
        """Time has come, or passed; calling too early does no harm."""
        if self._has_scrubbing and self.registered:
            period = self._parameters.scrubbing_period_ms * MS
            ##= VD-SCR-01
            if now - self._last_scrub >= period:
                self._last_scrub = now - (now - self._last_scrub) % period
                self._scrub(now)
        period = self._parameters.buffer_check_period_ms * MS
        ##= VD-RUN-02
        if self.active and now - self._last_check >= period:
            self._last_check = now - (now - self._last_check) % period
            buffered = self._bp.query_number_buffered(BP_PROTID_VARDIS)
            if buffered.status.is_ok and buffered.number == 0:
                self._generate(now, wall)

    def poll_timeout(self) -> int | None:
        """When ``handle_timeout`` is due next (monotonic ns), None when VarDis is not running."""
        due = []
        if self.active:
            due.append(self._last_check + self._parameters.buffer_check_period_ms * MS)
        if self._has_scrubbing and self.registered:
            due.append(self._last_scrub + self._parameters.scrubbing_period_ms * MS)
        return min(due, default=None)

    def _generate(self, now: int, wall: int) -> None:
        """Compose the next payload and hand it to BP."""
        ##= VD-RUN-03
        ##= VD-MGT-02
        if not self.active:
            return
        self._fit_registration(now, wall)
        containers = self._composer.compose(min(self._parameters.max_payload_size, self._registered_size))
        ##= VD-PAY-04
        if containers:
            payload = self._config.codec.encode_containers(containers)
            self._bp.transmit_payload(BP_PROTID_VARDIS, payload, now=now)

    def _fit_registration(self, now: int, wall: int) -> None:
        """Register anew when the maximum payload has grown; only while BP holds nothing, which would be lost."""
        wanted = self._parameters.max_payload_size
        if wanted <= self._registered_size or self._bp.query_number_buffered(BP_PROTID_VARDIS).number:
            return
        registered = self._registered_size
        self._bp.deregister(BP_PROTID_VARDIS)
        if not self._register(wanted, now, wall).is_ok and not self._register(registered, now, wall).is_ok:
            self.active = False

    def _scrub(self, now: int) -> None:
        """Delete the variables that nobody has updated for longer than their timeout."""
        for entry in list(self._database.entries.values()):
            timeout = (entry.spec.timeout or 0) * MS
            ##= VD-SCR-02
            if not timeout:
                continue
            age = now - entry.refreshed
            ##= VD-SCR-03
            if age < timeout or (age == timeout and not self._timed_out_at_timeout):
                continue
            ##= VD-SCR-04
            ##= VD-SCR-05
            if self._table[Event.TIMED_OUT][self._receiver.state(entry)].action is Action.DELETE:
                self._database.mark_deleted(entry)
                self._changed("deleted", entry)

    def _changed(self, event: str, entry: DBEntry) -> None:
        spec = entry.spec
        self._emit(VariableChanged(event, spec.var_id, entry.seqno, entry.value, spec.prod_id))

    # -- looking at it ------------------------------------------------------------------------------------------

    def snapshot(self) -> dict[str, Any]:
        """The state as plain data: octets in hexadecimal, times in ns, everything else under its own name."""
        return {
            "active": self.active,
            "registered": self.registered,
            "ownNodeIdentifier": self._receiver.own_id.hex(":"),
            "parameters": self.parameters(),
            **self._database.snapshot(),
        }

    def check_invariants(self) -> None:
        """Raises AssertionError if the state contradicts itself (section C.5 of the protocol reference)."""
        assert self.registered or not self.active, "active without being registered"
        assert self.registered or not len(self._database), "variables without being registered"
        assert len(self._database) <= self._max_variables, "more variables than allowed"
        assert len(self._database.req_create_q) <= self._max_variables, "more requests than allowed"
        self._database.check_invariants()
        for var_id, entry in self._database.entries.items():
            assert 0 <= entry.seqno < self._sizes.seqno_modulus, f"variable {var_id} has sequence number {entry.seqno}"
            if entry.spec.prod_id == self.own_node_identifier:
                assert var_id not in self._database.req_upd_q, f"own variable {var_id} is requested"
