"""Model of a node: the variables that it holds and the instructions that it must send, given the received frames.

The model follows the table of variable states (protocol reference C.5; dcp-vardis.md: Receive Path) and uses only what
a tester can observe.

Malformed payloads, and behaviour that the specification leaves open, make the variables concerned *uncertain*. A
variable is certain again after an event that leads to the same state from every possible state: a creation by the node
itself, a creation later than all that the node may have received, the deletion of a variable that certainly has another
producer, or, after the timeout of the variable, the end of the next scrubbing.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import Final

from dcp_spec.constants import Features, ICType

from dcp_codec.values import (
    VarCreate,
    VarDelete,
    VardisRecord,
    VarReqCreate,
    VarReqUpdate,
    VarSpec,
    VarSumm,
    VarUpdate,
    own_values,
)
from dcp_conformance.definitions.circular import Circle

from .knowledge import ANY_CREATION, NEVER, NO_CREATION, Limits, Obligation, Variable, Version
from .repetitions import Key

# Module-level names: faster than attributes of the enumeration in comparisons for each record.
_CREATES, _DELETES, _UPDATES = ICType.CREATE_VARIABLES, ICType.DELETE_VARIABLES, ICType.UPDATES
_SUMMARIES, _CREATE_REQUESTS = ICType.SUMMARIES, ICType.REQUEST_VARCREATES
_UPDATE_REQUESTS = ICType.REQUEST_VARUPDATES
#: The order in which records of a payload are processed.
_ORDER = {
    each: place
    for place, each in enumerate((_CREATES, _DELETES, _UPDATES, _SUMMARIES, _UPDATE_REQUESTS, _CREATE_REQUESTS))
}
DELETION: Final = (_DELETES, 0)
#: The requirements by which an older number is answered, unless the answer is queued already.
TAUGHT: Final = frozenset({"VD-PU-06", "VD-PS-03"})
#: ns in a millisecond, the unit of timeouts.
_MS = 1_000_000


def processing_order(record: VardisRecord) -> int:
    """Return the place of a record in the order in which the records of a payload are processed (VD-RX-08)."""
    return _ORDER[record.IC_TYPE]


class Model:
    """Tracks the variables of one node. All times are ns of one clock."""

    def __init__(
        self,
        own_id: bytes,
        features: Features,
        seqno_width: int,
        limits: Limits,
        *,
        latency: int,
        window: int,
        scrubbing: int | None = None,
    ) -> None:
        """``latency``: maximum age of a payload on reception, ns. ``window``: maximum time of a reaction, ns.

        ``scrubbing``: the node's VARDISPAR_SCRUBBING_PERIOD, ns; None ignores timeouts.
        """
        self.own_id = own_id
        self.variables: dict[int, Variable] = {}
        self._features = features
        self._circle = Circle(seqno_width)
        self._limits = limits
        self._most_repetitions = limits.max_repetitions
        """The largest limit so far: a variable keeps its repCnt when the limit is lowered."""
        self._latency = latency
        self._window = window
        self._scrubbing = scrubbing if features.creation_time else None
        self._owed: dict[int, list[Obligation]] = {}
        """Instructions that the node must still send, by variable; a dictionary because there may be many."""
        self.occasions: defaultdict[str, int] = defaultdict(int)
        """Number of occasions on which the node could have violated each requirement."""

    # -- received payloads ---------------------------------------------------------------------------------------

    def hear(self, records: Sequence[VardisRecord], time: int, frame: int) -> None:
        """Process the records of a received payload in the order of the specification."""
        variables = self.variables
        for record in records if len(set(map(type, records))) == 1 else sorted(records, key=processing_order):
            var_id = record.spec.var_id if isinstance(record, VarCreate) else record.var_id
            variable = variables.get(var_id) or self._variable(var_id)
            if time < variable.due or self._ageing(record, variable, var_id, time):
                getattr(self, _HEAR[record.IC_TYPE])(record, variable, time, frame)

    def doubt(self, var_id: int, creation: int = ANY_CREATION) -> None:
        """Mark a variable as uncertain: the node may or may not have processed a record about it.

        ``creation``: the latest creation that the node may have accepted; NO_CREATION if there was none.
        """
        variable = self._variable(var_id)
        self._lose(variable)
        variable.latest = max(variable.latest, creation)

    def adopt(self, var_id: int, version: Version) -> None:
        """Set the state of a variable to the answer of a service, which does not show what is owed."""
        variable = self.variables[var_id] = Variable()
        self._become(variable, version)
        variable.latest = _creation(version)
        variable.foreign = version.state != "unknown" and not self._own(version)

    def _receive_create(self, record: VarCreate, variable: Variable, time: int, frame: int) -> None:
        spec, update = record.spec, record.upd
        if spec.prod_id == self.own_id or not self._limits.acceptable(record, self._features):
            return
        known, creation = variable.versions[-1], spec.creation_time or 0
        if self._features.creation_time:
            if creation <= variable.latest:
                # Not later than what the node has, unless that is something earlier.
                if variable.latest != _creation(known):
                    self._lose(variable)
                return
        elif variable.uncertain or known.state != "unknown":
            if known.state == "deleted" and self._perhaps_gone(variable):
                self._lose(variable)
            return
        self._regain(variable, time)
        variable.latest, variable.foreign = creation, True
        self._forget(spec.var_id)
        variable.repetitions.clear()
        self._become(variable, Version(time, "alive", spec, update.seqno, update.value, own_values(update)))
        if spec.var_id != update.var_id:
            self._lose(variable)
            variable.foreign = False
        self._arm(_CREATES, spec.var_id, time, frame, "VD-PC-09")

    def _receive_delete(self, record: VarDelete, variable: Variable, time: int, frame: int) -> None:
        known = variable.versions[-1]
        if variable.uncertain and variable.foreign and self._features.creation_time:
            # Alive or not, and of whatever creation: now it is deleted.
            self._regain(variable, time)
            variable.repetitions.clear()
            variable.repetitions.arm(DELETION, self._most_repetitions, time)
            self._forget(record.var_id)
            # Which creation and number is deleted is not known.
            self._become(variable, Version(time, "deleted", None, 0, b""))
        elif known.state == "alive" and not self._own(known):
            self._forget(record.var_id)
            self._become(variable, known._replace(since=time, state="deleted"))
            self._arm(_DELETES, record.var_id, time, frame, "VD-PD-04")

    def _receive_update(self, record: VarUpdate, variable: Variable, time: int, frame: int) -> None:
        known = variable.versions[-1]
        if variable.uncertain:
            return
        if self._unknown(variable):
            self._ask(_CREATE_REQUESTS, record.var_id, time, frame, "VD-PU-01")
        elif known.state == "alive" and not self._own(known) and self._limits.fitting(record.value, self._features):
            if self._circle.newer(record.seqno, known.seqno):
                version = Version(time, "alive", known.spec, record.seqno, record.value, own_values(record))
                self._become(variable, version)
                self._settle(_UPDATE_REQUESTS, record.var_id)
                variable.repetitions.drop((_UPDATE_REQUESTS, 0))
                # Older numbers are not owed any more, also those that seem newer after the number has wrapped.
                self._settle(_UPDATES, record.var_id)
                self._arm(_UPDATES, record.var_id, time, frame, "VD-PU-07")
            elif self._circle.newer(known.seqno, record.seqno):
                self._arm(_UPDATES, record.var_id, time, frame, "VD-PU-06")
            elif record.seqno != known.seqno:
                # Half the circle apart: neither newer nor older (X28).
                self._lose(variable)

    def _receive_summary(self, record: VarSumm, variable: Variable, time: int, frame: int) -> None:
        known = variable.versions[-1]
        if variable.uncertain:
            return
        if self._unknown(variable):
            self._ask(_CREATE_REQUESTS, record.var_id, time, frame, "VD-PS-01")
        elif known.state == "alive" and record.seqno != known.seqno and not self._own(known):
            if self._circle.newer(known.seqno, record.seqno):
                self._arm(_UPDATES, record.var_id, time, frame, "VD-PS-03")
            elif self._circle.newer(record.seqno, known.seqno):
                self._ask(_UPDATE_REQUESTS, record.var_id, time, frame, "VD-PS-04")
            else:
                self._lose(variable)

    def _receive_update_request(self, record: VarReqUpdate, variable: Variable, time: int, frame: int) -> None:
        known = variable.versions[-1]
        if variable.uncertain:
            return
        if self._unknown(variable):
            if self._features.rerequest_unknown:
                self._ask(_CREATE_REQUESTS, record.var_id, time, frame, "VD-RU-01")
        elif known.state == "alive" and record.seqno != known.seqno:
            if self._circle.newer(known.seqno, record.seqno):
                self._arm(_UPDATES, record.var_id, time, frame, "VD-RU-04")
            elif not self._circle.newer(record.seqno, known.seqno):
                self._lose(variable)

    def _receive_create_request(self, record: VarReqCreate, variable: Variable, time: int, frame: int) -> None:
        if variable.uncertain:
            return
        if self._unknown(variable):
            if self._features.rerequest_unknown:
                self._ask(_CREATE_REQUESTS, record.var_id, time, frame, "VD-RC-01")
        elif variable.now.state == "alive":
            self._arm(_CREATES, record.var_id, time, frame, "VD-RC-03")

    # -- services called by applications -----------------------------------------------------------------------

    def created(self, spec: VarSpec, value: bytes, time: int) -> None:
        """Process an RTDB-Create with status OK. ``spec.creation_time`` is compared with creations by other nodes."""
        self._forget(spec.var_id)
        variable = self._variable(spec.var_id)
        self._regain(variable, time)
        variable.latest, variable.foreign = spec.creation_time or 0, False
        variable.repetitions.clear()
        self._become(variable, Version(time, "alive", spec, 0, value))
        self._arm(_CREATES, spec.var_id, time, 0, "VD-CRE-12")

    def updated(self, var_id: int, value: bytes, time: int) -> None:
        """Process an RTDB-Update with status OK."""
        variable = self._own_alive(var_id, time)
        known = variable.versions[-1]
        seqno = (known.seqno + 1) % self._circle.modulus
        self._become(variable, Version(time, "alive", known.spec, seqno, value))
        self._settle(_UPDATES, var_id)
        self._arm(_UPDATES, var_id, time, 0, "VD-UPD-08")

    def deleted(self, var_id: int, time: int) -> None:
        """Process an RTDB-Delete with status OK."""
        variable = self._own_alive(var_id, time)
        self._forget(var_id)
        self._become(variable, variable.now._replace(since=time, state="deleted"))
        self._arm(_DELETES, var_id, time, 0, "VD-DEL-05")

    def _own_alive(self, var_id: int, time: int) -> Variable:
        """Return a variable. It becomes certain if the node produces it and it is alive: others do not change it."""
        variable = self._variable(var_id)
        known = variable.now
        if known.state == "alive" and self._own(known):
            if (variable.uncertain or time >= variable.due) and known.spec is not None:
                # It may have been requested since then.
                variable.repetitions.clear()
                variable.repetitions.arm((_CREATES, 0), known.spec.rep_cnt, time)
            self._regain(variable, time)
        return variable

    # -- bookkeeping -------------------------------------------------------------------------------------------

    def _variable(self, var_id: int) -> Variable:
        variable = self.variables.get(var_id)
        if variable is None:
            variable = self.variables[var_id] = Variable()
        return variable

    def _become(self, variable: Variable, version: Version) -> None:
        variable.versions.append(version)
        variable.due = NEVER
        if self._scrubbing is not None and version.state == "alive" and version.spec is not None:
            timeout = version.spec.timeout
            if timeout:
                variable.due = version.since + timeout * _MS

    def _lose(self, variable: Variable) -> None:
        """Mark a variable as uncertain from now on."""
        variable.uncertain = True
        variable.due = NEVER

    def _regain(self, variable: Variable, time: int) -> None:
        """Mark a variable as certain from ``time`` on, if it was uncertain or its timeout had passed."""
        if variable.uncertain or time >= variable.due:
            variable.uncertain, variable.settled = False, time

    def _ageing(self, record: VardisRecord, variable: Variable, var_id: int, time: int) -> bool:
        """Process the timeout of a variable before ``record``. Return whether the record can change the variable."""
        self._fade(variable, var_id, time)
        if time < variable.due or isinstance(record, VarCreate):
            return True
        if self._own(variable.now) or not isinstance(record, (VarUpdate, VarDelete)):
            return False
        self._lose(variable)
        return True

    def _fade(self, variable: Variable, var_id: int, time: int) -> None:
        """Process a timeout: the next scrubbing deletes the variable; before its end, both states are possible."""
        gone = variable.due + (self._scrubbing or 0) + self._latency
        self._forget(var_id)
        if time <= gone:
            return
        known = variable.versions[-1]
        self._become(variable, known._replace(since=gone, state="deleted"))
        variable.settled = gone
        variable.repetitions.clear()
        variable.repetitions.arm(DELETION, known.spec.rep_cnt if known.spec is not None else 0, gone)

    def _arm(self, kind: ICType, var_id: int, time: int, frame: int, requirement: str) -> None:
        """Set the counter of an instruction to repCnt: up to repCnt further beacons may contain it, and one must."""
        variable = self.variables[var_id]
        known = variable.versions[-1]
        spec, seqno = known.spec, known.seqno
        repetitions = spec.rep_cnt if spec is not None else 0
        if requirement in TAUGHT and self._surely_queued(kind, var_id):
            return
        variable.repetitions.arm((kind, seqno if kind is _UPDATES else 0), repetitions, time)
        if repetitions > 0:
            self._oblige(kind, var_id, seqno, time, frame, requirement)

    def _surely_queued(self, kind: ICType, var_id: int) -> bool:
        """Return whether an instruction is surely in its queue, so that an older number does not queue it again."""
        del kind, var_id
        return False

    def _ask(self, kind: ICType, var_id: int, time: int, frame: int, requirement: str) -> None:
        """Allow one more request. It is mandatory unless the variable may be deleted."""
        variable = self.variables[var_id]
        variable.repetitions.arm((kind, 0), 1, time)
        known = variable.versions[-1]
        if known.state != "deleted":
            seqno = known.seqno if kind is _UPDATE_REQUESTS else 0
            self._oblige(kind, var_id, seqno, time, frame, requirement)

    def _unknown(self, variable: Variable) -> bool:
        """Whether the node does not have a variable, or may have removed it after a deletion."""
        state = variable.versions[-1].state
        return state == "unknown" or (state == "deleted" and self._perhaps_gone(variable))

    def _oblige(self, kind: ICType, var_id: int, seqno: int, time: int, frame: int, requirement: str) -> None:
        self.occasions[requirement] += 1
        owing = self._owed.setdefault(var_id, [])
        for owed in owing:
            if owed.kind is kind and owed.seqno == seqno:
                return
        owing.append(Obligation(time + self._window, kind, var_id, seqno, requirement, frame, time))

    def _settle(self, kind: ICType, var_id: int, seqno: int | None = None) -> None:
        """Remove an instruction that was sent or is obsolete. A newer update also replaces older ones."""
        owing = self._owed.get(var_id)
        if not owing:
            return
        left = [owed for owed in owing if not self._done(owed, kind, seqno)]
        if left:
            self._owed[var_id] = left
        else:
            del self._owed[var_id]

    def _done(self, owed: Obligation, kind: ICType, seqno: int | None) -> bool:
        if owed.kind is kind:
            return kind is not _UPDATES or seqno is None or not self._circle.newer(owed.seqno, seqno)
        return False

    def _forget(self, var_id: int) -> None:
        """Remove all owed instructions about a variable after a creation or deletion (VD-PC-08, VD-PD-04)."""
        self._owed.pop(var_id, None)

    def _perhaps_gone(self, variable: Variable) -> bool:
        """Return whether the last VarDelete may be composed but not yet sent (before 2.0)."""
        if not self._features.removed_after_deletion:
            return False
        told = variable.repetitions.counted(DELETION)
        return max(variable.repetitions.allowed(DELETION), 1) - told <= 1

    def _own(self, version: Version) -> bool:
        return version.spec is not None and version.spec.prod_id == self.own_id


def key_of(kind: ICType, seqno: int) -> Key:
    """Return the key that counts an instruction in :class:`Repetitions`."""
    return kind, seqno if kind is _UPDATES else 0


def _creation(version: Version) -> int:
    """Return creationTime; 0 before 2.0, NO_CREATION if the variable does not exist."""
    return NO_CREATION if version.spec is None else version.spec.creation_time or 0


#: Names instead of bound methods, which would make each model refer to itself: the thousands of models a second in a
#: fuzzer would live until the garbage collector runs.
_HEAR: Final[dict[ICType, str]] = {
    _CREATES: "_receive_create",
    _DELETES: "_receive_delete",
    _UPDATES: "_receive_update",
    _SUMMARIES: "_receive_summary",
    _UPDATE_REQUESTS: "_receive_update_request",
    _CREATE_REQUESTS: "_receive_create_request",
}
