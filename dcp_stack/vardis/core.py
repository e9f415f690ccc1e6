"""State shared by the parts of VarDis: configuration, database, and the table of events and states."""

from __future__ import annotations

from collections.abc import Callable

from dcp_stack.config import MAX_VARIABLES, NodeConfig
from dcp_stack.effects import Effect, VariableChanged
from dcp_stack.readings import HalfRange
from dcp_stack.record_sizes import RecordSizes
from dcp_stack.timestamps import StampClock

from .database import Database, DBEntry
from .delivery import Delivery
from .parameters import VardisParameters
from .state_table import Cell, Event, table


class Sequence:
    """Circular comparison of sequence numbers (C.1, reading X28)."""

    def __init__(self, modulus: int, half_range: HalfRange) -> None:
        self._modulus = modulus
        self._half = modulus >> 1
        self._half_is_older = half_range == "half-range-older"
        self._half_is_answered = half_range != "half-range-neither"

    def received_is_older(self, received: int, own: int) -> bool:
        """Return whether a received number is strictly older than the stored one."""
        behind = (own - received) % self._modulus
        return 0 < behind < self._half or (behind == self._half and self._half_is_older)

    def answers(self, requested: int, own: int) -> bool:
        """Return whether the stored number is strictly newer than the requested one, so that a request is answered."""
        ahead = (own - requested) % self._modulus
        return 0 < ahead < self._half or (ahead == self._half and self._half_is_answered)

    def after(self, seqno: int) -> int:
        """Return the number that follows ``seqno``, modulo the size of the field."""
        return (seqno + 1) % self._modulus


def _modulus(wanted: int | None, sizes: RecordSizes) -> int:
    """Return the number of sequence numbers. Raises ValueError if the field cannot hold the ``wanted`` ones."""
    if wanted is not None and not 2 <= wanted <= sizes.seqno_modulus:
        raise ValueError(f"seqno_modulus must be in 2..{sizes.seqno_modulus}, not {wanted}")
    return wanted or sizes.seqno_modulus


class Core:
    """The state of one VarDis entity, shared by its services, receiver and composer."""

    def __init__(self, config: NodeConfig, emit: Callable[[Effect], None]) -> None:
        """Initialise an inactive entity with an empty database.

        Raises ValueError if the node has no VarDis, or if parameters in ``config.vardis`` are out of bounds.
        """
        self.config = config
        self.readings = config.selected_readings
        self.features = config.features
        self.emit = emit
        self.parameters = VardisParameters(config)
        self.sizes = config.record_sizes
        assert config.vardis is not None
        self.settings = config.vardis
        self.sequence = Sequence(_modulus(self.settings.seqno_modulus, self.sizes), self.readings.half_range)
        self.delivery = Delivery(self.sequence)
        """Signs that neighbours do not accept the variables of this node."""
        self.database = Database(remove_deleted=self.features.removed_after_deletion)
        # The clock counts from 1970 in every profile: after a restart of the node, creation times must not be earlier.
        self.clock = StampClock(config.profile.types.timestamp)
        self.own_id = config.node_id
        ##= VD-INI-01
        self.active = False
        """``vardisActive``."""
        ahead = self.settings.max_creation_ahead_s
        if ahead is not None and not ahead >= 0:
            raise ValueError(f"max_creation_ahead_s must be at least 0 s, not {ahead:g}")
        room = self.settings.max_variables
        self.max_variables = room if room is not None else config.profile.limits.max_variables or MAX_VARIABLES
        self._table = table(config)

    def cell(self, event: Event, entry: DBEntry | None) -> Cell:
        """Return the table's cell for an event and the state of a variable; ``entry`` is None for an unknown one."""
        unknown, own, foreign, own_deleted, foreign_deleted = self._table[event]
        if entry is None:
            return unknown
        if entry.spec.prod_id == self.own_id:
            return own_deleted if entry.is_deleted else own
        return foreign_deleted if entry.is_deleted else foreign

    def changed(self, event: str, entry: DBEntry) -> None:
        """Emit ``VariableChanged``; ``event`` is ``created``, ``updated`` or ``deleted``."""
        spec = entry.spec
        if event == "deleted" or spec.prod_id != self.own_id:
            self.delivery.deleted(spec.var_id)
        self.emit(VariableChanged(event, spec.var_id, entry.seqno, entry.value, spec.prod_id))
