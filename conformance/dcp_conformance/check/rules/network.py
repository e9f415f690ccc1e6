"""dcp-vardis.md: rules for a network as a whole.

They find numbers without a value, nodes that disagree, endless requests, and protocols that fall silent. Most of these
are reported as info: the recorder hears more than any node, and the design permits that nodes disagree (hazards H1 to
H8).
"""

from __future__ import annotations

from dataclasses import dataclass, field

from dcp_spec.constants import ICType

from dcp_codec.analysis.entry import Entry
from dcp_conformance.check.base import MOST_SENDERS, MOST_VARIABLES, Context, Invariant, Seen, name
from dcp_conformance.check.reception import reception_of
from dcp_conformance.check.statements import (
    ASK_CREATE,
    ASK_UPDATE,
    CREATE,
    DELETE,
    SUMMARY,
    UPDATE,
    Statement,
    statement_of,
)
from dcp_conformance.model.circular import Circle
from dcp_conformance.model.results import Mark
from dcp_conformance.model.verdict import Verdict

from .vardis import seqno_of

#: Number of beacons with room in which a node must send the value whose number its summaries state.
_PATIENCE = 8
#: Payloads up to this length in octets have room: the bearer carries at least 256 octets.
_ROOM = 180
#: A protocol of a node has fallen silent if at least ``_SPOKE`` beacons, and the share ``_MOSTLY`` of all beacons up to
#: its last payload, had a payload of it, and the last ``_SILENT`` beacons had none.
_SPOKE, _SILENT, _MOSTLY = 20, 30, 0.9
#: Requests for one variable are endless from this number on; they count as unanswered with fewer than ``_ANSWERED``
#: answers.
_OFTEN, _ANSWERED = 10, 3


@dataclass(slots=True)
class _Backing:
    """The number of a variable that a node states, and whether the node has sent its value."""

    statement: Statement
    """The node's first record with this number."""
    number: int
    backed: bool
    """Whether the node has sent an update or create with this number, or beacons that may have had it are missing."""
    time: int
    """Time of the node's last record with this number, ns since 1970."""
    before: Statement | None = None
    """The node's last record with the previous number."""
    last: Statement | None = None
    """The node's last summary with this number."""
    beacons: int = 0
    """Number of beacons with room for the value but without it."""


