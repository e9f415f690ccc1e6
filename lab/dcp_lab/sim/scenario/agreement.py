"""Agreement of the nodes' databases, and the time until they agree after an event."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import msgspec


class Known(NamedTuple):
    """The state of an alive variable at a node."""

    producer: bytes
    creation_time: int | None
    seqno: int
    value: bytes


class Agreement:
    """Compares the alive variables of all present nodes, in constant time for each change.

    Unknown and deleted variables count as equal, because a node that joins late never receives a VarDelete. Absent
    nodes (switched off, or with VarDis deactivated) are not compared.
    """

    def __init__(self, nodes: int) -> None:
        self._known: list[dict[int, Known]] = [{} for _ in range(nodes)]
        self._present = [False] * nodes
        self._count = 0
        self._states: dict[int, dict[Known, int]] = {}
        """By variable the number of present nodes with each state."""
        self._disputed: set[int] = set()

    @property
    def reached(self) -> bool:
        """Whether all present nodes agree on all variables."""
        return not self._disputed

    @property
    def present(self) -> int:
        """Number of present nodes."""
        return self._count

    def known(self, node: int) -> Mapping[int, Known]:
        """Return the alive variables of a node."""
        return self._known[node]

    def enter(self, node: int, present: bool) -> None:
        """Set whether a node is present."""
        if self._present[node] == present:
            return
        self._present[node] = present
        self._count += 1 if present else -1
        for var_id, state in self._known[node].items():
            self._count_state(var_id, state, 1 if present else -1)
        for var_id in list(self._states):
            self._judge(var_id)

    def forget(self, node: int) -> None:
        """Remove all variables of a node."""
        for var_id in list(self._known[node]):
            self.learn(node, var_id, None)

    def learn(self, node: int, var_id: int, state: Known | None) -> None:
        """Set the state of a variable at a node; None if it is unknown or deleted there."""
        known, present = self._known[node], self._present[node]
        before = known.get(var_id)
        if state is not None:
            known[var_id] = state
        elif before is not None:
            del known[var_id]
        if present:
            if before is not None:
                self._count_state(var_id, before, -1)
            if state is not None:
                self._count_state(var_id, state, 1)
        self._judge(var_id)

    def replace(self, node: int, known: Mapping[int, Known]) -> None:
        """Replace all alive variables of a node."""
        for var_id in [var_id for var_id in self._known[node] if var_id not in known]:
            self.learn(node, var_id, None)
        for var_id, state in known.items():
            if self._known[node].get(var_id) != state:
                self.learn(node, var_id, state)

    def _count_state(self, var_id: int, state: Known, by: int) -> None:
        """Change the number of present nodes that have this state of a variable."""
        states = self._states.get(var_id)
        if states is None:
            states = self._states[var_id] = {}
        count = states.get(state, 0) + by
        if count:
            states[state] = count
        else:
            del states[state]

    def _judge(self, var_id: int) -> None:
        """Determine whether the present nodes agree on a variable."""
        states = self._states.get(var_id)
        if not states:
            self._states.pop(var_id, None)
            self._disputed.discard(var_id)
        elif len(states) == 1 and next(iter(states.values())) == self._count:
            self._disputed.discard(var_id)
        else:
            self._disputed.add(var_id)


class Convergence(msgspec.Struct):
    """An event, and how long it took until all databases agreed. Times are in ns.

    ``what``: description of the event. ``took``: None if the databases did not agree before the end of the run.
    """

    time: int
    what: str
    took: int | None = None


class ConvergenceClock:
    """Measures the time from each event until the databases agree."""

    def __init__(self) -> None:
        self.events: list[Convergence] = []
        self._open: list[Convergence] = []

    @property
    def pending(self) -> bool:
        """Whether the databases have not agreed yet since some event."""
        return bool(self._open)

    def event(self, time: int, what: str) -> None:
        """Start to measure the time of an event that changes the variables or the network."""
        # The measurement of earlier events continues: the databases may agree on several events at once.
        each = Convergence(time, what)
        self.events.append(each)
        self._open.append(each)

    def look(self, time: int, agreement: Agreement) -> None:
        """End all measurements if the databases agree now."""
        if self._open and agreement.reached:
            for each in self._open:
                each.took = time - each.time
            self._open.clear()
