"""VarDis as it looks from outside: what a node has heard decides what it has to say.

The model follows the table of variable states (protocol reference C.5; dcp-vardis.md: Receive Path) and knows nothing
of queues. It says three things of the node that hears all frames given to it: what it holds, what it owes, and whether
something it says is covered. A payload may have been composed a while before it is seen on the air; everything that was
true within ``latency`` before counts as true.

Octets that are no VarDis payload, and what the specification leaves open, make the variables concerned *uncertain*:
nothing is said of them any more.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator

from dcp_spec.constants import Features, ICType

from dcp_codec.values import VarCreate, VarDelete, VardisRecord, VarReqCreate, VarReqUpdate, VarSpec, VarSumm, VarUpdate
from dcp_conformance.circular import Circle

from .knowledge import VERSIONS, Complaint, Limits, Owed, State, Variable, Version


class Oracle:
    """The model of one node. Times are ns of any clock, as long as it is always the same."""

    def __init__(
        self, own_id: bytes, features: Features, seqno_width: int, limits: Limits, *, latency: int, window: int
    ) -> None:
        """``latency``: how old a payload may be when it is seen. ``window``: how long a reaction may take."""
        self.own_id = own_id
        self.variables: dict[int, Variable] = {}
        self._features = features
        self._circle = Circle(seqno_width)
        self._limits = limits
        self._latency = latency
        self._window = window
        self._owed: dict[int, list[Owed]] = {}
        """By variable: there may be many, of many variables."""
        self.occasions: Counter[str] = Counter()
        """By requirement: how often there was something to be kept or broken."""

    # -- what the node hears -----------------------------------------------------------------------------------

    def hear(self, records: Iterable[VardisRecord], time: int, frame: int) -> None:
        """A payload reaches the node: all records of it, in order."""
        records = list(records)
        order = (VarCreate, VarDelete, VarUpdate, VarSumm, VarReqUpdate, VarReqCreate)
        for kind in order:
            for record in records:
                if type(record) is kind:
                    self._process(record, time, frame)

    def doubt(self, var_id: int) -> None:
        """A payload said something of a variable of which it is open whether the node has taken it."""
        self._variable(var_id).uncertain = True

    def _process(self, record: VardisRecord, time: int, frame: int) -> None:
        match record:
            case VarCreate():
                self._hear_create(record, time, frame)
            case VarDelete():
                self._hear_delete(record, time, frame)
            case VarUpdate():
                self._hear_update(record, time, frame)
            case VarSumm():
                self._hear_summary(record, time, frame)
            case VarReqUpdate():
                self._hear_update_request(record, time, frame)
            case VarReqCreate():
                self._hear_create_request(record, time, frame)

    def _hear_create(self, record: VarCreate, time: int, frame: int) -> None:
        spec, update = record.spec, record.upd
        variable = self._variable(spec.var_id)
        known = variable.now
        if spec.prod_id == self.own_id or not self._limits.acceptable(record, self._features):
            return
        if known.state == "deleted" and self._perhaps_gone(spec.var_id):
            variable.uncertain = True
        if known.state != "unknown":
            newer = (
                self._features.creation_time
                and known.spec is not None
                and (spec.creation_time or 0) > (known.spec.creation_time or 0)
            )
            if not newer:
                return
        if spec.var_id != update.var_id:
            variable.uncertain = True
        self._forget(spec.var_id)
        variable.armed.clear()
        variable.said.clear()
        self._become(spec.var_id, Version(time, "alive", spec, update.seqno, update.value))
        self._arm(ICType.CREATE_VARIABLES, spec.var_id, time, frame, "VD-PC-09")

    def _hear_delete(self, record: VarDelete, time: int, frame: int) -> None:
        known = self._variable(record.var_id).now
        if known.state != "alive" or self._own(known):
            return
        self._forget(record.var_id)
        self._become(record.var_id, known._replace(since=time, state="deleted"))
        self._arm(ICType.DELETE_VARIABLES, record.var_id, time, frame, "VD-PD-04")

    def _hear_update(self, record: VarUpdate, time: int, frame: int) -> None:
        known = self._variable(record.var_id).now
        if self._unknown(record.var_id):
            self._ask(ICType.REQUEST_VARCREATES, record.var_id, time, frame, "VD-PU-01")
        elif known.state == "alive" and not self._own(known) and self._limits.fitting(record.value, self._features):
            if self._circle.newer(record.seqno, known.seqno):
                self._become(record.var_id, Version(time, "alive", known.spec, record.seqno, record.value))
                self._settle(ICType.REQUEST_VARUPDATES, record.var_id)
                # Older numbers need not be said any more, also those that look newer once the circle has moved on.
                self._settle(ICType.UPDATES, record.var_id)
                self._arm(ICType.UPDATES, record.var_id, time, frame, "VD-PU-07")
            elif self._circle.newer(known.seqno, record.seqno):
                self._arm(ICType.UPDATES, record.var_id, time, frame, "VD-PU-06")
            elif record.seqno != known.seqno:
                # Half the circle apart: neither newer nor older (X28).
                self._variable(record.var_id).uncertain = True

    def _hear_summary(self, record: VarSumm, time: int, frame: int) -> None:
        known = self._variable(record.var_id).now
        if self._unknown(record.var_id):
            self._ask(ICType.REQUEST_VARCREATES, record.var_id, time, frame, "VD-PS-01")
        elif known.state == "alive" and not self._own(known):
            if self._circle.newer(known.seqno, record.seqno):
                self._arm(ICType.UPDATES, record.var_id, time, frame, "VD-PS-03")
            elif self._circle.newer(record.seqno, known.seqno):
                self._ask(ICType.REQUEST_VARUPDATES, record.var_id, time, frame, "VD-PS-04")
            elif record.seqno != known.seqno:
                self._variable(record.var_id).uncertain = True

    def _hear_update_request(self, record: VarReqUpdate, time: int, frame: int) -> None:
        known = self._variable(record.var_id).now
        if self._unknown(record.var_id):
            if self._features.rerequest_unknown:
                self._ask(ICType.REQUEST_VARCREATES, record.var_id, time, frame, "VD-RU-01")
        elif known.state == "alive":
            if self._circle.newer(known.seqno, record.seqno):
                self._arm(ICType.UPDATES, record.var_id, time, frame, "VD-RU-04")
            elif record.seqno != known.seqno and not self._circle.newer(record.seqno, known.seqno):
                self._variable(record.var_id).uncertain = True

    def _hear_create_request(self, record: VarReqCreate, time: int, frame: int) -> None:
        known = self._variable(record.var_id).now
        if self._unknown(record.var_id):
            if self._features.rerequest_unknown:
                self._ask(ICType.REQUEST_VARCREATES, record.var_id, time, frame, "VD-RC-01")
        elif known.state == "alive":
            self._arm(ICType.CREATE_VARIABLES, record.var_id, time, frame, "VD-RC-03")

    # -- what its applications ask of it -----------------------------------------------------------------------

    def created(self, spec: VarSpec, value: bytes, time: int) -> None:
        """RTDB-Create was confirmed with OK; ``spec.creation_time`` is not compared."""
        self._forget(spec.var_id)
        variable = self._variable(spec.var_id)
        variable.armed.clear()
        variable.said.clear()
        self._become(spec.var_id, Version(time, "alive", spec, 0, value))
        self._arm(ICType.CREATE_VARIABLES, spec.var_id, time, 0, "VD-CRE-12")

    def updated(self, var_id: int, value: bytes, time: int) -> None:
        """RTDB-Update was confirmed with OK."""
        known = self._variable(var_id).now
        seqno = (known.seqno + 1) % self._circle.modulus
        self._become(var_id, Version(time, "alive", known.spec, seqno, value))
        self._settle(ICType.UPDATES, var_id)
        self._arm(ICType.UPDATES, var_id, time, 0, "VD-UPD-08")

    def deleted(self, var_id: int, time: int) -> None:
        """RTDB-Delete was confirmed with OK."""
        known = self._variable(var_id).now
        self._forget(var_id)
        self._become(var_id, known._replace(since=time, state="deleted"))
        self._arm(ICType.DELETE_VARIABLES, var_id, time, 0, "VD-DEL-05")

    # -- what the node says ------------------------------------------------------------------------------------

    def said(self, records: Iterable[tuple[ICType, VardisRecord]], time: int, frame: int) -> list[Complaint]:
        """Judge a payload of the node; what it owed and says is settled."""
        complaints: list[Complaint] = []
        for kind, record in records:
            spec = getattr(record, "spec", None)
            var_id: int = record.var_id if spec is None else spec.var_id  # type: ignore[union-attr]
            variable = self._variable(var_id)
            seqno = _seqno(record)
            self._settle(kind, var_id, seqno)
            if not variable.uncertain:
                complaints += self._judge(kind, record, var_id, seqno, time, frame)
            if variable.now.state == "deleted" and self._features.removed_after_deletion:
                self._remove_when_told(var_id, time)
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

    def holdings(self) -> Iterator[tuple[int, Version]]:
        """The variables that are certain, and what they are."""
        for var_id, variable in self.variables.items():
            if not variable.uncertain and variable.now.state != "unknown":
                yield var_id, variable.now

    def _judge(
        self, kind: ICType, record: VardisRecord, var_id: int, seqno: int, time: int, frame: int
    ) -> Iterator[Complaint]:
        versions = list(self._lately(var_id, time))
        states = {version.state for version in versions}
        if kind in (ICType.REQUEST_VARCREATES, ICType.REQUEST_VARUPDATES):
            yield from self._judge_request(kind, var_id, seqno, versions, frame)
            return
        needed: State = "deleted" if kind is ICType.DELETE_VARIABLES else "alive"
        about = {ICType.SUMMARIES: ("VD-CMP-04", "VD-CMP-05"), ICType.DELETE_VARIABLES: ("VD-PD-04",)}
        self.occasions.update(about.get(kind, ("VD-UPD-10", "VD-PU-07")))
        if needed not in states:
            requirement = {"deleted": "VD-PD-04", "alive": "VD-CMP-05"}[needed]
            observed = f"{kind.label} of it, while it is {versions[-1].state}"
            yield Complaint(requirement, var_id, f"nothing of the kind about variable {var_id}", observed, frame)
            return
        fitting = [version for version in versions if version.state == needed]
        if kind is not ICType.DELETE_VARIABLES:
            numbers = {version.seqno for version in fitting}
            if seqno not in numbers:
                shown = " or ".join(str(number) for number in sorted(numbers))
                requirement = "VD-CMP-04" if kind is ICType.SUMMARIES else "VD-UPD-10"
                yield Complaint(requirement, var_id, f"sequence number {shown}", f"{kind.label} with {seqno}", frame)
                return
            value = record.upd.value if isinstance(record, VarCreate) else getattr(record, "value", None)
            values = {version.value for version in fitting if version.seqno == seqno}
            if value is not None and value not in values:
                shown = " or ".join(each.hex() for each in values)
                yield Complaint("VD-PU-07", var_id, f"the value {shown} for number {seqno}", value.hex(), frame)
        if isinstance(record, VarCreate):
            self.occasions["VD-PC-10"] += not self._own(fitting[-1])
            specs = [version.spec for version in fitting if version.spec is not None]
            # The producer's own creation time is its own clock's: only it knows.
            if not self._own(fitting[-1]) and specs and record.spec not in specs:
                yield Complaint("VD-PC-10", var_id, f"{specs[-1]}", f"{record.spec}", frame)
        meant = [each for each in fitting if kind is ICType.DELETE_VARIABLES or each.seqno == seqno]
        if kind is not ICType.SUMMARIES and meant == versions[-1:]:
            # What is, or may be, of an earlier creation or of a moment ago is counted no more.
            yield from self._counted(kind, var_id, seqno, frame)

    def _judge_request(
        self, kind: ICType, var_id: int, seqno: int, versions: list[Version], frame: int
    ) -> Iterator[Complaint]:
        """Requests are for what the node does not have, tell what it has, and come once for each reason."""
        variable, label = self._variable(var_id), kind.label
        self.occasions.update(("VD-PS-02", "VD-SCP-01", *(("VD-PS-04",) if kind is ICType.REQUEST_VARUPDATES else ())))
        if kind is ICType.REQUEST_VARCREATES:
            fitting = [version for version in versions if version.state == "unknown"]
        else:
            fitting = [version for version in versions if version.state == "alive" and not self._own(version)]
        if not fitting:
            mine = " of its own" if self._own(versions[-1]) else ""
            observed = f"{label}, while it is {versions[-1].state}{mine}"
            yield Complaint("VD-PS-02", var_id, f"no request for variable {var_id}", observed, frame)
            return
        if kind is ICType.REQUEST_VARUPDATES and seqno not in {version.seqno for version in fitting}:
            shown = " or ".join(str(version.seqno) for version in fitting)
            yield Complaint("VD-PS-04", var_id, f"the own number {shown} in a request", f"{label} with {seqno}", frame)
        if versions == [variable.now]:
            said = variable.said[kind, 0] = variable.said.get((kind, 0), 0) + 1
            reasons = variable.armed.get((kind, 0), 0)
            if said > reasons:
                expected = f"{label} of variable {var_id} once for each reason to ask"
                yield Complaint("VD-SCP-01", var_id, expected, f"{said} for {reasons} reasons", frame)

    def _counted(self, kind: ICType, var_id: int, seqno: int, frame: int) -> Iterator[Complaint]:
        variable = self._variable(var_id)
        key = (kind, seqno if kind is ICType.UPDATES else 0)
        self.occasions["VD-SCP-02"] += 1
        count = variable.said[key] = variable.said.get(key, 0) + 1
        allowed = variable.armed.get(key, 0)
        if count > allowed:
            expected = f"{kind.label} of variable {var_id} in at most {allowed} beacons"
            yield Complaint("VD-SCP-02", var_id, expected, f"it stands in {count}", frame)

    # -- bookkeeping -------------------------------------------------------------------------------------------

    def _variable(self, var_id: int) -> Variable:
        variable = self.variables.get(var_id)
        if variable is None:
            variable = self.variables[var_id] = Variable()
            variable.versions.append(Version(-(1 << 62), "unknown", None, 0, b""))
        return variable

    def _become(self, var_id: int, version: Version) -> None:
        self._variable(var_id).versions.append(version)

    def _lately(self, var_id: int, time: int) -> Iterator[Version]:
        """What the variable was at any time within the latency, in order."""
        versions = list(self._variable(var_id).versions)
        for number, version in enumerate(versions):
            until = versions[number + 1].since if number + 1 < len(versions) else time
            if until >= time - self._latency:
                yield version

    def _arm(self, kind: ICType, var_id: int, time: int, frame: int, requirement: str) -> None:
        """The counter of an instruction is set: it may stand in repCnt beacons from now on, and must in one."""
        variable = self._variable(var_id)
        spec, seqno = variable.now.spec, variable.now.seqno
        key = (kind, seqno if kind is ICType.UPDATES else 0)
        variable.armed[key] = variable.armed.get(key, 0) + (spec.rep_cnt if spec is not None else 0)
        if len(variable.armed) > 2 * VERSIONS:
            oldest = next(iter(variable.armed))
            variable.armed.pop(oldest)
            variable.said.pop(oldest, None)
        if spec is not None and spec.rep_cnt > 0:
            self._owe(kind, var_id, seqno, time, frame, requirement)

    def _ask(self, kind: ICType, var_id: int, time: int, frame: int, requirement: str) -> None:
        """The node has a reason to ask: it may once more, and must if it is certain that the reason holds."""
        variable = self._variable(var_id)
        variable.armed[kind, 0] = variable.armed.get((kind, 0), 0) + 1
        if variable.now.state != "deleted":
            seqno = variable.now.seqno if kind is ICType.REQUEST_VARUPDATES else 0
            self._owe(kind, var_id, seqno, time, frame, requirement)

    def _unknown(self, var_id: int) -> bool:
        """Whether the node does not have a variable, or perhaps no longer."""
        state = self._variable(var_id).now.state
        return state == "unknown" or (state == "deleted" and self._perhaps_gone(var_id))

    def _owe(self, kind: ICType, var_id: int, seqno: int, time: int, frame: int, requirement: str) -> None:
        self.occasions[requirement] += 1
        owing = self._owed.setdefault(var_id, [])
        if not any(owed.kind is kind and owed.seqno == seqno for owed in owing):
            owing.append(Owed(time + self._window, kind, var_id, seqno, requirement, frame))

    def _settle(self, kind: ICType, var_id: int, seqno: int | None = None) -> None:
        """Something was said, or need not be any more. A newer number does for an older one; a create for an update."""
        owing = self._owed.pop(var_id, None)
        if owing and (left := [owed for owed in owing if not self._done(owed, kind, seqno)]):
            self._owed[var_id] = left

    def _done(self, owed: Owed, kind: ICType, seqno: int | None) -> bool:
        if owed.kind is kind:
            return kind is not ICType.UPDATES or seqno is None or not self._circle.newer(owed.seqno, seqno)
        return False

    def _forget(self, var_id: int) -> None:
        """A creation or deletion: everything that was to be said of the variable is dropped (VD-PC-08, VD-PD-04)."""
        self._owed.pop(var_id, None)

    def _perhaps_gone(self, var_id: int) -> bool:
        """Before 2.0: whether the last telling of a deletion may be composed already, and not be on the air yet."""
        variable, key = self._variable(var_id), (ICType.DELETE_VARIABLES, 0)
        left = variable.armed.get(key, 1) - variable.said.get(key, 0)
        return self._features.removed_after_deletion and left <= 1

    def _remove_when_told(self, var_id: int, time: int) -> None:
        """Before 2.0 a variable is gone once its deletion was told often enough."""
        variable = self._variable(var_id)
        key = (ICType.DELETE_VARIABLES, 0)
        if variable.said.get(key, 0) >= variable.armed.get(key, 1):
            variable.armed.clear()
            variable.said.clear()
            self._become(var_id, Version(time, "unknown", None, 0, b""))

    def _own(self, version: Version) -> bool:
        return version.spec is not None and version.spec.prod_id == self.own_id


def _seqno(record: VardisRecord) -> int:
    if isinstance(record, VarCreate):
        return record.upd.seqno
    number: int = getattr(record, "seqno", 0)
    return number
