"""dcp-vardis.md: rules for a network as a whole.

They find numbers without a value, nodes that disagree, endless requests, and protocols that fall silent. Most of these
are reported as info: the recorder hears more than any node, and the design permits that nodes disagree (hazards H1 to
H8).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from dcp_spec.constants import ICType

from dcp_conformance.check.base import MOST_SENDERS, MOST_VARIABLES, Context, Invariant, Seen, Stamp, name
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
from dcp_conformance.model.verdict import Verdict

from .vardis import seqno_of

SECOND = 1_000_000_000
#: Number of beacons with room in which a node must send the value whose number its summaries state.
_PATIENCE = 8
#: Payloads up to this length in octets have room: the bearer carries at least 256 octets.
_ROOM = 180
#: Time in ns after which a producer's number must have reached all nodes.
_STABLE = 3 * SECOND
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


@dataclass(slots=True)
class _Held:
    """The number of a variable that a node states."""

    number: int
    since: int
    """Time of the first record with it, ns since 1970."""
    statement: Statement
    """The first record with it."""
    last: int = 0
    """Time of a later record with it, ns since 1970; repeated summaries are kept in the context."""


class Agreement(Invariant):
    """Compare the numbers at all nodes with that of the producer; differences are reported as info."""

    id = "CK_NET_AGREES"
    section = "dcp-vardis.md: Global versus Local Dissemination"
    purpose = "All nodes reach the sequence number that the producer of a variable has"
    requirements = ("VD-PU-07", "VD-PU-06")
    expect = "the number of the producer at all nodes within three seconds"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._circle = Circle(context.profile.types.var_seqno.width)
        self._held: dict[int, dict[bytes, _Held]] = {}
        """Variable -> node -> number that the node states."""
        self._producers: dict[int, bytes] = {}
        """Variable -> node that sent a create with itself as the producer last."""
        self._size = 0
        """Number of entries in ``_held``."""
        context.on_gap.append(self._remember)

    def feed(self, seen: Seen) -> None:
        """Store the numbers; when a producer changes a number, compare the other nodes with the previous one."""
        sender, time = seen.sender, seen.time
        for each, _ in seen.news:
            kind, var_id = each.kind, each.var_id
            if kind is CREATE and each.record.spec.prod_id == sender:
                self._producers[var_id] = sender
            elif kind is DELETE and var_id in self._held:
                self._held[var_id].pop(sender, None)
            if kind is not SUMMARY and kind is not UPDATE and kind is not CREATE:
                continue
            number = each.number
            holders = self._held.get(var_id)
            if holders is None:
                holders = self._held[var_id] = {}
            held = holders.get(sender)
            if held is None:
                if self._size < MOST_VARIABLES:
                    self._size += 1
                    holders[sender] = _Held(number, time, each, time)
                continue
            if held.number == number:
                held.last = time
                continue
            if self._producers.get(var_id) == sender:
                self._compare(var_id, sender, held, time)
            held.number, held.since, held.statement, held.last = number, time, each, time

    def _remember(self, node: bytes, again: Mapping[int, Stamp]) -> None:
        """Store the times of a node's last summaries before the context forgets them."""
        for var_id, (_, time) in again.items():
            held = self._held.get(var_id, {}).get(node)
            if held is not None:
                held.last = time

    def _last(self, node: bytes, var_id: int, held: _Held) -> int:
        """Return the time of a node's last record with its number, in ns since 1970."""
        again = self.context.repeated_by_summary(node, var_id)
        return held.last if again is None else again[1]

    def _compare(self, var_id: int, producer: bytes, own: _Held, now: int) -> None:
        """Report nodes that kept another number for at least three seconds while the producer's did not change.

        ``own``: number of the producer. ``now``: end of its validity, ns since 1970.
        """
        if now - own.since < _STABLE:
            return
        for node, held in self._held[var_id].items():
            if node == producer or (last := self._last(node, var_id, held)) < own.since + _STABLE:
                continue
            self.exercised()
            if held.number == own.number:
                continue
            seconds = (last - max(own.since, held.since)) / 1e9
            if seconds < _STABLE / 1e9:
                continue
            text = (
                f"{name(node)} keeps {held.number} of variable {var_id} for {seconds:.1f} s, "
                f"while its producer {name(producer)} has {own.number}"
            )
            if self._circle.newer(held.number, own.number):
                what = "a stale value that looks newer than that of the producer (H8)"
            else:
                what = "a value of the producer that does not reach a node"
            key = (node, var_id, what)
            self.violated(text, [own.statement, held.statement], expected=what, verdict=Verdict.INFO, once=key)

    def finish(self) -> None:
        """Compare the last numbers in the recording."""
        for var_id, producer in self._producers.items():
            own = self._held.get(var_id, {}).get(producer)
            if own is not None:
                self._compare(var_id, producer, own, self._last(producer, var_id, own))


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
        """Report the requests that have not ended, with the likely reason."""
        for (node, var_id, asks), asked in self._asked.items():
            if asked.count < _OFTEN:
                continue
            what = "create" if asks is ICType.REQUEST_VARCREATES else "update"
            text = f"{name(node)} requests the {what} of variable {var_id} {asked.count} times, up to the end"
            if asked.answers < _ANSWERED or asked.answer is None:
                text += f"; it was sent {asked.answers} times since the first request"
                frames = [asked.first]
            else:
                who = ", ".join(sorted(map(name, asked.by)))
                text += f"; {who} sent it {asked.answers} times{self._reason(node, asked.answer)}"
                frames = [asked.first, asked.answer]
            self.violated(text, frames, expected="requests that do not end", verdict=Verdict.INFO)

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