class Backed(Invariant):
    """Check that a node sends the values whose numbers its summaries state."""

    id = "CK_VD_BACKED"
    section = "dcp-vardis.md: Global versus Local Dissemination"
    purpose = "A node that summarises a new number or a new variable also sends its update or create"
    requirements = ("VD-SCP-02", "VD-CMP-04")
    expect = "an update or create with each new number in the summaries of a node"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._known: dict[bytes, dict[int, _Backing]] = {}
        self._longest: dict[bytes, int] = {}
        """Node -> length of its longest beacon in octets."""
        self._whole: dict[bytes, tuple[int, int]] = {}
        """Node -> time since which it is heard without a gap (ns since 1970), and number of successive beacons in which
        it has summarised all its variables."""
        self._created: set[int] = set()
        """Variables with a create or update in the recording."""
        self._unbacked: dict[bytes, set[int]] = {}
        """Node -> variables whose value it has not sent, but may still send in time."""
        self._pairs = 0
        """Number of entries in ``_known``. It is limited for all nodes together: forged beacons can have any number of
        variables."""

    def feed(self, seen: Seen) -> None:
        """Follow the numbers of the sender."""
        if not seen.parts:
            return
        known = self._known.get(seen.sender)
        sender = self.context.senders.get(seen.sender)
        if sender is None:
            return
        if known is None:
            if len(self._known) >= MOST_SENDERS:
                return
            known = self._known[seen.sender] = {}
            self._unbacked[seen.sender] = set()
        unbacked = self._unbacked[seen.sender]
        length, longest = len(seen.heard.octets), self._longest.get(seen.sender, 0)
        room = length + 60 <= max(_ROOM, longest * 0.9)
        if length > longest:
            self._longest[seen.sender] = length
        unbroken, whole = self._whole.get(seen.sender, (0, 0))
        if unbroken != sender.unbroken:
            # The node may have sent the create of a variable in a missing beacon.
            whole = 0
        # Only new records and variables without a value are processed. A repeated summary changes only the time, which
        # the context keeps.
        changed = set(unbacked)
        for each, before in seen.news:
            kind, state = each.kind, known.get(each.var_id)
            if state is not None and before is not None and before.kind is SUMMARY:
                state.time, state.last = before.time, before
            if kind is CREATE or kind is UPDATE:
                self._created.add(each.var_id)
                self._back(known, each, sender.time)
                unbacked.discard(each.var_id)
            elif kind is DELETE:
                self._pairs -= known.pop(each.var_id, None) is not None
                unbacked.discard(each.var_id)
            changed.add(each.var_id)
        summaries = 0
        for kind, records, ids in seen.parts:
            if kind is SUMMARY:
                summaries += len(ids)
                if not changed.isdisjoint(ids):
                    for record in [record for record, var_id in zip(records, ids, strict=True) if var_id in changed]:
                        each = statement_of(kind, record, seen.heard, seen.sender)
                        self._summary(known, each, seen, sender.unbroken, complete=whole > _PATIENCE, room=room)
        self._whole[seen.sender] = (sender.unbroken, whole + 1 if summaries >= len(known) else 0)

    def _back(self, known: dict[int, _Backing], each: Statement, time: int) -> None:
        """Process a create or update: the node has sent the value of this number."""
        state = known.get(each.var_id)
        if state is not None and state.number == seqno_of(each):
            state.backed, state.time = True, time
        elif state is not None or self._pairs < MOST_VARIABLES:
            self._pairs += state is None
            known[each.var_id] = _Backing(each, seqno_of(each), backed=True, time=time)

    def _summary(
        self, known: dict[int, _Backing], each: Statement, seen: Seen, unbroken: int, *, complete: bool, room: bool
    ) -> None:
        """Process a summary; report its number if its value was not sent in time.

        ``unbroken``: time since which no beacon of the node is missing. ``complete``: all variables of the node are
        known. ``room``: the beacon had room for the value.
        """
        state, number = known.get(each.var_id), each.record.seqno
        if state is None:
            if self._pairs < MOST_VARIABLES:
                self._pairs += 1
                # If all variables of the node were known so far, this one is new.
                known[each.var_id] = _Backing(each, number, backed=not complete, time=seen.time)
                if complete:
                    self._unbacked[seen.sender].add(each.var_id)
            return
        if unbroken > state.time:
            # The value may have been in a missing beacon.
            known[each.var_id] = _Backing(each, number, backed=True, time=seen.time)
            self._unbacked[seen.sender].discard(each.var_id)
            return
        if number != state.number:
            state = known[each.var_id] = _Backing(
                each, number, backed=False, time=seen.time, before=state.last or state.statement
            )
            self._unbacked[seen.sender].add(each.var_id)
        state.time, state.last = seen.time, each
        if state.backed:
            return
        state.beacons += room
        if state.beacons == _PATIENCE:
            self._unbacked[seen.sender].discard(each.var_id)
            self.exercised()
            self._report_number(state, each, seen)

    def _report_number(self, state: _Backing, each: Statement, seen: Seen) -> None:
        """Report a number without a value."""
        who = f"{name(seen.sender)}, variable {each.var_id}"
        if state.before is None:
            nobody = "" if each.var_id in self._created else ", and no node has created it"
            text = f"{who}: summaries of a variable without a create of this node{nobody}"
            self.violated(text, [state.statement, each], once=(seen.sender, each.var_id, "new"))
            return
        text = f"{who}: summaries with {state.number} after {seqno_of(state.before)}, but no update with that number"
        self.violated(text, [state.before, state.statement, each], once=(seen.sender, each.var_id))

    def finish(self) -> None:
        """Count the numbers whose values were sent."""
        self._of_all += sum(each.backed for known in self._known.values() for each in known.values())


def _mark(entry: Entry) -> Mark:
    """Return the place of the first record with a state."""
    return Mark(entry.frame, path=f"{entry.kind.label} {entry.var_id}")


