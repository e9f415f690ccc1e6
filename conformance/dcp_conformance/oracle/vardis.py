"""VarDis as it looks from outside: what a node has heard decides what it has to say.

The model follows the table of variable states (protocol reference C.5; dcp-vardis.md: Receive Path) and knows nothing
of queues. It says three things of the node that hears all frames given to it: what it holds, what it owes, and whether
something it says is covered. A payload may have been composed a while before it is seen on the air; everything that was
true within ``latency`` before counts as true.

Octets that are no VarDis payload, and what the specification leaves open, make the variables concerned *uncertain*:
nothing is said of them until something happens after which there is one state whatever it was before. That is a
creation by the node itself, a creation later than all that it may have heard of, and the deletion of what is surely the
variable of somebody else; and for a variable whose timeout has passed, the end of the next scrubbing.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Final

from dcp_spec.constants import Features, ICType

from dcp_codec.values import VarCreate, VarDelete, VardisRecord, VarReqCreate, VarReqUpdate, VarSpec, VarSumm, VarUpdate
from dcp_conformance.circular import Circle

from .knowledge import ANY_CREATION, NEVER, Complaint, Limits, Owed, State, Variable, Version
from .repetitions import Key

# Names of the module: they are compared with for each record.
_CREATES, _DELETES, _UPDATES = ICType.CREATE_VARIABLES, ICType.DELETE_VARIABLES, ICType.UPDATES
_SUMMARIES, _CREATE_REQUESTS = ICType.SUMMARIES, ICType.REQUEST_VARCREATES
_UPDATE_REQUESTS = ICType.REQUEST_VARUPDATES
#: The order in which records of a payload are processed.
_ORDER = {VarCreate: 0, VarDelete: 1, VarUpdate: 2, VarSumm: 3, VarReqUpdate: 4, VarReqCreate: 5}
_DELETION: Final = (_DELETES, 0)
#: What a node counts down, by the requirements that it then keeps or breaks.
_REPEATED: Final = frozenset({_CREATES, _DELETES, _UPDATES})
_ABOUT: Final = {
    _SUMMARIES: ("VD-CMP-04", "VD-CMP-05"),
    _DELETES: ("VD-PD-04",),
    _CREATES: ("VD-UPD-10", "VD-PU-07"),
    _UPDATES: ("VD-UPD-10", "VD-PU-07"),
}
#: ns in a millisecond, the unit of timeouts.
_MS = 1_000_000
#: Payloads with room that are remembered.
_PAYLOADS = 4096


def _place(record: VardisRecord) -> int:
    return _ORDER[type(record)]


class Oracle:
    """The model of one node. Times are ns of any clock, as long as it is always the same."""

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
        """``latency``: how old a payload may be when it is seen. ``window``: how long a reaction may take.

        ``scrubbing``: the node's VARDISPAR_SCRUBBING_PERIOD; None leaves timeouts out of account.
        """
        self.own_id = own_id
        self.variables: dict[int, Variable] = {}
        self._features = features
        self._circle = Circle(seqno_width)
        self._limits = limits
        self._latency = latency
        self._window = window
        self._scrubbing = scrubbing if features.creation_time else None
        self._owed: dict[int, list[Owed]] = {}
        """By variable: there may be many, of many variables."""
        self._roomy: list[int] = []
        """When payloads came into which more would have fitted."""
        self.occasions: Counter[str] = Counter()
        """By requirement: how often there was something to be kept or broken."""
        self._hear_one: dict[type, Callable[[Any, Variable, int, int], None]] = {
            VarCreate: self._hear_create,
            VarDelete: self._hear_delete,
            VarUpdate: self._hear_update,
            VarSumm: self._hear_summary,
            VarReqUpdate: self._hear_update_request,
            VarReqCreate: self._hear_create_request,
        }

    # -- what the node hears -----------------------------------------------------------------------------------

    def hear(self, records: Sequence[VardisRecord], time: int, frame: int) -> None:
        """A payload reaches the node: all records of it, in order."""
        for record in records if len(records) == 1 else sorted(records, key=_place):
            var_id = record.spec.var_id if isinstance(record, VarCreate) else record.var_id
            variable = self._variable(var_id)
            if time < variable.due or self._ageing(record, variable, var_id, time):
                self._hear_one[type(record)](record, variable, time, frame)

    def doubt(self, var_id: int, creation: int = ANY_CREATION) -> None:
        """A payload said something of a variable of which it is open whether the node has taken it.

        ``creation``: the latest creation that the node may have taken; -1 if it was none.
        """
        variable = self._variable(var_id)
        self._lose(variable)
        variable.latest = max(variable.latest, creation)

    def _hear_create(self, record: VarCreate, variable: Variable, time: int, frame: int) -> None:
        spec, update = record.spec, record.upd
        if spec.prod_id == self.own_id or not self._limits.acceptable(record, self._features):
            return
        known, creation = variable.now, spec.creation_time or 0
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
        self._become(variable, Version(time, "alive", spec, update.seqno, update.value))
        if spec.var_id != update.var_id:
            self._lose(variable)
            variable.foreign = False
        self._arm(_CREATES, spec.var_id, time, frame, "VD-PC-09")

    def _hear_delete(self, record: VarDelete, variable: Variable, time: int, frame: int) -> None:
        known = variable.now
        if variable.uncertain and variable.foreign and self._features.creation_time:
            # Alive or not, and of whatever creation: now it is deleted.
            self._regain(variable, time)
            variable.repetitions.clear()
            variable.repetitions.arm(_DELETION, self._limits.max_repetitions, time)
            self._forget(record.var_id)
            self._become(variable, known._replace(since=time, state="deleted"))
        elif known.state == "alive" and not self._own(known):
            self._forget(record.var_id)
            self._become(variable, known._replace(since=time, state="deleted"))
            self._arm(_DELETES, record.var_id, time, frame, "VD-PD-04")

    def _hear_update(self, record: VarUpdate, variable: Variable, time: int, frame: int) -> None:
        known = variable.now
        if variable.uncertain:
            return
        if self._unknown(variable):
            self._ask(_CREATE_REQUESTS, record.var_id, time, frame, "VD-PU-01")
        elif known.state == "alive" and not self._own(known) and self._limits.fitting(record.value, self._features):
            if self._circle.newer(record.seqno, known.seqno):
                self._become(variable, Version(time, "alive", known.spec, record.seqno, record.value))
                self._settle(_UPDATE_REQUESTS, record.var_id)
                # Older numbers need not be said any more, also those that look newer once the circle has moved on.
                self._settle(_UPDATES, record.var_id)
                self._arm(_UPDATES, record.var_id, time, frame, "VD-PU-07")
            elif self._circle.newer(known.seqno, record.seqno):
                self._arm(_UPDATES, record.var_id, time, frame, "VD-PU-06")
            elif record.seqno != known.seqno:
                # Half the circle apart: neither newer nor older (X28).
                self._lose(variable)

    def _hear_summary(self, record: VarSumm, variable: Variable, time: int, frame: int) -> None:
        known = variable.now
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

    def _hear_update_request(self, record: VarReqUpdate, variable: Variable, time: int, frame: int) -> None:
        known = variable.now
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

    def _hear_create_request(self, record: VarReqCreate, variable: Variable, time: int, frame: int) -> None:
        if variable.uncertain:
            return
        if self._unknown(variable):
            if self._features.rerequest_unknown:
                self._ask(_CREATE_REQUESTS, record.var_id, time, frame, "VD-RC-01")
        elif variable.now.state == "alive":
            self._arm(_CREATES, record.var_id, time, frame, "VD-RC-03")

    # -- what its applications ask of it -----------------------------------------------------------------------

    def created(self, spec: VarSpec, value: bytes, time: int) -> None:
        """RTDB-Create was confirmed with OK; creations of others are compared with ``spec.creation_time``."""
        self._forget(spec.var_id)
        variable = self._variable(spec.var_id)
        self._regain(variable, time)
        variable.latest, variable.foreign = spec.creation_time or 0, False
        variable.repetitions.clear()
        self._become(variable, Version(time, "alive", spec, 0, value))
        self._arm(_CREATES, spec.var_id, time, 0, "VD-CRE-12")

    def updated(self, var_id: int, value: bytes, time: int) -> None:
        """RTDB-Update was confirmed with OK."""
        variable = self._own_alive(var_id, time)
        known = variable.now
        seqno = (known.seqno + 1) % self._circle.modulus
        self._become(variable, Version(time, "alive", known.spec, seqno, value))
        self._settle(_UPDATES, var_id)
        self._arm(_UPDATES, var_id, time, 0, "VD-UPD-08")

    def deleted(self, var_id: int, time: int) -> None:
        """RTDB-Delete was confirmed with OK."""
        variable = self._own_alive(var_id, time)
        self._forget(var_id)
        self._become(variable, variable.now._replace(since=time, state="deleted"))
        self._arm(_DELETES, var_id, time, 0, "VD-DEL-05")

    def _own_alive(self, var_id: int, time: int) -> Variable:
        """A variable that the node has just shown to be alive and its own, so that nobody else has changed it."""
        variable = self._variable(var_id)
        if variable.now.state == "alive" and self._own(variable.now):
            self._regain(variable, time)
        return variable

    # -- what the node says ------------------------------------------------------------------------------------

    def said(
        self, records: Iterable[tuple[ICType, VardisRecord]], time: int, frame: int, *, roomy: bool = False
    ) -> list[Complaint]:
        """Judge a payload of the node; what it owed and says is settled.

        ``roomy``: any other instruction would have fitted, so that those that are missing were not to be said.
        """
        complaints: list[Complaint] = []
        for kind, record in records:
            spec = getattr(record, "spec", None)
            var_id: int = record.var_id if spec is None else spec.var_id  # type: ignore[union-attr]
            variable = self._variable(var_id)
            if time >= variable.due:
                self._fade(variable, var_id, time)
            seqno = _seqno(record)
            self._settle(kind, var_id, seqno)
            exhausted = kind in _REPEATED and self._exhausted(variable, _key(kind, seqno), time)
            if not variable.uncertain and variable.settled < time - self._latency and time < variable.due:
                complaints += self._judge(kind, record, variable, var_id, seqno, time, frame, exhausted)
            if variable.now.state == "deleted" and self._features.removed_after_deletion:
                self._remove_when_told(variable, time)
        if roomy:
            self._roomy.append(time)
            if len(self._roomy) > _PAYLOADS:
                del self._roomy[: _PAYLOADS // 2]
        return complaints

    def overdue(self, time: int) -> list[Owed]:
        """What should have been said by now and was not; each is told once."""
        late: list[Owed] = []
        for var_id in list(self._owed):
            owing = self._owed.pop(var_id)
            late += [owed for owed in owing if owed.deadline < time]
            if later := [owed for owed in owing if owed.deadline >= time]:
                self._owed[var_id] = later
        late.sort(key=lambda owed: owed.deadline)
        return [owed for owed in late if not self._variable(owed.var_id).uncertain]

    def certain(self, var_id: int, time: int | None = None) -> Version | None:
        """What the node holds of a variable at ``time`` (None: now); None if that is not certain or never asked."""
        variable = self.variables.get(var_id)
        if variable is None:
            return None
        if time is not None and time >= variable.due:
            self._fade(variable, var_id, time)
            if time >= variable.due:
                return None
        return None if variable.uncertain else variable.versions[-1]

    def holdings(self) -> Iterator[tuple[int, Version]]:
        """The variables that are certain, and what they are; timeouts aside."""
        for var_id, variable in self.variables.items():
            if not variable.uncertain and variable.now.state != "unknown":
                yield var_id, variable.now

    def _judge(
        self,
        kind: ICType,
        record: VardisRecord,
        variable: Variable,
        var_id: int,
        seqno: int,
        time: int,
        frame: int,
        exhausted: bool,
    ) -> Iterator[Complaint]:
        versions = self._lately(variable, time)
        if kind is _CREATE_REQUESTS or kind is _UPDATE_REQUESTS:
            yield from self._judge_request(kind, variable, var_id, seqno, versions, frame)
            return
        needed: State = "deleted" if kind is _DELETES else "alive"
        for requirement in _ABOUT[kind]:
            self.occasions[requirement] += 1
        fitting = [version for version in versions if version.state == needed]
        if not fitting:
            requirement = {"deleted": "VD-PD-04", "alive": "VD-CMP-05"}[needed]
            observed = f"{kind.label} of it, while it is {versions[-1].state}"
            yield Complaint(requirement, var_id, f"nothing of the kind about variable {var_id}", observed, frame)
            return
        if kind is not _DELETES:
            meant = [version for version in fitting if version.seqno == seqno]
            if not meant:
                shown = " or ".join(str(number) for number in sorted({version.seqno for version in fitting}))
                requirement = "VD-CMP-04" if kind is _SUMMARIES else "VD-UPD-10"
                yield Complaint(requirement, var_id, f"sequence number {shown}", f"{kind.label} with {seqno}", frame)
                return
            yield from self._judge_content(record, var_id, fitting, meant, frame)
            fitting = meant
        if kind is not _SUMMARIES and len(fitting) == 1 and fitting[0] is versions[-1]:
            # What is, or may be, of an earlier creation or of a moment ago is counted no more.
            yield from self._counted(kind, variable, var_id, seqno, frame, exhausted)

    def _judge_content(
        self, record: VardisRecord, var_id: int, fitting: list[Version], meant: list[Version], frame: int
    ) -> Iterator[Complaint]:
        """What an instruction says beside the number, where the variable has it."""
        value = record.upd.value if isinstance(record, VarCreate) else getattr(record, "value", None)
        if value is not None and value not in {version.value for version in meant}:
            shown = " or ".join({version.value.hex(): None for version in meant})
            expected = f"the value {shown} for number {meant[0].seqno}"
            yield Complaint("VD-PU-07", var_id, expected, value.hex(), frame)
        if isinstance(record, VarCreate) and not self._own(fitting[-1]):
            # The producer's own creation time is its own clock's: only it knows.
            self.occasions["VD-PC-10"] += 1
            specs = [version.spec for version in fitting if version.spec is not None]
            if specs and record.spec not in specs:
                yield Complaint("VD-PC-10", var_id, f"{specs[-1]}", f"{record.spec}", frame)

    def _judge_request(
        self, kind: ICType, variable: Variable, var_id: int, seqno: int, versions: list[Version], frame: int
    ) -> Iterator[Complaint]:
        """Requests are for what the node does not have, tell what it has, and come once for each reason."""
        self.occasions["VD-PS-02"] += 1
        self.occasions["VD-SCP-01"] += 1
        if kind is _CREATE_REQUESTS:
            fitting = [version for version in versions if version.state == "unknown"]
        else:
            self.occasions["VD-PS-04"] += 1
            fitting = [version for version in versions if version.state == "alive" and not self._own(version)]
        if not fitting:
            mine = " of its own" if self._own(versions[-1]) else ""
            observed = f"{kind.label}, while it is {versions[-1].state}{mine}"
            yield Complaint("VD-PS-02", var_id, f"no request for variable {var_id}", observed, frame)
            return
        if kind is _UPDATE_REQUESTS and seqno not in {version.seqno for version in fitting}:
            shown = " or ".join(str(version.seqno) for version in fitting)
            observed = f"{kind.label} with {seqno}"
            yield Complaint("VD-PS-04", var_id, f"the own number {shown} in a request", observed, frame)
        if len(versions) == 1 and versions[0] is variable.versions[-1]:
            said, reasons = variable.repetitions.count((kind, 0)), variable.repetitions.allowed((kind, 0))
            if said > reasons:
                expected = f"{kind.label} of variable {var_id} once for each reason to ask"
                yield Complaint("VD-SCP-01", var_id, expected, f"{said} for {reasons} reasons", frame)

    def _counted(
        self, kind: ICType, variable: Variable, var_id: int, seqno: int, frame: int, exhausted: bool
    ) -> Iterator[Complaint]:
        key = _key(kind, seqno)
        self.occasions["VD-SCP-02"] += 1
        count, allowed = variable.repetitions.count(key), variable.repetitions.allowed(key)
        if count > allowed:
            expected = f"{kind.label} of variable {var_id} in at most {allowed} beacons"
            yield Complaint("VD-SCP-02", var_id, expected, f"it stands in {count}", frame)
        elif exhausted:
            expected = f"no {kind.label} of variable {var_id} after a payload with room for it but without it"
            yield Complaint("VD-SCP-02", var_id, expected, "it is there again, without a reason", frame)

    def _exhausted(self, variable: Variable, key: Key, time: int) -> bool:
        """An instruction stands in a payload: whether an earlier one has shown that it was not to be said any more."""
        armed = variable.repetitions.armed_at(key)
        if armed is None or time <= armed + self._latency:
            return False
        behind = variable.repetitions.stands_behind(key)
        return len(self._roomy) - bisect_right(self._roomy, armed + self._latency) > behind

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
        """From now on it is open what the node has."""
        variable.uncertain = True
        variable.due = NEVER

    def _regain(self, variable: Variable, time: int) -> None:
        """From now on it is certain again."""
        if variable.uncertain:
            variable.uncertain, variable.settled = False, time

    def _ageing(self, record: VardisRecord, variable: Variable, var_id: int, time: int) -> bool:
        """The node hears of a variable whose timeout has passed; False if that changes nothing, whatever it has."""
        self._fade(variable, var_id, time)
        if time < variable.due or isinstance(record, VarCreate):
            return True
        if self._own(variable.now) or not isinstance(record, VarUpdate | VarDelete):
            return False
        self._lose(variable)
        return True

    def _fade(self, variable: Variable, var_id: int, time: int) -> None:
        """The timeout has passed: at the end of the next scrubbing the variable is deleted, until then it may be."""
        gone = variable.due + (self._scrubbing or 0) + self._latency
        self._forget(var_id)
        if time <= gone:
            return
        known = variable.now
        self._become(variable, known._replace(since=gone, state="deleted"))
        variable.settled = gone
        variable.repetitions.clear()
        variable.repetitions.arm(_DELETION, known.spec.rep_cnt if known.spec is not None else 0, gone)

    def _lately(self, variable: Variable, time: int) -> list[Version]:
        """What the variable was at any time within the latency, in order."""
        versions, since = variable.versions, time - self._latency
        found = [versions[-1]]
        place = len(versions) - 1
        while place > 0 and versions[place].since >= since:
            place -= 1
            found.append(versions[place])
        found.reverse()
        return found

    def _arm(self, kind: ICType, var_id: int, time: int, frame: int, requirement: str) -> None:
        """The counter of an instruction is set: it may stand in repCnt beacons from now on, and must in one."""
        variable = self.variables[var_id]
        spec, seqno = variable.now.spec, variable.now.seqno
        repetitions = spec.rep_cnt if spec is not None else 0
        variable.repetitions.arm(_key(kind, seqno), repetitions, time)
        if repetitions > 0:
            self._owe(kind, var_id, seqno, time, frame, requirement)

    def _ask(self, kind: ICType, var_id: int, time: int, frame: int, requirement: str) -> None:
        """The node has a reason to ask: it may once more, and must if it is certain that the reason holds."""
        variable = self.variables[var_id]
        variable.repetitions.arm((kind, 0), 1, time)
        if variable.now.state != "deleted":
            seqno = variable.now.seqno if kind is _UPDATE_REQUESTS else 0
            self._owe(kind, var_id, seqno, time, frame, requirement)

    def _unknown(self, variable: Variable) -> bool:
        """Whether the node does not have a variable, or perhaps no longer."""
        state = variable.now.state
        return state == "unknown" or (state == "deleted" and self._perhaps_gone(variable))

    def _owe(self, kind: ICType, var_id: int, seqno: int, time: int, frame: int, requirement: str) -> None:
        self.occasions[requirement] += 1
        owing = self._owed.get(var_id)
        if owing is None:
            self._owed[var_id] = [Owed(time + self._window, kind, var_id, seqno, requirement, frame)]
            return
        for owed in owing:
            if owed.kind is kind and owed.seqno == seqno:
                return
        owing.append(Owed(time + self._window, kind, var_id, seqno, requirement, frame))

    def _settle(self, kind: ICType, var_id: int, seqno: int | None = None) -> None:
        """Something was said, or need not be any more. A newer number does for an older one; a create for an update."""
        owing = self._owed.get(var_id)
        if not owing:
            return
        left = [owed for owed in owing if not self._done(owed, kind, seqno)]
        if left:
            self._owed[var_id] = left
        else:
            del self._owed[var_id]

    def _done(self, owed: Owed, kind: ICType, seqno: int | None) -> bool:
        if owed.kind is kind:
            return kind is not _UPDATES or seqno is None or not self._circle.newer(owed.seqno, seqno)
        return False

    def _forget(self, var_id: int) -> None:
        """A creation or deletion: everything that was to be said of the variable is dropped (VD-PC-08, VD-PD-04)."""
        self._owed.pop(var_id, None)

    def _perhaps_gone(self, variable: Variable) -> bool:
        """Before 2.0: whether the last telling of a deletion may be composed already, and not be on the air yet."""
        if not self._features.removed_after_deletion:
            return False
        told = variable.repetitions.counted(_DELETION)
        return max(variable.repetitions.allowed(_DELETION), 1) - told <= 1

    def _remove_when_told(self, variable: Variable, time: int) -> None:
        """Before 2.0 a variable is gone once its deletion was told often enough."""
        if variable.repetitions.counted(_DELETION) >= max(variable.repetitions.allowed(_DELETION), 1):
            variable.repetitions.clear()
            self._become(variable, Version(time, "unknown", None, 0, b""))

    def _own(self, version: Version) -> bool:
        return version.spec is not None and version.spec.prod_id == self.own_id


def _key(kind: ICType, seqno: int) -> Key:
    return kind, seqno if kind is _UPDATES else 0


def _creation(version: Version) -> int:
    """When a variable was created, -1 if it was not."""
    return -1 if version.spec is None else version.spec.creation_time or 0


def _seqno(record: VardisRecord) -> int:
    if isinstance(record, VarCreate):
        return record.upd.seqno
    number: int = getattr(record, "seqno", 0)
    return number
