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
    latest,
    statement_of,
)
from dcp_conformance.definitions.circular import Circle
from dcp_conformance.definitions.verdict import Verdict

#: Number of beacons with room in which a node must send the value whose number its summaries state.
_PATIENCE = 8
#: Payloads up to this length in octets have room: the bearer carries at least 256 octets.
_ROOM = 180
#: A protocol of a node has fallen silent if at least ``_SPOKE`` beacons, and the share ``_MOSTLY`` of all beacons up to
#: its last payload, had a payload of it, and the last ``_SILENT`` beacons had none.
_SPOKE, _SILENT, _MOSTLY = 20, 30, 0.9
#: Protocol -> the requirement that it sends payloads.
_PROTOCOLS = {"VarDis": "VD-RUN-02", "SRP": "SRP-SRV-04"}
#: Requests for one variable are endless from this number on; they count as unanswered with fewer than ``_ANSWERED``
#: answers.
_OFTEN, _ANSWERED = 10, 3


@dataclass(slots=True)
class _Unbacked:
    """A number of a variable that a node summarises, and whose value it has not sent."""

    entry: Entry
    before: Statement | None
    """The node's last record with the previous number; None if the node did not have the variable."""
    first: Statement
    """The first summary with the number."""
    beacons: int = 0
    """Number of beacons with the summary and room for the value, but without it."""


class Backed(Invariant):
    """Check that a node sends the values whose numbers its summaries state.

    The ledger tells which states begin with a summary, and how often a node has sent their value.
    """

    id = "CK_VD_BACKED"
    section = "dcp-vardis.md: Global versus Local Dissemination"
    purpose = "A node that summarises a new number or a new variable also sends its update or create"
    requirements = ("VD-SCP-02", "VD-CMP-04")
    expect = "an update or create with each new number in the summaries of a node"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._longest: dict[bytes, int] = {}
        """Node -> length of its longest beacon in octets."""
        self._whole: dict[bytes, tuple[int, int]] = {}
        """Node -> time since which it is heard without a gap (ns since 1970), and number of successive beacons in which
        it has summarised all its variables."""
        self._created: set[int] = set()
        """Variables with a create or update in the recording."""
        self._unbacked: dict[bytes, dict[int, _Unbacked]] = {}
        """Node -> variables whose value it has not sent, but may still send in time."""

    def feed(self, seen: Seen) -> None:
        """Follow the numbers of the sender."""
        sender = self.context.senders.get(seen.sender)
        if not seen.parts or sender is None:
            return
        length, longest = len(seen.heard.octets), self._longest.get(seen.sender, 0)
        room = length + 60 <= max(_ROOM, longest * 0.9)
        if length > longest:
            self._longest[seen.sender] = length
        unbroken, whole = self._whole.get(seen.sender, (0, 0))
        unbacked = self._unbacked.get(seen.sender)
        if unbroken != sender.unbroken:
            # The node may have sent values, and creates of variables, in missing beacons.
            whole = 0
            if unbacked:
                unbacked.clear()
        for each, before, again in seen.news:
            kind, var_id = each.kind, each.var_id
            if kind is CREATE or kind is UPDATE:
                self._created.add(var_id)
            if unbacked and kind is not ASK_UPDATE and kind is not ASK_CREATE:
                unbacked.pop(var_id, None)
            if kind is SUMMARY and (before is not None or whole > _PATIENCE):
                entry = self.context.ledger.held(seen.sender, var_id)
                # If all variables of the node were known so far, one without an earlier record is new.
                if entry is not None and not entry.values:
                    if unbacked is None:
                        unbacked = self._unbacked[seen.sender] = {}
                    unbacked[var_id] = _Unbacked(entry, None if before is None else latest(before, again), each)
        summaries = 0
        for kind, records, ids, _, _ in seen.parts:
            if kind is SUMMARY:
                summaries += len(ids)
                if unbacked and room and not unbacked.keys().isdisjoint(ids):
                    for record, var_id in zip(records, ids, strict=True):
                        if var_id in unbacked:
                            self._summarised(unbacked, statement_of(kind, record, seen.heard, seen.sender))
        whole = whole + 1 if summaries >= self.context.ledger.holds(seen.sender) else 0
        self._whole[seen.sender] = (sender.unbroken, whole)

    def _summarised(self, unbacked: dict[int, _Unbacked], each: Statement) -> None:
        """Count a beacon with room for a value, but without it; report the number if there are too many."""
        state = unbacked[each.var_id]
        state.beacons += 1
        if state.beacons < _PATIENCE:
            return
        del unbacked[each.var_id]
        self.exercised()
        who = f"{name(each.sender)}, variable {each.var_id}"
        if state.before is None:
            nobody = "" if each.var_id in self._created else ", and no node has created it"
            text = f"{who}: summaries of a variable without a create of this node{nobody}"
            self.violated(text, [state.first, each], once=(each.sender, each.var_id, "new"))
            return
        text = f"{who}: summaries with {each.number} after {state.before.number}, but no update with that number"
        self.violated(text, [state.before, state.first, each], once=(each.sender, each.var_id))

    def finish(self) -> None:
        """Count the numbers whose values were sent, or may have been."""
        held = sum(self.context.ledger.holds(node) for node in self.context.ledger.nodes)
        self._of_all += held - sum(map(len, self._unbacked.values()))


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
        self.exercised(times=ledger.count())
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
            self.violated(text, [held, left], expected=what, verdict=Verdict.INFO, once=key)


