"""Compare an implementation with the independent model while steps are executed."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

import msgspec
from dcp_spec.constants import ICType, features

from dcp_codec.codec import Codec
from dcp_codec.errors import DecodeError, Problem
from dcp_codec.values import (
    Beacon,
    Container,
    VarCreate,
    VarDelete,
    VardisRecord,
    VarReqCreate,
    VarSpec,
)
from dcp_codec.views.dissect import dissect
from dcp_conformance.frames.header_rules import judge
from dcp_conformance.fuzz.steps import Effect
from dcp_conformance.model.circular import Circle
from dcp_conformance.oracle import Limits, Oracle, Version, Waiting
from dcp_conformance.oracle.knowledge import NEVER, NO_CREATION

#: Maximum age of a payload when it is received, and maximum delay of a reaction, in beacon periods.
LATENCY, WINDOW = 1.6, 8.0

#: Names of the records in the reached pairs of state and message.
_NAMES: Final = {
    ICType.CREATE_VARIABLES: "create",
    ICType.DELETE_VARIABLES: "delete",
    ICType.UPDATES: "update",
    ICType.SUMMARIES: "summary",
    ICType.REQUEST_VARUPDATES: "request-update",
    ICType.REQUEST_VARCREATES: "request-create",
}
#: Requirements whose violation makes a receiver discard the whole beacon.
_IGNORED = frozenset({"BP-RX-01", "BP-RX-02"})


class Observer:
    """The model of one node. It receives the frames that the node receives, and judges those that the node sends.

    ``reached`` lists the pairs (state of the variable, kind of message) that occurred.
    """

    def __init__(
        self,
        codec: Codec,
        own_id: bytes,
        period: int,
        *,
        network: int | None,
        limits: Limits | None = None,
        window: float = WINDOW,
        scrubbing: int | None = None,
        room: int | None = None,
    ) -> None:
        """``period``: beacon period in ns. ``network``: network identifier of the node; None if beacons have none.

        ``window``: beacon periods until the node must have sent a record that is due. ``scrubbing``: scrubbing period
        of the node in ns; None if unknown, variables with a timeout are then uncertain. ``room``: maximum VarDis
        payload of the node in octets; None if unknown, free room then does not prove that nothing is queued.
        """
        self.codec = codec
        self.own_id = own_id
        self.reached: list[tuple[str, str]] = []
        self._damaged = b""
        self._named: tuple[set[int], int] = set(), NO_CREATION
        """The variables and the latest creation time in ``_damaged``, cached because damaged beacons are repeated."""
        self.requested: set[int] = set()
        """Identifiers of the variables that the node has requested."""
        self.busy = False
        """Whether a payload of the node was more than half full: then its records may be delayed."""
        profile = codec.profile
        self._skips = profile.behaviour.vardis_receive_error == "skip-element"
        self._id_width, self._id_order = profile.types.var_id.width, profile.types.var_id.byte_order
        self._period = period
        self._network = network if profile.has_header_field("networkId") else None
        most = profile.limits
        limits = limits or Limits(most.max_value_length, most.max_description_length, most.max_repetitions)
        self._features = features(profile.spec_version)
        self._circle = Circle(profile.types.var_seqno.width)
        self.oracle = Oracle(
            own_id,
            self._features,
            profile.types.var_seqno.width,
            limits,
            latency=round(LATENCY * period),
            window=round(window * period),
            scrubbing=scrubbing,
        )
        self._judges_timeouts = scrubbing is not None
        self._waiting: Waiting | None = None
        # Any record fits into half of a payload.
        self._roomy = 0 if room is None else room // 2

    # -- frames that the node receives -------------------------------------------------------------------------

    def hears(self, octets: bytes, time: int, number: int) -> list[int]:
        """Process a bearer payload that the node receives. Returns the variables of its records."""
        if octets == self._damaged:
            return self.doubts(octets)
        try:
            beacon = self.codec.decode(octets)
        except DecodeError as error:
            # A beacon with another magic number or version is ignored as a whole.
            return [] if error.problem.requirement in _IGNORED else self.doubts(octets)
        if not self.is_for_node(beacon):
            return []
        touched: list[int] = []
        for payload in beacon.payloads:
            containers = payload.content
            if isinstance(containers, tuple):
                touched += self._payload(containers, time, number)
        return touched

    @property
    def compares_creations(self) -> bool:
        """Whether creation times decide which of several creations is valid."""
        return self._features.creation_time

    def is_for_node(self, beacon: Beacon) -> bool:
        """Return whether the node has to process a beacon: it is from another node of the same network."""
        header = beacon.bp
        if header is None:
            return True
        return header.sender_id != self.own_id and (self._network is None or header.network_id == self._network)

    def doubts(self, octets: bytes) -> list[int]:
        """Process a damaged bearer payload. The variables that it names become uncertain; returns an empty list.

        Reading X34 leaves open which of its records the node processes.
        """
        if octets != self._damaged:
            self._damaged, self._named = octets, self._names_in(octets)
        ids, latest = self._named
        for var_id in ids:
            self.oracle.doubt(var_id, latest)
            self.reached.append(("any", "damaged"))
        if self._skips:
            # A node that skips a bad element and continues may find a record at any offset.
            for start in range(len(octets) - self._id_width + 1):
                self.oracle.doubt(int.from_bytes(octets[start : start + self._id_width], self._id_order))
        return []

    def _names_in(self, octets: bytes) -> tuple[set[int], int]:
        """Return the variables that a damaged beacon names, and the latest creation time in it."""
        ids, latest = set[int](), NO_CREATION
        for each in dissect(self.codec.beacon_plan, octets).root.walk():
            if isinstance(each.value, int):
                if each.name == "varId":
                    ids.add(each.value)
                elif each.name == "creationTime":
                    latest = max(latest, each.value)
        return ids, latest

    def _payload(self, containers: tuple[Container, ...], time: int, number: int) -> list[int]:
        # The model has no rules for container types that a profile adds.
        records: list[VardisRecord] = [each for one in containers for each in one.records if each.IC_TYPE is not None]
        variables, reached, removes = self.oracle.variables, self.reached, self._features.removed_after_deletion
        touched = []
        for record in records:
            var_id = record.spec.var_id if isinstance(record, VarCreate) else record.var_id
            touched.append(var_id)
            known = variables.get(var_id)
            now = None if known is None else known.versions[-1]
            if now is None or now.state == "unknown":
                reached.append(("unknown", _NAMES[record.IC_TYPE]))
            else:
                reached.append((self._state(now), self._message(record, now)))
            if isinstance(record, VarCreate):
                self._open_questions(record)
            if removes and self._was_deleted(var_id):
                # The time at which a deleted variable leaves the database is observable only by later reactions.
                self.oracle.doubt(var_id)
        self.oracle.hear(records, time, number)
        if removes:
            for record in records:
                if isinstance(record, VarDelete) and touched.count(record.var_id) > 1:
                    # It is also unknown whether the variable still exists for later records of this payload.
                    self.oracle.doubt(record.var_id)
        return touched

    def _was_deleted(self, var_id: int) -> bool:
        known = self.oracle.variables.get(var_id)
        return known is not None and any(version.state == "deleted" for version in known.versions)

    def _open_questions(self, record: VarCreate) -> None:
        """Mark variables as uncertain for which the reaction to this record is undefined or depends on a clock."""
        spec = record.spec
        creation = spec.creation_time or 0
        if record.upd.var_id != spec.var_id:
            self.oracle.doubt(spec.var_id, creation)
            self.oracle.doubt(record.upd.var_id, creation)
        if spec.timeout and not self._judges_timeouts:
            self.oracle.doubt(spec.var_id)
        known = self.oracle.variables.get(spec.var_id)
        own = known.now.spec if known is not None else None
        if own is not None and own.prod_id == self.own_id and own.creation_time is None and self.compares_creations:
            self.oracle.doubt(spec.var_id)

    def _state(self, version: Version) -> str:
        own = version.spec is not None and version.spec.prod_id == self.own_id
        return f"{version.state} {'own' if own else 'foreign'}"

    def _message(self, record: VardisRecord, version: Version) -> str:
        name = _NAMES[record.IC_TYPE]
        if isinstance(record, VarCreate):
            return f"{name} {self._compared(record, version)}".rstrip()
        if isinstance(record, (VarDelete, VarReqCreate)):
            return name
        if record.seqno == version.seqno:
            return f"{name} equal"
        if self._circle.newer(record.seqno, version.seqno):
            return f"{name} newer"
        return f"{name} older" if self._circle.newer(version.seqno, record.seqno) else f"{name} opposite"

    def _compared(self, record: VarCreate, version: Version) -> str:
        if version.spec is None or record.spec.creation_time is None:
            return ""
        before = version.spec.creation_time or 0
        if record.spec.creation_time == before:
            return "equal"
        return "later" if record.spec.creation_time > before else "earlier"

    # -- services that its applications call -------------------------------------------------------------------

    def created(self, spec: VarSpec, value: bytes, time: int) -> None:
        """Process a RTDB-Create that was confirmed with OK."""
        self.oracle.created(msgspec.structs.replace(spec, prod_id=self.own_id), value, time)

    def expects(self, method: str, var_id: int) -> bool | None:
        """Return whether a service must succeed now; None if the specification or the model does not decide it."""
        known = self.oracle.variables.get(var_id)
        if known is not None and (known.uncertain or known.due != NEVER):
            return None
        version = known.now if known is not None else None
        own = version is not None and version.spec is not None and version.spec.prod_id == self.own_id
        alive = version is not None and version.state == "alive"
        match method:
            case "RTDB-Update":
                return None if alive and own else False
            case "RTDB-Delete":
                return alive and own
            case "RTDB-Create":
                return False if alive and not own else None
            case "RTDB-Read":
                return alive
        return None

    # -- beacons and state of the node -------------------------------------------------------------------------

    def says(self, octets: bytes, most: int, time: int, number: int, step: int) -> Effect | None:
        """Judge a beacon of the node with a maximum size of ``most`` octets. Returns its first fault, or None."""
        if len(octets) > most:
            return Effect("bad-beacon", f"a beacon of {len(octets)} octets, where {most} are allowed", step)
        try:
            beacon = self.codec.decode(octets)
        except DecodeError as error:
            return bad_beacon(self.codec, octets, error.problem, step)
        if beacon.bp is not None and beacon.bp.sender_id != self.own_id:
            return Effect("bad-beacon", f"a beacon of {beacon.bp.sender_id.hex(':')}", step, "sender")
        roomy = len(octets) <= self._roomy
        if not roomy:
            self.busy = True
        contents = [payload.content for payload in beacon.payloads if isinstance(payload.content, tuple)]
        if self._waiting is None:
            self._waiting = Waiting(self._period, most)
        waited = self._waiting.of(len(octets), vardis=bool(contents))
        for containers in contents:
            effect = self._judged(containers, roomy, waited, time, number, step)
            if effect is not None:
                return effect
        return None

    def _judged(
        self, containers: tuple[Container, ...], roomy: bool, waited: int, time: int, number: int, step: int
    ) -> Effect | None:
        records: list[tuple[ICType, VardisRecord]] = []
        for container in containers:
            # All records of a container have the same type.
            if (kind := container.records[0].IC_TYPE) is None:
                continue
            records += [(kind, record) for record in container.records]
            if kind is ICType.REQUEST_VARCREATES:
                self.requested.update([record.var_id for record in container.records])
        for each in self.oracle.transmitted(records, time, number, roomy=roomy, waited=waited):
            detail = f"variable {each.var_id}: expected {each.expected}, got {each.observed}"
            return Effect("said", detail, step, each.requirement)
        return None

    def certain(self, var_ids: Iterable[int], time: int | None = None) -> list[tuple[int, Version]]:
        """Return the versions of these variables that the model is certain of, at a time in ns (None: now)."""
        certain = self.oracle.certain
        return [(var_id, version) for var_id in var_ids if (version := certain(var_id, time)) is not None]

    def missing(self, time: int, step: int, *, busy: bool) -> Effect | None:
        """Return the effect of a record that the node should have sent by ``time`` (ns), or None.

        Each missing record is reported once. A ``busy`` node may be late, so nothing is reported.
        """
        overdue = self.oracle.overdue(time)
        if busy or not overdue:
            return None
        owed = overdue[0]
        detail = f"variable {owed.var_id}: {owed.kind.label} did not come"
        return Effect("said", detail, step, f"missing {owed.kind.label} {owed.requirement}")


def bad_beacon(codec: Codec, octets: bytes, problem: Problem, step: int) -> Effect:
    """Return the effect of a beacon that cannot be decoded, with the requirement for senders that it violates."""
    broken = judge(octets, codec)
    rules = broken[0].requirements if broken else ()
    return Effect("bad-beacon", f"an invalid beacon: {problem}", step, " ".join((problem.reason, *rules)))
