"""dcp-vardis.md: what nodes do about what they hear from each other.

A recorder is not a node: it may hear what a node did not. So nothing here rests on single frames. That Y hears X is
shown by Y passing on something that only X had sent before; that it does not do what it must, by its not doing so most
of many times.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

from dcp_spec.constants import ICType

from dcp_conformance.circular import Circle
from dcp_conformance.heard import Instruction

from .base import MOST_VARIABLES, Context, Invariant, Seen, name
from .rules_vardis import seqno_of

MS = 1_000_000
#: For how long after it was shown that Y hears X this is believed, in ns.
_BELIEF = 20_000 * MS
#: A gap in the recording shows within so many ns, or never.
_GAP_SHOWS = 2_000 * MS
#: So often it must look as if one node heard another.
_SHOWN = 2
#: Of so many occasions this part must be missed for a verdict; of fewer, down to the second number, every one.
_OCCASIONS, _MISSED, _FEWEST = 5, 0.8, 4
_PENDING = 10_000


class _Shown(NamedTuple):
    """It looks as if one node heard another."""

    begin: int
    end: int
    listener: bytes
    speaker: bytes


class Hearing:
    """Who is known to hear whom.

    A node that repeats what one other node alone has sent hears that one, if no third has sent it that the recorder
    missed: that is waited for. Only variables with a single life count; of others several nodes may come up with the
    same.
    """

    def __init__(self, context: Context) -> None:
        self._context = context
        self._origins: dict[tuple[int, int, ICType], tuple[int, set[bytes]]] = {}
        self._open: deque[_Shown] = deque()
        self._heard: dict[tuple[bytes, bytes], int] = {}
        self._counts: dict[tuple[bytes, bytes], int] = {}

    def feed(self, instruction: Instruction, sender: bytes, time: int) -> None:
        """Take an instruction."""
        while self._open and self._open[0].end + _GAP_SHOWS < time:
            self._believe(self._open.popleft())
        if instruction.kind not in (ICType.CREATE_VARIABLES, ICType.UPDATES):
            return
        key = (instruction.var_id, seqno_of(instruction), instruction.kind)
        lives = self._context.lives
        if lives.born(instruction.var_id) is None:
            self._origins.pop(key, None)
            return
        begin, senders = self._origins.get(key, (0, set()))
        if not senders or time - begin > _BELIEF:
            # The numbers come round again.
            if len(self._origins) >= MOST_VARIABLES:
                self._origins.clear()
            self._origins[key] = (time, {sender})
        elif sender not in senders:
            if len(senders) == 1 and lives.producer(instruction.var_id) != sender and len(self._open) < _PENDING:
                self._open.append(_Shown(begin, time, sender, next(iter(senders))))
            senders.add(sender)

    def _believe(self, shown: _Shown) -> None:
        if self._context.senders.complete(shown.begin, shown.end) and len(self._counts) < MOST_VARIABLES:
            pair = (shown.listener, shown.speaker)
            self._counts[pair] = self._counts.get(pair, 0) + 1
            if self._counts[pair] >= _SHOWN:
                self._heard[pair] = shown.end

    def listeners(self, speaker: bytes, time: int) -> list[bytes]:
        """Who is known to hear ``speaker``."""
        return [
            listener for (listener, each), shown in self._heard.items() if each == speaker and time - shown <= _BELIEF
        ]


class _Due(NamedTuple):
    deadline: int
    node: bytes
    """Who has to do something."""
    var_id: int
    cause: Instruction
    seqno: int


class Counter:
    """Of how many occasions how many were missed, and one example."""

    def __init__(self) -> None:
        self.occasions = self.missed = 0
        self.examples: list[Instruction] = []

    def note(self, cause: Instruction, *, missed: bool) -> None:
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
        self._producers: dict[tuple[bytes, int], bytes] = {}
        """(node, variable) -> who produces it, as the node has said."""
        self._due: deque[_Due] = deque()
        self._counters: dict[tuple[bytes, int], Counter] = {}
        period = context.pics.pixit.beacon_period_ms * MS
        self.window = round((context.pics.pixit.reaction_periods + 1) * period)

    def feed(self, seen: Seen) -> None:
        """Take all instructions of a beacon, then look at what it answers."""
        self._expire(seen.time)
        for each in seen.heard.instructions():
            key = (seen.sender, each.var_id)
            self.hearing.feed(each, seen.sender, seen.time)
            if each.kind is ICType.CREATE_VARIABLES and (
                key in self._producers or len(self._producers) < MOST_VARIABLES
            ):
                self._producers[key] = each.record.spec.prod_id
            self.met(each, seen)
            if each.kind in (ICType.CREATE_VARIABLES, ICType.UPDATES, ICType.SUMMARIES):
                if key in self._known or len(self._known) < MOST_VARIABLES:
                    self._known[key] = (seqno_of(each), seen.time)
            elif each.kind is ICType.DELETE_VARIABLES:
                self._known.pop(key, None)
        for each in seen.heard.instructions():
            self.asked(each, seen)

    def met(self, instruction: Instruction, seen: Seen) -> None:
        """A node says something: settle what was due from it."""
        raise NotImplementedError

    def asked(self, instruction: Instruction, seen: Seen) -> None:
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
        producer = self._producers.get((node, var_id))
        if producer is None and self.context.lives.born(var_id) is not None:
            producer = self.context.lives.producer(var_id)
        return producer is not None and producer != node

    def expect_from(self, node: bytes, cause: Instruction, seen: Seen, seqno: int) -> None:
        """Something is due from ``node`` within the window."""
        if len(self._due) < _PENDING:
            self._due.append(_Due(seen.time + self.window, node, cause.var_id, cause, seqno))

    def settle(self, node: bytes, var_id: int, done: object) -> None:
        """``node`` did it; ``done(due)`` says for which occasions."""
        kept: deque[_Due] = deque()
        for due in self._due:
            if due.node == node and due.var_id == var_id and done(due):  # type: ignore[operator]
                self._count(due, missed=False)
            else:
                kept.append(due)
        self._due = kept

    def _expire(self, time: int) -> None:
        while self._due and self._due[0].deadline < time:
            self._count(self._due.popleft(), missed=True)

    def _count(self, due: _Due, *, missed: bool) -> None:
        if missed and not self.context.senders.unbroken(due.node, due.cause.heard.wall):
            # Perhaps it did, and the recorder missed it.
            return
        if (due.node, due.var_id) in self._counters or len(self._counters) < MOST_VARIABLES:
            self._counters.setdefault((due.node, due.var_id), Counter()).note(due.cause, missed=missed)

    def finish(self) -> None:
        """Judge the counts."""
        for (node, var_id), counter in self._counters.items():
            self.exercised()
            if counter.convincing:
                text = f"{name(node)}, variable {var_id}: missed {counter.missed} of {counter.occasions} times"
                self.violated(f"{text}{self.example(counter)}", counter.examples)

    def example(self, counter: Counter) -> str:
        """More about what was missed."""
        first = counter.examples[0]
        return f", first after frame {first.heard.number} of {name(first.heard.sender or b'')}"


class AnswersUpdateRequests(_Dialogue):
    """Requests for updates are answered."""

    id = "CK_VD_ANSWER_UPDATE"
    section = "dcp-vardis.md: Processing REQUEST-VARUPDATES"
    purpose = "Who has a newer value and hears a request for it sends it"
    requirements = ("VD-RU-04",)
    expect = "an update within the reaction time after a request that tells an older number"

    def met(self, instruction: Instruction, seen: Seen) -> None:
        """An update answers every request with an older number."""
        if instruction.kind is ICType.UPDATES:
            number = seqno_of(instruction)
            self.settle(seen.sender, instruction.var_id, lambda due: not self.circle.newer(due.seqno, number))
        elif instruction.kind is ICType.DELETE_VARIABLES:
            self.settle(seen.sender, instruction.var_id, lambda _due: True)

    def asked(self, instruction: Instruction, seen: Seen) -> None:
        """Everybody who hears the request and has something newer owes an answer."""
        if instruction.kind is not ICType.REQUEST_VARUPDATES:
            return
        for node in self.hearing.listeners(seen.sender, seen.time):
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

    def met(self, instruction: Instruction, seen: Seen) -> None:
        """A create answers."""
        if instruction.kind in (ICType.CREATE_VARIABLES, ICType.DELETE_VARIABLES):
            self.settle(seen.sender, instruction.var_id, lambda _due: True)

    def asked(self, instruction: Instruction, seen: Seen) -> None:
        """Everybody who hears the request and has the variable owes an answer."""
        if instruction.kind is not ICType.REQUEST_VARCREATES:
            return
        for node in self.hearing.listeners(seen.sender, seen.time):
            if self.number(node, instruction.var_id) is not None:
                self.expect_from(node, instruction, seen, 0)


class TakesUpdates(_Dialogue):
    """Updates are taken."""

    id = "CK_VD_TAKES_UPDATE"
    section = "dcp-vardis.md: Processing UPDATES"
    purpose = "Who hears a newer value of a variable has it from then on"
    requirements = ("VD-PU-07", "VD-RX-04")
    expect = "the newer number in the summaries and updates of a node that hears the update"

    def met(self, instruction: Instruction, seen: Seen) -> None:
        """Whatever carries the number, or a newer one, shows that it was taken."""
        if instruction.kind in (ICType.SUMMARIES, ICType.UPDATES, ICType.CREATE_VARIABLES):
            number = seqno_of(instruction)
            self.settle(seen.sender, instruction.var_id, lambda due: not self.circle.newer(due.seqno, number))
        elif instruction.kind is ICType.DELETE_VARIABLES:
            self.settle(seen.sender, instruction.var_id, lambda _due: True)

    def asked(self, instruction: Instruction, seen: Seen) -> None:
        """Everybody who hears the update, has the variable and is not its producer must take it."""
        if instruction.kind is not ICType.UPDATES:
            return
        for node in self.hearing.listeners(seen.sender, seen.time):
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
