"""Variables in every state at the implementation, and the outcomes of events: the table of variable states.

Used by the cases that test the table event by event. A :class:`Situation` is a variable in a state; an outcome is a
function that checks the reaction to an event in that situation. The docstrings of outcomes are part of test purposes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import msgspec
from dcp_spec.constants import ICType

from dcp_codec.values import VarCreate, VardisRecord, VarUpdate
from dcp_conformance.frames.received import ReceivedBeacon
from dcp_conformance.frames.sampling import plain
from dcp_conformance.test_steps.services import create_request
from dcp_conformance.test_system.bench import Bench
from dcp_conformance.test_system.sending.peers import Peer

from .variable_queries import INSTRUCTIONS, ask, check_state, stepped, traces


@dataclass
class VariableState:
    """A variable in a state at the implementation."""

    bench: Bench
    peer: Peer
    """Its producer; another node if the implementation is the producer."""
    var_id: int
    state: str
    own: bool = False
    stored: VarCreate | None = None
    """The variable as the implementation last sent it, before it was deleted; None if it is unknown."""
    rep_cnt: int = 1

    @property
    def known(self) -> VarCreate:
        """The stored contents; ``ValueError`` for an unknown variable."""
        if self.stored is None:
            raise ValueError(f"an {self.state} variable has no contents")
        return self.stored

    def seqno(self, distance: int) -> int:
        """Return a sequence number at this distance from the stored one (from 0 for an unknown variable)."""
        return stepped(self.bench, 0 if self.stored is None else self.stored.upd.seqno, distance)

    def creation_time(self, distance: int) -> int:
        """Return a creationTime later than, equal to or earlier than the stored one, by the sign of ``distance``."""
        stored = None if self.stored is None else self.stored.spec.creation_time
        if stored is None:
            return self.bench.records.creation_time()
        return max(stored + 1, self.bench.records.creation_time()) if distance > 0 else stored + distance

    def create(self, distance: int, producer: bytes | None = None) -> VarCreate:
        """Return a VarCreate that differs from the stored one in every field but the identifier."""
        return self.peer.create(
            self.var_id,
            value=b"other",
            seqno=self.seqno(7),
            descr=b"other",
            creation_time=self.creation_time(distance),
            producer=producer,
        )

    def send(self, record: VardisRecord) -> None:
        """Send the event. Up to 1.3, where deleted variables are removed, delete the variable along with it."""
        if self.state != "deleted" or not self.bench.features.removed_after_deletion:
            self.peer.send(record)
        elif self.own:
            since = self.bench.mark()
            self.bench.must("RTDB-Delete", varId=self.var_id)
            self.bench.mark()
            if len(self.bench.receiver.frames_with(ICType.DELETE_VARIABLES, self.var_id, since)) >= self.rep_cnt:
                self.bench.inconclusive(
                    "remaining repetitions of the VarDelete", "none left when RTDB-Delete was confirmed"
                )
            self.peer.send(record)
        elif isinstance(record, VarCreate):
            # In one payload it would be processed before the deletion (VD-RX-08).
            self.peer.send(self.peer.delete(self.var_id))
            self.peer.send(record)
        else:
            self.peer.send(self.peer.delete(self.var_id), record)


# -- the states --------------------------------------------------------------------------------------------------------


def _repetitions(bench: Bench, state: str) -> int:
    """Return a repetition count that, up to 1.3, keeps a deleted variable in the database for a while.

    Long enough for a service call, and for the implementation to process the next payload.
    """
    if state != "deleted" or not bench.features.removed_after_deletion:
        return 1
    longest = max(bench.session.slow_call / bench.period, bench.session.known.reaction.per_payload)
    return bench.sut.rep_cnt(2 + math.ceil(1.5 * longest))


def foreign(bench: Bench, state: str) -> VariableState:
    """Teach the implementation a variable of another node and bring it into a state."""
    peer = bench.peer()
    if state == "unknown":
        return VariableState(bench, peer, bench.unknown_id(), state)
    rep_cnt = _repetitions(bench, state)
    record = peer.create(bench.var_id(), seqno=5, rep_cnt=rep_cnt)
    bench.learn(peer, record) if rep_cnt > 1 else _learn_once(bench, peer, record)
    situation = VariableState(bench, peer, record.spec.var_id, state, stored=record, rep_cnt=rep_cnt)
    if state == "deleted" and not bench.features.removed_after_deletion:
        peer.send(peer.delete(situation.var_id))
        _until_deleted(situation)
    return situation


def _learn_once(bench: Bench, peer: Peer, record: VarCreate) -> None:
    peer.send(record)
    if bench.until_instruction(ICType.CREATE_VARIABLES, record.spec.var_id) is None:
        bench.inconclusive("a VarCreate of the variable, which this case needs", "not forwarded in time")


def _until_deleted(situation: VariableState) -> None:
    bench = situation.bench
    if bench.until_instruction(ICType.DELETE_VARIABLES, situation.var_id) is None:
        bench.inconclusive("a VarDelete of the variable, which this case needs", "none in time")


def own(bench: Bench, state: str) -> VariableState:
    """Create one of the node's own variables, with sequence number 2, and bring it into a state."""
    var_id, rep_cnt, since = bench.identifiers.own_var_id(), _repetitions(bench, state), bench.mark()
    bench.must("RTDB-Create", **create_request(bench, var_id, rep_cnt=rep_cnt))
    for value in (bench.records.value(b"first"), bench.records.value(b"next")):
        bench.must("RTDB-Update", varId=var_id, value=value.hex())

    def newest(heard: ReceivedBeacon) -> VarUpdate | None:
        update: VarUpdate | None = heard.about(ICType.UPDATES, var_id)
        return update if update is not None and update.seqno == 2 else None

    updated = bench.until(newest)
    created = next((each.record for each in bench.instructions(ICType.CREATE_VARIABLES, var_id, since)), None)
    if created is None or updated is None:
        bench.inconclusive("a VarCreate of the node's own variable, which this case needs", "none in time")
    held = msgspec.structs.replace(created, upd=updated)
    if rep_cnt > 1:
        bench.until_quiet(newest, since=since)
    situation = VariableState(bench, bench.peer(), var_id, state, own=True, stored=held, rep_cnt=rep_cnt)
    if state == "deleted" and not bench.features.removed_after_deletion:
        bench.must("RTDB-Delete", varId=var_id)
        _until_deleted(situation)
    return situation


