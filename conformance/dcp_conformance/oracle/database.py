"""Model of the VarDis entity of a node: the instructions of :class:`Oracle`, and services, activity, order and room."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any, Final, Literal

import msgspec
from dcp_spec.constants import Features, ICType, SpecVersion

from dcp_codec.values import Container, VarCreate, VardisRecord, VarSpec

from .judgement import MS, Expected, Finding
from .knowledge import NEVER, VERSIONS, Limits, Obligation, State, Variable, Version
from .model import TAUGHT, processing_order
from .queues import Order
from .repetitions import IN_FLIGHT
from .services import OK, Situation, expected
from .vardis import Oracle

_CREATES, _DELETES, _UPDATES = ICType.CREATE_VARIABLES, ICType.DELETE_VARIABLES, ICType.UPDATES
_SUMMARIES, _CREATE_REQUESTS = ICType.SUMMARIES, ICType.REQUEST_VARCREATES
_UPDATE_REQUESTS = ICType.REQUEST_VARUPDATES
#: By kind: the requirement about the order of records that return to the tail.
_ROTATION: Final = {
    _CREATES: "VD-CMP-06", _DELETES: "VD-CMP-10", _UPDATES: "VD-CMP-09", _SUMMARIES: "VD-CMP-03",
    _CREATE_REQUESTS: "VD-PAY-06", _UPDATE_REQUESTS: "VD-PAY-06",
}  # fmt: skip
#: The instructions that each counter of a variable is about.
_COUNTED: Final = {"countUpdate": _UPDATES, "countCreate": _CREATES, "countDelete": _DELETES}
#: Instructions that are sent several times.
_ROTATED: Final = frozenset({_CREATES, _DELETES, _UPDATES})
#: By kind of a record that has not changed a variable: the requirements.
_IGNORED: Final = {
    _CREATES: ("VD-PC-01", "VD-PC-04"), _DELETES: ("VD-PD-01", "VD-PD-03"), _UPDATES: ("VD-PU-05", "VD-PU-03"),
}  # fmt: skip
#: By the requirement that refuses a VarCreate: its flaw.
_FLAWS: Final = {
    "VD-PC-03": "own", "VD-PC-04": "bad value", "VD-PC-05": "bad description", "VD-PC-06": "bad repCnt",
}  # fmt: skip
_TAKEN: Final = {_CREATES: ("VD-PC-07",), _DELETES: ("VD-PD-04",), _UPDATES: ("VD-PU-07",)}
#: By the requirement of a creation: the one by which a known variable leaves all queues first.
_EMPTIES: Final[dict[tuple[str, ...], str]] = {("VD-PC-07",): "VD-PC-08", ("VD-CRE-11",): "VD-CRE-11"}
#: Number of payloads without the summary of a variable that show that it is in no queue.
_ABSENT: Final = 3
_STATES: Final[tuple[State, ...]] = ("unknown", "alive", "deleted")
_SITUATIONS: Final = tuple(Situation(state, own) for state in _STATES for own in (False, True))


class Due(msgspec.Struct):
    """An instruction in its queue. Each payload with room must contain it until it has been sent often enough."""

    left: int
    """Number of payloads that must still contain it."""
    time: int
    """When it was queued, ns."""
    requirement: str
    cause: int
    """Number of the frame that asks for it; 0 for a service call."""


class Room:
    """Sizes in octets that decide whether a record fits into a payload."""

    def __init__(self, header: int, sizes: Mapping[ICType, int], most: int, summaries: int) -> None:
        """``sizes``: of a record of each type without value and description. ``most``: VARDISPAR_MAX_PAYLOAD_SIZE."""
        self.header = header
        self.sizes = sizes
        self.most = self.registered = most
        self.summaries = summaries
        self.former: list[tuple[int, int, int]] = []
        """Former values of size and summaries, with the times of their changes, ns."""

    @property
    def limit(self) -> int:
        """The largest payload in octets that the parameter and the registration with BP allow."""
        return min(self.most, self.registered)


class VardisModel(Oracle):
    """The VarDis entity of one node. Only the variables in ``mine`` are judged."""

    def __init__(self, own_id: bytes, features: Features, width: int, limits: Limits, room: Room, **times: Any) -> None:
        """``width``: octets of a sequence number. ``times``: as for :class:`~.model.Model`."""
        self.late: int = times.pop("late", 0)
        spare: int = times.pop("spare", 0)
        self._in_order: bool = times.pop("in_order", True)
        """True if service calls are short enough to judge the order of queues."""
        self._lossy: bool = times.pop("lossy", False)
        self._whole: bool = times.pop("whole", False)
        """Whether a received payload is processed as a whole, and no payload is composed in between."""
        self._clock: int | None = times.pop("clock", None)
        """Largest difference between the node's clock and the tester's; None if it is unknown."""
        self._offset = 0
        """Time since 1970 minus the time of the tester at the last confirm, ns."""
        self._scrubs: bool | None = times.pop("scrubs", None)
        """Whether the node scrubs the variables of others (X26); None if neither is known."""
        super().__init__(own_id, features, width, limits, **times)
        self.spare = spare
        self.room = room
        self.active = True
        self.switched = -(1 << 62)
        self.mine: set[int] = set()
        self.why: dict[int, tuple[str, ...]] = {}
        """By variable: the requirements that decide its state after the last event."""
        self._absent: dict[int, int] = {}
        """By variable: the number of payloads in a row with room for its summary and without it."""
        self._due: dict[tuple[ICType, int], Due] = {}
        """By kind and variable."""
        self._order = Order(self.late, in_order=features.version >= SpecVersion.V1_2)
        self._longest = (limits.max_value_length, limits.max_description_length)
        self._told: dict[int, tuple[Version, int, int]] = {}
        """By variable: its version when the node sent the last VarDelete, the time of that VarDelete in ns, and the
        number of VarDeletes during this version."""
        self._asked: dict[tuple[ICType, int], int] = {}
        """By kind and variable: the time of the only reason for the request that the node may have queued, ns."""
        self._passed: dict[int, int] = {}
        """Variables of others whose timeout has passed, with the time at which a scrubbing node has deleted them."""
        self.payloads = 0

    # -- what the node receives ------------------------------------------------------------------------------

    def hear(self, records: Sequence[VardisRecord], time: int, frame: int) -> None:
        """Process the records of a payload that a node received at ``time`` or shortly after."""
        if not self.active:
            for record in records:
                self.why[var_id_of(record)] = ("VD-MGT-03",)
            return
        ids = {var_id_of(record) for record in records}
        for var_id in ids:
            # A record may renew or delete it.
            self._passed.pop(var_id, None)
        before = {var_id: self._variable(var_id).now for var_id in ids}
        self._order.next_event()
        for position, each in enumerate(sorted(records, key=processing_order)):
            self._order.next_record(each.IC_TYPE, position)
            super().hear((each,), time, frame)
        self._order.next_record(None)
        for record in records:
            var_id, kind = var_id_of(record), record.IC_TYPE
            if kind in _TAKEN and not self._variable(var_id).uncertain:
                changed = self._variable(var_id).now is not before[var_id]
                self.why[var_id] = _TAKEN[kind] if changed else _refusal(record, self.own_id, self._limits)
        if self._lossy:
            for var_id in ids:
                self.doubt(var_id)

    def _receive_create(self, record: VarCreate, variable: Variable, time: int, frame: int) -> None:
        before, new = variable.now, self._is_new(variable)
        super()._receive_create(record, variable, time, frame)
        if variable.now is not before:
            self._queued(record.spec.var_id, time, "VD-PC-09", new=new)

    @staticmethod
    def _is_new(variable: Variable) -> bool:
        """Return whether the node surely has nothing of a variable in its queues."""
        return not variable.uncertain and variable.now.state == "unknown"

    def _queued(self, var_id: int, time: int, requirement: str, *, new: bool) -> None:
        """Record that a creation puts a variable into createQ and summaryQ."""
        self._passed.pop(var_id, None)
        self._order.remove(var_id)
        # 1.0 does not remove the variable from these queues first.
        waiting = not new and self._features.version < SpecVersion.V1_1
        for kind in (_SUMMARIES, _CREATES):
            self._order.append(kind, var_id, time, requirement, waiting=waiting, renewed=not new)

    def _oblige(self, kind: ICType, var_id: int, seqno: int, time: int, frame: int, requirement: str) -> None:
        waiting = kind in (_UPDATES, _CREATES) or any(each.kind is kind for each in self._owed.get(var_id, ()))
        super()._oblige(kind, var_id, seqno, time, frame, requirement)
        if requirement not in ("VD-PC-09", "VD-CRE-12"):
            self._order.append(kind, var_id, time, requirement, waiting=waiting)

        spec = self.variables[var_id].now.spec
        before = self._due.get((kind, var_id))
        if kind in _ROTATED and requirement not in TAUGHT and spec is not None:
            self._due[kind, var_id] = Due(spec.rep_cnt, time, requirement, frame)
        elif before is None:
            # Sent once for certain: it may have been in its queue already.
            self._due[kind, var_id] = Due(1, time, requirement, frame)

    def _arm(self, kind: ICType, var_id: int, time: int, frame: int, requirement: str) -> None:
        idle = requirement in TAUGHT and self._surely_sent(var_id) and not self._surely_queued(kind, var_id)
        super()._arm(kind, var_id, time, frame, requirement)
        spec = self.variables[var_id].now.spec
        if idle and spec is not None and spec.rep_cnt > 0:
            # The answer found none of its variable in the queue.
            self._due[kind, var_id] = Due(spec.rep_cnt, time, requirement, frame)

    def _ask(self, kind: ICType, var_id: int, time: int, frame: int, requirement: str) -> None:
        one = self.variables[var_id].repetitions.get((kind, 0))
        self._asked[kind, var_id] = time if one is None or one.counted == one.allowed else NEVER
        super()._ask(kind, var_id, time, frame, requirement)

    def _surely_sent(self, var_id: int) -> bool:
        """Return whether all VarUpdates of a variable were sent, so that none is in the queue."""
        for key, one in self.variables[var_id].repetitions.items():
            left = key[0] is _UPDATES and one.since is not None and one.counted < one.allowed
            if left and not self._emptied(one.since or 0, one.behind):
                return False
        return True

    def _surely_queued(self, kind: ICType, var_id: int) -> bool:
        due = self._due.get((kind, var_id))
        return due is not None and due.left > IN_FLIGHT and not self._lossy

    def _settle(self, kind: ICType, var_id: int, seqno: int | None = None) -> None:
        super()._settle(kind, var_id, seqno)
        if seqno is None:
            self._due.pop((kind, var_id), None)

    def _forget(self, var_id: int) -> None:
        super()._forget(var_id)
        self._remove(var_id)

    def _remove(self, var_id: int) -> None:
        """Record that a variable is in no queue, or that this is not known."""
        self._order.remove(var_id)
        for kind in ICType:
            self._due.pop((kind, var_id), None)

    def _lose(self, variable: Variable) -> None:
        super()._lose(variable)
        for var_id, each in self.variables.items():
            if each is variable:
                self._remove(var_id)

    def _fade(self, variable: Variable, var_id: int, time: int) -> None:
        """Process a timeout: only a node that scrubs the variables of others deletes them (X26)."""
        own = self._own(variable.now)
        if own or self._scrubs:
            due, before = variable.due, variable.now
            super()._fade(variable, var_id, time)
            if variable.now.state != "deleted":
                return
            self.why[var_id] = ("VD-SCR-04", "VD-SCR-05")
            version, told, count = self._told.get(var_id, (None, due, 0))
            if version is not before or told <= due:
                count = 0
            left = 0 if before.spec is None else before.spec.rep_cnt - count
            if left > 0:
                # Its place in the queue is not known.
                if not count:
                    super()._oblige(_DELETES, var_id, 0, time, 0, "VD-SCR-04")
                self._due[_DELETES, var_id] = Due(left, time, "VD-SCR-04", 0)
        elif self._scrubs is None and time >= variable.due:
            self._passed[var_id] = variable.due + (self._scrubbing or 0) + self._latency
            self._lose(variable)
        elif self._scrubs is False:
            variable.due = NEVER

    # -- services --------------------------------------------------------------------------------------------

    def expect(self, method: str, params: Mapping[str, Any], time: int) -> list[Expected]:
        """Return the statuses that a service may answer now; empty for an unknown service."""
        var_id = params.get("varId")
        situations: Iterable[Situation] = _SITUATIONS
        if type(var_id) is int and var_id in self.mine:
            self._variable(var_id)
            version = self.certain(var_id, time)
            if version is not None:
                situations = (Situation(version.state, self._own(version)),)
            elif self.variables[var_id].foreign:
                situations = [each for each in _SITUATIONS if not each.own and each.state != "unknown"]
        return expected(method, params, situations, self._limits, self._features, active=self.active)

    def confirmed(
        self, method: str, params: Mapping[str, Any], result: Mapping[str, Any], time: int, offset: int = 0
    ) -> Iterator[Finding]:
        """Take the confirm of a service with an expected status into account. ``offset``: wall clock minus ``time``."""
        self._offset = offset
        if method in ("VD-MGMT-Activate", "VD-MGMT-Deactivate"):
            self._switch(method == "VD-MGMT-Activate", time)
            return
        if str(result.get("status", "")).replace("_", "-") != OK or not self.active:
            return
        var_id = params.get("varId")
        match method:
            case "RTDB-Update":
                self.updated(params["varId"], bytes.fromhex(params["value"]), time)
                self.why[params["varId"]] = ("VD-UPD-08",)
            case "RTDB-Delete":
                self.deleted(params["varId"], time)
                self.why[params["varId"]] = ("VD-DEL-05",)
            case "RTDB-Read" if var_id in self.mine:
                yield from self._observed(params["varId"], result, "alive", ("VD-REA-04",), time)
            case "RTDB-DescribeVariable" if var_id in self.mine:
                row = result.get("variable", {})
                yield from self._described(params["varId"], row, ("VD-DVA-03",), time)
            case "RTDB-DescribeDatabase":
                yield from self._listed(result.get("variables", ()), time)

    def created_by_application(self, spec: VarSpec, value: bytes, time: int) -> None:
        """Process an RTDB-Create with status OK; see :meth:`~.model.Model.created`."""
        variable = self._variable(spec.var_id)
        again, new = variable.now.state != "unknown", self._is_new(variable)
        self.created(spec, value, time)
        self._queued(spec.var_id, time, "VD-CRE-12", new=new)
        self.why[spec.var_id] = ("VD-CRE-11", "VD-CRE-03") if again else ("VD-CRE-10", "VD-CRE-12")

    def began(self, var_id: int, earlier: int) -> None:
        """Begin the timeout of a variable ``earlier`` ns before the confirm of the service that has started it.

        Call once after each RTDB-Create or RTDB-Update with status OK.
        """
        variable = self.variables[var_id]
        if self.active and variable.due != NEVER:
            variable.due -= earlier

    def _switch(self, active: bool, time: int) -> None:
        if active == self.active:
            return
        self.active, self.switched = active, time
        # X37: what was pending may be dropped; X36: whether time passes for variables with a timeout is open.
        self._owed.clear()
        self._due.clear()
        self._passed.clear()
        self._order.forget()
        for variable in self.variables.values():
            if variable.due != NEVER:
                self._lose(variable)

    def _reasons(self, var_id: int, otherwise: tuple[str, ...]) -> tuple[str, ...]:
        return self.why.get(var_id, otherwise)

    def differs(self, var_id: int, requirement: str) -> tuple[str, ...]:
        """Return the requirements of a status that differs from that of the state of a variable."""
        return (requirement, *self.why.get(var_id, ())[:1])

    def _observed(
        self, var_id: int, row: Mapping[str, Any], state: State, which: tuple[str, ...], time: int
    ) -> Iterator[Finding]:
        """Compare the state and the value of a variable that a service shows."""
        yield from self._scrubbed(var_id, state, time)
        version = self.certain(var_id, time)
        if version is None:
            return
        if version.state != state:
            self.doubt(var_id)
            yield Finding(self._reasons(var_id, which), f"variable {var_id} {version.state}", state)
            return
        value = row.get("value")
        if value is not None and state == "alive" and value.lower() != version.value.hex():
            self.doubt(var_id)
            yield Finding(self._reasons(var_id, which), f"value {_brief(version.value.hex())}", _brief(value))
            return
        stamp = row.get("tStamp")
        if self._clock is None or type(stamp) is not int or state != "alive":
            return
        off = stamp - self._offset - version.since
        if not -self._clock - self._latency <= off <= self._clock + self._latency + self.late:
            reasons = (*which, "VD-DB-03", *self._reasons(var_id, ())[:1])
            expected = f"the time of the last change of variable {var_id} as tStamp"
            yield Finding(tuple(dict.fromkeys(reasons)), expected, f"a time {off / MS:g} ms later")

    def _scrubbed(self, var_id: int, state: State, time: int) -> Iterator[Finding]:
        """Take the state of a variable of another node after its timeout into account (X26)."""
        gone = self._passed.get(var_id)
        if gone is None or not self.active:
            return
        if state == "alive" and time > gone + self.late:
            if self._scrubs:
                self._passed.pop(var_id)
                yield Finding(("VD-SCR-04", "VD-SCR-05"), f"variable {var_id} deleted after its timeout", state)
            else:
                # It must not be deleted later, either.
                self._scrubs = False
        elif state == "deleted":
            self._passed.pop(var_id)
            if self._scrubs is False:
                expected = "every variable is scrubbed within a period after its timeout, or none of other nodes"
                yield Finding(("VD-SCR-03", "VD-SCR-04"), expected, f"variable {var_id} was deleted later")
            self._scrubs = True

    def _described(self, var_id: int, row: Mapping[str, Any], which: tuple[str, ...], time: int) -> Iterator[Finding]:
        state: State = "deleted" if row.get("isDeleted") else "alive"
        if "isDeleted" in row:
            yield from self._observed(var_id, row, state, which, time)
        version = self.certain(var_id, time)
        if version is None or version.spec is None or version.state == "unknown":
            return
        spec = version.spec
        shown = {
            "seqno": version.seqno, "repCnt": spec.rep_cnt, "timeout": spec.timeout,
            "prodId": spec.prod_id, "descr": spec.descr,
            "creationTime": spec.creation_time if not self._own(version) else None,
        }  # fmt: skip
        for name, wanted in shown.items():
            got = _field(row, name)
            if wanted is None or got is None or got == wanted:
                continue
            if name == "prodId" and isinstance(wanted, bytes) and _same_node(got, wanted):
                continue
            self.doubt(var_id)
            reasons = (*which, *self._reasons(var_id, ())[:1])
            about: Literal["", "creationTime"] = "creationTime" if name == "creationTime" else ""
            yield Finding(reasons, f"{name} {_text(wanted)} of variable {var_id}", _text(got), about)
            return
        why = self._reasons(var_id, ())[:1]
        for name in ("countUpdate", "countCreate", "countDelete"):
            count = row.get(name)
            if type(count) is not int:
                continue
            if not 0 <= count <= spec.rep_cnt:
                yield Finding((*which, "VD-DB-01", *why), f"{name} of at most {spec.rep_cnt}", str(count))
                return
            due = self._due.get((_COUNTED[name], var_id))
            # One payload may have been composed with the event.
            if due is not None and due.time == time and not self._latency + self.late and count < due.left - 1:
                yield Finding((due.requirement, *which), f"{name} of at least {due.left - 1} at once", str(count))
                return

    def _listed(self, rows: Iterable[Mapping[str, Any]], time: int) -> Iterator[Finding]:
        found: dict[Any, Mapping[str, Any]] = {}
        for each in rows:
            if each.get("varId") in found and each.get("varId") in self.mine:
                yield Finding(("VD-DB-01",), f"variable {each.get('varId')} once", "twice")
            found[each.get("varId")] = each
        for var_id in sorted(self.mine):
            variable = self.variables.get(var_id)
            version = self.certain(var_id, time)
            row = found.get(var_id)
            if row is not None:
                if version is not None and version.state == "unknown":
                    self.doubt(var_id)
                    yield Finding(self._reasons(var_id, ("VD-DDB-02",)), f"no variable {var_id}", "it is listed")
                    continue
                yield from self._described(var_id, row, ("VD-DDB-02",), time)
                continue
            surely = version is not None and version.state != "unknown"
            if self._features.removed_after_deletion:
                surely = version is not None and version.state == "alive"
            elif version is None:
                surely = variable is not None and variable.foreign
            if surely:
                which = ("VD-DDB-02", "VD-DB-02") if version is None or version.state == "deleted" else ("VD-DDB-02",)
                self.doubt(var_id)
                yield Finding(which, f"variable {var_id} in the database", "not listed")

    # -- parameters ------------------------------------------------------------------------------------------

    def set_limits(
        self, time: int, *, value: int | None = None, descr: int | None = None, repetitions: int | None = None
    ) -> None:
        """Record new limits of values, descriptions and repetitions."""
        del time
        old = self._limits
        self._limits = Limits(
            old.max_value_length if value is None else value,
            old.max_description_length if descr is None else descr,
            old.max_repetitions if repetitions is None else repetitions,
        )
        self._most_repetitions = max(self._most_repetitions, self._limits.max_repetitions)
        self._longest = (
            max(self._longest[0], self._limits.max_value_length),
            max(self._longest[1], self._limits.max_description_length),
        )

    def set_room(self, time: int, *, most: int | None = None, summaries: int | None = None) -> None:
        """Record a new VARDISPAR_MAX_PAYLOAD_SIZE or VARDISPAR_MAX_SUMMARIES."""
        room = self.room
        room.former.append((time, room.most, room.summaries))
        room.most = room.most if most is None else most
        room.summaries = room.summaries if summaries is None else summaries

    def set_scrubbing(self, period: int) -> None:
        """Record a new VARDISPAR_SCRUBBING_PERIOD in ns; the running period may still end first."""
        if self._scrubbing is not None:
            self._scrubbing = max(self._scrubbing, period)
            self._passed.clear()

    def set_window(self, window: int) -> None:
        """Record a new longest time from a cause to the payload that shows it, ns; never a shorter one."""
        self._window = max(self._window, window)

    # -- payloads of the node --------------------------------------------------------------------------------

    def payload(
        self, containers: Sequence[Container], octets: int, since: int, time: int, frame: int
    ) -> Iterator[Finding]:
        """Judge a payload of ``octets`` octets, composed at ``since`` or later and received at ``time`` (ns)."""
        self.payloads += 1
        causes, shown = self._shown(containers), self._shown_versions(containers)
        since = max([since, *causes.values()])
        former = [(size, count) for changed, size, count in self.room.former if changed >= since]
        most = max([self.room.most, *(size for size, _ in former)])
        summaries = max([self.room.summaries, *(count for _, count in former)])
        if octets > most:
            yield Finding(("VD-IC-05",), f"at most {most} octets of containers", str(octets))
        groups: dict[ICType, list[VardisRecord]] = {}
        records: list[tuple[ICType, VardisRecord]] = []
        for container in containers:
            kind = container.records[0].IC_TYPE if container.records else None
            if kind is None:
                continue
            groups.setdefault(kind, []).extend(container.records)
            records += [(kind, each) for each in container.records if var_id_of(each) in self.mine]
        kinds = [each for each in self._features.container_order if each in groups]
        if list(groups) != kinds:
            which = "VD-PAY-01" if self._features.version >= SpecVersion.V1_1 else "VD-PAY-07"
            wanted, found_order = (", ".join(each.label for each in some) for some in (kinds, groups))
            yield Finding((which,), f"containers in the order {wanted}", found_order)
        if len(groups.get(_SUMMARIES, ())) > summaries:
            yield Finding(("VD-CMP-02",), f"at most {summaries} summaries", str(len(groups[_SUMMARIES])))
        for kind, found in groups.items():
            ids = [var_id_of(each) for each in found]
            if len(set(ids)) < len(ids) and self.mine.intersection(ids):
                twice = next(each for each in ids if ids.count(each) > 1)
                yield Finding(("VD-PAY-03",), f"variable {twice} once in {kind.label}", "twice")
        roomy = octets + self._needs(_CREATES) + self.room.header <= self.room.limit
        # A received payload may be processed later.
        waited = max(0, time - self._latency - since) + self.late
        owed = {} if self._lossy else {var_id: list(each) for var_id, each in self._owed.items()}
        for each in self.transmitted(records, time, frame, roomy=roomy and not self._lossy, waited=waited, shown=shown):
            unasked = each.expected.startswith("no ")
            yield Finding(self._named(each.requirement, each.var_id, unasked=unasked), each.expected, each.observed)
        if not self._lossy:
            if self._in_order:
                yield from self._ordered(groups, since, owed, shown)
            if not former:
                free = self.room.limit - octets - self.room.header
                yield from self._missing(groups, free, since, causes if self._whole else {})
                yield from self._unsummarised(groups.get(_SUMMARIES, ()), free, since)
        for kind, record in records:
            var_id = var_id_of(record)
            if kind is _DELETES:
                now = self._variable(var_id).now
                version, _, count = self._told.get(var_id, (now, 0, 0))
                self._told[var_id] = now, time, count + 1 if version is now else 1
            if due := self._due.get((kind, var_id)):
                due.left -= 1
                if not due.left:
                    del self._due[kind, var_id]

    def _shown(self, containers: Sequence[Container]) -> dict[int, int]:
        """Return the numbers and times of the frames, or services (0), that a payload certainly shows."""
        found: dict[int, int] = {}
        for container in containers:
            for record in container.records:
                for each in self._owed.get(var_id_of(record), ()) if record.IC_TYPE is not None else ():
                    if each.kind is record.IC_TYPE and each.kind in (_CREATE_REQUESTS, _DELETES):
                        found[each.cause] = max(found.get(each.cause, each.time), each.time)
        return found

    def _shown_versions(self, containers: Sequence[Container]) -> set[int]:
        """Return the variables of which a payload shows the present version, and no earlier one."""
        found = set[int]()
        for record in (each for container in containers for each in container.records):
            variable = self.variables.get(var_id_of(record))
            if variable is None or variable.uncertain or not 1 < len(variable.versions) < VERSIONS:
                continue
            kind = record.IC_TYPE
            if self._whole and kind and variable.now.since == self._asked.get((kind, var_id_of(record))):
                # The reason to ask, and the change of the variable, came at the same time.
                found.add(var_id_of(record))
            if kind not in (_SUMMARIES, _UPDATES, _CREATES):
                continue
            *earlier, now = variable.versions
            if self._shows(record, now) and not any(self._shows(record, each) for each in earlier):
                found.add(var_id_of(record))
        return found

    def _shows(self, record: VardisRecord, version: Version) -> bool:
        """Return whether a node with this version of a variable could send a record about it."""
        update = record.upd if isinstance(record, VarCreate) else record
        if version.state != "alive" or version.seqno != getattr(update, "seqno", None):
            return False
        if not isinstance(record, VarCreate) or version.spec is None:
            return True
        mine = self._own(version) and not version.spec.creation_time
        return mine or version.spec == record.spec

    def _named(self, requirement: str, var_id: int, *, unasked: bool) -> tuple[str, ...]:
        """Return the requirements of a complaint. ``unasked``: about an instruction that nothing has queued."""
        why = self.why.get(var_id, ())
        if requirement in ("VD-PD-04", "VD-CMP-05", "VD-PS-02") and why:
            return (why[0], requirement) if why[0] != requirement else (requirement,)
        if requirement == "VD-SCP-02" and unasked and why[:1] in _EMPTIES:
            return (requirement, _EMPTIES[why[:1]])
        return (requirement,)

    def _needs(self, kind: ICType) -> int:
        """Return the largest possible size of a record, in octets."""
        size = self.room.sizes[kind]
        value, descr = self._longest
        return size + (value if kind in (_CREATES, _UPDATES) else 0) + (descr if kind is _CREATES else 0)

    def _ordered(
        self,
        groups: Mapping[ICType, list[VardisRecord]],
        since: int,
        owed: Mapping[int, list[Obligation]],
        shown: Collection[int],
    ) -> Iterator[Finding]:
        """Judge the order of the records of each container, and of those that it lacks."""
        self._order.next_payload(since)
        for kind, records in groups.items():
            ids = [var_id for each in records if (var_id := var_id_of(each)) in self.mine]

            def queued(var_id: int, since: int, kind: ICType = kind) -> bool:
                variable = self.variables.get(var_id)
                if variable is None or variable.uncertain or self._needs(kind) + self.room.header > self.room.most:
                    return False
                if kind is _SUMMARIES:
                    version = variable.now
                    return version.state == "alive" and variable.due == NEVER and variable.settled < since
                times = [each.time for each in owed.get(var_id, ()) if each.kind is kind]
                if due := self._due.get((kind, var_id)):
                    times.append(due.time)
                return any(each + self.late < since for each in times)

            for passed, first, place, together in self._order.payload(
                kind, ids, since - self.late, queued, shown, whole=self._whole
            ):
                which = place.requirement if place.appended is not None and place.requirement else _ROTATION[kind]
                if kind in (_CREATES, _DELETES, _UPDATES) and place.appended is not None:
                    which = "VD-PAY-06"
                reasons = ("VD-RX-09", which) if together else (which,)
                expected = f"{kind.label} of variable {passed}, which was queued before {first}"
                # It is not there at all, if the event before had no effect.
                causes = (*reasons, *(("VD-CMP-03",) if kind is _SUMMARIES else ()), *self.why.get(passed, ())[:1])
                yield Finding(tuple(dict.fromkeys(causes)), expected, f"that of {first} first")
                self._order.forget()
                break
            self._order.sent(kind, ids, since, shown)

    def _missing(
        self, groups: Mapping[ICType, list[VardisRecord]], free: int, since: int, causes: Mapping[int, int]
    ) -> Iterator[Finding]:
        """Yield a finding for a record that must be in this payload: it was queued before, and any record would fit.

        ``free``: octets for records in one more container. ``causes``: frames that the payload shows, each of which was
        processed as a whole before it was composed.
        """
        for (kind, var_id), due in self._due.items():
            variable, there = self.variables[var_id], groups.get(kind, ())
            if var_id not in self.mine or variable.uncertain or variable.due != NEVER:
                continue
            if any(var_id_of(each) == var_id for each in there) or len(there) >= 255:
                continue
            shown = due.cause and causes.get(due.cause) == max(due.time, variable.settled)
            if (max(due.time, variable.settled) + self.late >= since and not shown) or self._needs(kind) > free:
                continue
            if kind in (_CREATES, _UPDATES) and not self._features.receive_checks_too_long:
                # The head of the queue may have any size, and hold up the others.
                continue
            del self._due[kind, var_id]
            spec = variable.now.spec
            which: tuple[str, ...]
            if kind in _ROTATED and spec is not None and due.left < spec.rep_cnt:
                which = (due.requirement, _ROTATION[kind])
            else:
                which = ("VD-PAY-02", due.requirement) if there else (due.requirement, "VD-CMP-13", "VD-PAY-02")
            yield Finding(which, f"{kind.label} of variable {var_id} in this payload, which has room", "none")
            return

    def _unsummarised(self, there: Sequence[VardisRecord], free: int, since: int) -> Iterator[Finding]:
        """Yield a finding for a variable that several payloads with room for its summary lack."""
        # Variables that were deleted may take a place in one payload.
        if len(there) >= self.room.summaries or self._needs(_SUMMARIES) > free:
            self._absent.clear()
            return
        ids = {var_id_of(each) for each in there}
        for var_id in self.mine:
            variable = self.variables.get(var_id)
            if variable is None or var_id in ids or variable.now.state != "alive":
                self._absent.pop(var_id, None)
            elif self._alive_since(variable, since - self.late):
                self._absent[var_id] = self._absent.get(var_id, 0) + 1
                if self._absent[var_id] == _ABSENT:
                    yield self._without_summary(var_id, f"none in {_ABSENT} payloads")
                    return

    @staticmethod
    def _alive_since(variable: Variable, time: int) -> bool:
        """Return whether a variable without a timeout surely existed before ``time``, and did not change since then."""
        alive = variable.now.state == "alive" and not variable.uncertain and variable.due == NEVER
        return alive and max(variable.now.since, variable.settled) < time

    def _without_summary(self, var_id: int, observed: str) -> Finding:
        which = "VD-CRE-12" if self._own(self.variables[var_id].now) else "VD-PC-09"
        causes = (which, "VD-CMP-03", *self.why.get(var_id, ())[:1])
        return Finding(tuple(dict.fromkeys(causes)), f"a summary of variable {var_id}", observed)

    def silent(self, time: int) -> Iterator[Finding]:
        """Yield a finding for a record that is overdue at ``time``, if no payload came since its cause."""
        if self._lossy or not self.active:
            return
        former = self.room.former[-1][0] if self.room.former else 0
        changed = former > time - self._window
        for each in self.overdue(time):
            fits = self._needs(each.kind) + self.room.header <= self.room.limit
            if each.var_id in self.mine and fits and not changed:
                yield Finding((each.requirement,), f"{each.kind.label} of variable {each.var_id}", "no payload")
                return
        fits = self._needs(_SUMMARIES) + self.room.header <= self.room.limit
        if not fits or not self.room.summaries or changed or self.switched > time - self._window:
            return
        for var_id in self.mine:
            variable = self.variables.get(var_id)
            if variable is not None and self._alive_since(variable, time - self._window):
                yield self._without_summary(var_id, "no payload")
                return

    @property
    def next_timeout(self) -> int | None:
        """The time of the next timeout of a variable in ns; None if none has one."""
        due = [each.due for each in self.variables.values() if each.due != NEVER]
        return min(due) if due else None

    def postpone(self, time: int) -> None:
        """Give everything that is owed its whole time again, because the node could not send until ``time``."""
        for var_id, owing in self._owed.items():
            self._owed[var_id] = [
                msgspec.structs.replace(each, deadline=max(each.deadline, time + self._window)) for each in owing
            ]

    def state_of(self, var_id: int) -> str:
        """A name of the state of a variable, for statistics."""
        variable = self.variables.get(var_id)
        if variable is None:
            name = "unknown"
        elif variable.uncertain:
            name = "uncertain"
        else:
            version = variable.now
            name = (
                version.state
                if version.state == "unknown"
                else f"{version.state}, {'own' if self._own(version) else 'foreign'}"
            )
            if var_id in self._owed:
                name += ", pending"
            if variable.due != NEVER:
                name += ", with timeout"
        return name if self.active else f"{name}; VarDis inactive"

    def event_of(self, kind: str, record: VardisRecord) -> str:
        """A name of what a record says compared with what the node holds, for statistics. ``kind`` begins it."""
        variable = self.variables.get(var_id_of(record)) or Variable()
        words = [kind]
        if isinstance(record, VarCreate):
            flaw = _FLAWS.get(_refusal(record, self.own_id, self._limits)[0], "")
            later = (record.spec.creation_time or 0) > variable.latest or not self._features.creation_time
            words += ["later" if later else "not later", flaw]
        elif (seqno := getattr(record, "seqno", None)) is not None:
            number = variable.now.seqno
            newer, older = self._circle.newer(seqno, number), self._circle.newer(number, seqno)
            words.append("equal" if seqno == number else "newer" if newer else "older" if older else "opposite")
            value = getattr(record, "value", None)
            if value is not None and not 0 < len(value) <= self._limits.max_value_length:
                words.append("bad value")
        return ", ".join(each for each in words if each)


def _refusal(record: VardisRecord, own_id: bytes, limits: Limits) -> tuple[str, ...]:
    """Return the requirements by which a record changes nothing."""
    kind = record.IC_TYPE
    if isinstance(record, VarCreate):
        spec, value = record.spec, record.upd.value
        if spec.prod_id == own_id:
            return ("VD-PC-03",)
        if not 0 < len(value) <= limits.max_value_length:
            return ("VD-PC-04",)
        if not 0 < len(spec.descr) <= limits.max_description_length:
            return ("VD-PC-05",)
        if not 0 < spec.rep_cnt <= limits.max_repetitions:
            return ("VD-PC-06",)
        return ("VD-PC-01",)
    return _IGNORED.get(kind, ())


def var_id_of(record: VardisRecord) -> int:
    """Return the variable of a record; for a VarCreate that of its VarSpec (X14)."""
    return record.spec.var_id if isinstance(record, VarCreate) else record.var_id


def _field(row: Mapping[str, Any], name: str) -> Any:
    if name == "descr":
        if "descrHex" in row:
            return bytes.fromhex(str(row["descrHex"]))
        return str(row["descr"]).encode() if "descr" in row else None
    return row.get(name)


def _same_node(shown: Any, node_id: bytes) -> bool:
    text = str(shown).lower()
    return text.replace(":", "") == node_id.hex() or text.encode() == node_id


def _text(value: Any) -> str:
    return value.hex() if isinstance(value, bytes) else str(value)


def _brief(text: str) -> str:
    return text if len(text) <= 24 else f"{text[:16]}... ({len(text) // 2} octets)"


__all__ = ["Room", "VardisModel", "Version"]
