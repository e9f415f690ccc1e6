"""The State Reporting Protocol (dcp-srp.md) without input or output.

Order of calls: :meth:`StateReporting.start` once BP exists, then :meth:`~StateReporting.update_safety_data` and
:meth:`~StateReporting.handle_payload` in any order, after each of them ``poll_timeout()`` for when
:meth:`~StateReporting.handle_timeout` is due. ``now`` is monotonic ns, ``wall`` ns since 1970.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

import msgspec
from dcp_spec.constants import BP_PROTID_SRP, SpecVersion
from dcp_spec.parameters import UnknownParameterError, Violation, validate
from dcp_spec.status import BPStatus, SRPStatus

from dcp_codec.errors import DecodeError
from dcp_codec.plan.measures import record, start
from dcp_codec.values import ExtendedSafetyData, SafetyData
from dcp_stack.bp_port import BPPort
from dcp_stack.config import MAX_NEIGHBOURS, MS, NodeConfig, SRPConfig
from dcp_stack.drops import DROPS
from dcp_stack.effects import Dropped, Effect, NeighbourExpired, NeighbourSeen
from dcp_stack.positions.geometry import Motion
from dcp_stack.timestamps import StampClock

from .motion import OwnMotion
from .neighbour_table import NeighbourTable, seqno_modulus

TIMEOUT: Final = "SRPPAR_NEIGHBOUR_TABLE_TIMEOUT"
TRAVERSALS_PER_TIMEOUT: Final = 6
"""One more than required, so that after a late call an interval has enough traversals (SRP-RUN-01). A call for another
reason, such as a beacon, traverses after half the interval, to save a wake-up of the node."""


class UpdateSafetyDataConfirm(msgspec.Struct, frozen=True, gc=False):
    """``SRP-UpdateSafetyData.confirm``."""

    status: SRPStatus


class NotInitializedError(RuntimeError):
    """The neighbour table was read before :meth:`StateReporting.start` succeeded or after the shutdown."""


class StateReporting:
    """The SRP entity of one node."""

    def __init__(self, config: NodeConfig, bp: BPPort, *, emit: Callable[[Effect], None], now: int, wall: int) -> None:
        """``emit`` takes the effects in order. ``wall`` is the epoch of stamps if the profile's has no date.

        Raises ValueError for a profile without octets for state reports, and for a parameter that is out of bounds.
        """
        profile = config.profile
        if config.codec.report_plan is None:
            raise ValueError(f"profile {profile.name} has no octets for state reports: configure the node without SRP")
        self._config = config
        self._bp = bp
        self._emit = emit
        self._settings = config.srp or SRPConfig()
        self._sizes = config.sizes
        self._stamps = StampClock(profile.types.timestamp, origin=wall)
        self._fields = config.safety_fields
        room = self._settings.max_neighbours
        self._table = NeighbourTable(
            profile,
            capacity=room if room is not None else profile.limits.max_neighbours or MAX_NEIGHBOURS,
            stamps=self._stamps,
            fields=self._fields,
        )
        self._node_id = config.node_id
        self._node_id_offset = config.once(_node_id_offset)
        self._registered = False
        self._initialized = False
        self._seqno = 0
        self._steady = config.selected_readings.neighbour_age == "steady-age"
        self._own = OwnMotion(self._fields)
        self._traversed = now
        self._timeout_ms: float = 0
        violation = self.set_parameter(TIMEOUT, self._settings.neighbour_table_timeout_ms)
        if violation is not None:
            raise ValueError(str(violation))

    # -- initialization and shutdown --------------------------------------------------------------------------

    def start(self, now: int, wall: int) -> BPStatus:
        """Register with BP; also after a shutdown or a restart of BP. Returns the status from BP.

        Unless it is OK, SRP stays inactive.
        """
        profile = self._config.profile
        ##= SRP-INI-04
        self._bp.deregister(BP_PROTID_SRP)
        confirm = self._bp.register(
            ##= SRP-INI-01
            BP_PROTID_SRP,
            protocol_name(self._config.named_version),
            ##= SRP-INI-02
            max(self.record_size, profile.limits.max_srp_payload or 0),
            ##= SRP-INI-03 SRP-INI-08 SRP-TYP-07
            # ONCE and REPEAT both keep the newest record only.
            self._config.features.srp_queueing_mode,
            1,
            False,
            now=now,
            wall=wall,
        )
        self._table.clear()
        ##= SRP-INI-05
        self._seqno = 0
        self._own.clear()
        self._registered = self._initialized = confirm.status is BPStatus.OK
        if self._registered:
            ##= SRP-INI-06
            # Before 1.1 the confirm does not say it.
            self._node_id = confirm.own_node_identifier or self._config.node_id
        return confirm.status

    def shutdown(self) -> None:
        """Deregister from BP and clear the neighbour table, which is not traversed from now on."""
        ##= SRP-SHD-01
        self._bp.deregister(BP_PROTID_SRP)
        self._registered = self._initialized = False
        self._table.clear()
        self._own.clear()

    @property
    def registered(self) -> bool:
        """True from registration until SRP deregisters or detects that BP no longer knows it."""
        return self._registered

    @property
    def record_size(self) -> int:
        """Octets of an ExtendedSafetyDataT of this node."""
        return self._config.once(_record_size)

    # -- services ---------------------------------------------------------------------------------------------

    ##= SRP-SRV-02
    def update_safety_data(
        self, data: SafetyData | Mapping[str, Any], *, now: int, wall: int
    ) -> UpdateSafetyDataConfirm | None:
        """``SRP-UpdateSafetyData.request`` (SRP-TransmitSafetyData in 1.0): send ``data`` in the next beacon.

        ``data`` is of ``codec.safety_data_type``, or a mapping from all of the profile's field names to numbers in
        the profile's units (floats are rounded where the field is an integer, opaque fields may be missing). The
        answer is None only under reading X10 ``no-response``, before the first start.

        Raises ValueError (FieldError, EncodeError), and changes nothing, for data that do not fit the profile.
        """
        if self._registered and self._bp.query_number_buffered(BP_PROTID_SRP).status is BPStatus.UNKNOWN_PROTOCOL:
            # BP was restarted, or another client has deregistered SRP; BP does not indicate either.
            self._registered = False
        if not self._registered:
            if not self._initialized and self._config.selected_readings.uninitialized_srp == "no-response":
                return None
            ##= SRP-SRV-01 SRP-INI-07
            return UpdateSafetyDataConfirm(SRPStatus.INACTIVE)
        ##= SRP-TYP-03
        report = ExtendedSafetyData(
            data if isinstance(data, SafetyData) else self._safety_data(data),
            ##= SRP-TYP-04
            self._node_id,
            ##= SRP-TYP-05
            self._stamps.stamp(wall),
            ##= SRP-TYP-06
            self._seqno,
        )
        ##= SRP-FMT-01 SRP-TYP-02
        payload = self._config.codec.encode_report(self._config.own_fields.filled(report))
        ##= SRP-SEQ-01 SRP-TYP-01
        self._seqno = (self._seqno + 1) % seqno_modulus(self._config.profile)
        self._own.note(report.s_data, now)
        ##= SRP-SRV-03 SRP-SRV-04 SRP-RX-06
        # The only submission of payloads in SRP: received reports are never forwarded.
        # Its confirm, which need not exist, changes nothing (X11).
        ##= SRP-SRV-05
        self._bp.transmit_payload(BP_PROTID_SRP, payload, now=now)
        return UpdateSafetyDataConfirm(SRPStatus.OK)

    @property
    def neighbours(self) -> NeighbourTable:
        """Return the neighbour table. Raises :class:`NotInitializedError` before the start and after the shutdown."""
        ##= SRP-INI-07
        if not self._initialized:
            raise NotInitializedError("SRP is not initialized: there is no neighbour table yet")
        return self._table

    def own_motion(self) -> Motion | None:
        """Return own position and velocity as last submitted; None without, or if the profile has no position.

        Where the profile has no velocity it is that between the last two submissions.
        """
        return self._own.motion()

    def parameters(self) -> dict[str, float]:
        """Return the configurable parameters by their names in the specification."""
        return {TIMEOUT: self._timeout_ms}

    def set_parameter(self, name: str, value: object) -> Violation | None:
        """Set a parameter from now on; a returned violation means that the old value was kept.

        Raises ``UnknownParameterError`` for a name that is not a configurable parameter of SRP.
        """
        if name != TIMEOUT:
            raise UnknownParameterError(f"SRP has no parameter {name!r}; it has {TIMEOUT}")
        ##= SRP-PAR-01 SRP-PAR-03
        violation = validate(name, value, self._sizes)
        if violation is None:
            assert isinstance(value, int | float)
            self._timeout_ms = value
        return violation

    # -- runtime ----------------------------------------------------------------------------------------------

    @property
    def _timeout(self) -> int:
        return round(self._timeout_ms * MS)

    @property
    def _interval(self) -> int:
        return max(self._timeout // TRAVERSALS_PER_TIMEOUT, 1)

    def poll_timeout(self) -> int | None:
        """Return when the table is traversed next (monotonic ns); None while it is empty."""
        if not self._table:
            return None
        ##= SRP-RUN-01
        return self._traversed + self._interval

    def handle_timeout(self, now: int, wall: int) -> None:
        """Traverse the neighbour table if the traversal is due."""
        if not self._table or now < self._traversed + self._interval // 2:
            return
        self._traversed = now
        ##= SRP-RUN-02 SRP-PAR-02
        # By the monotonic clock: a step of the system time is not the age of anything (X50).
        gone = self._table.expire(now, self._timeout) if self._steady else self._table.expire_at(wall, self._timeout)
        for node_id in gone:
            self._emit(NeighbourExpired(node_id))

    # -- receive path -----------------------------------------------------------------------------------------

    def handle_payload(self, payload: bytes, sender_id: bytes, *, now: int, wall: int) -> None:
        """``BP-ReceivePayload.indication`` for BP_PROTID_SRP. Never raises, for any octets."""
        if not self._registered:
            self._drop("inactive")
            return
        ##= SRP-RX-01
        try:
            report = self._config.codec.decode_report(payload)
        except DecodeError as error:
            # A wrong length is the only possible fault of a report, also with text of variable length.
            self._drop("wrong-length", error.problem.offset)
            return
        ##= SRP-RX-02 SRP-NT-03
        if report.node_id == self._node_id:
            self._drop("own-report", self._node_id_offset)
            return
        if not self._table:
            # The first interval starts with the first entry.
            self._traversed = now
        outcome = self._table.record(report, sender_id, now=now, wall=wall)
        if self._table.displaced is not None:
            self._emit(NeighbourExpired(self._table.displaced))
            self._table.displaced = None
            self._drop("table-full", self._node_id_offset)
        self._emit(NeighbourSeen(report.node_id, outcome == "new"))

    def _drop(self, reason: str, offset: int = -1) -> None:
        self._emit(Dropped("srp", reason, DROPS[reason][0], offset))

    def _safety_data(self, values: Mapping[str, Any]) -> SafetyData:
        return self._config.codec.safety_data_type(**self._fields.complete(values))

    def snapshot(self) -> dict[str, Any]:
        """Return the state as plain data."""
        own = None if self._own.data is None else self._own.data.as_dict()
        return {
            "registered": self._registered,
            "node_id": self._node_id.hex(":"),
            "next_seqno": self._seqno,
            "safety_data": own and {k: v.hex() if isinstance(v, bytes) else v for k, v in own.items()},
            "parameters": self.parameters(),
            "max_neighbours": self._table.capacity,
            "neighbours": self._table.snapshot(),
        }


def protocol_name(version: SpecVersion) -> str:
    """The name under which SRP registers; the version is that of the specification (X31)."""
    return f"SRP -- State Reporting Protocol V{version}"


def _record_size(config: NodeConfig) -> int:
    fields = config.safety_fields
    blank = config.codec.safety_data_type(**fields.complete({field.name: 0 for field in fields.numbers()}))
    return len(config.codec.encode_report(ExtendedSafetyData(blank, config.node_id, 0, 0)))


def _node_id_offset(config: NodeConfig) -> int:
    """Return the offset of nodeId in a state report (octets), -1 if a text before it makes it vary."""
    plan = config.codec.report_plan
    layout = None if plan is None else record(plan, "ExtendedSafetyData")
    found = None if layout is None else start(layout, "nodeId")
    return -1 if found is None else found
