"""Variables in every state at the implementation, and what may become of them: the table of variable states.

For the cases that go through the table event by event. A :class:`Situation` is a variable that has been brought into a
state; an outcome is a function that checks what an event in that situation has led to.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from dcp_spec.constants import ICType

from dcp_codec.values import VarCreate, VardisRecord, VarUpdate

from .bench import Bench
from .heard import Heard
from .peers import Peer
from .services import create_request
from .variables import INSTRUCTIONS, ask, named, stepped, traces


@dataclass
class Situation:
    """A variable in a state at the implementation."""

    bench: Bench
    peer: Peer
    """Its producer; a neighbour where the implementation is the producer."""
    var_id: int
    state: str
    own: bool = False
    stored: VarCreate | None = None
    """The variable as the implementation last sent it, before it was deleted; None: it does not know it."""
    rep_cnt: int = 1

    @property
    def known(self) -> VarCreate:
        """What is stored. For states in which something is."""
        if self.stored is None:
            raise ValueError(f"an {self.state} variable has no content")
        return self.stored

    def seqno(self, distance: int) -> int:
        """A sequence number at this distance from the stored one; of an unknown variable any."""
        return stepped(self.bench, 0 if self.stored is None else self.stored.upd.seqno, distance)

    def creation_time(self, distance: int) -> int:
        """A creationTime that is later, the same or earlier than the stored one, by the sign of ``distance``."""
        stored = None if self.stored is None else self.stored.spec.creation_time
        if stored is None:
            return self.bench.creation_time()
        return max(stored + 1, self.bench.creation_time()) if distance > 0 else stored + distance

    def create(self, distance: int, producer: bytes | None = None) -> VarCreate:
        """A VarCreate that differs from what is stored in all but the identifier."""
        return self.peer.create(
            self.var_id,
            value=b"other",
            seqno=self.seqno(7),
            descr=b"other",
            creation_time=self.creation_time(distance),
            producer=producer,
        )

    def send(self, record: VardisRecord) -> None:
        """The event. Where deleted variables leave the database, the deletion comes with it."""
        if self.state != "deleted" or not self.bench.features.removed_after_deletion:
            self.peer.send(record)
        elif self.own:
            since = self.bench.mark()
            self.bench.must("RTDB-Delete", varId=self.var_id)
            self.bench.mark()
            if len(self.bench.frames_with(ICType.DELETE_VARIABLES, self.var_id, since)) >= self.rep_cnt:
                self.bench.inconclusive("a deletion that is still to be repeated", "it was over when it was confirmed")
            self.peer.send(record)
        elif type(record) is VarCreate:
            # In one payload it would be processed before the deletion (VD-RX-08).
            self.peer.send(self.peer.delete(self.var_id))
            self.peer.send(record)
        else:
            self.peer.send(self.peer.delete(self.var_id), record)


# -- the states --------------------------------------------------------------------------------------------------------


def _repetitions(bench: Bench, state: str) -> int:
    """More than one keeps a deleted variable in the database for a while, up to 1.3.

    For as long as a call takes, or the next payload is not looked at.
    """
    if state != "deleted" or not bench.features.removed_after_deletion:
        return 1
    reaction = bench.session.reaction
    longest = max(bench.session.slow_call / bench.period, 0 if reaction is None else reaction.per_payload)
    return bench.rep_cnt(2 + math.ceil(1.5 * longest))


def foreign(bench: Bench, state: str) -> Situation:
    """A variable of another node."""
    peer = bench.peer()
    if state == "unknown":
        return Situation(bench, peer, bench.unknown_id(), state)
    rep_cnt = _repetitions(bench, state)
    record = peer.create(bench.var_id(), seqno=5, rep_cnt=rep_cnt)
    bench.learn(peer, record) if rep_cnt > 1 else _learn_once(bench, peer, record)
    situation = Situation(bench, peer, record.spec.var_id, state, stored=record, rep_cnt=rep_cnt)
    if state == "deleted" and not bench.features.removed_after_deletion:
        peer.send(peer.delete(situation.var_id))
        _until_deleted(situation)
    return situation


def _learn_once(bench: Bench, peer: Peer, record: VarCreate) -> None:
    peer.send(record)
    if bench.until_instruction(ICType.CREATE_VARIABLES, record.spec.var_id) is None:
        bench.inconclusive("the implementation learns a variable, which this case needs", "it does not repeat it")


def _until_deleted(situation: Situation) -> None:
    bench = situation.bench
    if bench.until_instruction(ICType.DELETE_VARIABLES, situation.var_id) is None:
        bench.inconclusive("the variable is deleted, which this case needs", "there is no VarDelete")


def own(bench: Bench, state: str) -> Situation:
    """A variable of the implementation's application, with sequence number 2."""
    var_id, rep_cnt, since = bench.own_var_id(), _repetitions(bench, state), bench.mark()
    bench.must("RTDB-Create", **create_request(bench, var_id, rep_cnt=rep_cnt))
    for value in (bench.value(b"first"), bench.value(b"next")):
        bench.must("RTDB-Update", varId=var_id, value=value.hex())

    def newest(heard: Heard) -> VarUpdate | None:
        update: VarUpdate | None = heard.about(ICType.UPDATES, var_id)
        return update if update is not None and update.seqno == 2 else None

    updated = bench.until(newest)
    created = next((each.record for each in bench.instructions(ICType.CREATE_VARIABLES, var_id, since)), None)
    if created is None or updated is None:
        bench.inconclusive("the implementation sends its own variable, which this case needs", "it does not")
    held = VarCreate(created.spec, updated)
    if rep_cnt > 1:
        bench.until_quiet(newest, since=since)
    situation = Situation(bench, bench.peer(), var_id, state, own=True, stored=held, rep_cnt=rep_cnt)
    if state == "deleted" and not bench.features.removed_after_deletion:
        bench.must("RTDB-Delete", varId=var_id)
        _until_deleted(situation)
    return situation


