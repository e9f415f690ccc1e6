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
from dcp_conformance.results import Mark

from .base import MOST_VARIABLES, Context, Invariant, Seen, name
from .rules_vardis import Creations, seqno_of

MS = 1_000_000
#: For how long after it was shown that Y hears X this is believed, in ns.
_BELIEF = 20_000 * MS
#: Of so many occasions this part must be missed for a verdict; of fewer, down to the second number, every one.
_OCCASIONS, _MISSED, _FEWEST = 5, 0.8, 4
#: For how many beacon periods before it is seen on the air a payload may have been composed.
_COMPOSED = 1.6
_PENDING = 10_000


class Hearing:
    """Who is known to hear whom."""

    def __init__(self) -> None:
        self._origins: dict[tuple[int, int, int, ICType], set[bytes]] = {}
        self._heard: dict[tuple[bytes, bytes], int] = {}

    def feed(self, instruction: Instruction, creation: int, sender: bytes, time: int) -> None:
        """Take an instruction; whoever repeats what one other node alone has sent hears that one."""
        if instruction.kind not in (ICType.CREATE_VARIABLES, ICType.UPDATES):
            return
        key = (instruction.var_id, creation, seqno_of(instruction), instruction.kind)
        senders = self._origins.get(key)
        if senders is None:
            if len(self._origins) >= MOST_VARIABLES:
                self._origins.clear()
            self._origins[key] = {sender}
        elif sender not in senders:
            if len(senders) == 1:
                self._heard[sender, next(iter(senders))] = time
            senders.add(sender)

    def hears(self, listener: bytes, speaker: bytes, time: int) -> bool:
        """Whether it was shown lately that ``listener`` hears ``speaker``."""
        shown = self._heard.get((listener, speaker))
        return shown is not None and abs(time - shown) <= _BELIEF

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


class _Counter:
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
        self.creations = Creations()
        self.hearing = Hearing()
        self.known: dict[tuple[bytes, int], tuple[int, int]] = {}
        """(node, variable) -> creation and number that it was last heard to have."""
        self.producers: dict[int, bytes] = {}
        self._due: deque[_Due] = deque()
        self._counters: dict[tuple[bytes, int], _Counter] = {}
        period = context.pics.pixit.beacon_period_ms * MS
        self.window = round((context.pics.pixit.reaction_periods + 1) * period)

    def feed(self, seen: Seen) -> None:
        """Take all instructions of a beacon, then look at what it answers."""
        self._expire(seen.time)
        for each in seen.heard.instructions():
            creation = self.creations.feed(each)
            self.hearing.feed(each, creation, seen.sender, seen.time)
            if each.kind is ICType.CREATE_VARIABLES:
                self.producers[each.var_id] = each.record.spec.prod_id
            self.met(each, seen)
            if each.kind in (ICType.CREATE_VARIABLES, ICType.UPDATES, ICType.SUMMARIES):
                if (seen.sender, each.var_id) in self.known or len(self.known) < MOST_VARIABLES:
                    self.known[seen.sender, each.var_id] = (creation, seqno_of(each))
            elif each.kind is ICType.DELETE_VARIABLES:
                self.known.pop((seen.sender, each.var_id), None)
        for each in seen.heard.instructions():
            self.asked(each, seen)

    def met(self, instruction: Instruction, seen: Seen) -> None:
        """A node says something: settle what was due from it."""
        raise NotImplementedError

    def asked(self, instruction: Instruction, seen: Seen) -> None:
        """A node says something: note what others have to do about it."""
        raise NotImplementedError

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
        if (due.node, due.var_id) in self._counters or len(self._counters) < MOST_VARIABLES:
            self._counters.setdefault((due.node, due.var_id), _Counter()).note(due.cause, missed=missed)

    def finish(self) -> None:
        """Judge the counts."""
        for (node, var_id), counter in self._counters.items():
            self.exercised()
            if counter.convincing:
                text = f"{name(node)}, variable {var_id}: missed {counter.missed} of {counter.occasions} times"
                self.violated(f"{text}{self.example(counter)}", counter.examples)

    def example(self, counter: _Counter) -> str:
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
            has = self.known.get((node, instruction.var_id))
            if has is not None and self.circle.newer(has[1], seqno_of(instruction)):
                self.expect_from(node, instruction, seen, has[1])


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
            if (node, instruction.var_id) in self.known:
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
            has = self.known.get((node, instruction.var_id))
            if has is None or self.producers.get(instruction.var_id) == node:
                continue
            if self.circle.newer(seqno_of(instruction), has[1]):
                self.expect_from(node, instruction, seen, seqno_of(instruction))


