"""dcp-vardis.md: what nodes do about what they hear from each other.

A recorder is not a node: it may hear what a node did not. So nothing here rests on single frames. That Y hears X is
shown by Y passing on something that only X had sent before; that it does not do what it must, by its not doing so most
of many times.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

from dcp_spec.constants import ICType

from dcp_conformance.circular import Circle

from .base import MOST_VARIABLES, Context, Invariant, Seen, name
from .rules_vardis import SENT, seqno_of
from .said import Said

MS = 1_000_000
#: For how long after it was shown that Y hears X this is believed, in ns.
_BELIEF = 20_000 * MS
#: A gap in the recording shows within so many ns, or never.
_GAP_SHOWS = 2_000 * MS
#: Of the times at which it did, so many are remembered of each pair.
_REMEMBERED = 64
#: Of so many occasions this part must be missed for a verdict; of fewer, down to the second number, every one.
_OCCASIONS, _MISSED, _FEWEST = 5, 0.8, 4
#: Beacons that a node must have sent in the window.
_CHANCES = 3
_PENDING = 10_000


class _Shown(NamedTuple):
    """It looks as if one node heard another."""

    begin: int
    end: int
    listener: bytes
    speaker: bytes


class Hearing:
    """Who is known to hear whom.

    A node that comes to a number of a variable, of which one other node alone has sent the value, hears that one, if no
    third has sent it that the recorder missed: that is waited for. Only variables with a single life count; of others
    several nodes may come up with the same.
    """

    def __init__(self, context: Context) -> None:
        self._context = context
        self._half = 1 << (8 * context.profile.types.var_seqno.width - 1)
        self._numbers: dict[tuple[bytes, int], int] = {}
        """(node, variable) -> the number that it sent last."""
        self._origins: dict[tuple[int, int], tuple[int, set[bytes]]] = {}
        """(variable, number) -> since when, and who has sent its value."""
        self._open: deque[_Shown] = deque()
        self._heard: dict[tuple[bytes, bytes], deque[int]] = {}

    def feed(self, instruction: Said, sender: bytes, time: int) -> None:
        """Take an instruction."""
        while self._open and self._open[0].end + _GAP_SHOWS < time:
            self._believe(self._open.popleft())
        if instruction.kind not in SENT:
            return
        var_id, number = instruction.var_id, seqno_of(instruction)
        had = self._numbers.get((sender, var_id))
        if had is not None or len(self._numbers) < MOST_VARIABLES:
            self._numbers[sender, var_id] = number
        if instruction.kind is ICType.SUMMARIES:
            return
        lives = self._context.lives
        if lives.born(var_id) is None:
            self._origins.pop((var_id, number), None)
            return
        # The numbers come round again: half a circle ahead is half a circle back.
        self._origins.pop((var_id, (number + self._half) % (2 * self._half)), None)
        begin, senders = self._origins.get((var_id, number), (time, set()))
        if not senders:
            if len(self._origins) >= MOST_VARIABLES:
                self._origins.clear()
            self._origins[var_id, number] = (time, {sender})
        elif sender not in senders:
            new = had != number and lives.producer(var_id) != sender
            if new and len(senders) == 1 and time - begin < _BELIEF and len(self._open) < _PENDING:
                self._open.append(_Shown(begin, time, sender, next(iter(senders))))
            senders.add(sender)

    def _believe(self, shown: _Shown) -> None:
        if self._context.senders.complete(shown.begin, shown.end) and len(self._heard) < MOST_VARIABLES:
            self._heard.setdefault((shown.listener, shown.speaker), deque(maxlen=_REMEMBERED)).append(shown.end)

    def finish(self) -> None:
        """No gap will show any more."""
        while self._open:
            self._believe(self._open.popleft())

    def hears(self, listener: bytes, speaker: bytes, time: int) -> bool:
        """Whether it was shown, not long before or after, that ``listener`` hears ``speaker``."""
        shown = self._heard.get((listener, speaker), ())
        return any(abs(time - each) <= _BELIEF for each in shown)


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
        if self.occasions < _OCCASIONS:
            return self.missed == self.occasions >= _FEWEST
        return self.missed >= _MISSED * self.occasions


class _Dialogue(Invariant):
    """Base: what each node was last heard to have of each variable, and what is due."""

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self.circle = Circle(context.profile.types.var_seqno.width)
        self.hearing = Hearing(context)
        self._known: dict[tuple[bytes, int], tuple[int, int]] = {}
        """(node, variable) -> number that it was last heard to have, and when."""
        self._creations: dict[tuple[bytes, int], tuple[Any, ...]] = {}
        """(node, variable) -> producer and creation time, as the node has said."""
        self._holders: dict[int, set[bytes]] = {}
        """Who was ever heard to have a variable."""
        self._due: deque[_Due] = deque()
        self._outcomes: deque[_Outcome] = deque()
        self._counters: dict[tuple[bytes, int], Counter] = {}
        period = context.pics.pixit.beacon_period_ms * MS
        self.window = round((context.pics.pixit.reaction_periods + 1) * period)

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
            self._holders.setdefault(each.var_id, set()).add(seen.sender)

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
            self._outcomes.append(_Outcome(due.cause.time + _BELIEF + _GAP_SHOWS, due, missed))

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
            self.exercised()
            if counter.convincing:
                text = f"{name(node)}, variable {var_id}: missed {counter.missed} of {counter.occasions} times"
                self.violated(f"{text}{self.example(counter)}", counter.examples)

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
    """Updates are taken."""

    id = "CK_VD_TAKES_UPDATE"
    section = "dcp-vardis.md: Processing UPDATES"
    purpose = "Who hears a newer value of a variable has it from then on"
    requirements = ("VD-PU-07", "VD-RX-04")
    expect = "the newer number in the summaries and updates of a node that hears the update"

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
