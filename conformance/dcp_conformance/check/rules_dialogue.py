"""dcp-vardis.md: what nodes do about what they hear from each other.

A recorder is not a node: it may hear what a node did not. So nothing here rests on single frames. That Y hears X is
shown by Y passing on something that only X had sent before; that it does not do what it must, by its not doing so most
of many times.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

from dcp_spec.constants import ICType

from dcp_conformance.circular import Circle
from dcp_conformance.pics import REACTION_FLOOR

from .base import MOST_VARIABLES, Context, Invariant, Seen, name
from .hearing import BELIEF, GAP_SHOWS, Hearing
from .rules_vardis import SENT, seqno_of
from .said import Said

MS = 1_000_000
#: Of so many occasions this part must be missed for a verdict; of fewer, down to the second number, every one.
_OCCASIONS, _MISSED, _FEWEST = 5, 0.8, 4
#: What a radio may lose, and what it loses where a node has reacted so often; less likely findings are no accident.
_LOSS, _LITTLE, _ENOUGH, _CHANCE = 0.5, 0.1, 20, 1.5e-4
#: Beacons that a node must have sent in the window.
_CHANCES = 3
_PENDING = 10_000
#: Nodes with a variable that are followed: others would say the same of it.
_HOLDERS = 64


class _Due(NamedTuple):
    deadline: int
    node: bytes
    """Who has to do something."""
    var_id: int
    cause: Said
    seqno: int
    beacons: int
    """How many beacons of the node had been heard by then."""


class _Outcome(NamedTuple):
    """Something was due, and came or did not."""

    judged: int
    """When it is known whether the node hears the one that it should have reacted to."""
    due: _Due
    missed: bool


class Counter:
    """Of how many occasions how many were missed, and one example."""

    def __init__(self) -> None:
        self.occasions = self.missed = 0
        self.examples: list[Said] = []

    def note(self, cause: Said, *, missed: bool) -> None:
        self.occasions += 1
        if missed:
            self.missed += 1
            if len(self.examples) < 3:
                self.examples.append(cause)

    @property
    def convincing(self) -> bool:
        """Whether it is the rule and no exception."""
        if self.occasions < _OCCASIONS:
            return self.missed == self.occasions >= _FEWEST
        return self.missed >= _MISSED * self.occasions

    def unlikely(self, loss: float) -> bool:
        """Whether so much is not missed by chance where this part of all beacons is lost on the way."""
        rest = range(self.missed, self.occasions + 1)
        tail = math.fsum(
            math.comb(self.occasions, each) * loss**each * (1 - loss) ** (self.occasions - each) for each in rest
        )
        return tail <= _CHANCE


class _Dialogue(Invariant):
    """Base: what each node was last heard to have of each variable, and what is due."""

    enough = 4

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self.circle = Circle(context.profile.types.var_seqno.width)
        self.hearing = Hearing(context)
        self._known: dict[tuple[bytes, int], tuple[int, int]] = {}
        """(node, variable) -> number that it was last heard to have, and when."""
        self._creations: dict[tuple[bytes, int], tuple[Any, ...]] = {}
        """(node, variable) -> producer and creation time, as the node has said."""
        self._holders: dict[int, dict[bytes, None]] = {}
        """Who was ever heard to have a variable."""
        self._due: deque[_Due] = deque()
        self._outcomes: deque[_Outcome] = deque()
        self._counters: dict[tuple[bytes, int], Counter] = {}
        period = context.pics.pixit.beacon_period_ms * MS
        self.window = round(((context.pics.pixit.reaction_periods or REACTION_FLOOR) + 1) * period)

    def feed(self, seen: Seen) -> None:
        """Take all instructions of a beacon, then look at what it answers."""
        self._expire(seen.time)
        for each in seen.said:
            self.hearing.feed(each, seen.sender, seen.time)
            if each.kind is ICType.DELETE_VARIABLES or (each.kind in SENT and self._begins_again(each, seen.sender)):
                # Whatever was due was due of another life of the variable.
                self._settle(seen.sender, each.var_id, lambda _due: True, met=None)
            self.met(each, seen)
            self._note(each, seen)
        for each in seen.said:
            self.asked(each, seen)

    def _begins_again(self, each: Said, node: bytes) -> bool:
        """Whether a node has taken another creation than it had."""
        key = (node, each.var_id)
        if each.kind is ICType.CREATE_VARIABLES:
            spec = each.record.spec
            this = (spec.prod_id, spec.creation_time)
            before = self._creations.get(key)
            if before is not None or len(self._creations) < MOST_VARIABLES:
                self._creations[key] = this
            if before not in (None, this):
                return True
        known = self._known.get(key)
        return known is not None and seqno_of(each) != known[0] and not self.circle.newer(seqno_of(each), known[0])

    def _note(self, each: Said, seen: Seen) -> None:
        key = (seen.sender, each.var_id)
        if each.kind is ICType.DELETE_VARIABLES:
            self._known.pop(key, None)
        elif each.kind in SENT and (key in self._known or len(self._known) < MOST_VARIABLES):
            self._known[key] = (seqno_of(each), seen.time)
            self._hold(each.var_id, seen.sender)

    def _hold(self, var_id: int, node: bytes) -> None:
        holders = self._holders.setdefault(var_id, {})
        if len(holders) < _HOLDERS:
            holders[node] = None

    def others(self, instruction: Said, seen: Seen) -> list[bytes]:
        """Who else was ever heard to have the variable; whether they hear the sender is seen later."""
        return [node for node in self._holders.get(instruction.var_id, ()) if node != seen.sender]

    def met(self, instruction: Said, seen: Seen) -> None:
        """A node says something: settle what was due from it."""
        raise NotImplementedError

    def asked(self, instruction: Said, seen: Seen) -> None:
        """A node says something: note what others have to do about it."""
        raise NotImplementedError

    def number(self, node: bytes, var_id: int) -> int | None:
        """The number that a node has of a variable; None if it has none, or may have lost it unheard since."""
        known = self._known.get((node, var_id))
        if known is None or not self.context.senders.unbroken(node, known[1]):
            return None
        return known[0]

    def consumer(self, node: bytes, var_id: int) -> bool:
        """Whether a node has a variable of somebody else, as it said itself, or as there has only been one."""
        creation = self._creations.get((node, var_id))
        producer: bytes | None = None if creation is None else creation[0]
        if producer is None and self.context.lives.born(var_id) is not None:
            producer = self.context.lives.producer(var_id)
        return producer is not None and producer != node

    def expect_from(self, node: bytes, cause: Said, seen: Seen, seqno: int) -> None:
        """Something is due from ``node`` within the window."""
        sender = self.context.senders.get(node)
        if sender is not None and len(self._due) < _PENDING:
            self._due.append(_Due(seen.time + self.window, node, cause.var_id, cause, seqno, sender.beacons))

    def settle(self, node: bytes, var_id: int, done: Callable[[_Due], bool]) -> None:
        """``node`` did it; ``done`` says for which occasions."""
        self._settle(node, var_id, done, met=True)

    def _settle(self, node: bytes, var_id: int, done: Callable[[_Due], bool], *, met: bool | None) -> None:
        """``met`` None: there is no telling any more."""
        if not any(due.node == node and due.var_id == var_id for due in self._due):
            return
        kept: deque[_Due] = deque()
        for due in self._due:
            if due.node != node or due.var_id != var_id or not done(due):
                kept.append(due)
            elif met is not None:
                self._outcome(due, missed=False)
        self._due = kept

    def _expire(self, time: int) -> None:
        while self._due and self._due[0].deadline < time:
            due = self._due.popleft()
            sender = self.context.senders.get(due.node)
            # If something of it is missing, perhaps it did what it had to do, unheard. If it fell silent, it had no
            # occasion.
            if sender is not None and sender.unbroken <= due.cause.time and sender.beacons >= due.beacons + _CHANCES:
                self._outcome(due, missed=True)
        while self._outcomes and self._outcomes[0].judged < time:
            self._count(self._outcomes.popleft())

    def _outcome(self, due: _Due, *, missed: bool) -> None:
        if len(self._outcomes) < _PENDING:
            self._outcomes.append(_Outcome(due.cause.time + BELIEF + GAP_SHOWS, due, missed))

    def _count(self, outcome: _Outcome) -> None:
        due = outcome.due
        speaker = due.cause.sender
        if not self.hearing.hears(due.node, speaker, due.cause.time):
            return
        if (due.node, due.var_id) in self._counters or len(self._counters) < MOST_VARIABLES:
            self._counters.setdefault((due.node, due.var_id), Counter()).note(due.cause, missed=outcome.missed)

    def finish(self) -> None:
        """Judge the counts."""
        self.hearing.finish()
        while self._outcomes:
            self._count(self._outcomes.popleft())
        for (node, var_id), counter in self._counters.items():
            self.exercised(times=counter.occasions)
            if counter.convincing and counter.unlikely(self.loss(node, counter.examples[0].sender)):
                text = f"{name(node)}, variable {var_id}: missed {counter.missed} of {counter.occasions} times"
                self.violated(f"{text}{self.example(counter)}", counter.examples)

    def loss(self, node: bytes, speaker: bytes) -> float:  # noqa: ARG002 - for those that know better
        """The part of the beacons of ``speaker`` that ``node`` may have missed: nobody knows it."""
        return _LOSS

    def example(self, counter: Counter) -> str:
        """More about what was missed."""
        first = counter.examples[0]
        return f", first after frame {first.frame} of {name(first.sender)}"


class AnswersUpdateRequests(_Dialogue):
    """Requests for updates are answered."""

    id = "CK_VD_ANSWER_UPDATE"
    section = "dcp-vardis.md: Processing REQUEST-VARUPDATES"
    purpose = "Who has a newer value and hears a request for it sends it"
    requirements = ("VD-RU-04",)
    expect = "an update within the reaction time after a request that tells an older number"

    def met(self, instruction: Said, seen: Seen) -> None:
        """An update answers every request with an older number."""
        if instruction.kind is ICType.UPDATES:
            number = seqno_of(instruction)
            self.settle(seen.sender, instruction.var_id, lambda due: not self.circle.newer(due.seqno, number))

    def asked(self, instruction: Said, seen: Seen) -> None:
        """Everybody who hears the request and has something newer owes an answer."""
        if instruction.kind is not ICType.REQUEST_VARUPDATES:
            return
        for node in self.others(instruction, seen):
            has = self.number(node, instruction.var_id)
            if has is not None and self.circle.newer(has, seqno_of(instruction)):
                self.expect_from(node, instruction, seen, has)


class AnswersCreateRequests(_Dialogue):
    """Requests for creations are answered."""

    id = "CK_VD_ANSWER_CREATE"
    section = "dcp-vardis.md: Processing REQUEST-VARCREATES"
    purpose = "Who has a variable and hears a request for it sends its creation"
    requirements = ("VD-RC-03",)
    expect = "a create within the reaction time after a request"

    def met(self, instruction: Said, seen: Seen) -> None:
        """A create answers."""
        if instruction.kind is ICType.CREATE_VARIABLES:
            self.settle(seen.sender, instruction.var_id, lambda _due: True)

    def asked(self, instruction: Said, seen: Seen) -> None:
        """Everybody who hears the request and has the variable owes an answer."""
        if instruction.kind is not ICType.REQUEST_VARCREATES:
            return
        for node in self.others(instruction, seen):
            if self.number(node, instruction.var_id) is not None:
                self.expect_from(node, instruction, seen, 0)


class TakesUpdates(_Dialogue):
    """Updates are taken.

    How well a node hears another shows where it asks: every request for an update answers a summary. A node that asks
    again and again after every summary, and never takes the updates, has heard them.
    """

    id = "CK_VD_TAKES_UPDATE"
    section = "dcp-vardis.md: Processing UPDATES"
    purpose = "Who hears a newer value of a variable has it from then on"
    requirements = ("VD-PU-07", "VD-RX-04")
    expect = "the newer number in the summaries and updates of a node that hears the update"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._told: dict[tuple[bytes, int], set[bytes]] = {}
        """(node, variable) -> who has told it of a newer number since its last beacon but one."""
        self._asked: dict[tuple[bytes, bytes], list[int]] = {}
        """(node, speaker) -> beacons in which it could ask because of that one alone, and in which it did."""

    def feed(self, seen: Seen) -> None:
        """Also count who asks whom."""
        super().feed(seen)
        asks = {each.var_id for each in seen.said if each.kind is ICType.REQUEST_VARUPDATES}
        for each in seen.said:
            if each.kind is ICType.SUMMARIES:
                self._count_request(seen.sender, each.var_id, asked=each.var_id in asks)
                for node in self.others(each, seen):
                    has = self.number(node, each.var_id)
                    if has is not None and self.circle.newer(seqno_of(each), has):
                        self._told.setdefault((node, each.var_id), set()).add(seen.sender)

    def _count_request(self, node: bytes, var_id: int, *, asked: bool) -> None:
        speakers = self._told.pop((node, var_id), set())
        if len(speakers) == 1:
            (speaker,) = speakers
            if (node, speaker) in self._asked or len(self._asked) < MOST_VARIABLES:
                counts = self._asked.setdefault((node, speaker), [0, 0])
                counts[0] += 1
                counts[1] += asked

    def loss(self, node: bytes, speaker: bytes) -> float:
        """Little, where it has asked after nearly every summary."""
        could, did = self._asked.get((node, speaker), (0, 0))
        return _LITTLE if could >= _ENOUGH and did >= 0.9 * could else _LOSS

    def met(self, instruction: Said, seen: Seen) -> None:
        """Whatever carries the number, or a newer one, shows that it was taken."""
        if instruction.kind in SENT:
            number = seqno_of(instruction)
            self.settle(seen.sender, instruction.var_id, lambda due: not self.circle.newer(due.seqno, number))

    def asked(self, instruction: Said, seen: Seen) -> None:
        """Everybody who hears the update, has the variable and is not its producer must take it."""
        if instruction.kind is not ICType.UPDATES:
            return
        for node in self.others(instruction, seen):
            has = self.number(node, instruction.var_id)
            if has is None or not self.consumer(node, instruction.var_id):
                continue
            if self.circle.newer(seqno_of(instruction), has):
                self.expect_from(node, instruction, seen, seqno_of(instruction))


RULES: tuple[type[Invariant], ...] = (
    AnswersUpdateRequests,
    AnswersCreateRequests,
    TakesUpdates,
)