class Repetitions(Invariant):
    """Instructions are repeated as often as the VarSpec says."""

    id = "CK_VD_REPEAT"
    section = "dcp-vardis.md: Global versus Local Dissemination"
    purpose = "A node sends an instruction in at most repCnt beacons, unless somebody gives it a reason to begin again"
    requirements = ("VD-SCP-02", "VD-SCP-03")
    expect = "at most repCnt beacons with the same instruction for each reason to send it"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._circle = Circle(context.profile.types.var_seqno.width)
        self._creations = Creations()
        self._rep_cnt: dict[int, int] = {}
        self._runs: dict[tuple[bytes, int, ICType], list[int]] = {}
        """(node, variable, kind) -> creation, number, beacons so far, beacons allowed, equal requests."""
        self._senders: dict[tuple[int, ICType], set[bytes]] = {}
        """Who has a run of that kind, by variable."""
        self._reasons: deque[tuple[int, bytes, Instruction]] = deque()
        """What was said lately that can be a reason for others, when, and by whom."""
        self._composed = round(_COMPOSED * context.pics.pixit.beacon_period_ms * MS)

    def feed(self, seen: Seen) -> None:
        """Count beacons; requests and older numbers of others allow more."""
        while self._reasons and self._reasons[0][0] < seen.time - self._composed:
            self._reasons.popleft()
        for each in seen.heard.instructions():
            creation = self._creations.feed(each)
            if each.kind is ICType.CREATE_VARIABLES:
                self._rep_cnt[each.var_id] = each.record.spec.rep_cnt
            if each.kind in (ICType.CREATE_VARIABLES, ICType.UPDATES, ICType.DELETE_VARIABLES):
                self._sent(each, creation, seen)
            if each.kind is not ICType.DELETE_VARIABLES:
                # Whoever says anything else of a variable has it: it may be deleted another time.
                self._runs.pop((seen.sender, each.var_id, ICType.DELETE_VARIABLES), None)
                self._reason(each, seen)

    def _sent(self, each: Instruction, creation: int, seen: Seen) -> None:
        allowed = self._rep_cnt.get(each.var_id)
        if allowed is None:
            # Created before the recording began: nobody knows how often.
            return
        number = seqno_of(each) if each.kind is ICType.UPDATES else 0
        key = (seen.sender, each.var_id, each.kind)
        run = self._runs.get(key)
        if run is None or run[0] != creation or run[1] != number:
            if run is not None or len(self._runs) < MOST_VARIABLES:
                run = self._runs[key] = [creation, number, 1, allowed, 0]
                self._senders.setdefault((each.var_id, each.kind), set()).add(seen.sender)
                # A payload may have been composed a while before: what was said meanwhile counts for the next one.
                for _, node, reason in self._reasons:
                    if node != seen.sender and reason.var_id == each.var_id:
                        self._weigh(run, each.kind, reason, allowed)
            return
        run[2] += 1
        self.exercised()
        if run[2] > run[3]:
            text = (
                f"{name(seen.sender)}, variable {each.var_id}: {each.kind.label} {number} in {run[2]} beacons, "
                f"{run[3]} allowed"
            )
            answered = bool(run[4]) and each.kind is ICType.UPDATES
            if answered:
                text += f"; {run[4]} requests told the same number, which must not be answered"
            self.violated(text, [each], "VD-RU-03" if answered else "VD-SCP-02", once=(key, creation))

    def _reason(self, each: Instruction, seen: Seen) -> None:
        """What somebody says may be a reason for others to send again."""
        if len(self._reasons) < _PENDING:
            self._reasons.append((seen.time, seen.sender, each))
        allowed = self._rep_cnt.get(each.var_id, 0)
        for kind in (ICType.CREATE_VARIABLES, ICType.UPDATES):
            for node in self._senders.get((each.var_id, kind), ()):
                if node != seen.sender:
                    self._weigh(self._runs[node, each.var_id, kind], kind, each, allowed)

    def _weigh(self, run: list[int], kind: ICType, reason: Instruction, allowed: int) -> None:
        """Allow more, if this is a reason for that kind of instruction."""
        if kind is ICType.CREATE_VARIABLES:
            run[3] += allowed if reason.kind is ICType.REQUEST_VARCREATES else 0
        elif kind is ICType.UPDATES and reason.kind in (ICType.REQUEST_VARUPDATES, ICType.SUMMARIES, ICType.UPDATES):
            if self._circle.older(seqno_of(reason), run[1]):
                run[3] += allowed
            elif reason.kind is ICType.REQUEST_VARUPDATES and seqno_of(reason) == run[1]:
                run[4] += 1