# -- the outcomes ------------------------------------------------------------------------------------------------------


def ignored(situation: Situation, since: int) -> None:
    """Nothing is sent on account of it, and what is stored stays."""
    bench, var_id = situation.bench, situation.var_id
    gone = situation.state == "deleted" and bench.features.removed_after_deletion
    if gone:
        bench.check_repeated(ICType.DELETE_VARIABLES, var_id, situation.rep_cnt, since)
    if situation.state == "unknown":
        # The question below would make it ask for the variable, too.
        bench.require_alive("what it must ignore")
        bench.beacons(1, 1.5)
        found = traces(bench, var_id, since)
        bench.check(not found, "nothing is sent on account of it", f"{named(found)} came", frames=found, shown=True)
    elif gone:
        bench.require_alive("what it must ignore")
        found = traces(bench, var_id, since, set(INSTRUCTIONS) - {ICType.DELETE_VARIABLES})
        bench.check(not found, "nothing is sent on account of it", f"{named(found)} came", frames=found, shown=True)
        return
    held = ask(bench, var_id)
    bench.check(
        held.state == situation.state, f"the variable is {situation.state} as before", str(held), shown=held.shown
    )
    if situation.state == "unknown":
        return
    # Whatever it had caused would stand in the beacon with the answer at the latest.
    answers = bench.instructions(ICType.CREATE_VARIABLES, var_id, since)
    found = [each for each in traces(bench, var_id, since) if each not in answers[-1:]]
    bench.check(not found, "nothing is sent on account of it", f"{named(found)} came", frames=found, shown=True)
    if situation.state == "alive":
        bench.check(held.record == situation.stored, "what is stored has not changed", str(held), shown=True)


def only(situation: Situation, since: int, kind: ICType, record: VardisRecord) -> None:
    """This record is sent in as many beacons as it must be, and nothing else."""
    bench, var_id = situation.bench, situation.var_id
    requested = kind in (ICType.REQUEST_VARCREATES, ICType.REQUEST_VARUPDATES)
    found = bench.check_repeated(kind, var_id, 1 if requested else situation.rep_cnt, since)
    wrong = [each for each in found if each.record != record]
    observed = f"{wrong[0].record}" if wrong else ""
    bench.check(not wrong, f"the {kind.label} record is {record}", observed, frames=wrong, shown=True)
    others = traces(bench, var_id, since, [each for each in INSTRUCTIONS if each is not kind])
    what = f"nothing but {kind.label} records is sent"
    bench.check(not others, what, f"{named(others)} came", frames=others, shown=True)


def requests_variable(situation: Situation, since: int, sent: VardisRecord) -> None:  # noqa: ARG001
    """It asks for the variable, once."""
    record = situation.peer.request_create(situation.var_id)
    only(situation, since, ICType.REQUEST_VARCREATES, record)


def requests_update(situation: Situation, since: int, sent: VardisRecord) -> None:  # noqa: ARG001
    """It asks for the newer value, once, and says which number it has."""
    record = situation.peer.request_update(situation.var_id, situation.known.upd.seqno)
    only(situation, since, ICType.REQUEST_VARUPDATES, record)


def sends_value(situation: Situation, since: int, sent: VardisRecord) -> None:  # noqa: ARG001
    """It sends its own value."""
    only(situation, since, ICType.UPDATES, situation.known.upd)


def sends_variable(situation: Situation, since: int, sent: VardisRecord) -> None:  # noqa: ARG001
    """It sends the whole variable."""
    only(situation, since, ICType.CREATE_VARIABLES, situation.known)


def stores(situation: Situation, since: int, sent: VardisRecord) -> None:
    """It stores what came and passes it on, unchanged."""
    bench = situation.bench
    creates = type(sent) is VarCreate
    bench.created.add(situation.var_id)
    only(situation, since, ICType.CREATE_VARIABLES if creates else ICType.UPDATES, sent)
    held = ask(bench, situation.var_id)
    record = held.record if creates or held.record is None else held.record.upd
    bench.check(record == sent, "what came is stored", str(held), shown=held.record is not None)


def deletes(situation: Situation, since: int, sent: VardisRecord) -> None:
    """It marks the variable as deleted and passes that on."""
    bench, var_id = situation.bench, situation.var_id
    only(situation, since, ICType.DELETE_VARIABLES, sent)
    first = next(
        (index for index, heard in enumerate(bench.heard) if heard.instructions(ICType.DELETE_VARIABLES, var_id)), since
    )
    summaries = bench.instructions(ICType.SUMMARIES, var_id, first)
    bench.check(not summaries, "no summary follows", "it is still summarised", frames=summaries, shown=True)
    held = ask(bench, var_id)
    # Up to 1.3 it leaves the database with the last repetition.
    after = "unknown" if bench.features.removed_after_deletion else "deleted"
    bench.check(held.state == after, f"the variable is {after}", str(held), shown=held.shown)


def taken_over(situation: Situation, since: int, sent: VardisRecord) -> None:
    """It stores what came although it was the producer itself."""
    stores(situation, since, sent)
    bench = situation.bench
    answer = bench.call("RTDB-Update", varId=situation.var_id, value="00")
    bench.info("H4: what RTDB-Update answers to the producer whose variable was taken over", str(answer))