# -- the outcomes ------------------------------------------------------------------------------------------------------


def ignored(situation: VariableState, since: int) -> None:
    """The implementation sends no record as a reaction, and the stored contents are unchanged."""
    bench, var_id = situation.bench, situation.var_id
    gone = situation.state == "deleted" and bench.features.removed_after_deletion
    if gone:
        bench.check_repeated(ICType.DELETE_VARIABLES, var_id, situation.rep_cnt, since)
    if situation.state == "unknown":
        # The request below would itself cause a request for the variable.
        bench.require_processed("a record that it must ignore")
        found = traces(bench, var_id, since)
        bench.none(found, "no record as a reaction")
    elif gone:
        bench.require_alive("a record that it must ignore")
        found = traces(bench, var_id, since, set(INSTRUCTIONS) - {ICType.DELETE_VARIABLES})
        bench.none(found, "no record as a reaction")
        return
    held = ask(bench, var_id)
    check_state(bench, held, situation.state, "state of the variable, as before")
    if situation.state == "unknown":
        return
    # Any reaction would be in the beacon with the answer at the latest.
    answers = bench.instructions(ICType.CREATE_VARIABLES, var_id, since)
    found = [each for each in traces(bench, var_id, since) if each not in answers[-1:]]
    bench.none(found, "no record as a reaction")
    if situation.state == "alive":
        bench.answered(held.record, situation.stored, "the stored contents unchanged")


def only(situation: VariableState, since: int, kind: ICType, record: VardisRecord) -> None:
    """Check that this record is sent in the required number of beacons, and no other record."""
    bench, var_id = situation.bench, situation.var_id
    requested = kind in (ICType.REQUEST_VARCREATES, ICType.REQUEST_VARUPDATES)
    found = bench.check_repeated(kind, var_id, 1 if requested else situation.rep_cnt, since)
    # The implementation makes a request itself, with its own values in the fields that the profile adds.
    bench.every(
        found,
        lambda each: not (plain(each.record) != plain(record) if requested else each.record != record),
        f"the {kind.label} record {record}",
    )
    others = traces(bench, var_id, since, [each for each in INSTRUCTIONS if each is not kind])
    bench.none(others, f"no records other than {kind.label}")


def requests_variable(situation: VariableState, since: int, sent: VardisRecord) -> None:  # noqa: ARG001
    """The implementation requests the variable once."""
    record = situation.peer.request_create(situation.var_id)
    only(situation, since, ICType.REQUEST_VARCREATES, record)


def requests_update(situation: VariableState, since: int, sent: VardisRecord) -> None:  # noqa: ARG001
    """The implementation requests the newer value once, with its own sequence number."""
    record = situation.peer.request_update(situation.var_id, situation.known.upd.seqno)
    only(situation, since, ICType.REQUEST_VARUPDATES, record)


def sends_value(situation: VariableState, since: int, sent: VardisRecord) -> None:  # noqa: ARG001
    """The implementation sends the stored value."""
    only(situation, since, ICType.UPDATES, situation.known.upd)


def sends_variable(situation: VariableState, since: int, sent: VardisRecord) -> None:  # noqa: ARG001
    """The implementation sends the VarCreate with the stored contents."""
    only(situation, since, ICType.CREATE_VARIABLES, situation.known)


def stores(situation: VariableState, since: int, sent: VardisRecord) -> None:
    """The implementation stores and forwards the record unchanged."""
    bench = situation.bench
    creates = isinstance(sent, VarCreate)
    bench.identifiers.created.add(situation.var_id)
    only(situation, since, ICType.CREATE_VARIABLES if creates else ICType.UPDATES, sent)
    held = ask(bench, situation.var_id)
    bench.equal(held.record if creates or held.record is None else held.record.upd, sent, "the record in the database")


def deletes(situation: VariableState, since: int, sent: VardisRecord) -> None:
    """The implementation marks the variable as deleted and forwards the record."""
    bench, var_id = situation.bench, situation.var_id
    only(situation, since, ICType.DELETE_VARIABLES, sent)
    first = next(
        (index for index, heard in enumerate(bench.heard) if heard.instructions(ICType.DELETE_VARIABLES, var_id)), since
    )
    bench.none(bench.instructions(ICType.SUMMARIES, var_id, first), "no summary after the VarDelete")
    # Up to 1.3 the variable is removed from the database with the last repetition.
    after = "unknown" if bench.features.removed_after_deletion else "deleted"
    check_state(bench, ask(bench, var_id), after, "state of the variable")


def taken_over(situation: VariableState, since: int, sent: VardisRecord) -> None:
    """The implementation stores and forwards the record, although it was the producer itself."""
    stores(situation, since, sent)
    bench = situation.bench
    answer = bench.call("RTDB-Update", varId=situation.var_id, value="00")
    bench.info("What does RTDB-Update answer to the former producer of the variable? (H4)", str(answer))
