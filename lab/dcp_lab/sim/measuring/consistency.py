"""The share of nodes that have the newest value of each variable, over time.

Under continuous updates the databases may never agree completely, although most nodes have the newest value most of
the time. Times are virtual ns, nodes are numbers from 0. The producer of a variable always has its newest value and is
not counted.
"""

from __future__ import annotations

import msgspec


class VariableConsistency(msgspec.Struct, frozen=True):
    """Shares for one variable of one producer.

    They cover the time from its creation or the end of the warm-up to its deletion or the end of the run.
    """

    variable: int
    producer: int
    seconds: float
    """Length of this time, as far as other nodes were present."""
    newest_share: float
    """Mean over this time of the share of the other nodes that had the newest value, 0..1."""
    complete_share: float
    """Share of this time in which all other nodes had the newest value, 0..1."""


class _Variable:
    """The newest value of a variable, the nodes that hold it, and the integrals so far."""

    __slots__ = ("alive", "area", "complete", "holders", "looked", "newest", "present_holders", "time")

    def __init__(self, now: int) -> None:
        self.newest: object = None
        self.holders: set[int] = set()
        self.present_holders = 0
        self.alive = True
        self.looked = now
        self.time = self.complete = 0
        self.area = 0.0


class Consistency:
    """Integrates the shares over time. Call its methods for each change, in order of time."""

    def __init__(self, nodes: int) -> None:
        self._variables: dict[tuple[int, int], _Variable] = {}
        self._present = [False] * nodes
        self._count = 0
        self._held: list[dict[tuple[int, int], object]] = [{} for _ in range(nodes)]

    def born(self, now: int, producer: int, var_id: int, value: object) -> None:
        """Note that a producer created or updated a variable; no other node has the new value yet."""
        key = (producer, var_id)
        variable = self._variables.get(key)
        if variable is None:
            variable = self._variables[key] = _Variable(now)
        self._settle(key, variable, now)
        variable.newest = value
        variable.alive = True
        variable.holders.clear()
        variable.present_holders = 0

    def holds(self, now: int, node: int, producer: int, var_id: int, value: object) -> None:
        """Note that a node stored this value."""
        key = (producer, var_id)
        self._held[node][key] = value
        variable = self._variables.get(key)
        if variable is None or node == producer:
            return
        if (value is variable.newest) != (node in variable.holders):
            self._settle(key, variable, now)
            if value is variable.newest:
                variable.holders.add(node)
                variable.present_holders += self._present[node]
            else:
                self._drop(variable, node)

    def lost(self, now: int, node: int, var_id: int) -> None:
        """Note that a node no longer has the variable; if it is the producer, the variable's time ends."""
        for key in [key for key in self._held[node] if key[1] == var_id]:
            del self._held[node][key]
            variable = self._variables.get(key)
            if variable is not None and node in variable.holders:
                self._settle(key, variable, now)
                self._drop(variable, node)
        own = self._variables.get((node, var_id))
        if own is not None and own.alive:
            self._settle((node, var_id), own, now)
            own.alive = False

    def enter(self, now: int, node: int, present: bool) -> None:
        """Note that a node is present (switched on, with active VarDis) from now on, or absent."""
        if self._present[node] == present:
            return
        self.settle(now)
        self._present[node] = present
        by = 1 if present else -1
        self._count += by
        for key in self._held[node]:
            variable = self._variables.get(key)
            if variable is not None and node in variable.holders:
                variable.present_holders += by

    def forget(self, now: int, node: int) -> None:
        """Note that a node lost its memory. The measurement of the variables that it produces continues."""
        for key in self._held[node]:
            variable = self._variables.get(key)
            if variable is not None and node in variable.holders:
                self._settle(key, variable, now)
                self._drop(variable, node)
        self._held[node].clear()

    def settle(self, now: int) -> None:
        """Integrate up to now."""
        for key, variable in self._variables.items():
            self._settle(key, variable, now)

    def restart(self, now: int) -> None:
        """Set all integrals to zero, at the end of the warm-up."""
        for variable in self._variables.values():
            variable.looked, variable.time, variable.complete, variable.area = now, 0, 0, 0.0

    def found(self, now: int) -> list[VariableConsistency]:
        """Return the shares up to now, sorted by variable and producer.

        Variables that existed only while no other node was present are left out.
        """
        self.settle(now)
        return [
            VariableConsistency(
                variable=var_id,
                producer=producer,
                seconds=each.time / 1e9,
                newest_share=each.area / each.time,
                complete_share=each.complete / each.time,
            )
            for (producer, var_id), each in sorted(self._variables.items(), key=lambda item: item[0][::-1])
            if each.time
        ]

    def _drop(self, variable: _Variable, node: int) -> None:
        """Remove a node from the holders of the newest value."""
        variable.holders.discard(node)
        variable.present_holders -= self._present[node]

    def _settle(self, key: tuple[int, int], variable: _Variable, now: int) -> None:
        """Integrate one variable up to now."""
        elapsed, variable.looked = now - variable.looked, now
        others = self._count - self._present[key[0]]
        if not elapsed or not variable.alive or not others:
            return
        variable.time += elapsed
        variable.area += elapsed * variable.present_holders / others
        if variable.present_holders == others:
            variable.complete += elapsed