@dataclass(slots=True)
class _Payloads:
    """The beacons of a node with payloads of one protocol."""

    count: int = 0
    """Number of these beacons."""
    until: int = 0
    """Number of all beacons of the node up to the last one of these."""
    last: int = 0
    """Frame number of the last one of these."""


class FallsSilent(Invariant):
    """Find protocols that stop sending payloads while their node continues to send beacons; reported as info."""

    id = "CK_NET_SILENT"
    section = "dcp-vardis.md: Runtime"
    purpose = "VarDis and SRP of a node send payloads as long as it sends beacons"
    requirements = ("VD-RUN-02", "SRP-SRV-04")
    expect = "payloads of a protocol in the beacons of a node up to the end"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._beacons: dict[bytes, int] = {}
        """Node -> number of its beacons."""
        self._payloads: dict[bytes, dict[str, _Payloads]] = {}
        """Node -> its beacons with payloads of each protocol."""

    def feed(self, seen: Seen) -> None:
        """Count beacons with and without payloads of each protocol."""
        if not seen.sound:
            return
        payloads = self._payloads.get(seen.sender)
        if payloads is None:
            if len(self._payloads) >= MOST_SENDERS:
                return
            payloads = self._payloads[seen.sender] = {protocol: _Payloads() for protocol in _PROTOCOLS}
        beacons = self._beacons[seen.sender] = self._beacons.get(seen.sender, 0) + 1
        for protocol, there in (("VarDis", bool(seen.parts)), ("SRP", seen.heard.report is not None)):
            if there:
                sent = payloads[protocol]
                sent.count += 1
                sent.last, sent.until = seen.number, beacons

    def finish(self) -> None:
        """Report protocols that are silent up to the end: an application may have deactivated them."""
        for node, payloads in self._payloads.items():
            for protocol, sent in payloads.items():
                if sent.count < _SPOKE:
                    continue
                rule, silent = _PROTOCOLS[protocol], self._beacons[node] - sent.until
                self.exercised(rule)
                if silent >= _SILENT and sent.count >= _MOSTLY * sent.until:
                    text = f"{name(node)}: no {protocol} payload in its last {silent} beacons, after frame {sent.last}"
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
    of_reactions = True

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._asked: dict[tuple[bytes, int, ICType], _Asked] = {}
        self._askers: dict[tuple[int, ICType], dict[bytes, None]] = {}

    def feed(self, seen: Seen) -> None:
        """Count the requests, and the answers of other nodes, until the requesting node holds the variable."""
        for each, _, _ in seen.news:
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