class Agreement(Invariant):
    """Compare the numbers at all nodes with that of the producer; differences are reported as info."""

    id = "CK_NET_AGREES"
    section = "dcp-vardis.md: Global versus Local Dissemination"
    purpose = "All nodes reach the sequence number that the producer of a variable has"
    requirements = ("VD-PU-07", "VD-PU-06")
    expect = "the number of the producer at all nodes within three seconds"

    def finish(self) -> None:
        """Count the states of nodes, and report those that a node keeps after the producer has left them."""
        circle = Circle(self.context.profile.types.var_seqno.width)
        ledger = self.context.ledger
        self.exercised(times=sum(each.number >= 0 for each in ledger.entries()))
        for held in ledger.stale(self.context.pics.pixit.beacon_period_ms * 1e6):
            left, newest = held.left, held.newest
            assert left is not None
            assert newest is not None
            what = "a value of the producer that does not reach a node"
            if circle.newer(held.number, newest.number):
                what = "a stale value that looks newer than that of the producer (H8)"
            elif not held.missed:
                what = "a deletion by the producer that a node does not follow"
            its = []
            if held.missed:
                its.append(f"has {newest.number}, {held.missed} number{'' if held.missed == 1 else 's'} later")
            if held.deleted:
                its.append("has deleted it")
            text = (
                f"{name(held.node)} keeps {held.number} of variable {held.var_id} for {held.age / 1e9:.1f} s after its "
                f"producer {name(newest.node)} has changed it; by then the producer {', and '.join(its)}"
            )
            if held.asked:
                text += f"; the node requests the update {held.asked} times"
            key = (held.node, held.var_id, what)
            self.violated(text, [_mark(left), _mark(held)], expected=what, verdict=Verdict.INFO, once=key)


@dataclass(slots=True)
class _PayloadTimes:
    """How long a node has sent payloads of each protocol."""

    beacons: int = 0
    """Number of its beacons."""
    vardis: int = 0
    """Number of its beacons with VarDis records."""
    until_vardis: int = 0
    """Number of its beacons up to the last one with VarDis records."""
    last_vardis: int = 0
    """Frame number of the last one with VarDis records."""
    srp: int = 0
    """Number of its beacons with a state report."""
    until_srp: int = 0
    """Number of its beacons up to the last one with a state report."""
    last_srp: int = 0
    """Frame number of the last one with a state report."""


class FallsSilent(Invariant):
    """Find protocols that stop sending payloads while their node continues to send beacons; reported as info."""

    id = "CK_NET_SILENT"
    section = "dcp-vardis.md: Runtime"
    purpose = "VarDis and SRP of a node send payloads as long as it sends beacons"
    requirements = ("VD-RUN-02", "SRP-SRV-04")
    expect = "payloads of a protocol in the beacons of a node up to the end"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._voices: dict[bytes, _PayloadTimes] = {}

    def feed(self, seen: Seen) -> None:
        """Count beacons with and without payloads of each protocol."""
        if not seen.sound:
            return
        voice = self._voices.get(seen.sender)
        if voice is None:
            if len(self._voices) >= MOST_SENDERS:
                return
            voice = self._voices[seen.sender] = _PayloadTimes()
        voice.beacons += 1
        if seen.parts:
            voice.vardis += 1
            voice.last_vardis, voice.until_vardis = seen.number, voice.beacons
        if seen.heard.report is not None:
            voice.srp += 1
            voice.last_srp, voice.until_srp = seen.number, voice.beacons

    def finish(self) -> None:
        """Report protocols that are silent up to the end: an application may have deactivated them."""
        for node, voice in self._voices.items():
            of_all = voice.beacons
            self._judge(node, "VarDis", "VD-RUN-02", voice.vardis, voice.until_vardis, of_all, voice.last_vardis)
            self._judge(node, "SRP", "SRP-SRV-04", voice.srp, voice.until_srp, of_all, voice.last_srp)

    def _judge(self, node: bytes, protocol: str, rule: str, spoke: int, until: int, beacons: int, last: int) -> None:
        """Judge one protocol of a node.

        ``spoke``: number of its beacons with a payload. ``until``: number of its beacons up to the last payload, in
        frame ``last``. ``beacons``: number of all its beacons.
        """
        if spoke < _SPOKE:
            return
        self.exercised(rule)
        if beacons - until >= _SILENT and spoke >= _MOSTLY * until:
            text = f"{name(node)}: no {protocol} payload in its last {beacons - until} beacons, after frame {last}"
            self.violated(text, [], rule, expected="a protocol that falls silent", verdict=Verdict.INFO)


@dataclass(slots=True)
class _Asked:
    """The open requests of one node for one variable."""

    count: int
    """Number of requests."""
    first: Statement
    """The first request."""
    answers: int = 0
    """Number of answers that other nodes have sent."""
    answer: Statement | None = None
    """The last answer."""
    by: set[bytes] = field(default_factory=set)
    """The nodes that have answered."""