class Requests(Invariant):
    """Nobody asks for what it has."""

    id = "CK_VD_REQUEST"
    section = "dcp-vardis.md: Global versus Local Dissemination"
    purpose = (
        "A node asks for the creation of variables that it does not have, and does not pass on the requests of others"
    )
    requirements = ("VD-SCP-01",)
    expect = "no request for a variable that the node has in the same payload, or has summarised right before"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._has: dict[tuple[bytes, int], Instruction] = {}
        self._asked: dict[tuple[bytes, int], list[int]] = {}
        self._producers: dict[int, bytes] = {}

    def feed(self, seen: Seen) -> None:
        """Compare requests with what the node last said."""
        for each in seen.heard.instructions():
            key = (seen.sender, each.var_id)
            if each.kind is ICType.REQUEST_VARCREATES:
                self.exercised()
                self._count(each, seen)
                has = self._has.get(key)
                restarted = has is not None and (seen.heard.seqno or 0) < (has.heard.seqno or 0)
                if has is not None and not restarted:
                    text = f"{name(seen.sender)} asks for variable {each.var_id}, which it has"
                    self.violated(text, [has, each], once=key)
            elif each.kind is ICType.DELETE_VARIABLES:
                self._has.pop(key, None)
            elif each.kind is not ICType.REQUEST_VARUPDATES and (key in self._has or len(self._has) < MOST_VARIABLES):
                self._has[key] = each
            if each.kind is ICType.CREATE_VARIABLES:
                self._producers[each.var_id] = each.record.spec.prod_id

    def _count(self, each: Instruction, seen: Seen) -> None:
        key = (seen.sender, each.var_id)
        if key in self._asked or len(self._asked) < MOST_VARIABLES:
            self._asked.setdefault(key, [0, each.heard.number])[0] += 1

    def finish(self) -> None:
        """Hazards of the design: requests that never end, and producers that ask for their own variables."""
        by_variable: dict[int, list[tuple[bytes, int, int]]] = {}
        for (node, var_id), (count, first) in self._asked.items():
            by_variable.setdefault(var_id, []).append((node, count, first))
            if self._producers.get(var_id) == node:
                text = f"{name(node)} asks {count} times for variable {var_id}, whose producer it is"
                self.note("a producer that has forgotten its own variable (H2)", text, [Mark(first)])
        for var_id, askers in by_variable.items():
            often = [each for each in askers if each[1] >= 10]
            if len(often) >= 2:
                who = ", ".join(f"{name(node)} {count} times" for node, count, _ in often)
                marks = [Mark(first) for _, _, first in often]
                self.note("nodes that ask each other for what neither has (H1)", f"variable {var_id}: {who}", marks)


RULES: tuple[type[Invariant], ...] = (
    Repetitions,
    Requests,
    AnswersUpdateRequests,
    AnswersCreateRequests,
    TakesUpdates,
)
