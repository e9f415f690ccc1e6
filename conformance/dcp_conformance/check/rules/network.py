"""dcp-vardis.md: what a recording shows of a network as a whole.

Values without a source, nodes that disagree or ask for ever, protocols that fall silent.

Most of it is observed and not judged: the recorder hears more than any node does, and the design itself lets nodes
disagree (hazards H1 to H8).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from dcp_spec.constants import ICType

from dcp_conformance.check.base import MOST_SENDERS, MOST_VARIABLES, Context, Invariant, Seen, Stamp, name
from dcp_conformance.check.reception import reception_of
from dcp_conformance.check.statements import ASK_CREATE, ASK_UPDATE, CREATE, DELETE, SUMMARY, UPDATE, Statement, said_of
from dcp_conformance.model.circular import Circle
from dcp_conformance.model.verdict import Verdict

from .vardis import seqno_of

SECOND = 1_000_000_000
#: So many beacons with room for it a node gets to send the value that its summaries speak of.
_PATIENCE = 8
#: Payloads up to this length have room: the bearer carries 256 octets at least.
_ROOM = 180
#: A number that a producer has had for so long has had its time to arrive.
_STABLE = 3 * SECOND
#: Beacons in which a protocol was there, and in which it is not, before that is worth a line.
_SPOKE, _SILENT, _MOSTLY = 20, 30, 0.9
#: So many requests for one variable are no longer a matter of loss.
_OFTEN, _ANSWERED = 10, 3


@dataclass(slots=True)
class _Backing:
    """What a node says of a variable, and whether it has sent the value."""

    said: Statement
    """Where the node first stated the number."""
    number: int
    backed: bool
    time: int
    before: Statement | None = None
    last: Statement | None = None
    """Where the node stated it last."""
    beacons: int = 0


class Backed(Invariant):
    """Numbers in summaries have values."""

    id = "CK_VD_BACKED"
    section = "dcp-vardis.md: Global versus Local Dissemination"
    purpose = (
        "A node that comes to a new number or a new variable also sends the update or create, and not only summaries"
    )
    requirements = ("VD-SCP-02", "VD-CMP-04")
    expect = "an update or create with the number that the summaries of the same node begin to tell"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._known: dict[bytes, dict[int, _Backing]] = {}
        self._longest: dict[bytes, int] = {}
        self._whole: dict[bytes, tuple[int, int]] = {}
        """Since when a node is heard without a gap; in how many beacons in a row it has summarised all that it has."""
        self._created: set[int] = set()
        self._unbacked: dict[bytes, set[int]] = {}
        """By node: variables of whose number it has sent no value, as long as it may still do so."""
        self._pairs = 0
        """Of a node and a variable that are followed: of all nodes together, since anybody can builder more."""

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
        length = len(seen.heard.octets)
        room = length + 60 <= max(_ROOM, self._longest.get(seen.sender, 0) * 0.9)
        self._longest[seen.sender] = max(length, self._longest.get(seen.sender, 0))
        unbroken, whole = self._whole.get(seen.sender, (0, 0))
        if unbroken != sender.unbroken:
            # It may have come to a variable in a beacon that is missing.
            whole = 0
        # What the node says with other records, or says anew, is looked at; a summary that says the same again changes
        # nothing but the time, which the context keeps.
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
                    for var_id, record in zip(ids, records, strict=True):
                        if var_id in changed:
                            each = said_of(kind, record, seen.heard, seen.sender)
                            self._summary(known, each, seen, sender.unbroken, complete=whole > _PATIENCE, room=room)
        self._whole[seen.sender] = (sender.unbroken, whole + 1 if summaries >= len(known) else 0)

    def _back(self, known: dict[int, _Backing], each: Statement, time: int) -> None:
        state = known.get(each.var_id)
        if state is not None and state.number == seqno_of(each):
            state.backed, state.time = True, time
        elif state is not None or self._pairs < MOST_VARIABLES:
            self._pairs += state is None
            known[each.var_id] = _Backing(each, seqno_of(each), backed=True, time=time)

    def _summary(
        self, known: dict[int, _Backing], each: Statement, seen: Seen, unbroken: int, *, complete: bool, room: bool
    ) -> None:
        state, number = known.get(each.var_id), each.record.seqno
        if state is None:
            if self._pairs < MOST_VARIABLES:
                self._pairs += 1
                # Of a node that was heard to the last beacon, all of whose variables are known, this one is new.
                known[each.var_id] = _Backing(each, number, backed=not complete, time=seen.time)
                if complete:
                    self._unbacked[seen.sender].add(each.var_id)
            return
        if unbroken > state.time:
            # The beacon with the value may be missing.
            known[each.var_id] = _Backing(each, number, backed=True, time=seen.time)
            self._unbacked[seen.sender].discard(each.var_id)
            return
        if number != state.number:
            state = known[each.var_id] = _Backing(
                each, number, backed=False, time=seen.time, before=state.last or state.said
            )
            self._unbacked[seen.sender].add(each.var_id)
        state.time, state.last = seen.time, each
        if state.backed:
            return
        state.beacons += room
        if state.beacons == _PATIENCE:
            self._unbacked[seen.sender].discard(each.var_id)
            self.exercised()
            self._tell(state, each, seen)

    def _tell(self, state: _Backing, each: Statement, seen: Seen) -> None:
        who = f"{name(seen.sender)}, variable {each.var_id}"
        if state.before is None:
            nobody = "" if each.var_id in self._created else ", and nobody has ever created it"
            text = f"{who}: summaries of a variable of which it has sent no create{nobody}"
            self.violated(text, [state.said, each], once=(seen.sender, each.var_id, "new"))
            return
        text = f"{who}: summaries tell {state.number} after {seqno_of(state.before)}, and no update brings that value"
        self.violated(text, [state.before, state.said, each], once=(seen.sender, each.var_id))

    def finish(self) -> None:
        """Count what was backed."""
        self._of_all += sum(each.backed for known in self._known.values() for each in known.values())


@dataclass(slots=True)
class _Held:
    """The number that a node states, and since when."""

    number: int
    since: int
    said: Statement
    last: int = 0


class Agreement(Invariant):
    """What the producer says arrives everywhere, or not."""

    id = "CK_NET_AGREES"
    section = "dcp-vardis.md: Global versus Local Dissemination"
    purpose = "All nodes come to the number that the producer of a variable has"
    requirements = ("VD-PU-07", "VD-PU-06")
    expect = "the number of the producer at all nodes, three seconds after it was set"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._circle = Circle(context.profile.types.var_seqno.width)
        self._held: dict[int, dict[bytes, _Held]] = {}
        self._producers: dict[int, bytes] = {}
        self._recreated: set[int] = set()
        self._size = 0
        context.on_gap.append(self._remember)

    def feed(self, seen: Seen) -> None:
        """Remember numbers; when a producer goes on, compare with what it said before."""
        for each, _ in seen.news:
            kind = each.kind
            if kind is CREATE and each.record.spec.prod_id == seen.sender:
                self._producers[each.var_id] = seen.sender
            elif kind is DELETE and each.var_id in self._held:
                self._held[each.var_id].pop(seen.sender, None)
            if kind is not SUMMARY and kind is not UPDATE and kind is not CREATE:
                continue
            number = each.number
            holders = self._held.setdefault(each.var_id, {})
            held = holders.get(seen.sender)
            if held is None:
                if self._size < MOST_VARIABLES:
                    self._size += 1
                    holders[seen.sender] = _Held(number, seen.time, each, seen.time)
                continue
            if held.number == number:
                held.last = seen.time
                continue
            if self._producers.get(each.var_id) == seen.sender:
                self._compare(each.var_id, seen.sender, held, seen.time)
                if not self._circle.newer(number, held.number):
                    self._recreated.add(each.var_id)
            holders[seen.sender] = _Held(number, seen.time, each, seen.time)

    def _remember(self, node: bytes, again: Mapping[int, Stamp]) -> None:
        """What a node said last, before the context forgets it."""
        for var_id, (_, time) in again.items():
            held = self._held.get(var_id, {}).get(node)
            if held is not None:
                held.last = time

    def _last(self, node: bytes, var_id: int, held: _Held) -> int:
        """When a node stated its number last, in ns since 1970."""
        again = self.context.said_again(node, var_id)
        return held.last if again is None else again[1]

    def _compare(self, var_id: int, producer: bytes, own: _Held, now: int) -> None:
        """Who has another number than the producer had for long."""
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
                f"{name(node)} stays with {held.number} of variable {var_id} for {seconds:.1f} s, "
                f"while its producer {name(producer)} has {own.number}"
            )
            if self._circle.newer(held.number, own.number):
                what = "a stale value that looks newer than that of the producer (H8)"
            else:
                what = "a value of the producer that does not arrive"
            key = (node, var_id, what)
            self.violated(text, [own.said, held.said], expected=what, verdict=Verdict.INFO, once=key)

    def finish(self) -> None:
        """Compare what was said last."""
        for var_id, producer in self._producers.items():
            own = self._held.get(var_id, {}).get(producer)
            if own is not None:
                self._compare(var_id, producer, own, self._last(producer, var_id, own))


class FallsSilent(Invariant):
    """A protocol of a node that stops while the node goes on."""

    id = "CK_NET_SILENT"
    section = "dcp-vardis.md: Runtime"
    purpose = "VarDis and SRP of a node do not fall silent while it sends beacons"
    requirements = ("VD-RUN-02", "SRP-SRV-04")
    expect = "payloads of a protocol in the beacons of a node, as before"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._voices: dict[tuple[bytes, str], tuple[list[int], list[int]]] = {}

    def feed(self, seen: Seen) -> None:
        """Count beacons with and without payloads of each protocol."""
        if not seen.sound:
            return
        for protocol, there in (("VarDis", bool(seen.parts)), ("SRP", seen.heard.report is not None)):
            key = (seen.sender, protocol)
            entry = self._voices.get(key)
            if entry is None:
                if len(self._voices) >= MOST_SENDERS:
                    continue
                # Spoke, silent in a row, beacons until it fell silent; and the last frame with it.
                entry = self._voices[key] = ([0, 0, 0], [0])
            counts, last = entry
            if there:
                counts[0] += 1
                counts[2] += 1 + counts[1]
                counts[1] = 0
                last[0] = seen.number
            else:
                counts[1] += 1

    def finish(self) -> None:
        """Say who has fallen silent, and stayed so to the end: an application may have stopped it."""
        for (node, protocol), ((spoke, silent, beacons), (last,)) in self._voices.items():
            rule = "VD-RUN-02" if protocol == "VarDis" else "SRP-SRV-04"
            if spoke < _SPOKE:
                continue
            self.exercised(rule)
            if silent >= _SILENT and spoke >= _MOSTLY * beacons:
                text = f"{name(node)}: no {protocol} payload in its last {silent} beacons, after frame {last}"
                self.violated(text, [], rule, expected="a protocol that falls silent", verdict=Verdict.INFO)


@dataclass(slots=True)
class _Asked:
    count: int
    first: Statement
    answers: int = 0
    answer: Statement | None = None
    by: set[bytes] = field(default_factory=set)


class EndlessRequests(Invariant):
    """Requests that do not end."""

    id = "CK_VD_ENDLESS"
    section = "dcp-vardis.md: Global versus Local Dissemination"
    purpose = "Requests end: they are answered, and the answer is taken"
    requirements = ("VD-PC-07", "VD-PU-07", "VD-RC-03", "VD-RU-04")
    expect = "fewer than ten requests for one variable without an answer that is taken"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._asked: dict[tuple[bytes, int, ICType], _Asked] = {}
        self._askers: dict[tuple[int, ICType], dict[bytes, None]] = {}

    def feed(self, seen: Seen) -> None:
        """Count requests, and answers of others, until the node has what it asked for."""
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
                self._said(each, seen, ASK_CREATE)
            elif kind is UPDATE:
                self._said(each, seen, ASK_UPDATE)
            elif kind is DELETE:
                for asks in (ASK_CREATE, ASK_UPDATE):
                    self._ends(seen.sender, each.var_id, asks)

    def _said(self, each: Statement, seen: Seen, asks: ICType) -> None:
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
        asked = self._asked.pop((node, var_id, asks), None)
        if asked is not None:
            del self._askers[var_id, asks][node]
            self.exercised()

    def finish(self) -> None:
        """Tell those that have not ended, with the likely reason."""
        for (node, var_id, asks), asked in self._asked.items():
            if asked.count < _OFTEN:
                continue
            what = "create" if asks is ICType.REQUEST_VARCREATES else "update"
            text = f"{name(node)} asks {asked.count} times for the {what} of variable {var_id}, to the end"
            if asked.answers < _ANSWERED or asked.answer is None:
                text += f"; it was sent {asked.answers} times since the first request"
                frames = [asked.first]
            else:
                who = ", ".join(sorted(map(name, asked.by)))
                text += f"; {who} sent it {asked.answers} times{self._reason(node, asked.answer)}"
                frames = [asked.first, asked.answer]
            self.violated(text, frames, expected="requests that do not end", verdict=Verdict.INFO)

    def _reason(self, node: bytes, answer: Statement) -> str:
        """Why a node may not take what it asks for: it is above all that the node has shown to take."""
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
                    f"(it has taken no more than {station.repetitions})"
                )
            if len(spec.descr) > max(1, station.description):
                return f"; the likely reason: a description of {len(spec.descr)} octets is above the node's maximum"
        if len(value) > max(1, station.value):
            return (
                f"; the likely reason: a value of {len(value)} octets is above the node's maximum "
                f"(it has taken no more than {station.value})"
            )
        return "; perhaps the payload is longer than the node takes, or it loses a part of it"


RULES: tuple[type[Invariant], ...] = (Backed, Agreement, EndlessRequests, FallsSilent)
