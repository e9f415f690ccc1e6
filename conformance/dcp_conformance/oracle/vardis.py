"""Oracle for VarDis: computes from the received payloads of a node which instructions it must and may send.

The model has no queues. For a node that receives all given frames it computes the variables that it holds, the
instructions that it must send, and whether an instruction that it sends has a cause. A node may compose a payload up to
``latency`` before it sends it, so that every state during this time is accepted. Uncertain variables are not judged.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Collection, Iterable, Iterator
from typing import Any, Final

from dcp_spec.constants import ICType

from dcp_codec.values import VarCreate, VardisRecord, VarSpec, VarUpdate, own_values

from .knowledge import VERSIONS, Complaint, Obligation, State, Variable, Version
from .model import DELETION, Model, key_of
from .repetitions import Key

# Module-level names: faster than attributes of the enumeration in comparisons for each record.
_CREATES, _DELETES, _UPDATES = ICType.CREATE_VARIABLES, ICType.DELETE_VARIABLES, ICType.UPDATES
_SUMMARIES, _CREATE_REQUESTS = ICType.SUMMARIES, ICType.REQUEST_VARCREATES
_UPDATE_REQUESTS = ICType.REQUEST_VARUPDATES
#: Instructions with a repetition counter.
_REPEATED: Final = frozenset({_CREATES, _DELETES, _UPDATES})
_ASKED: Final = (_CREATE_REQUESTS, 0)
_ABOUT: Final = {
    _SUMMARIES: ("VD-CMP-04", "VD-CMP-05"),
    _DELETES: ("VD-PD-04",),
    _CREATES: ("VD-UPD-10", "VD-PU-07"),
    _UPDATES: ("VD-UPD-10", "VD-PU-07"),
}
#: Maximum number of remembered payloads with room.
_PAYLOADS = 4096


class Oracle(Model):
    """Models one node, and judges the payloads that it sends."""

    def __init__(self, *args: Any, **times: Any) -> None:
        """Arguments as for :class:`Model`."""
        super().__init__(*args, **times)
        self.spare = 0
        """Number of payloads that may be sent before a received one is processed, beside those on their way."""
        self._roomy: list[int] = []
        """Times (ns) of payloads that had room for another instruction."""

    def transmitted(
        self,
        records: Iterable[tuple[ICType, VardisRecord]],
        time: int,
        frame: int,
        *,
        roomy: bool = False,
        waited: int = 0,
        shown: Collection[int] = (),
    ) -> list[Complaint]:
        """Judge a payload that the node sent, and remove its instructions from those that the node must send.

        ``roomy``: any other instruction would have fitted, so that missing ones were not queued.
        ``waited``: time in ns that may be added to ``latency`` for this payload (:class:`~.waiting.Waiting`).
        ``shown``: variables whose present version the payload shows, so that it was composed after the node had it.
        """
        complaints: list[Complaint] = []
        variables, owed, removes = self.variables, self._owed, self._features.removed_after_deletion
        composed = time - self._latency - waited
        for kind, record in records:
            if isinstance(record, VarCreate):
                var_id, seqno = record.spec.var_id, record.upd.seqno
            else:
                var_id, seqno = record.var_id, getattr(record, "seqno", 0)
            variable = variables.get(var_id) or self._variable(var_id)
            if time >= variable.due:
                self._fade(variable, var_id, time)
            if var_id in owed:
                self._settle(kind, var_id, seqno)
            exhausted = kind in _REPEATED and self._exhausted(variable, key_of(kind, seqno), composed)
            if not variable.uncertain and variable.settled < composed and time < variable.due:
                known = variable.versions[-1]
                if kind is _SUMMARIES and known.seqno == seqno and known.state == "alive":
                    # Most of what a node says, and there is nothing else in it.
                    self._occur(kind)
                else:
                    # A version is never older than its own beginning.
                    since = max(composed, variable.now.since + 1) if var_id in shown else composed
                    complaints += self._judge(kind, record, variable, var_id, seqno, since, frame, exhausted)
            if removes and variable.versions[-1].state == "deleted":
                self._remove_after_last_delete(variable, time)
        if roomy:
            # As if it had waited no longer than others.
            self._roomy.append(composed + self._latency)
            if len(self._roomy) > _PAYLOADS:
                del self._roomy[: _PAYLOADS // 2]
        return complaints

    def overdue(self, time: int) -> list[Obligation]:
        """Return the instructions whose deadline is before ``time``; each is returned once."""
        late: list[Obligation] = []
        for var_id in list(self._owed):
            owing = self._owed.pop(var_id)
            late += [owed for owed in owing if owed.deadline < time]
            if later := [owed for owed in owing if owed.deadline >= time]:
                self._owed[var_id] = later
        late.sort(key=lambda owed: owed.deadline)
        return [owed for owed in late if not self._variable(owed.var_id).uncertain]

    def certain(self, var_id: int, time: int | None = None) -> Version | None:
        """Return the state of a variable at ``time`` (None: now); None if it is uncertain or was never queried."""
        variable = self.variables.get(var_id)
        if variable is None:
            return None
        if time is not None and time >= variable.due:
            self._fade(variable, var_id, time)
            if time >= variable.due:
                return None
        return None if variable.uncertain else variable.versions[-1]

    def holdings(self) -> Iterator[tuple[int, Version]]:
        """Yield the variables that are certain, with their states; timeouts are ignored."""
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
        composed: int,
        frame: int,
        exhausted: bool,
    ) -> Iterator[Complaint]:
        versions = self._since(variable, composed)
        if len(versions) == VERSIONS:
            # The state at the time of composition may be forgotten.
            return
        if kind is _CREATE_REQUESTS or kind is _UPDATE_REQUESTS:
            yield from self._judge_request(kind, variable, var_id, seqno, versions, frame)
            return
        needed: State = "deleted" if kind is _DELETES else "alive"
        self._occur(kind)
        fitting = [version for version in versions if version.state == needed]
        if not fitting:
            state = versions[-1].state
            # A deletion takes a variable out of all queues; of those that are not there, nothing is summarised either.
            of_nothing = needed == "alive" and (kind is _SUMMARIES or state == "unknown")
            requirement = "VD-CMP-05" if of_nothing else "VD-PD-04"
            observed = f"{kind.label} of it, while it is {state}"
            yield Complaint(requirement, var_id, f"nothing of the kind about variable {var_id}", observed, frame)
            return
        if isinstance(record, VarCreate) and (other := self._other_creation(record, var_id, fitting, frame)):
            yield other
            return
        if kind is not _DELETES:
            meant = [version for version in fitting if version.seqno == seqno]
            if not meant:
                shown = " or ".join(str(number) for number in sorted({version.seqno for version in fitting}))
                requirement = "VD-CMP-04" if kind is _SUMMARIES else "VD-UPD-10"
                yield Complaint(requirement, var_id, f"sequence number {shown}", f"{kind.label} with {seqno}", frame)
                return
            yield from self._judge_content(record, var_id, meant, frame)
            fitting = meant
        if kind is not _SUMMARIES and len(fitting) == 1 and fitting[0] is versions[-1]:
            # An instruction of an earlier creation, or of a moment ago, is not counted.
            yield from self._counted(kind, variable, var_id, seqno, frame, exhausted)

    def _occur(self, kind: ICType) -> None:
        for requirement in _ABOUT[kind]:
            self.occasions[requirement] += 1

    def _judge_content(
        self, record: VardisRecord, var_id: int, meant: list[Version], frame: int
    ) -> Iterator[Complaint]:
        """Yield a complaint if value or added fields are not those that belong to the sequence number (VD-PU-07)."""
        update = record.upd if isinstance(record, VarCreate) else record
        if not isinstance(update, VarUpdate):
            return
        if update.value not in {version.value for version in meant}:
            shown = " or ".join({version.value.hex(): None for version in meant})
            expected = f"the value {shown} for number {meant[0].seqno}"
            yield Complaint("VD-PU-07", var_id, expected, update.value.hex(), frame)
        elif not {None, own_values(update)} & {version.own for version in meant}:
            names: tuple[str, ...] = getattr(update, "ADDED", ())
            texts = [
                " ".join(f"{name} {value}" for name, value in zip(names, own or (), strict=False))
                for own in (own_values(update), *dict.fromkeys(version.own for version in meant))
            ]
            expected = f"the added fields {' or '.join(texts[1:])} for number {meant[0].seqno}"
            yield Complaint("VD-PU-07", var_id, expected, texts[0], frame)

    def _other_creation(self, record: VarCreate, var_id: int, fitting: list[Version], frame: int) -> Complaint | None:
        """Return a complaint if a forwarded VarCreate has a VarSpec that the node never stored (VD-PC-10)."""
        if self._own(fitting[-1]):
            # Only the producer knows the creation time of its own variable: it comes from its clock.
            return None
        self.occasions["VD-PC-10"] += 1
        specs = [version.spec for version in fitting if version.spec is not None]
        if not specs or record.spec in specs:
            return None
        expected, observed = f"the creation of {_described(specs[-1])}", f"that of {_described(record.spec)}"
        return Complaint("VD-PC-10", var_id, expected, observed, frame)

    def _judge_request(
        self, kind: ICType, variable: Variable, var_id: int, seqno: int, versions: list[Version], frame: int
    ) -> Iterator[Complaint]:
        """Yield complaints about a request: no need for it, a wrong sequence number, or more requests than causes."""
        self.occasions["VD-PS-02"] += 1
        self.occasions["VD-SCP-01"] += 1
        if kind is _CREATE_REQUESTS:
            removes = self._features.removed_after_deletion
            fitting = [each for each in versions if each.state == "unknown" or (removes and each.state == "deleted")]
        else:
            self.occasions["VD-PS-04"] += 1
            fitting = [version for version in versions if version.state == "alive" and not self._own(version)]
        if not fitting:
            mine = " of its own" if self._own(versions[-1]) else ""
            observed = f"{kind.label}, while it is {versions[-1].state}{mine}"
            yield Complaint("VD-PS-02", var_id, f"no request for variable {var_id}", observed, frame)
            return
        if kind is _UPDATE_REQUESTS and seqno not in {version.seqno for version in fitting}:
            numbers = " or ".join(str(version.seqno) for version in fitting)
            observed = f"{kind.label} with {seqno}"
            yield Complaint("VD-PS-04", var_id, f"the own number {numbers} in a request", observed, frame)
        # The number of a request for an update shows the version with which it was composed.
        shown = [each for each in fitting if each.seqno == seqno] if kind is _UPDATE_REQUESTS else versions
        if len(shown) == 1 and shown[0] is variable.versions[-1]:
            sent, reasons = variable.repetitions.count((kind, 0))
            if sent > reasons:
                expected = f"{kind.label} of variable {var_id} once for each reason to ask"
                yield Complaint("VD-SCP-01", var_id, expected, f"{sent} for {reasons} reasons", frame)

    def _counted(
        self, kind: ICType, variable: Variable, var_id: int, seqno: int, frame: int, exhausted: bool
    ) -> Iterator[Complaint]:
        key = key_of(kind, seqno)
        self.occasions["VD-SCP-02"] += 1
        count, allowed = variable.repetitions.count(key)
        if count > allowed + self.spare:
            expected = f"no {kind.label} about variable {var_id}"
            if allowed:
                expected = f"{kind.label} about variable {var_id} in at most {_beacons(allowed)}"
            yield Complaint("VD-SCP-02", var_id, expected, f"it in {_beacons(count)}", frame)
        elif exhausted:
            expected = f"no {kind.label} of variable {var_id} after a payload with room for it but without it"
            yield Complaint("VD-SCP-02", var_id, expected, "it is there again, without a reason", frame)

    def _exhausted(self, variable: Variable, key: Key, composed: int) -> bool:
        """Count an instruction, and return whether its queue was already empty.

        The queue was empty if a payload after the last cause had room for the instruction and did not contain it.
        """
        stood = variable.repetitions.stands(key, composed)
        if stood is None:
            return False
        return self._emptied(*stood)

    def _emptied(self, armed: int, since: int) -> bool:
        """Return whether an instruction left its queue: it was not in all roomy payloads after its last cause.

        ``armed``: time of the cause in ns; ``since``: the number of payloads after it that had the instruction.
        """
        return len(self._roomy) - bisect_right(self._roomy, armed + self._latency) > since

    def _since(self, variable: Variable, since: int) -> list[Version]:
        """Return the states of the variable since the time ``since`` (ns), oldest first."""
        versions = variable.versions
        found = [versions[-1]]
        place = len(versions) - 1
        while place > 0 and versions[place].since >= since:
            place -= 1
            found.append(versions[place])
        found.reverse()
        return found

    def _remove_after_last_delete(self, variable: Variable, time: int) -> None:
        """Remove a variable after the last VarDelete (before 2.0)."""
        if variable.repetitions.counted(DELETION) >= max(variable.repetitions.allowed(DELETION), 1):
            # It may have been asked for after the last VarDelete was composed.
            asked = variable.repetitions.get(_ASKED)
            variable.repetitions.clear()
            if asked is not None:
                variable.repetitions[_ASKED] = asked
            self._become(variable, Version(time, "unknown", None, 0, b""))


def _described(spec: VarSpec) -> str:
    """Return a VarSpec as text, without varId."""
    since_2_0 = "" if spec.creation_time is None else f", creationTime {spec.creation_time}, timeout {spec.timeout}"
    return f"{spec.prod_id.hex(':')} with repCnt {spec.rep_cnt}{since_2_0}, descr {spec.descr.hex()}"


def _beacons(count: int) -> str:
    return f"{count} beacon{'' if count == 1 else 's'}"
