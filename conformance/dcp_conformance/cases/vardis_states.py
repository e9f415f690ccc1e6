"""dcp-vardis.md: Receive Path, Variable States.

Every event in every state of a variable: unknown, alive, deleted; produced by the implementation or by another node.
The variants are named ``state.event``. Consumers' states are reached and observed over the air; an own variable takes
the application's services.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from dcp_spec.constants import ICType, SpecVersion

from dcp_codec.values import VarCreate, VardisRecord, VarUpdate
from dcp_conformance.bench import Bench
from dcp_conformance.case import Needs, Variant, case
from dcp_conformance.heard import Heard
from dcp_conformance.peers import Peer
from dcp_conformance.services import create_request, taught
from dcp_conformance.variables import INSTRUCTIONS, ask, named, own_id, stepped, traces

_OWN = ("RTDB-Create", "RTDB-Update", "RTDB-Delete")
_V2_0, _V1_3, _V1_1 = SpecVersion.V2_0, SpecVersion.V1_3, SpecVersion.V1_1


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
            self.bench.must("RTDB-Delete", varId=self.var_id)
            self.peer.send(record)
        elif type(record) is VarCreate:
            # In one payload it would be processed before the deletion (VD-RX-08).
            self.peer.send(self.peer.delete(self.var_id))
            self.peer.send(record)
        else:
            self.peer.send(self.peer.delete(self.var_id), record)


# -- the states --------------------------------------------------------------------------------------------------------


def _repetitions(bench: Bench, state: str) -> int:
    """More than one keeps a deleted variable in the database for a while, up to 1.3."""
    return bench.rep_cnt(2) if state == "deleted" and bench.features.removed_after_deletion else 1


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
    var_id, rep_cnt, since = bench.var_id(), _repetitions(bench, state), bench.mark()
    bench.must("RTDB-Create", **create_request(bench, var_id, rep_cnt=rep_cnt))
    created = bench.until_instruction(ICType.CREATE_VARIABLES, var_id)
    for value in (b"first", b"second"):
        bench.must("RTDB-Update", varId=var_id, value=value.hex())

    def newest(heard: Heard) -> VarUpdate | None:
        update: VarUpdate | None = heard.about(ICType.UPDATES, var_id)
        return update if update is not None and update.seqno == 2 else None

    updated = bench.until(newest)
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
    bench.require_alive("what it must ignore")
    bench.beacons(1, 1.5)
    kinds = [kind for kind in INSTRUCTIONS if not (gone and kind is ICType.DELETE_VARIABLES)]
    found = traces(bench, var_id, since, kinds)
    bench.check(not found, "nothing is sent on account of it", f"{named(found)} came", frames=found)
    if gone:
        return
    held = ask(bench, var_id)
    bench.check(held.state == situation.state, f"the variable is {situation.state} as before", str(held))
    if situation.state == "alive":
        bench.check(held.record == situation.stored, "what is stored has not changed", str(held))


def only(situation: Situation, since: int, kind: ICType, record: VardisRecord) -> None:
    """This record is sent in as many beacons as it must be, and nothing else."""
    bench, var_id = situation.bench, situation.var_id
    requested = kind in (ICType.REQUEST_VARCREATES, ICType.REQUEST_VARUPDATES)
    found = bench.check_repeated(kind, var_id, 1 if requested else situation.rep_cnt, since)
    wrong = [each for each in found if each.record != record]
    bench.check(not wrong, f"the {kind.label} record is {record}", f"{wrong[0].record if wrong else ''}", frames=wrong)
    others = traces(bench, var_id, since, [each for each in INSTRUCTIONS if each is not kind])
    bench.check(not others, f"nothing but {kind.label} records is sent", f"{named(others)} came", frames=others)


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
    bench.check(record == sent, "what came is stored", str(held))


def deletes(situation: Situation, since: int, sent: VardisRecord) -> None:
    """It marks the variable as deleted and passes that on."""
    bench, var_id = situation.bench, situation.var_id
    only(situation, since, ICType.DELETE_VARIABLES, sent)
    first = next(
        (index for index, heard in enumerate(bench.heard) if heard.instructions(ICType.DELETE_VARIABLES, var_id)), since
    )
    summaries = bench.instructions(ICType.SUMMARIES, var_id, first)
    bench.check(not summaries, "no summary follows", "it is still summarised", frames=summaries)
    held = ask(bench, var_id)
    # Up to 1.3 it leaves the database with the last repetition.
    after = "unknown" if bench.features.removed_after_deletion else "deleted"
    bench.check(held.state == after, f"the variable is {after}", str(held))


def taken_over(situation: Situation, since: int, sent: VardisRecord) -> None:
    """It stores what came although it was the producer itself."""
    stores(situation, since, sent)
    bench = situation.bench
    answer = bench.call("RTDB-Update", varId=situation.var_id, value="00")
    bench.info("H4: what RTDB-Update answers to the producer whose variable was taken over", str(answer))


# -- the events --------------------------------------------------------------------------------------------------------

Outcome = Callable[[Situation, int, VardisRecord], None]
Event = Callable[[Situation], VardisRecord]


@dataclass(frozen=True)
class Cell:
    """What an event in a state leads to."""

    situation: Callable[[Bench, str], Situation]
    state: str
    event: Event
    outcome: Outcome | None
    """None: the record is ignored."""


EVENTS: dict[str, tuple[str, Event]] = {
    "rx-create": ("a VarCreate", lambda s: s.create(1)),
    "rx-create-later": ("a VarCreate with a later creationTime", lambda s: s.create(1)),
    "rx-create-same": ("a VarCreate with the stored creationTime", lambda s: s.create(0)),
    "rx-create-earlier": ("a VarCreate with an earlier creationTime", lambda s: s.create(-1)),
    "rx-create-own": ("a VarCreate that names the implementation as producer", lambda s: s.create(1, own_id(s.bench))),
    "rx-delete": ("a VarDelete", lambda s: s.peer.delete(s.var_id)),
    "rx-update": ("a VarUpdate", lambda s: s.peer.update(s.var_id, 3)),
    "rx-newer-update": ("a newer VarUpdate", lambda s: s.peer.update(s.var_id, s.seqno(1))),
    "rx-equal-update": ("a VarUpdate with the stored number", lambda s: s.peer.update(s.var_id, s.seqno(0))),
    "rx-older-update": ("an older VarUpdate", lambda s: s.peer.update(s.var_id, s.seqno(-1))),
    "rx-summary": ("a summary", lambda s: s.peer.summary(s.var_id, 3)),
    "rx-newer-summary": ("a newer summary", lambda s: s.peer.summary(s.var_id, s.seqno(1))),
    "rx-equal-summary": ("a summary with the stored number", lambda s: s.peer.summary(s.var_id, s.seqno(0))),
    "rx-older-summary": ("an older summary", lambda s: s.peer.summary(s.var_id, s.seqno(-1))),
    "rx-request-update": ("a VarReqUpdate", lambda s: s.peer.request_update(s.var_id, 3)),
    "rx-request-behind": ("a VarReqUpdate behind the stored", lambda s: s.peer.request_update(s.var_id, s.seqno(-1))),
    "rx-request-equal": (
        "a VarReqUpdate with the stored number",
        lambda s: s.peer.request_update(s.var_id, s.seqno(0)),
    ),
    "rx-request-ahead": ("a VarReqUpdate that is ahead", lambda s: s.peer.request_update(s.var_id, s.seqno(1))),
    "rx-request-create": ("a VarReqCreate", lambda s: s.peer.request_create(s.var_id)),
}

_Row = tuple[str, str, Outcome | None, Needs]
_ALL, _SINCE_1_1, _SINCE_2_0, _UNTIL_1_3 = Needs(), Needs(since=_V1_1), Needs(since=_V2_0), Needs(until=_V1_3)
_ONLY_1_0 = Needs(until=SpecVersion.V1_0)


def _one_repetition(bench: Bench) -> str | None:
    if bench.parameter("VARDISPAR_MAX_REPETITIONS") < 2:
        return "a variable that is being deleted can only be met with at least two repetitions"
    return None


_DELETING = Needs(until=_V1_3, when=_one_repetition)

UNKNOWN: list[_Row] = [
    ("rx-create", "VD-PC-07 VD-PC-09", stores, _ALL),
    ("rx-create-own", "VD-PC-03", None, _ALL),
    ("rx-delete", "VD-PD-01", None, _ALL),
    ("rx-update", "VD-PU-01", requests_variable, _ALL),
    ("rx-summary", "VD-PS-01", requests_variable, _ALL),
    ("rx-request-update", "VD-RU-01", requests_variable, _SINCE_1_1),
    ("rx-request-create", "VD-RC-01", requests_variable, _SINCE_1_1),
]
UNKNOWN_1_0: list[_Row] = [
    ("rx-request-update", "VD-SCP-01", None, _ONLY_1_0),
    ("rx-request-create", "VD-SCP-01", None, _ONLY_1_0),
]
ALIVE_CONSUMER: list[_Row] = [
    ("rx-create-later", "VD-PC-01", stores, _SINCE_2_0),
    ("rx-create-same", "VD-PC-01", None, _SINCE_2_0),
    ("rx-create-earlier", "VD-PC-01", None, _SINCE_2_0),
    ("rx-create", "VD-SCP-03", None, _UNTIL_1_3),
    ("rx-create-own", "VD-PC-03", None, _ALL),
    ("rx-delete", "VD-PD-04", deletes, _ALL),
    ("rx-newer-update", "VD-PU-07", stores, _ALL),
    ("rx-equal-update", "VD-PU-05", None, _ALL),
    ("rx-older-update", "VD-PU-06", sends_value, _ALL),
    ("rx-newer-summary", "VD-PS-04", requests_update, _ALL),
    ("rx-equal-summary", "VD-PS-02", None, _ALL),
    ("rx-older-summary", "VD-PS-03", sends_value, _ALL),
    ("rx-request-behind", "VD-RU-04", sends_value, _ALL),
    ("rx-request-equal", "VD-RU-03", None, _ALL),
    ("rx-request-ahead", "VD-RU-03", None, _ALL),
    ("rx-request-create", "VD-RC-03", sends_variable, _ALL),
]
ALIVE_PRODUCER: list[_Row] = [
    ("rx-create-later", "VD-PC-01", taken_over, _SINCE_2_0),
    ("rx-create-same", "VD-PC-01", None, _SINCE_2_0),
    ("rx-create-earlier", "VD-PC-01", None, _SINCE_2_0),
    ("rx-create", "VD-SCP-03", None, _UNTIL_1_3),
    ("rx-create-own", "VD-PC-03", None, _ALL),
    ("rx-delete", "VD-PD-03", None, _ALL),
    ("rx-newer-update", "VD-PU-03", None, _ALL),
    ("rx-equal-update", "VD-PU-03", None, _ALL),
    ("rx-older-update", "VD-PU-03", None, _ALL),
    ("rx-newer-summary", "VD-PS-02", None, _ALL),
    ("rx-equal-summary", "VD-PS-02", None, _ALL),
    ("rx-older-summary", "VD-PS-02", None, _ALL),
    ("rx-request-behind", "VD-RU-04", sends_value, _ALL),
    ("rx-request-equal", "VD-RU-03", None, _ALL),
    ("rx-request-ahead", "VD-RU-03", None, _ALL),
    ("rx-request-create", "VD-RC-03", sends_variable, _ALL),
]
DELETED: list[_Row] = [
    ("rx-create-later", "VD-PC-02", stores, _SINCE_2_0),
    ("rx-create-same", "VD-PC-01", None, _SINCE_2_0),
    ("rx-create-earlier", "VD-PC-01", None, _SINCE_2_0),
    ("rx-create", "VD-SCP-03", None, _DELETING),
    ("rx-create-own", "VD-PC-03", None, _ALL),
    ("rx-delete", "VD-PD-02", None, _ALL),
    ("rx-newer-update", "VD-PU-02", None, _ALL),
    ("rx-equal-update", "VD-PU-02", None, _ALL),
    ("rx-older-update", "VD-PU-02", None, _ALL),
    ("rx-newer-summary", "VD-PS-02", None, _ALL),
    ("rx-equal-summary", "VD-PS-02", None, _ALL),
    ("rx-older-summary", "VD-PS-02", None, _ALL),
    ("rx-request-behind", "VD-RU-02", None, _ALL),
    ("rx-request-equal", "VD-RU-02", None, _ALL),
    ("rx-request-ahead", "VD-RU-02", None, _ALL),
    ("rx-request-create", "VD-RC-02", None, _ALL),
]

_CONSUMER = {"unknown": UNKNOWN, "alive-consumer": ALIVE_CONSUMER, "deleted-consumer": DELETED}
_PRODUCER = {"alive-producer": ALIVE_PRODUCER, "deleted-producer": DELETED}
_WORDS = {
    "unknown": "an unknown variable",
    "alive-consumer": "a variable of another node",
    "alive-producer": "an own variable",
    "deleted-consumer": "a deleted variable of another node",
    "deleted-producer": "an own deleted variable",
}


def _cells(table: dict[str, list[_Row]], *, effect: bool) -> Iterator[tuple[str, Variant]]:
    """The variants of a case: cells with an effect, or those in which the event is ignored."""
    for column, rows in table.items():
        for name, requirements, outcome, needs in rows:
            if (outcome is not None) is not effect:
                continue
            what, event = EVENTS[name]
            makes = own if column.endswith("producer") else foreign
            result = (outcome.__doc__ or "").rstrip(".") if outcome is not None else "It is ignored"
            methods = _OWN if makes is own else ()
            yield (
                f"{column}.{name}",
                Variant(
                    Cell(makes, column.partition("-")[0], event, outcome),
                    purpose=f"{what[0].upper()}{what[1:]} of {_WORDS[column]}: {result[0].lower()}{result[1:]}",
                    requirements=requirements,
                    stimulus=f"{what} of {_WORDS[column]}",
                    expect=f"{result[0].lower()}{result[1:]}",
                    needs=Needs(since=needs.since, until=needs.until, ut=methods, when=needs.when),
                ),
            )


def _play(bench: Bench, cell: Cell) -> None:
    situation = cell.situation(bench, cell.state)
    record = cell.event(situation)
    since = bench.mark()
    situation.send(record)
    if cell.outcome is None:
        ignored(situation, since)
    else:
        cell.outcome(situation, since, record)


@case(
    "TC_VD_STATE_BV_01",
    "{variant}",
    requirements="VD-PC-07",
    stimulus="{variant}",
    expect="the effect that the specification has for this cell",
    window=4,
    variants=dict(_cells(_CONSUMER, effect=True)),
)
def consumer_effect(bench: Bench, cell: Cell) -> None:
    _play(bench, cell)


@case(
    "TC_VD_STATE_BO_01",
    "{variant}",
    requirements="VD-PC-07",
    stimulus="{variant}",
    expect="nothing, and a probe is answered",
    window=4,
    variants=dict(_cells(_CONSUMER, effect=False)),
)
def consumer_ignores(bench: Bench, cell: Cell) -> None:
    _play(bench, cell)


@case(
    "TC_VD_STATE_BO_02",
    "{variant} (1.0)",
    requirements="VD-SCP-01",
    stimulus="{variant}",
    expect="nothing, and a probe is answered",
    window=4,
    variants=dict(_cells({"unknown": UNKNOWN_1_0}, effect=False)),
)
def unknown_in_1_0(bench: Bench, cell: Cell) -> None:
    _play(bench, cell)


@case(
    "TC_VD_STATE_BV_02",
    "{variant}",
    requirements="VD-PC-07",
    stimulus="{variant}",
    expect="the effect that the specification has for this cell",
    window=4,
    variants=dict(_cells(_PRODUCER, effect=True)),
)
def producer_effect(bench: Bench, cell: Cell) -> None:
    _play(bench, cell)


@case(
    "TC_VD_STATE_BO_03",
    "{variant}",
    requirements="VD-PC-07",
    stimulus="{variant}",
    expect="nothing, and a probe is answered",
    window=4,
    variants=dict(_cells(_PRODUCER, effect=False)),
)
def producer_ignores(bench: Bench, cell: Cell) -> None:
    _play(bench, cell)


@case(
    "TC_VD_STATE_BV_04",
    "Up to 1.3 a variable is unknown again once its deletion has been repeated",
    requirements="VD-PD-04",
    stimulus="a VarDelete; after its repetitions a summary of the variable",
    expect="a request for it",
    needs=_UNTIL_1_3,
)
def removed(bench: Bench) -> None:
    peer = bench.peer()
    var_id = taught(bench, peer)
    since = bench.mark()
    peer.send(peer.delete(var_id))
    bench.check_repeated(ICType.DELETE_VARIABLES, var_id, 1, since)
    peer.send(peer.summary(var_id, 0))
    came = bench.until_instruction(ICType.REQUEST_VARCREATES, var_id)
    bench.check(came, "the variable is requested as an unknown one", "there is no VarReqCreate")
    peer.send(peer.create(var_id))
    came = bench.until_instruction(ICType.CREATE_VARIABLES, var_id)
    bench.check(came, "its identifier can be used again", "a new VarCreate is not repeated")