class EndlessRequests(Invariant):
    """Find requests that a node repeats up to the end of the recording; reported as info with the likely reason."""

    id = "CK_VD_ENDLESS"
    section = "dcp-vardis.md: Global versus Local Dissemination"
    purpose = "Requests end: another node answers, and the requesting node stores the answer"
    requirements = ("VD-PC-07", "VD-PU-07", "VD-RC-03", "VD-RU-04")
    expect = "fewer than ten requests for one variable before an answer is stored"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._asked: dict[tuple[bytes, int, ICType], _Asked] = {}
        self._askers: dict[tuple[int, ICType], dict[bytes, None]] = {}

    def feed(self, seen: Seen) -> None:
        """Count the requests, and the answers of other nodes, until the requesting node holds the variable."""
        for each, _ in seen.news:
            kind = each.kind
            if kind is ASK_CREATE or kind is ASK_UPDATE:
                key = (seen.sender, each.var_id, kind)
                asked = self._asked.get(key)
                if asked is not None:
                    asked.count += 1
                elif len(self._asked) < MOST_VARIABLES:
                    self._asked[key] = _Asked(1, each)
                    self._askers.setdefault((each.var_id, kind), {})[seen.sender] = None
            elif kind is CREATE:
                self._answered(each, seen, ASK_CREATE)
            elif kind is UPDATE:
                self._answered(each, seen, ASK_UPDATE)
            elif kind is DELETE:
                for asks in (ASK_CREATE, ASK_UPDATE):
                    # A deletion does not answer the requests.
                    asked = self._asked.get((seen.sender, each.var_id, asks))
                    if asked is not None and asked.count >= _OFTEN:
                        self._report(seen.sender, each.var_id, asks, asked, "up to the deletion")
                    self._ends(seen.sender, each.var_id, asks)

    def _answered(self, each: Statement, seen: Seen, asks: ICType) -> None:
        """Process a record that answers requests of kind ``asks``, and ends those of its sender."""
        askers = self._askers.get((each.var_id, asks))
        if not askers:
            return
        self._ends(seen.sender, each.var_id, asks)
        for node in askers:
            asked = self._asked[node, each.var_id, asks]
            asked.answers += 1
            asked.answer = each
            asked.by.add(seen.sender)

    def _ends(self, node: bytes, var_id: int, asks: ICType) -> None:
        """Remove the requests of a node, if there are any, and count them as ended."""
        asked = self._asked.pop((node, var_id, asks), None)
        if asked is not None:
            del self._askers[var_id, asks][node]
            self.exercised()

    def finish(self) -> None:
        """Report the requests that have not ended."""
        for (node, var_id, asks), asked in self._asked.items():
            if asked.count >= _OFTEN:
                self._report(node, var_id, asks, asked, "up to the end")

    def _report(self, node: bytes, var_id: int, asks: ICType, asked: _Asked, until: str) -> None:
        """Report requests with the likely reason why they do not end."""
        what = "create" if asks is ICType.REQUEST_VARCREATES else "update"
        text = f"{name(node)} requests the {what} of variable {var_id} {asked.count} times, {until}"
        if asked.answers < _ANSWERED or asked.answer is None:
            text += f"; it was sent {asked.answers} times since the first request"
            frames = [asked.first]
        else:
            who = ", ".join(sorted(map(name, asked.by)))
            text += f"; {who} sent it {asked.answers} times{self._reason(node, asked.answer)}"
            frames = [asked.first, asked.answer]
        once = (node, var_id, asks)
        self.violated(text, frames, expected="requests that do not end", verdict=Verdict.INFO, once=once)

    def _reason(self, node: bytes, answer: Statement) -> str:
        """Return the likely reason why a node does not store the answer, mostly that it exceeds the node's limits."""
        station = reception_of(self.context).observer.stations.get(node)
        if station is None:
            return ""
        value = answer.record.upd.value if answer.kind is ICType.CREATE_VARIABLES else answer.record.value
        if answer.kind is ICType.CREATE_VARIABLES:
            spec = answer.record.spec
            if spec.prod_id == node:
                return "; it is its producer, and has forgotten the variable (H2)"
            if not spec.descr:
                return "; the likely reason: the description is empty (X21)"
            if spec.rep_cnt > max(1, station.repetitions):
                return (
                    f"; the likely reason: repCnt {spec.rep_cnt} is above the node's maximum "
                    f"(it has stored no more than {station.repetitions})"
                )
            if len(spec.descr) > max(1, station.description):
                return f"; the likely reason: a description of {len(spec.descr)} octets is above the node's maximum"
        if len(value) > max(1, station.value):
            return (
                f"; the likely reason: a value of {len(value)} octets is above the node's maximum "
                f"(it has stored no more than {station.value})"
            )
        return "; the payload may be longer than the node accepts, or the node may lose a part of it"


RULES: tuple[type[Invariant], ...] = (Backed, Agreement, EndlessRequests, FallsSilent)
