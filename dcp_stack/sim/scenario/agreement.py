"""Do the databases agree, and how long did it take them?"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import NamedTuple

import msgspec


class Known(NamedTuple):
    """What a node knows about a variable that is alive."""

    producer: bytes
    creation_time: int | None
    seqno: int
    value: bytes


class Agreement:
    """Compares what nodes know about variables that are alive, in constant time for each change.

    A variable that a node does not know and one that it knows as deleted are the same: those who come late never hear
    of deletions. Nodes that are absent (switched off, or VarDis deactivated) are not asked.
    """

    def __init__(self, nodes: int) -> None:
        self._known: list[dict[int, Known]] = [{} for _ in range(nodes)]
        self._present = [False] * nodes
        self._count = 0
        self._states: dict[int, Counter[Known]] = {}
        self._disputed: set[int] = set()

    @property
    def reached(self) -> bool:
        """Whether all who are present agree on all variables."""
        return not self._disputed

    @property
    def disputed(self) -> list[int]:
        """The variables that they do not agree on."""
        return sorted(self._disputed)

    @property
    def present(self) -> int:
        """How many nodes are asked."""
        return self._count

    def known(self, node: int) -> Mapping[int, Known]:
        """What a node knows."""
        return self._known[node]

    def enter(self, node: int, present: bool) -> None:
        """A node is there from now on, or not."""
        if self._present[node] == present:
            return
        self._present[node] = present
        self._count += 1 if present else -1
        for var_id, state in self._known[node].items():
            self._count_state(var_id, state, 1 if present else -1)
        for var_id in list(self._states):
            self._judge(var_id)

    def forget(self, node: int) -> None:
        """A node knows nothing any more."""
        for var_id in list(self._known[node]):
            self.learn(node, var_id, None)

    def learn(self, node: int, var_id: int, state: Known | None) -> None:
        """What a node knows about a variable now; None if it is not alive for it."""
        known, present = self._known[node], self._present[node]
        before = known.pop(var_id, None)
        if present and before is not None:
            self._count_state(var_id, before, -1)
        if state is not None:
            known[var_id] = state
            if present:
                self._count_state(var_id, state, 1)
        self._judge(var_id)

    def replace(self, node: int, known: Mapping[int, Known]) -> None:
        """All that a node knows."""
        for var_id in [var_id for var_id in self._known[node] if var_id not in known]:
            self.learn(node, var_id, None)
        for var_id, state in known.items():
            if self._known[node].get(var_id) != state:
                self.learn(node, var_id, state)

    def _count_state(self, var_id: int, state: Known, by: int) -> None:
        states = self._states.setdefault(var_id, Counter())
        states[state] += by
        if not states[state]:
            del states[state]

    def _judge(self, var_id: int) -> None:
        states = self._states.get(var_id)
        if not states:
            self._states.pop(var_id, None)
            self._disputed.discard(var_id)
        elif len(states) == 1 and next(iter(states.values())) == self._count:
            self._disputed.discard(var_id)
        else:
            self._disputed.add(var_id)


class Convergence(msgspec.Struct):
    """How long after an event all databases agreed; ``took`` None: they did not before the next event or the end.

    Times are ns.
    """

    time: int
    what: str
    took: int | None = None


class ConvergenceClock:
    """Stops the time from each event until the databases agree."""

    def __init__(self) -> None:
        self.events: list[Convergence] = []
        self._open: list[Convergence] = []

    @property
    def pending(self) -> bool:
        """Whether there is an event since which they did not agree."""
        return bool(self._open)

    def event(self, time: int, what: str) -> None:
        """Something happened that the databases have to come to terms with."""
        # The time of an event that is overtaken by the next one goes on: they may agree on both at once.
        each = Convergence(time, what)
        self.events.append(each)
        self._open.append(each)

    def look(self, time: int, agreement: Agreement) -> None:
        """Look whether they agree now."""
        if self._open and agreement.reached:
            for each in self._open:
                each.took = time - each.time
            self._open.clear()
